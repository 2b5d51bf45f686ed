"""Study logs and files of one sensor's bodies as recordings that are tracked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from mocapella.conventions import NOT_AVAILABLE
from mocapella.errors import InputError
from mocapella.live.due_frame import DueFrame
from mocapella.live.recorded import Replayed, track_again
from mocapella.live.track_again import UNCHANGED, Changes, FrameToTrack, RunToTrack
from mocapella.model.limits import PARTICIPANT
from mocapella.model.scene import Scene
from mocapella.model.session import SCENARIOS, Setup
from mocapella.model.study_log import StudyLog
from mocapella.recording.body_csv import read_body_csv
from mocapella.recording.study_log import read_study_log
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_origin import TakeOrigin, sha256_of
from mocapella.sources.body_replay import BodyReplay
from mocapella.sources.recorded_track import ReplayReport
from mocapella.sources.study_replay import StudyReplay
from mocapella.tracker.method import never_tracked

if TYPE_CHECKING:
    from mocapella.live.new_take import NewTake


class _RecordedRows:
    """Rows of a file, tracked with a method and settings.

    Args:
        file: the file.
        source: its sensors' frames.
        setup: labels and number of sensors.
        changes: how it is tracked.
    """

    missing: Final[list[str]] = []
    damaged: Final = False
    sensors: tuple[str, ...]

    def __init__(self, file: Path, source: StudyReplay | BodyReplay, setup: Setup, changes: Changes) -> None:
        self.file, self._source, self._changes = file, source, changes
        self._first = next(source.arrivals())
        info = TakeInfo(setup, self._first.at_ns, self._first.at_ns)
        self._info = changes.info(info)
        self.setup, self.method_settings = self._info.setup, self._info.method_settings

    @property
    def files(self) -> tuple[Path, ...]:
        """The file."""
        return (self.file,)

    def origin(self) -> TakeOrigin:
        """Return the file as the origin of a take."""
        return TakeOrigin(self.file.name, sha256_of(self.files), changes=self._changes.as_origin())

    def runs_to_track(self) -> list[RunToTrack]:
        """Return the rows as one run, at the times of the file."""
        if reason := never_tracked(self._first.frame, self.setup.method):
            raise InputError(f"cannot be tracked: {reason}", file=self.file)
        return [RunToTrack(self._info, self._events(), self._changes.layout)]

    def _events(self) -> Iterator[FrameToTrack]:
        for arrival in self._source.arrivals():
            yield FrameToTrack(arrival, None, arrival.at_ns)

    def add_rest(self, take: NewTake) -> None:
        """Add what else the recording has: nothing."""

    def due_frames(self, sensor: str) -> Iterator[DueFrame]:
        """Return one sensor's frames with their due times; time 0 is that of the file's first frame.

        Raises:
            SettingsError: the file has no sensor of this name, or the name cannot be used for one that has no name.
        """
        return (DueFrame(due_s, frame) for due_s, frame in self._source.frames(sensor))

    def replay(self, on_scene: Callable[[Scene], None]) -> Replayed:
        """Track the whole file, as fast as possible; call ``on_scene`` with each scene, and return the counts."""
        return track_again(self, self.runs_to_track(), lambda _, scene: on_scene(scene))

    def notes(self) -> dict[str, Any]:
        """Return counts and problems of the file's rows."""
        return {
            "log": msgspec.to_builtins(self._source.report),
            "problems": _row_problems(self._source.report),
        }

    @property
    def seconds(self) -> float:
        """Time from the first frame to the last [s]."""
        return self._source.duration_s


class RecordedLog(_RecordedRows):
    """A KinectMultiTrack study log (2015), as two sensors with separate clocks.

    Args:
        file: the study log.
        changes: how it is tracked, and the placement of the sensors; None for the log's own.

    Raises:
        InputError, SettingsError: as in `open_recording`.
    """

    def __init__(self, file: Path, changes: Changes = UNCHANGED) -> None:
        log = read_study_log(file)
        source = StudyReplay(log, placement=changes.placement)
        self.sensors, self._placement = tuple(source.sensors), source.placement
        super().__init__(file, source, setup_of_log(log, source.placement), changes)

    def notes(self) -> dict[str, Any]:
        """Return counts and problems of the log's rows, and the placement."""
        return {"placement": self._placement, **super().notes()}


def setup_of_log(log: StudyLog, placement: str) -> Setup:
    """Return the labels of a study log, without labels that change within it.

    Args:
        log: the log.
        placement: placement of its sensors.
    """
    scenarios = {number: name for name, number in SCENARIOS.items()}
    participants, numbers = set(log.study_id.tolist()), set(log.scenario_id.tolist())
    participant = participants.pop() if len(participants) == 1 else NOT_AVAILABLE
    return Setup(
        sensors_expected=len(set(log.kinect_id.tolist())),
        participant=participant if participant in PARTICIPANT else NOT_AVAILABLE,
        placement=placement,
        scenario=scenarios.get(numbers.pop(), "") if len(numbers) == 1 else "",
    )


class RecordedBodies(_RecordedRows):
    """A file of one sensor's bodies (`mocapella.recording.body_csv`), which does not name the sensor.

    Args:
        file: the file.
        changes: how it is tracked.

    Raises:
        InputError, SettingsError: as in `open_recording`.
    """

    def __init__(self, file: Path, changes: Changes = UNCHANGED) -> None:
        source = BodyReplay(read_body_csv(file))
        self.sensors = (source.sensor,)
        super().__init__(file, source, Setup(), changes)


def _row_problems(report: ReplayReport) -> list[str]:
    problems = (
        (report.duplicates_dropped, "rows repeat a person of the same sensor and time, and were dropped"),
        (report.sorted, "rows came late, and were sorted in"),
    )
    return [f"{count} {what}" for count, what in problems if count]
