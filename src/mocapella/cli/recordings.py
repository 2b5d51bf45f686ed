"""A common interface of study logs, files of one sensor's bodies and takes, to read their frames and replay them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec

from mocapella.cli.common import say
from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, PluginError, SettingsError, one_of
from mocapella.exports.export import EXPORTS, left_out
from mocapella.live.node import DueFrame
from mocapella.live.replay import replay
from mocapella.live.session import Session
from mocapella.live.summary import RunSummary
from mocapella.model.frame_types import FRAME_TYPES, frame_type_of
from mocapella.model.observations import Arrival
from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import Phase, Scene, TrackerState
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import Setup
from mocapella.recording.body_csv import is_body_csv, read_body_csv
from mocapella.recording.disk import SUFFIX
from mocapella.recording.mcap_file import MAGIC
from mocapella.recording.study_log import read_study_log
from mocapella.recording.take import Command
from mocapella.recording.take_reader import Take, read_take
from mocapella.registry import Table, load
from mocapella.schema import encode_scene
from mocapella.sources.body_replay import BodyReplay
from mocapella.sources.recorded_track import ReplayReport
from mocapella.sources.study_replay import StudyReplay
from mocapella.tracker import METHODS

TAKES = Path("takes")
"""Default folder of a server's takes."""
_ENDINGS = (SUFFIX, ".csv", ".csv.gz")
_MOST_NAMED = 10
LATE_NS = 100_000_000
"""A frame stored later than its capture time suggests by more than this was fetched later [ns]."""
LONGEST_BETWEEN_NS = 60_000_000_000
"""Consecutive capture times of a node that differ by more than this are of two clocks [ns]."""


@dataclass(frozen=True)
class Replayed:
    """Result of a replay.

    Attributes:
        summary: counts of frames and scenes.
        last: final state of the tracker.
        seconds: duration of the recording [s].
        notes: further fields for ``--json``, which depend on the type of recording.
    """

    summary: RunSummary
    last: TrackerState
    seconds: float
    notes: dict[str, Any] = field(default_factory=dict)


class ReplayableRecording(Protocol):
    """Interface of a recording, a take or a CSV file: its sensors' frames, and their tracking again."""

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the recorded sensors, sorted."""

    @property
    def setup(self) -> Setup:
        """Setup with which the recording is tracked."""

    @property
    def method_settings(self) -> dict[str, Any]:
        """Settings of the method, by name."""

    @property
    def missing(self) -> list[str]:
        """Descriptors needed for tracking that are not installed, each with its package."""

    @property
    def damaged(self) -> bool:
        """Whether the file is damaged or was not closed, so that some of it cannot be read."""

    def due_frames(self, sensor: str) -> Iterator[DueFrame]:
        """Return one sensor's frames with their due times; time 0 is that of the file's first frame.

        Raises:
            SettingsError: there is no sensor of this name.
        """

    def replay(self, on_scene: Callable[[Scene], None]) -> Replayed:
        """Track the whole recording, as fast as possible; call ``on_scene`` with each scene, and return the counts."""


def find_recording(file: Path) -> Path:
    """Return the file of that name, or the take, which may be given without ``.mcap`` and be in the folder ``takes``.

    Raises:
        InputError: there is none; lists the takes.
    """
    names = [file] if file.name.endswith(_ENDINGS) else [file, file.with_name(file.name + SUFFIX)]
    names += [TAKES / name for name in names] if file.parent == Path() else []
    found = next((name for name in names if name.is_file()), None)
    if found is not None:
        return found
    folders = [file] if file.is_dir() else dict.fromkeys(name.parent for name in names)
    takes = sorted((path for folder in folders for path in folder.glob(f"*{SUFFIX}")), key=str)
    there = _some(file, takes) if takes else "name a study log or a take"
    raise InputError("it is a folder" if file.is_dir() else "no such file", file=file, fix=there)


def _some(file: Path, takes: Sequence[Path]) -> str:
    """Return the first takes as text, and the name that resembles the file's, as a user may write it."""
    names = [take.stem if take.parent == TAKES else str(take.with_suffix("")) for take in takes]
    close = one_of(str(file).removesuffix(SUFFIX), names).rpartition(" (did you mean ")
    listed = ", ".join(map(str, takes[:_MOST_NAMED]))
    return f"there are {listed}" + (f" (did you mean {close[2]}" if close[1] else "")


def is_take(file: Path) -> bool:
    """Return whether the file is a take, from its name or its first bytes."""
    if file.suffix == SUFFIX:
        return True
    try:
        with file.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:  # its reader reports the reason
        return False


def open_recording(
    file: Path,
    placement: str | None = None,
    method: str | None = None,
    method_settings: Mapping[str, Any] | None = None,
) -> ReplayableRecording:
    """Open a study log, a file of one sensor's bodies or a take, as `find_recording` finds it.

    ``placement`` selects the sensors' placement in a study log; ``method`` and ``method_settings`` choose how logs and
    body files are tracked (None: the defaults). A take has all three recorded, so they must be None or empty.

    Raises:
        InputError: the file cannot be used, or has no frames; names file, row, field and value if possible.
        SettingsError: one of the three is given for a take, or the file does not have that placement.
    """
    file = find_recording(file)
    if is_take(file):
        _refuse_settings(file, placement, method, method_settings)
        take = RecordedTake(file)
        if not take.sensors:
            raise InputError("is a take without frames", file=file, fix="name one that was recorded while sensors sent")
        return take
    if is_body_csv(file):
        if placement:
            raise SettingsError(f"{file} has one sensor; leave --placement out, which is for study logs")
        return RecordedBodies(file, method or Setup().method, method_settings or {})
    try:
        return RecordedLog(file, placement, method or Setup().method, method_settings or {})
    except InputError as error:
        if error.row != 1:
            raise
        fix = f"{error.fix or 'a study log has 87 columns'}; docs/sensors.md has the other tables that are read"
        raise InputError(error.problem, file=file, row=1, field=error.field, value=error.value, fix=fix) from None


def _refuse_settings(
    take: Path, placement: str | None, method: str | None, method_settings: Mapping[str, Any] | None
) -> None:
    """Raise a `SettingsError` if one of the options is given for a take; it says what tracks the frames otherwise."""
    ours = f"{take} is a take, tracked with its recorded settings; leave"
    if method or method_settings:
        given = {"--placement": placement, "--method": method, "--set or --settings": method_settings}
        refused = ", ".join(option for option, value in given.items() if value)
        raise SettingsError(
            f"{ours} {refused} out; to track its frames otherwise, run `mocapella serve --method NAME`, and for each "
            f"sensor `mocapella node replay {take} --sensor NAME`"
        )
    if placement:
        raise SettingsError(f"{ours} --placement out, which is for study logs")


def open_take(file: Path) -> Take:
    """Read a take, found as by `find_recording`; damaged entries are skipped. Repeated calls return the same object.

    Raises:
        InputError: the file is missing, empty, or no take; or nothing in it is readable.
        SchemaVersionError: the take was made with another message schema.
    """
    found = find_recording(file).absolute()
    is_now = found.stat()
    return _take(found, is_now.st_mtime_ns, is_now.st_size)


@lru_cache(maxsize=1)
def _take(path: Path, _modified_ns: int, _size: int) -> Take:
    take = read_take(path)
    take.skips = True
    return take


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


def tell_left_out(export: str, file: Path) -> None:
    """Print which parts of a take an export leaves out, and which packages of the take are not installed.

    Args:
        export: name of the export, a key of `EXPORTS`.
        file: the take.

    Raises:
        InputError, SchemaVersionError: as in `open_take`.
    """
    take = open_take(file)
    left = left_out(EXPORTS[export], take.part_counts)
    if left:
        parts = ", ".join(f"{name} ({count})" for name, count in left.items())
        say(f"{take.path.name}: left out by export {export}: {parts}; `mocapella export json` writes everything")
    for missing in missing_of(take):
        say(f"{take.path.name}: {missing}")


def open_to_track(
    file: Path, placement: str | None, method: str | None, method_settings: Mapping[str, Any]
) -> ReplayableRecording:
    """Open a recording as `open_recording` does, with the same arguments, and check that it can be tracked.

    Raises:
        PluginError: a package that is needed for the tracking is missing; names it.
        InputError, SettingsError: as in `open_recording`.
    """
    recording = open_recording(file, placement, method, method_settings)
    if recording.missing:
        raise PluginError(f"{file} cannot be tracked: {'; '.join(recording.missing)}")
    return recording


class RecordedLog:
    """A KinectMultiTrack study log (2015), as two sensors with separate clocks.

    Args:
        file: the study log.
        placement: placement of the sensors; None for the log's own.
        method: name of the tracking method.
        method_settings: settings of the method.

    Raises:
        InputError, SettingsError: as in `open_recording`.
    """

    missing: Final[list[str]] = []
    damaged: Final = False

    def __init__(self, file: Path, placement: str | None, method: str, method_settings: Mapping[str, Any]) -> None:
        self.method_settings = dict(method_settings)
        self._source = StudyReplay(read_study_log(file), placement=placement)
        self.sensors = tuple(self._source.sensors)
        self.setup = Setup(method=method, sensors_expected=len(self.sensors))

    def due_frames(self, sensor: str) -> Iterator[DueFrame]:
        """Return one sensor's frames with their due times; time 0 is that of the file's first frame.

        Raises:
            SettingsError: the log has no sensor of this name.
        """
        return (DueFrame(due_s, frame) for due_s, frame in self._source.frames(sensor))

    def replay(self, on_scene: Callable[[Scene], None]) -> Replayed:
        """Track the whole log, as fast as possible; call ``on_scene`` with each scene, and return the counts."""
        session = Session(self.setup, self.method_settings)
        summary = replay(session, self._source.arrivals(), on_scene)
        notes = {
            "placement": self._source.placement,
            "log": msgspec.to_builtins(self._source.report),
            "unusable": dict(session.unusable),
            "problems": _row_problems(self._source.report),
        }
        return Replayed(summary, session.state, self._source.duration_s, notes)


class RecordedBodies:
    """A file of one sensor's bodies (`mocapella.recording.body_csv`), which does not name the sensor.

    Args:
        file: the file.
        method: name of the tracking method.
        method_settings: settings of the method.

    Raises:
        InputError, SettingsError: as in `open_recording`.
    """

    missing: Final[list[str]] = []
    damaged: Final = False

    def __init__(self, file: Path, method: str, method_settings: Mapping[str, Any]) -> None:
        self.method_settings = dict(method_settings)
        self._source = BodyReplay(read_body_csv(file))
        self.sensors = (self._source.sensor,)
        self.setup = Setup(method=method, sensors_expected=1)

    def due_frames(self, sensor: str) -> Iterator[DueFrame]:
        """Return all frames as those of ``sensor``, any valid name; time 0 is that of the file's first frame.

        Raises:
            SettingsError: the name cannot be used.
        """
        return (DueFrame(due_s, frame) for due_s, frame in self._source.frames(sensor))

    def replay(self, on_scene: Callable[[Scene], None]) -> Replayed:
        """Track the whole file, as fast as possible; call ``on_scene`` with each scene, and return the counts."""
        session = Session(self.setup, self.method_settings)
        summary = replay(session, self._source.arrivals(), on_scene)
        notes = {
            "log": msgspec.to_builtins(self._source.report),
            "unusable": dict(session.unusable),
            "problems": _row_problems(self._source.report),
        }
        return Replayed(summary, session.state, self._source.duration_s, notes)


def due_times(times: Sequence[tuple[int, int, int]]) -> list[int]:
    """Return the due times of frames for a replay at the recorded speed, on the clock of their storage [ns].

    A frame is due at its storage time. But a frame that the server missed was fetched later, with others: it is due as
    long before the next frame as it was captured before that one.

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

    Raises:
        InputError, SchemaVersionError: as in `read_take`.
    """

    def __init__(self, file: Path) -> None:
        self._take = read_take(file)
        self._take.skips = True
        self.sensors = self._take.sensors
        self.setup = self._take.info.setup
        self.method_settings = self._take.info.method_settings
        self._resolvers: dict[str, Any] = {}

    @property
    def missing(self) -> list[str]:
        """Methods, frame types and part types of the take that are not installed, each with its package."""
        return missing_of(self._take)

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
            "clean": self._take.clean,
            "damaged": self._take.damaged or bool(commands),
            "problems": [*self._take.problems, *commands],
            "lost": sum(frames.lost for frames in self._take.complete()),
        }
        return Replayed(summary, last, self._take.seconds, notes)


def _row_problems(report: ReplayReport) -> list[str]:
    problems = (
        (report.duplicates_dropped, "rows repeat a person of the same sensor and time, and were dropped"),
        (report.sorted, "rows came late, and were sorted in"),
    )
    return [f"{count} {what}" for count, what in problems if count]
