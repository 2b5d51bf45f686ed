"""The server: receives frames and commands, publishes scenes; one thread tracks, the others only transfer.

bus threads ──► inbox ──► tracker thread ──► bus (scenes), recorder (scenes and their frames)
          └───► recorder (record path)   ▲ commands, in the order of arrival
housekeeping thread: silent sensors, status, missing frames of a take
clock thread: clock probes, which a node may not answer
"""

from __future__ import annotations

import platform
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from mocapella import __version__
from mocapella.calibration.sensor_layout import SensorLayout
from mocapella.errors import MocapellaError, NotNowError, SettingsError, WireError, one_of
from mocapella.live.inbox import Inbox, ReceivedMessage
from mocapella.live.recording_service import RecordingService, outcome
from mocapella.live.sensor_registry import SensorRegistry
from mocapella.live.session import Session
from mocapella.live.summary import RunSummary
from mocapella.model.observations import Arrival, check_sensor_name
from mocapella.model.scene import Phase
from mocapella.model.session import CommandReply, RecordingHealth, SessionStatus, Setup
from mocapella.recording.disk import ensure_folder, free_name, next_name, take_path
from mocapella.schema import decode_frame, encode_scene
from mocapella.wire.clock import estimate_offset
from mocapella.wire.keys import NodeKey, parse_node_id
from mocapella.wire.node import JoinReply
from mocapella.wire.server import Answer, ServerLink

STATUS_EVERY_S = 0.2
PROBE_EVERY_S = 1.0
CONDITION_AGAIN_S = 10.0
"""A condition that returns within this time is not reported again [s]."""
_MAX_NOTICE = 500
"""Longest notice, in characters; its text may come from any node, and every status has it."""


@dataclass(frozen=True)
class ServerSettings:
    """Settings of a server.

    Attributes:
        listen: the bus address.
        takes: folder for takes named by commands.
        setup: the initial one.
        running: whether tracking begins at once.
        method_settings: settings of the tracker's method.
        reserve_bytes: free disk space that a recording leaves.
        layout: the sensors' poses of the last session.
        waiting_for: if tracking cannot begin yet, the reason, shown until `Server.ready`; ``start`` is refused with it.
    """

    listen: str
    takes: Path = Path("takes")
    setup: Setup = field(default_factory=Setup)
    running: bool = True
    method_settings: dict[str, Any] = field(default_factory=dict)
    reserve_bytes: int = 1 << 30
    layout: SensorLayout | None = None
    waiting_for: str = ""


class Server:
    """A session on the bus; it listens from the constructor on, until `close`.

    ``say`` is called with each notice, on any thread.

    Attributes:
        summary: statistics of the run.
        failed: set when a thread of the server has ended with an unexpected error; close the server then.

    Raises:
        AddressInUseError, BusError: it cannot listen at the address.
        SettingsError: the setup or the method's settings are invalid.
    """

    def __init__(self, settings: ServerSettings, say: Callable[[str], None] = lambda text: None) -> None:
        self._settings = settings
        self._say = say
        self._session = Session(
            settings.setup,
            settings.method_settings,
            running=settings.running,
            layout=settings.layout,
            waiting_for=settings.waiting_for,
        )
        self._phase = ""
        self._reason = ""
        self._reported: dict[str, float] = {}
        self._revision = 0
        self._notices: deque[str] = deque(maxlen=8)
        self._inbox = Inbox()
        self._commands: queue.SimpleQueue[tuple[str, dict[str, Any], Answer]] = queue.SimpleQueue()
        self._registry = SensorRegistry()
        self._lock = threading.RLock()
        self._stepping = threading.RLock()
        self._ended = threading.Event()
        self.failed = threading.Event()
        self._began = time.monotonic()
        self.summary = RunSummary(began_ns=time.monotonic_ns())
        self._link = ServerLink(settings.listen, on_nonsense=self._note)
        self._recording = RecordingService(
            self._session,
            self._link,
            self._on_recorded_frame,
            self._note,
            reserve_bytes=settings.reserve_bytes,
            between_steps=self._stepping,
        )
        self._link.serve(
            on_frame=self._on_frame, on_truth=self._on_truth, on_alive=self._on_alive, on_command=self._on_command
        )
        loops = (self._track, self._housekeeping, self._watch_clocks)
        self._finishing: list[threading.Thread] = []
        self._threads = [threading.Thread(target=self._guarded, args=(run,), name=run.__name__) for run in loops]
        for thread in self._threads:
            thread.start()

    # On the bus's threads: only pass on.

    def _on_frame(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        if self._admit(node, arrived_ns):
            self._inbox.put(ReceivedMessage(node, data, arrived_ns))

    def _on_recorded_frame(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        recorder = self._recording.recorder
        if recorder is not None and self._admit(node, arrived_ns):
            recorder.frame(node, data, arrived_ns)

    def _on_truth(self, node: NodeKey, data: bytes, arrived_ns: int) -> None:
        recorder = self._recording.recorder
        if recorder is not None and self._admit(node, arrived_ns):
            recorder.truth(node.sensor, data, arrived_ns)

    def _on_alive(self, node: NodeKey, alive: bool) -> None:
        with self._lock:
            self._registry.set_connected(node, alive, time.monotonic_ns())
        if not alive:
            self._inbox.forget(node)

    def _on_command(self, verb: str, arguments: dict[str, Any], answer: Answer) -> None:
        if verb == "join":
            answer(msgspec.json.encode(self._join(arguments)))
            return
        self._commands.put((verb, arguments, answer))
        self._inbox.wake()

    def _admit(self, node: NodeKey, now_ns: int) -> bool:
        with self._lock:
            return self._registry.admit(node, now_ns) == ""

    def _join(self, arguments: dict[str, Any]) -> JoinReply:
        try:
            sensor = check_sensor_name(str(arguments.get("sensor"))[:80])
            node = NodeKey(sensor, parse_node_id(str(arguments.get("node_id"))))
        except (SettingsError, WireError) as error:
            return JoinReply(False, str(error))
        with self._lock:
            refusal = self._registry.admit(node, time.monotonic_ns())
            self._registry.set_local(node, arguments.get("machine") == platform.node())
        return JoinReply(not refusal, refusal)

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
            with self._stepping:
                while not self._commands.empty():
                    self._carry_out(*self._commands.get())
                if message is not None:
                    self._step(message)

    def _step(self, message: ReceivedMessage) -> None:
        try:
            frame = decode_frame(message.data)
            if frame.key[:2] != message.node:
                raise WireError(f"a frame of {frame.sensor}/{frame.node_id:016x} came under another node's key")
            with self._lock:
                if not self._registry.holds(message.node):
                    return
                at_ns = self._registry.arrived(frame, message.node, message.arrived_ns)
        except WireError as error:
            self.summary.rejected += 1
            with self._lock:
                self._registry.rejected(message.node, str(error))
            return
        self.summary.frames_in += 1
        recorder = self._recording.recorder
        if recorder is not None:  # here at the latest, so that a take has the frames of all its scenes
            recorder.frame(message.node, message.data, message.arrived_ns)
        scene = self._session.step(Arrival(frame, at_ns))
        if scene is None:
            return
        data = encode_scene(scene)
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
        self._watch_state()

    def _watch_state(self) -> None:
        state = self._session.state
        if state.phase.value != self._phase:
            self._phase = state.phase.value
            self.summary.state(time.monotonic() - self._began, self._phase, state.reason)
            self._note(self._phase + (f": {self.summary.in_words(state.reason)}" if state.reason else ""))
        elif state.phase is Phase.TRACKING and state.reason != self._reason:
            self._note_conditions(state.reason, time.monotonic())
        self._reason = state.reason

    def _note_conditions(self, reason: str, now_s: float) -> None:
        """Report conditions while tracking; one that keeps returning is not reported each time."""
        self._reported = {text: at_s for text, at_s in self._reported.items() if now_s - at_s < CONDITION_AGAIN_S}
        for text in self.summary.in_words(reason).split("; "):
            if text and not text.endswith(": silent") and text not in self._reported:  # silence: see the registry
                self._reported[text] = now_s
                self._note(text)

    def _carry_out(self, verb: str, arguments: dict[str, Any], answer: Answer) -> None:
        try:
            if verb == "record-stop":
                self._stop_recording(answer)
                if answer.sender:
                    self._note(f"end of the take ({answer.sender})")
                return
            message = self._do(verb, arguments, answer.sender)
        except MocapellaError as error:
            self._note(f"{verb} was refused: {error}")
            self._answer(answer, CommandReply(False, str(error), self.status()))
            return
        self._watch_state()
        self._answer(answer, CommandReply(True, message, self.status()))

    def _do(self, verb: str, arguments: dict[str, Any], by: str = "") -> str:
        if verb == "status":
            return ""
        if verb == "record":
            message = self._record_by_name(arguments)
        elif verb in self._session.verbs:
            message = self._session.carry_out(verb, arguments)
            if verb == "start":
                with self._lock:
                    self._registry.tracking_began()
            self._recording.record_command(verb, arguments, by)
        else:
            known = ("status", "record", "record-stop", *self._session.verbs)
            raise SettingsError(f"unknown command {verb!r}; known: {one_of(verb, known)}")
        self._revision += 1
        self._note(f"{message} ({by})" if by else message)
        return message

    def _answer(self, answer: Answer, reply: CommandReply) -> None:
        answer(msgspec.json.encode(reply))
        self._link.publish_status(msgspec.json.encode(reply.status))

    def record_to(self, path: Path, *, resume: bool = False) -> str:
        """Start a take at ``path``; with ``resume``, continue an interrupted one.

        Raises:
            NotNowError: a take is being recorded already.
            TakeExistsError, DiskFullError, RecordingError: before anything is created.
        """
        with self._stepping:  # the take begins with a snapshot between two steps
            with self._lock:
                newest = self._registry.newest()
            return self._recording.begin(path, resume=resume, newest=newest)

    def ready(self, *, begin: bool) -> None:
        """End the wait of `ServerSettings.waiting_for`; with ``begin``, start tracking, unless it was started."""
        with self._stepping:  # between two steps
            self._session.ready()
            if begin and not self._session.running:
                self._do("start", {})
                self._watch_state()

    def layout(self) -> SensorLayout | None:
        """Return the sensor layout; None while it is unknown."""
        with self._stepping:  # between two steps
            return self._session.layout_now()

    def _record_by_name(self, arguments: dict[str, Any]) -> str:
        name = arguments.get("name")
        if not isinstance(name, str):
            raise SettingsError('record needs the name of the take, such as {"name": "walk-1"}')
        ensure_folder(self._settings.takes)
        return self.record_to(take_path(self._settings.takes, name))

    def _stop_recording(self, answer: Answer) -> None:
        """Finish the take on a thread of its own: it waits for late frames and the disk, and the tracker must not."""
        if self._recording.recorder is None:
            raise NotNowError("not recording; begin a take first")

        def finish() -> None:
            health = self._recording.finish()
            self._revision += 1
            self._answer(answer, CommandReply(not health.problem, outcome(health), self.status()))

        self._finishing = [thread for thread in self._finishing if thread.is_alive()]
        self._finishing.append(threading.Thread(target=finish, name="finish-take"))
        self._finishing[-1].start()

    # Housekeeping.

    def _housekeeping(self) -> None:
        while not self._ended.wait(STATUS_EVERY_S):
            self._recording.fetch_missing()
            with self._lock:
                self._registry.notice_silence(time.monotonic_ns())
                notices = self._registry.take_notices()
            for notice in notices:
                self._note(notice)
            status = self.status()
            self._link.publish_status(msgspec.json.encode(status))
            recorder = self._recording.recorder
            if recorder is not None:
                recorder.status(status, time.monotonic_ns())

    def _watch_clocks(self) -> None:
        while not self._ended.wait(PROBE_EVERY_S):
            with self._lock:
                nodes = self._registry.nodes()
            for node in nodes:
                if not self._ended.is_set():
                    self._compare_clocks(node)

    def _compare_clocks(self, node: NodeKey) -> None:
        try:
            probes = self._link.probe_clock(node, timeout=0.5)
        except WireError as error:
            with self._lock:
                self._registry.rejected(node, str(error))
            return
        estimate = estimate_offset(probes)
        if estimate is None:
            return
        with self._lock:
            self._registry.set_clock(node, estimate)
        recorder = self._recording.recorder
        if recorder is not None:
            times = [[p.sent_ns, p.far_ns, p.received_ns] for p in probes]
            row = {"sensor": node.sensor, "node_id": node.node_id, "probes": times}
            recorder.clock(row, time.monotonic_ns())

    def _note(self, text: str) -> None:
        notice = text if len(text) <= _MAX_NOTICE else text[: _MAX_NOTICE - 1] + "…"
        self._notices.append(notice)
        self._say(notice)

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
            sensors = self._registry.health(now_ns, session.setup, stored, lost)
        return SessionStatus(
            revision=self._revision,
            running=session.running,
            phase=state.phase.value,
            sensors_missing=state.sensors_missing,
            frames_remaining=state.frames_remaining,
            frames_wanted=state.frames_wanted,
            reason=state.reason,
            counts={name: count for name, count in self.summary.counts.items() if session.running},
            scenes=self.summary.scenes_out,
            scenes_hz=round(self.summary.rate_hz(now_ns), 1),
            setup=session.setup,
            sensors=tuple(sensors),
            recording=recording,
            notices=tuple(self._notices),
            uptime=round(time.monotonic() - self._began, 2),
            version=__version__,
            next_take=free_name(self._settings.takes, take),
            refused=self._link.refused,
        )

    def halt(self) -> None:
        """Stop tracking: from now on, `status` and `summary` give the session's result."""
        self._ended.set()
        self._inbox.wake()
        for thread in self._threads:  # no command may start another take afterwards
            thread.join()

    def close(self) -> RecordingHealth:
        """Finish the take, leave the bus, and return the result of the last take."""
        self.halt()
        health = self._recording.finish()
        for thread in self._finishing:
            thread.join()
        self._link.close()
        return health
