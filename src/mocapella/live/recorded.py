"""A common interface of study logs, files of one sensor's bodies and takes, to read and track their frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from mocapella.live.due_frame import DueFrame
from mocapella.live.summary import RunSummary
from mocapella.live.track_again import RunToTrack, track_runs
from mocapella.model.scene import Scene, TrackerState
from mocapella.model.session import Setup
from mocapella.recording.take import TakeReport
from mocapella.recording.take_origin import TakeOrigin

if TYPE_CHECKING:
    from mocapella.live.new_take import NewTake


@dataclass(frozen=True)
class Replayed:
    """Result of a replay.

    Attributes:
        summary: counts of frames and scenes.
        last: final state of the tracker.
        seconds: duration of the recording [s].
        notes: further fields for ``--json``, which depend on the type of recording.
        written: report of the new take; None if none was written.
    """

    summary: RunSummary
    last: TrackerState
    seconds: float
    notes: dict[str, Any] = field(default_factory=dict)
    written: TakeReport | None = None


class TrackableRecording(Protocol):
    """Interface of a recording, a file or frames in memory, whose frames are tracked with new trackers."""

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the recorded sensors, sorted."""

    @property
    def missing(self) -> list[str]:
        """Descriptors needed for tracking that are not installed, each with its package."""

    @property
    def damaged(self) -> bool:
        """Whether the file is damaged or was not closed, so that some of it cannot be read."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Files of the recording."""

    @property
    def seconds(self) -> float:
        """Duration of the recording [s]."""

    def origin(self) -> TakeOrigin | None:
        """Return the recording, with the changes, as the origin of a take; None for frames in memory."""

    def runs_to_track(self) -> list[RunToTrack]:
        """Return all frames by run, to be tracked by new trackers.

        Raises:
            InputError: no frame can be tracked; says which method does.
        """

    def add_rest(self, take: NewTake) -> None:
        """Add what else the recording has to a take that is made of it."""

    def notes(self) -> dict[str, Any]:
        """Return further counts and ``problems``, as of `Replayed`."""


class ReplayableRecording(TrackableRecording, Protocol):
    """Interface of a recording, a take or a CSV file: its sensors' frames, and their tracking again."""

    @property
    def setup(self) -> Setup:
        """Setup for tracking the recording."""

    @property
    def method_settings(self) -> dict[str, Any]:
        """Settings of the method, by name."""

    def due_frames(self, sensor: str) -> Iterator[DueFrame]:
        """Return one sensor's frames with their due times; time 0 is that of the file's first frame.

        Raises:
            SettingsError: there is no sensor of this name.
        """

    def replay(self, on_scene: Callable[[Scene], None]) -> Replayed:
        """Track the whole recording, as fast as possible; call ``on_scene`` with each scene, and return the counts."""


def track_again(
    recording: TrackableRecording,
    runs: Sequence[RunToTrack],
    on_scene: Callable[[int, Scene], None],
    path: Path | None = None,
) -> Replayed:
    """Track all frames of a recording with new trackers, as fast as possible, and write a new take.

    The recording is only read. After an error or Ctrl-C no file is left.

    Args:
        recording: the recording, opened with the changes.
        runs: its runs, of `TrackableRecording.runs_to_track`.
        on_scene: called with the place of the run in ``runs``, and each scene.
        path: the new take; None for none.

    Raises:
        InputError: the recording cannot be read.
        SettingsError: a setting is invalid.
        TakeExistsError, DiskFullError, RecordingError: the take cannot be written.
    """
    if path is None:
        found, written = track_runs(runs, on_scene), None
    else:
        from mocapella.live.new_take import NewTake  # with the whole recorder

        size = sum(file.stat().st_size for file in recording.files)
        with NewTake(path, recording.origin(), size_bytes=size) as take:
            found = track_runs(runs, on_scene, take)
            recording.add_rest(take)
        written = take.report
    notes = with_problems({**recording.notes(), "unusable": dict(found.unusable)}, found.problems)
    return Replayed(found.summary, found.last, recording.seconds, notes, written)


def with_problems(notes: dict[str, Any], problems: Sequence[str]) -> dict[str, Any]:
    """Return notes with commands that could not be carried out, which make a recording a damaged one."""
    if not problems:
        return notes
    return {**notes, "problems": [*notes["problems"], *problems], "damaged": True}
