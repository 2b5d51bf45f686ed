"""Track the raw frames of a recording again, with another method, other settings or another calibration.

Every recorded tracker's first run begins with a new tracker, so results do not depend on what the recorded one had
remembered. It starts from the sensor poses that the recorded one knew then, if its method keeps poses. A run of the
same tracker with other labels goes on with it. All frames are
tracked, also frames that the recorded tracker skipped, or received while it was stopped. docs/decisions/0057 says why.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

from mocapella.calibration.sensor_layout import SensorLayout
from mocapella.errors import SettingsError
from mocapella.live.replay import replay
from mocapella.live.session import Session
from mocapella.live.summary import RunSummary
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene, TrackerState
from mocapella.model.session import STUDY_EVENT, Setup
from mocapella.recording.take import Command, TakeInfo
from mocapella.recording.take_reader import Take
from mocapella.schema import encode_frame
from mocapella.settings import merged
from mocapella.tracker import METHODS

if TYPE_CHECKING:
    from mocapella.live.new_take import NewTake

KEPT: Final = ("recalibrate", STUDY_EVENT)
"""Recorded commands that apply to another tracker, or to none. Others state ids or the memory of the recorded one, or
stop it."""

FrameKey = tuple[str, int, int]
"""Sensor, node id and sequence number of a frame."""
Names = Mapping[tuple[str, int], str]
"""People's names by (sensor, tracking id) of their raw bodies."""


@dataclass(frozen=True)
class Changes:
    """What is different when a recording is tracked again; nothing by default.

    Attributes:
        method: name of the tracking method; None for the recorded one.
        settings: settings of the method by name, nested; added to the recorded ones if the method is the recorded one.
        placement: key of `mocapella.model.session.PLACEMENTS`, a label; None for the recorded one.
        layout: sensor poses to start from; None for the recorded ones.
        recalibrate: whether to start without sensor poses.

    Raises:
        SettingsError: ``layout`` and ``recalibrate`` are given together.
    """

    method: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    placement: str | None = None
    layout: SensorLayout | None = None
    recalibrate: bool = False

    def __post_init__(self) -> None:
        if self.layout is not None and self.recalibrate:
            raise SettingsError("a layout and recalibrate contradict each other; give one of them")

    def __bool__(self) -> bool:
        return self != Changes()

    def info(self, recorded: TakeInfo) -> TakeInfo:
        """Return how a recorded run is tracked again.

        Raises:
            SettingsError: the placement or the method is unknown, or the method keeps no sensor layout.
        """
        method = recorded.method if self.method is None else METHODS.find(self.method).name
        if self.layout is not None and not METHODS.find(method).keeps_layout:
            able = [name for name, one in METHODS.items() if one.keeps_layout]
            raise SettingsError(f"the method {method} starts from no sensor layout; methods that do: {', '.join(able)}")
        placement = recorded.setup.placement if self.placement is None else self.placement
        setup: Setup = replace(recorded.setup, method=method, placement=placement)
        if self.placement is not None:
            replace(setup, scenario="").check_usual_labels()
        base = recorded.method_settings if method == recorded.method else {}
        return replace(recorded, setup=setup, method_settings=merged(base, self.settings))

    def as_origin(self) -> dict[str, Any]:
        """Return the changes by name, for `mocapella.recording.take_origin.TakeOrigin`."""
        found = {
            "method": self.method,
            "settings": dict(self.settings),
            "placement": self.placement,
            "layout": None if self.layout is None else f"of {', '.join(self.layout.sensors)}",
            "recalibrate": self.recalibrate,
        }
        return {name: value for name, value in found.items() if value}


UNCHANGED: Final = Changes()
"""No changes: the recorded method and settings, or the defaults."""


class RecordedNames:
    """Names that people had in the scenes of a run of a take, which are read when the first is asked for."""

    def __init__(self, take: Take, run: int) -> None:
        self._take, self._run = take, run
        self._names: dict[FrameKey, Names] | None = None

    def of(self, key: FrameKey) -> Names:
        """Return the names in the scene of a frame, given by its key."""
        if self._names is None:
            self._names = dict(self._read()) if self._has_names() else {}
        return self._names.get(key, {})

    def _has_names(self) -> bool:
        """Whether a command of the run gives names, or restores a memory with names."""
        arguments = [command.arguments for command in self._take.commands(self._run)]
        return any(one.get("name") or one.get("names") for one in arguments)

    def _read(self) -> Iterator[tuple[FrameKey, Names]]:
        before: Names = {}
        for _, scene in self._take.scenes(self._run):
            named = (person for person in scene.people if person.name)
            names = {(view.sensor, view.tracking_id): person.name for person in named for view in person.views}
            before = before if names == before else names  # one object for many scenes
            yield (scene.sensor, scene.node_id, scene.sequence), before


@dataclass(frozen=True)
class FrameToTrack:
    """A frame of a recording.

    Attributes:
        arrival: the frame with its data, and its capture time on the recording's clock.
        raw: the stored bytes of the frame; None if it is encoded only when a take is written.
        log_ns: time of its storage, on the recording's clock.
    """

    arrival: Arrival
    raw: bytes | None
    log_ns: int


@dataclass(frozen=True)
class RunToTrack:
    """A run of a recording.

    Attributes:
        info: how it is tracked.
        events: its frames and commands, in order.
        layout: sensor poses to start from; None if unknown.
        names: returns the names of people in the recorded scene of a frame, by the frame's key.
    """

    info: TakeInfo
    events: Iterable[FrameToTrack | Command]
    layout: SensorLayout | None = None
    names: Callable[[FrameKey], Names] = lambda key: {}


@dataclass
class TrackedAgain:
    """Result of tracking a recording again.

    Attributes:
        summary: counts of frames and scenes.
        last: final state of the tracker.
        unusable: number of frames that the trackers could not use, by reason.
        problems: commands that could not be carried out.
    """

    summary: RunSummary = field(default_factory=RunSummary)
    last: TrackerState = field(default_factory=lambda: TrackerState(Phase.STOPPED))
    unusable: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)


def track_runs(
    runs: Sequence[RunToTrack], on_scene: Callable[[int, Scene], None], take: NewTake | None = None
) -> TrackedAgain:
    """Track runs, one after the other, with a new tracker where the recorded one was new; write them to a take.

    Args:
        runs: the runs.
        on_scene: called with the run's place in ``runs`` and each scene.
        take: the take to write; None for none.

    Raises:
        SettingsError: a method or a setting is invalid.
        RecordingError: the take cannot be written.
    """
    found = TrackedAgain()
    sessions = [_session(run) for run in runs]  # an invalid setting of any run is refused before the first is tracked
    for number, run in enumerate(runs):
        session = sessions[number]
        if number and run.info.continues:
            session = sessions[number] = sessions[number - 1]
            session.carry_out("setup", asdict(session.setup.labelled_as(run.info.setup)))
        before = Counter(session.unusable)
        tracking = _Tracking(run, session, lambda scene, number=number: on_scene(number, scene), take)  # type: ignore[misc]
        replay(tracking.session, tracking.events(), tracking.scene, found.summary, found.problems.append)
        found.last = tracking.session.state
        found.unusable += Counter(session.unusable) - before
    return found


def _session(run: RunToTrack) -> Session:
    keeps = METHODS.find(run.info.method).keeps_layout
    return Session(run.info.setup, run.info.method_settings, layout=run.layout if keeps else None)


class _Tracking:
    """One run: passes its events on, and writes them with what the session makes of them.

    What is written repeats the results: after a frame whose tracking failed, and which has no scene, follows a command
    ``restore`` with the tracker's memory, as in a live recording.
    """

    def __init__(
        self, run: RunToTrack, session: Session, on_scene: Callable[[Scene], None], take: NewTake | None
    ) -> None:
        self.session = session
        self._run, self._on_scene, self._take = run, on_scene, take
        self._log_ns = run.info.started_ns
        self._scene: Scene | None = None
        if take is not None:
            take.run(run.info)
            if self.session.layout is not None or run.info.continues:
                take.command("restore", self.session.memory(), self._log_ns, self.session.next_step)

    def events(self) -> Iterator[Arrival | Command]:
        """Yield the session's inputs, and write each before it takes effect."""
        for event in self._run.events:
            if isinstance(event, Command):
                if event.values.get("verb") in KEPT:
                    yield self._command(event.values["verb"], event.arguments)
                continue
            frame, self._log_ns, self._scene = event.arrival.frame, event.log_ns, None
            if self._take is not None:
                raw = encode_frame(frame) if event.raw is None else event.raw
                self._take.frame(raw, frame.sensor, frame.node_id, frame.sequence, event.log_ns)
            yield event.arrival
            if self._scene is None:
                yield self._command("restore", self.session.memory())
            else:
                yield from self._names(self._scene, self._run.names(frame.key))

    def scene(self, scene: Scene) -> None:
        """Take a scene of the session."""
        self._scene = scene
        if self._take is not None:
            self._take.scene(scene, self._log_ns)
        self._on_scene(scene)

    def _command(self, verb: str, arguments: Mapping[str, Any]) -> Command:
        step = self.session.next_step
        if self._take is not None:
            self._take.command(verb, arguments, self._log_ns, step)
        return Command(step, self._log_ns, {"verb": verb, "arguments": dict(arguments)})

    def _names(self, scene: Scene, names: Names) -> Iterator[Command]:
        """Yield commands that give people the names of the recording, which their raw bodies tell; ids may differ."""
        known = self.session.names
        present = {person.id for person in scene.people} if names else set()
        for person in scene.people if names else ():
            name = next((found for view in person.views if (found := names.get((view.sensor, view.tracking_id)))), "")
            others = {known[other] for other in present - {person.id} if other in known}
            if name and known.get(person.id) != name and name not in others:
                yield self._command("name", {"person": person.id, "name": name})
