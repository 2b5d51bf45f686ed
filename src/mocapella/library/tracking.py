"""Track recordings, or frames of a program, with any method."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mocapella.calibration.sensor_layout import SensorLayout, load_layout
from mocapella.errors import SettingsError
from mocapella.library.recording import Recording, load
from mocapella.library.tracked_scenes import TrackedScenes
from mocapella.live.given_frames import GivenFrames
from mocapella.live.recorded import TrackableRecording, track_again
from mocapella.live.recordings import open_recording, open_to_track
from mocapella.live.track_again import Changes
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.recording.disk import take_path
from mocapella.recording.take_trajectories import labels_of_setup
from mocapella.settings import merged
from mocapella.tracker import METHODS
from mocapella.tracker.method_files import settings_of_files, settings_of_rig_for_recording


def track(
    recording: Recording | Path | str | Iterable[SensorFrame | Arrival],
    method: str | None = None,
    *,
    record: Path | str | None = None,
    placement: str | None = None,
    layout: SensorLayout | Path | str | None = None,
    recalibrate: bool = False,
    **settings: Any,
) -> Recording:
    """Track the raw frames of a recording again, or frames in memory, and return the results as a recording.

    again = mocapella.track("walk-1.mcap", "stand-still", frames=60, record="walk-1-again.mcap")

    All frames are tracked, with a new tracker for each run; the recording is only read. Without ``record`` the results
    stay in memory.

    Args:
        recording: a take, a study log or a file of bodies, loaded or its path; or frames in the order of tracking, as
            in `mocapella.live.given_frames.GivenFrames`.
        method: name of the tracking method; None for the recorded one, or ``default``.
        record: new take to write, which names its origin; None for none.
        placement: the take's new label, or the placement of a study log; None for the recorded one.
        layout: sensor poses to start from, or their file; None for the take's poses at its beginning.
        recalibrate: whether to start without sensor poses.
        settings: settings of the method, added to a take's own if it was recorded with this method. A rig, and
            other files of the method, may be given as a `Path`: ``rig=Path("rig.toml")``.

    Raises:
        InputError: the recording cannot be used, or the method takes none of its frames.
        SettingsError: a method, setting or placement is unknown or invalid; names the valid ones.
        PluginError: a package that the tracking needs is missing.
        TakeExistsError, DiskFullError, RecordingError: the take cannot be written.
    """
    if isinstance(layout, Path | str):
        layout = load_layout(Path(layout))
    changes = Changes(method, settings, placement, layout, recalibrate)
    source = recording.path if isinstance(recording, Recording) else recording
    if isinstance(recording, Recording) and not recording.has_frames:
        raise SettingsError(f"{recording.path.name} has no sensors' frames to track; a take and a study log have")
    new = None if record is None else take_path(Path(record).parent, Path(record).name)
    if isinstance(source, Path | str):
        path, found = Path(source), _opened(Path(source), changes)
    else:
        path, found = Path("frames"), GivenFrames(source, _with_files(changes, method or "default"))
    return _tracked(found, path, new)


def _opened(path: Path, changes: Changes) -> TrackableRecording:
    if any(isinstance(value, Path) for value in changes.settings.values()):
        recorded = open_recording(path, Changes(placement=changes.placement)).setup.method
        method = changes.method or recorded
        read = _with_files(changes, method)
        changes = replace(read, settings=settings_of_rig_for_recording(method, read.settings))
    return open_to_track(path, changes)


def _with_files(changes: Changes, method: str) -> Changes:
    """Return changes whose settings have the content of files in place of their paths."""
    read = {option for one in METHODS.values() for option in one.files}
    paths = {name: value for name, value in changes.settings.items() if isinstance(value, Path) and name in read}
    others = {name: value for name, value in changes.settings.items() if name not in paths}
    settings = merged(others, settings_of_files(method, paths))
    return Changes(changes.method, settings, changes.placement, changes.layout, changes.recalibrate)


def _tracked(recording: TrackableRecording, path: Path, new: Path | None) -> Recording:
    runs = recording.runs_to_track()
    if new is not None:
        track_again(recording, runs, lambda run, scene: None, new)
        return load(new)
    wall_ns = [run.info.started_unix_ns - run.info.started_ns for run in runs]
    timed: list[tuple[int, int, Scene]] = []
    found = track_again(recording, runs, lambda run, scene: timed.append((run, scene.at_ns + wall_ns[run], scene)))
    labels = {number: labels_of_setup(run.info.setup) for number, run in enumerate(runs)}
    unusable = [f"{count} frames could not be used: {why}" for why, count in found.notes["unusable"].items()]
    problems: Sequence[str] = [*found.notes["problems"], *unusable]
    scenes = TrackedScenes(timed, recording.sensors, found.seconds, labels, tuple(problems))
    return Recording(path, None, tracked=scenes, has_frames=bool(recording.files))
