"""The server: receives frames and commands, publishes scenes; one thread tracks, the others only transfer.

bus threads ──► inbox ──► tracker thread ──► bus (scenes), recorder (scenes and their frames)
          └───► recorder                 ▲ commands, in the order of arrival
record path thread: acknowledges stored frames to the nodes, and requests missing ones
housekeeping thread: silent sensors, status
clock thread: clock probes, which a node may not answer
notices thread: prints notices, because a terminal may block

No message or command ends a thread: each turn of a loop is within a `Boundary`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from mocapella import __version__
from mocapella.calibration.sensor_layout import SensorLayout
from mocapella.errors import MocapellaError, NotNowError, SettingsError, WireError, one_of
from mocapella.live.clock_watch import ClockWatch
from mocapella.live.command_queue import Answer, CommandQueue, WaitingCommand
from mocapella.live.door import Door
from mocapella.live.health import HealthWatch
from mocapella.live.inbox import Inbox, ReceivedMessage
from mocapella.live.notices import Notices
from mocapella.live.recording_service import RecordingService, outcome
from mocapella.live.sensor_registry import SensorRegistry
from mocapella.live.session import Session
from mocapella.live.state_notices import StateNotices
from mocapella.live.study_service import StudyRecording, StudyService, StudyStore
from mocapella.live.summary import RunSummary
from mocapella.live.wall_clock import WallClock
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import CommandReply, RecordingHealth, ServerHealth, SessionStatus, Setup
from mocapella.recording.disk import ensure_folder, folder_problem, free_name, next_name, take_path
from mocapella.schema import SceneEncoder, decode_frame
from mocapella.supervision import Boundary
from mocapella.wire.expected import write_expected
from mocapella.wire.keys import NodeKey
from mocapella.wire.server import ServerLink

STATUS_EVERY_S = 0.2
_COMMANDS_A_TURN = 4
"""Largest number of commands that are carried out between two frames."""


@dataclass(frozen=True)
class ServerSettings:
    """Settings of a server.

    Attributes:
        listen: address to listen at, ``[SESSION@]tls/HOST:PORT``; unused if the server gets a link.
        takes: folder for takes named by commands.
        setup: the session's initial configuration.
        running: whether tracking begins at once.
        method_settings: settings of the tracker's method.
        reserve_bytes: free disk space that a recording leaves.
        layout: the sensors' poses of the last session; None if unknown.
        waiting_for: if tracking cannot begin yet, the reason, shown until `Server.ready`; ``start`` is refused with it.
        log: file of the structured log, named in the status; empty if there is none.
        record: take to record from the start, before any node is admitted; one that was interrupted is continued. None
            records none.
        study: where a study's session is kept, which the server runs; None without a study.
    """

    listen: str
    takes: Path = Path("takes")
    setup: Setup = field(default_factory=Setup)
    running: bool = True
    method_settings: dict[str, Any] = field(default_factory=dict)
    reserve_bytes: int = 1 << 30
    layout: SensorLayout | None = None
    waiting_for: str = ""
    log: str = ""
    record: Path | None = None
    study: StudyStore | None = None


class Server:
    """A session on the bus: receives frames, tracks, and publishes scenes, from the constructor on until `close`.

    Args:
        settings: settings of the server.
        say: called with the text of each notice, all on one thread of its own.
        link: a link that listens already, which the server closes; None opens one at ``settings.listen``.
        failed: event for the attribute ``failed``, which other threads of the process may set, too; None makes one.

    Attributes:
        summary: statistics of the run.
        failed: event that is set when a thread has ended with an unexpected error; close the server then. `close`
            waits for nothing but the disk from then on.

    Raises:
        AddressInUseError, BusError: it cannot listen at the address.
        SettingsError: the setup or the method's settings are invalid.
        TakeExistsError, DiskFullError, RecordingError: the take of the settings cannot be recorded.
    """

    def __init__(
        self,
        settings: ServerSettings,
        say: Callable[[str], None] = lambda text: None,
        link: ServerLink | None = None,
        failed: threading.Event | None = None,
    ) -> None:
        self._settings = settings
        self._session = Session(
            settings.setup,
            settings.method_settings,
            running=settings.running,
            layout=settings.layout,
            waiting_for=settings.waiting_for,
        )
        self._revision = self._nonsense = self._tracked = 0
        self._inbox = Inbox()
        self._commands = CommandQueue()
        self._encoder = SceneEncoder()
        self._registry = SensorRegistry()
        self._lock = threading.RLock()
        self._stepping = threading.RLock()
        self._ended = threading.Event()
        self.failed = failed or threading.Event()
        self._began = time.monotonic()
        self.summary = RunSummary(began_ns=time.monotonic_ns())
        self._health = HealthWatch(settings.takes, settings.reserve_bytes, settings.log)
        self._wall_clock = WallClock()
        self._notices = Notices(say)
        self._errors = Boundary(self._note)
        self._states = StateNotices(self.summary, self._note)
        self._finishing: list[threading.Thread] = []
        self._study: StudyService | None = None
        with ExitStack() as undo:  # if the construction fails
            undo.callback(self._notices.close)
            if settings.record is None and (problem := folder_problem(settings.takes)):
                self._note(f"takes cannot be recorded: {problem}; start with another folder (--set takes=FOLDER)")
            self._link = link or ServerLink(settings.listen, on_nonsense=self._on_nonsense)
            if link is None:
                undo.callback(self._link.close)
            self._serve(undo)
            undo.pop_all()
        clocks = ClockWatch(self._link, self._registry, self._lock, self._recording, self._errors)
        loops = {
            "tracker": self._track, "housekeeping": self._housekeeping, "clocks": partial(clocks.run, self._ended)
        }  # fmt: skip
        self._threads = [threading.Thread(target=self._guarded, args=(run,), name=name) for name, run in loops.items()]
        for thread in self._threads:
            thread.start()

    def _serve(self, undo: ExitStack) -> None:
        """Begin the take of the settings, and only then admit nodes, so that the take has their first frames."""
        self._link.on_nonsense, self._link.on_refused = self._on_nonsense, self._note_foreign
        self._link.errors = self._errors
        door = Door(self._registry, self._lock, self._inbox, self._commands, lambda: self._recording,
                    full=self._health.full, refused=self._note_foreign)  # fmt: skip
        self._recording = RecordingService(
            self._session,
            self._link,
            self._connected,
            self._note,
            reserve_bytes=self._settings.reserve_bytes,
            between_steps=self._stepping,
            hurry=self.failed,
        )
        undo.callback(self._recording.interrupt)
        if self._settings.record is not None:
            self._recording.begin(self._settings.record, resume=True)
        if self._settings.study is not None:
            self._study = StudyService(self._settings.study, self._for_study(), time.time_ns)
            undo.callback(self._study.close)
            if note := self._study.go_on():
                self._note(note)
        self._link.serve(
            on_frame=door.frame,
            on_truth=door.truth,
            on_alive=door.alive,
            on_command=door.command,
            on_join=door.join,
            on_leave=door.leave,
        )

    def _connected(self) -> list[NodeKey]:
        with self._lock:
            return self._registry.connected()

    def _guarded(self, run: Callable[[], None]) -> None:
        try:
            run()
        finally:
            if not self._ended.is_set():
                self.failed.set()

    # The tracker's thread.

    def _track(self) -> None:
        while not self._ended.is_set():
            message = self._inbox.take(timeout=0.1)
            self._errors.run("turn of the tracker", partial(self._turn, message))

    def _turn(self, message: ReceivedMessage | None) -> None:
        with self._stepping:
            if self._study is not None:
                self._errors.run("study", self._study.beat)
            for _ in range(_COMMANDS_A_TURN):
                command = self._commands.take()
                if command is None:
                    break
                problem = self._errors.run("command", partial(self._carry_out, command))
                if problem:
                    self._answer(command.answer, CommandReply(False, problem, self.status()))
            else:
                self._inbox.wake()
            if message is None:
                return
            problem = self._errors.run("frame", partial(self._step, message))
            if problem:
                self._reject(message, problem)
                self._errors.run("snapshot after an error", self._record_memory)

    def _record_memory(self) -> None:
        """Record the tracker's snapshot after an error, so that the take's replay continues from it."""
        if self._recording.recorder is not None:
            self._recording.record_command("restore", self._session.memory())

    def _reject(self, message: ReceivedMessage, reason: str) -> None:
        self.summary.rejected += 1
        with self._lock:
            if message.stranger:
                self._registry.admit(message.node, message.arrived_ns, quiet=True)
            self._registry.rejected(message.node, reason)

    def _step(self, message: ReceivedMessage) -> None:
        try:
            frame = decode_frame(message.data)
            if frame.key[:2] != message.node:
                raise WireError(f"a frame of {frame.sensor}/{frame.node_id:016x} came under another node's key")
            with self._lock:
                if message.stranger:
                    self._registry.admit(message.node, message.arrived_ns, proven=True)
                if not self._registry.holds(message.node):
                    return
                at_ns = self._registry.arrived(frame, message.node, message.arrived_ns)
        except WireError as error:
            self._reject(message, str(error))
            return
        self.summary.frames_in += 1
        recorder = self._recording.recorder
        if recorder is not None:  # here at the latest, so that a take has the frames of all its scenes
            recorder.frame(message.node, message.data, message.arrived_ns, frame.sequence)
        scene = self._session.step(Arrival(frame, at_ns))
        if scene is None:
            self.summary.untracked += 1
            return
        data = self._encoder.encode(scene)
        self._link.publish_scene(data)
        done_ns = time.monotonic_ns()
        if recorder is not None:
            recorder.scene(data, message.arrived_ns)
        with self._lock:
            latency = self._registry.finished(message.node, frame.sent_ns, done_ns)
            if self._session.problem:
                self.summary.rejected += 1
                self._registry.rejected(message.node, f"a frame cannot be tracked: {self._session.problem}")
        self.summary.scene(scene, latency, done_ns)
        self._errors.run("expected people", partial(self._tell_expected, message.node, frame))
        self._tracked += scene.state.phase is Phase.TRACKING and bool(scene.people)
        self._watch_state()

    def _tell_expected(self, node: NodeKey, frame: SensorFrame) -> None:
        """Tell the node of a frame where people are expected in its next image, if it wants to know."""
        if self._link.awaits_expected(node):
            regions = self._session.expected(node.sensor)
            if regions is not None:
                self._link.publish_expected(node, write_expected(frame.time_ns, regions))

    def _watch_state(self) -> None:
        self._states.update(self._session.state, time.monotonic() - self._began)

    def _carry_out(self, command: WaitingCommand) -> None:
        try:
            if command.verb == "record-stop":
                self._stop_recording(command.answer)
                if command.sender:
                    self._note_foreign(f"end of the take ({command.sender})")
                return
            message = self._do(command.verb, command.arguments, command.sender)
        except MocapellaError as error:
            self._note_foreign(f"{command.verb} was refused: {error}")
            self._answer(command.answer, CommandReply(False, str(error), self.status()))
            return
        self._watch_state()
        self._answer(command.answer, CommandReply(True, message, self.status()))

    def _do(self, verb: str, arguments: dict[str, Any], by: str = "") -> str:
        if verb == "status":
            return ""
        if verb == "record":
            message = self._record_by_name(arguments)
        elif verb == "name" and self._study is not None:
            raise NotNowError("people of a study have codes, and no name comes into its takes")
        elif verb in self._session.verbs:
            message = self._session.carry_out(verb, arguments)
            if verb == "start":
                with self._lock:
                    self._registry.tracking_began()
            self._recording.record_command(verb, arguments, by)
        elif self._study is not None and verb in self._study.verbs:
            message = self._study.carry_out(verb, arguments)
        else:
            known = (
                "status",
                "record",
                "record-stop",
                *self._session.verbs,
                *(self._study.verbs if self._study else ()),
            )
            raise SettingsError(f"unknown command {verb!r}; known: {one_of(verb, known)}")
        self._revision += 1
        self._note(f"{message} ({by})" if by else message)
        return message

    def _answer(self, answer: Answer, reply: CommandReply) -> None:
        answer(msgspec.json.encode(reply))
        self._link.publish_status(msgspec.json.encode(reply.status))

    def record_to(self, path: Path, *, resume: bool = False) -> str:
        """Start a take at ``path``, and return a message; with ``resume``, continue an interrupted one.

        Raises:
            NotNowError: a take is being recorded already.
            TakeExistsError, DiskFullError, RecordingError: before anything is created.
        """
        with self._stepping:  # the take begins with a snapshot between two steps
            with self._lock:
                newest = self._registry.newest()
            return self._recording.begin(path, resume=resume, newest=newest)

    def wait_for(self, reason: str) -> None:
        """Give another reason of the wait, in place of `ServerSettings.waiting_for`; without effect after `ready`."""
        with self._stepping:  # between two steps
            self._session.wait_for(reason)

    def ready(self, *, begin: bool) -> None:
        """End the wait of `ServerSettings.waiting_for`; with ``begin``, start tracking unless it runs already."""
        with self._stepping:  # between two steps
            self._session.ready()
            if begin and not self._session.running:
                self._do("start", {})
                self._watch_state()

    def layout(self) -> SensorLayout | None:
        """Return the sensors' poses, to be used by a later session; None while they are unknown."""
        with self._stepping:  # between two steps
            return self._session.layout_now()

    def _record_by_name(self, arguments: dict[str, Any]) -> str:
        name = arguments.get("name")
        if not isinstance(name, str):
            raise SettingsError('record needs the name of the take, such as {"name": "walk-1"}')
        ensure_folder(self._settings.takes)
        return self.record_to(take_path(self._settings.takes, name))

    def _for_study(self) -> StudyRecording:
        def set_up(setup: Setup) -> None:
            self._session.set_up(setup)
            self._recording.record_command("setup", asdict(setup))

        return StudyRecording(
            setup=lambda: self._session.setup,
            set_up=set_up,
            recalibrate=lambda: self._session.running and self._do("recalibrate", {}),
            record=lambda path: self.record_to(path, resume=True),
            end_take=self._end_take,
            note=self._recording.record_command,
            results=lambda: self._tracked,
        )

    def _end_take(self) -> None:
        take = Path(self._recording.health().path)
        if self._recording.recorder is not None:
            self._finish_take(lambda reply: self._keep(take))

    def _keep(self, take: Path) -> None:
        """Have the study keep a take that has ended."""
        try:
            if self._settings.study is not None:
                self._settings.study.keep(take)
        except MocapellaError as error:
            self._note(str(error))

    def _stop_recording(self, answer: Answer) -> None:
        if self._recording.recorder is None:
            raise NotNowError("not recording; begin a take first")
        self._finish_take(lambda reply: self._answer(answer, reply))

    def _finish_take(self, then: Callable[[CommandReply], object]) -> None:
        """Finish the take on a thread of its own: it waits for late frames and the disk, and the tracker must not."""

        def finish() -> None:
            problem = self._errors.run("end of the take", self._recording.finish)
            health = self._recording.health()
            problem = problem or health.problem
            self._revision += 1
            then(CommandReply(not problem, problem or outcome(health), self.status()))

        self._finishing = [thread for thread in self._finishing if thread.is_alive()]
        self._finishing.append(
            threading.Thread(target=self._errors.wrap("end of the take", finish), name="finish-take")
        )
        self._finishing[-1].start()

    # Housekeeping.

    def _housekeeping(self) -> None:
        while not self._ended.wait(STATUS_EVERY_S):
            self._errors.run("housekeeping", self._keep_house)

    def _keep_house(self) -> None:
        with self._lock:
            self._registry.notice_silence(time.monotonic_ns())
            notices = self._registry.take_notices()
        for notice in notices:
            self._note_foreign(notice)
        self._recording.tell_closed()
        step = self._wall_clock.step()
        if step:
            self._note(step)
        self._notices.beat()
        self._health.beat(self._recording.health().path)
        status = self.status()
        self._link.publish_status(msgspec.json.encode(status))
        recorder = self._recording.recorder
        if recorder is not None:
            recorder.status(replace(status, study=None), time.monotonic_ns())  # the events say more, in less room

    def _note(self, text: str) -> None:
        self._notices.add(text)

    def _note_foreign(self, text: str) -> None:
        """Add a notice that any program on the bus can cause at will; its rate is limited."""
        self._notices.add(text, foreign=True)

    def _on_nonsense(self, text: str) -> None:
        self._nonsense += 1
        self._note_foreign(text)

    def part_ended(self, part: str) -> None:
        """Report that a part of the session, such as the view, has ended by itself; the server goes on."""
        self._health.ended(part)

    def server_health(self) -> ServerHealth:
        """Return the state of the server itself."""
        turned_away = {
            "messages with an invalid key or invalid arguments": self._nonsense,
            "messages of unknown nodes": self._inbox.strangers_dropped,
            "sensors": self._registry.turned_away,
            "commands": self._commands.refused,
            "notices": self._notices.left_out,
            "attempts with a key of another session": self._link.refused,
        }
        return self._health.health(self._errors.counts, turned_away, self.summary.latency_ms() or {})

    def status(self) -> SessionStatus:
        """Return the session's present state, for a view or a script."""
        now_ns = time.monotonic_ns()
        recorder = self._recording.recorder
        stored, lost = recorder.stored_and_lost() if recorder is not None else ({}, {})
        session = self._session
        state = session.state
        recording = self._recording.health()
        take = next_name(Path(recording.path).stem) if recording.path else "take-1"
        with self._lock:
            for node, frames in self._inbox.take_skipped().items():
                self._registry.fell_behind(node, frames)
            sensors = self._registry.health(now_ns, session.setup, stored, lost, self.summary.places)
        return SessionStatus(
            revision=self._revision,
            running=session.running,
            phase=state.phase.value,
            sensors_missing=state.sensors_missing,
            frames_remaining=state.frames_remaining,
            frames_wanted=state.frames_wanted,
            reason=state.reason,
            counts={name: count for name, count in self.summary.counts.items() if session.running},
            people_conditions=self.summary.people_conditions if session.running else (),
            scenes=self.summary.scenes_out,
            scenes_hz=round(self.summary.rate_hz(now_ns), 1),
            setup=session.setup,
            sensors=tuple(sensors),
            recording=recording,
            notices=self._notices.newest,
            uptime=round(time.monotonic() - self._began, 2),
            version=__version__,
            next_take=free_name(self._settings.takes, take),
            health=self.server_health(),
            study=None if self._study is None else self._study.status(),
        )

    def halt(self) -> None:
        """Stop tracking and housekeeping: from now on, `status` and `summary` give the session's result."""
        self._ended.set()
        self._inbox.wake()
        for thread in self._threads:  # no command may start another take afterwards
            thread.join()
        if self._study is not None:
            self._study.close()
            self._study = None
        self.summary.errors = self._errors.counts

    def close(self) -> RecordingHealth:
        """Finish the take, leave the bus, and return the result of the last take.

        After a failure the take is closed first and at once, without missing frames, because the process exits soon.
        """
        if self.failed.is_set():
            self._ended.set()
            self._recording.finish()
        self.halt()
        ends_now = self._recording.recorder is not None and not self.failed.is_set()
        health = self._recording.finish()
        for thread in self._finishing:
            thread.join()
        if ends_now and not self.failed.is_set():  # else a later process goes on with it
            self._keep(Path(health.path))
        self._link.close()
        self._notices.close()
        return health
