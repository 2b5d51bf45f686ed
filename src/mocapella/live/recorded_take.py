"""A take as a recording: replayed like the live run, or tracked again from its raw frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mocapella.calibration.sensor_layout import SensorLayout
from mocapella.conventions import NS_PER_S
from mocapella.decoding import FAULTS
from mocapella.errors import InputError, MocapellaError, PluginError, SettingsError, one_of
from mocapella.live.due_frame import DueFrame
from mocapella.live.recorded import Replayed, with_problems
from mocapella.live.replay import replay
from mocapella.live.session import Session
from mocapella.live.summary import RunSummary
from mocapella.live.track_again import UNCHANGED, Changes, FrameToTrack, RecordedNames, RunToTrack
from mocapella.model.frame_types import FRAME_TYPES, frame_type_of
from mocapella.model.observations import Arrival
from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import Phase, Scene, TrackerState
from mocapella.model.sensor_frame import SensorFrame
from mocapella.recording.take import Command, Run, TakeInfo
from mocapella.recording.take_origin import TakeOrigin, sha256_of
from mocapella.recording.take_reader import Take, read_take
from mocapella.registry import Table, load
from mocapella.schema import encode_scene
from mocapella.tracker import METHODS
from mocapella.tracker.method import never_tracked

if TYPE_CHECKING:
    from mocapella.live.new_take import NewTake

LATE_NS = 100_000_000
"""A frame stored later than its capture time suggests by more than this was fetched later [ns]."""
LONGEST_BETWEEN_NS = 60_000_000_000
"""Consecutive capture times of a node that differ by more than this are of two clocks [ns]."""


def missing_of(take: Take) -> list[str]:
    """Return the methods, frame types and part types of a take that are not installed, each with its package."""
    packages = {what: package for run in take.runs for what, package in run.info.packages.items()}
    needed: list[tuple[Table[Any], Iterable[str]]] = [
        (METHODS, dict.fromkeys(run.info.method for run in take.runs)),
        (FRAME_TYPES, take.unread_frame_types),
        (PART_TYPES, take.part_counts),
    ]
    return [_missing(table, name, packages) for table, names in needed for name in names if name not in table]


def _missing(table: Table[Any], name: str, packages: Mapping[str, str]) -> str:
    what = f"{table.what} {name}"
    package = packages.get(what, "a package that the take does not name")
    try:
        table.find(name)
    except PluginError as error:
        return f"it was made with {package}: {error}"
    except SettingsError:
        pass
    return f"it was made with the {what} of {package}, which is not installed; install it"


def due_times(times: Sequence[tuple[int, int, int]]) -> list[int]:
    """Return the due times of frames for a replay at the recorded speed, on the clock of their storage [ns].

    A frame is due at its storage time. But a frame that the server missed was fetched later, with others: it is due as
    long before the next frame as its capture was before the next one's.

    Args:
        times: node id, storage time [ns] and capture time [ns] of each frame, in the order of capture.
    """
    due = [stored for _, stored, _ in times]
    for i in range(len(times) - 2, -1, -1):
        (node, stored, captured), (next_node, next_stored, next_captured) = times[i], times[i + 1]
        between = next_captured - captured
        if node != next_node or not 0 <= between < LONGEST_BETWEEN_NS:
            continue
        expected = due[i + 1] - between
        came_alone = next_stored - stored > between / 2 and stored <= expected + LATE_NS
        due[i] = stored if came_alone else min(stored, expected)
    return due


class RecordedTake:
    """A take. Its replay tracks each run of the recorded tracker again, and compares the scenes with the recorded ones.

    A run has one setup, and frames and commands in the tracker's order. Damaged entries are left out, and named.

    Args:
        file: the take.
        changes: changes of the tracking, for `runs_to_track`.

    Raises:
        InputError, SchemaVersionError: as in `read_take`.
    """

    def __init__(self, file: Path, changes: Changes = UNCHANGED) -> None:
        self._take = read_take(file)
        self._take.skips = True
        self.sensors = self._take.sensors
        self._changes = changes
        info = changes.info(self._take.info)
        self.setup, self.method_settings = info.setup, info.method_settings
        self._resolvers: dict[str, Any] = {}

    @property
    def missing(self) -> list[str]:
        """Methods, frame types and part types of the take that are not installed, each with its package.

        None are needed to track it with another method: what this one cannot read is kept.
        """
        return [] if self._changes.method is not None else missing_of(self._take)

    @property
    def files(self) -> tuple[Path, ...]:
        """Files of the take."""
        return self._take.parts

    @property
    def seconds(self) -> float:
        """Time from the first entry to the last [s]."""
        return self._take.seconds

    def origin(self) -> TakeOrigin:
        """Return the take as the origin of another."""
        take = self._take
        changes = self._changes.as_origin()
        return TakeOrigin(take.path.name, sha256_of(take.parts), take.take_id, take.info.version, changes)

    def runs_to_track(self) -> list[RunToTrack]:
        """Return the runs with all their frames, to be tracked anew.

        Raises:
            InputError: the method of no run takes any of the take's frames; says which one does.
            SettingsError: as in `Changes.info`.
        """
        infos = [(run, self._changes.info(run.info)) for run in self._take.runs]
        firsts = [stored.frame for sensor in self.sensors for stored in islice(self._take.frames(sensor), 1)]
        reasons = [never_tracked(frame, info.method) for _, info in infos for frame in firsts]
        if all(reasons):
            raise InputError(f"cannot be tracked: {(*reasons, 'no frame can be read')[0]}", file=self._take.path)
        return [self._run_to_track(run, info) for run, info in infos]

    def _run_to_track(self, run: Run, info: TakeInfo) -> RunToTrack:
        names = RecordedNames(self._take, run.number)
        return RunToTrack(info, self._raw_events(run.number), self._layout(run), names.of)

    def _raw_events(self, run: int) -> Iterator[Command | FrameToTrack]:
        for event in self._take.raw_run(run):
            if isinstance(event, Command):
                yield event
            else:
                stored = event.stored
                yield FrameToTrack(Arrival(self._resolved(stored.frame), event.at_ns), stored.raw, stored.log_ns)

    def _layout(self, run: Run) -> SensorLayout | None:
        """Return the sensor poses that a run began with, which are in the memory of its tracker; None if unknown."""
        if self._changes.layout is not None or self._changes.recalibrate:
            return self._changes.layout
        first = next(self._take.commands(run.number), None)
        known = METHODS.get(run.info.method)
        if first is None or first.values.get("verb") != "restore" or known is None or not known.keeps_layout:
            return None
        session = Session(run.info.setup, run.info.method_settings)
        try:
            session.carry_out("restore", first.arguments)
            return session.layout_now()
        except (MocapellaError, *FAULTS):  # a memory that cannot be read states no poses
            return None

    def add_rest(self, take: NewTake) -> None:
        """Add the ground truths, the clock probes, and the accounts of the nodes' frames to a new take."""
        for sensor in self.sensors:
            for log_ns, truth in self._take.truths(sensor):
                take.truth(sensor, truth, log_ns)
        for log_ns, probes in self._take.clock_probes():
            take.clock(probes, log_ns)
        take.expect(self._take.complete())

    def notes(self) -> dict[str, Any]:
        """Return the state of the take, with the entries left out so far."""
        return {
            "clean": self._take.clean,
            "damaged": self._take.damaged,
            "problems": list(self._take.problems),
            "lost": sum(frames.lost for frames in self._take.complete()),
        }

    @property
    def damaged(self) -> bool:
        """Whether the take is damaged or was not closed, so that some of it cannot be read."""
        return self._take.damaged

    def due_frames(self, sensor: str) -> Iterator[DueFrame]:
        """Return one sensor's frames at their `due_times`; time 0 is that of the take's first frame.

        Frames of a node that was started again continue on the first node's clock.

        Raises:
            SettingsError: the take has no sensor of this name.
        """
        if sensor not in self.sensors:
            raise SettingsError(f"{self._take.path} has no sensor {sensor!r}; it has {one_of(sensor, self.sensors)}")
        due = {name: self._due_times(name) for name in self.sensors}
        zero = min((min(times) for times in due.values() if times), default=0)
        return self._due_frames(sensor, zero, due[sensor])

    def _due_times(self, sensor: str) -> list[int]:
        frames = self._take.frames_in_sequence(sensor)
        return due_times([(stored.frame.node_id, stored.log_ns, stored.frame.time_ns) for stored in frames])

    def _due_frames(self, sensor: str, zero: int, due_ns: list[int]) -> Iterator[DueFrame]:
        node_id, shift = None, 0
        last_due = last_time = 0
        for due, stored in zip(due_ns, self._take.frames_in_sequence(sensor), strict=True):
            frame = stored.frame
            if node_id not in (None, frame.node_id):  # another clock; a replay has only one
                shift = last_time + max(1, due - last_due) - frame.time_ns
            node_id, last_due, last_time = frame.node_id, due, frame.time_ns + shift
            whole = self._resolved(frame)
            yield DueFrame((due - zero) / NS_PER_S, msgspec.structs.replace(whole, time_ns=last_time))

    def _resolved(self, frame: SensorFrame) -> Any:
        """Return the frame with the referenced data, such as the image of a video."""
        kind = frame_type_of(frame)
        if kind is None or not kind.resolver:
            return frame
        resolver = self._resolvers.get(kind.name)
        if resolver is None:
            resolver = self._resolvers[kind.name] = load(kind.resolver)()
        return resolver.resolve(frame)

    def _events(self, run: int) -> Iterator[Command | Arrival]:
        """Yield one run's frames and commands in the tracker's order."""
        for event in self._take.replay_run(run):
            yield event if isinstance(event, Command) else Arrival(self._resolved(event.frame), event.at_ns)

    def replay(self, on_scene: Callable[[Scene], None]) -> Replayed:
        """Track all runs again, as fast as possible, and count the scenes that differ from the recorded ones.

        Args:
            on_scene: called with each scene.

        Returns:
            The counts; ``differing_scenes`` in its ``notes`` counts the scenes that differ, are missing or are new.
        """
        recorded = (encode_scene(scene) for _, scene in self._take.scenes())
        differing = 0

        def compare(scene: Scene) -> None:
            nonlocal differing
            differing += encode_scene(scene) != next(recorded, None)
            on_scene(scene)

        summary, last, unusable = RunSummary(), TrackerState(Phase.STOPPED), Counter[str]()
        commands: list[str] = []
        for run in self._take.runs:
            session = Session(run.info.setup, run.info.method_settings)
            summary = replay(session, self._events(run.number), compare, summary, commands.append)
            last = session.state
            unusable.update(session.unusable)
        missing = self._take.scene_count - summary.scenes_out
        notes = {
            "recorded_scenes": self._take.scene_count,
            "differing_scenes": differing + max(missing, 0),  # new scenes differ from none
            "unusable": dict(unusable),
        }
        return Replayed(summary, last, self.seconds, notes | with_problems(self.notes(), commands))
