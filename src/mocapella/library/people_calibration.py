"""Calibrate cameras from people in keypoint files; `mocapella calibrate people` uses it too."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from mocapella.association.keypoint_rays import sources_named
from mocapella.calibration.keypoint_tracks import CameraTracks, collect_tracks
from mocapella.calibration.people_rig import RigFromPeople, RigScale, place_rig
from mocapella.calibration.rig_from_people import RigFromPeopleSettings, solve_people
from mocapella.errors import CalibrationError, InputError
from mocapella.library.rig_image_sizes import check_inside
from mocapella.model.camera import Camera, CameraRig
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import check_sensor_name
from mocapella.model.point_tracks import match_cameras
from mocapella.recording.detection_files import read_detections
from mocapella.recording.detections import AUTO, CameraDetections, keypoint_frames
from mocapella.recording.disk import SUFFIX
from mocapella.recording.take_reader import RawFrame, read_take

Progress = Callable[[str], None]


def calibrate_people(
    files: Sequence[Path | str] | Path | str,
    *,
    size_px: tuple[int, int] | None = None,
    fps: float | None = None,
    scale: RigScale | None = None,
    rig: CameraRig | Path | str | None = None,
    order: str = AUTO,
    progress: Progress = lambda text: None,
    **settings: Any,
) -> RigFromPeople:
    """Calibrate cameras from the people in their keypoint files.

    found = mocapella.calibrate_people("session/pose", size_px=(1280, 720), fps=30)
    save_camera_rig(Path("rig.toml"), found.rig)

    Args:
        files: a folder with a folder or file for each camera, or several folders or files, as `triangulate_people`; or
            a take (.mcap) with keypoint frames, which have their own sizes, times and order.
        size_px: (width, height) of the images; None for the sizes of ``rig``.
        fps: frame rate that the numbers of the frames follow; None for the times of the files [Hz].
        scale: a stated length; None for a guess.
        rig: an older rig, or its file: lenses, and world, are kept, and cameras that were moved are named.
        order: order of keypoints without names, such as BODY_25; auto: by their number and places.
        progress: called with a line about each stage.
        settings: fields of `RigFromPeopleSettings`.

    Returns:
        The rig, the quality of each camera, and notes.

    Raises:
        CalibrationError: the people do not determine the cameras; says why, and what to do.
        InputError: a file cannot be used, or there is no image size.
        SettingsError: an argument is invalid; names the valid ones.
    """
    paths = [Path(path) for path in ([files] if isinstance(files, Path | str) else files)]
    old = rig if isinstance(rig, CameraRig) or rig is None else load_camera_rig(Path(rig))
    if any(path.suffix.lower() == SUFFIX for path in paths):
        frames = take_frames(paths)
    else:
        found = read_detections(paths, order=order, progress=lambda text: progress(f"reading {text}"))
        frames = detected_frames(found, old, size_px, fps)
    return calibrate_frames(frames, scale, old, RigFromPeopleSettings(**settings), progress)


def take_frames(paths: Sequence[Path]) -> list[KeypointFrame]:
    """Return the keypoint frames of people in a take, each camera's in the order of their times.

    The times are on the common clock of the take, on which the method ``webcams`` tracks it again.

    Raises:
        InputError: there are several files, or the take has no such frames, or cannot be read.
        SchemaVersionError: the take was made with another message schema.
    """
    if len(paths) > 1:
        raise InputError("a take is given beside other files", file=paths[0], fix="give one take alone")
    take = read_take(paths[0])
    events = (event for run in take.runs for event in take.raw_run(run.number) if isinstance(event, RawFrame))
    frames = [
        msgspec.structs.replace(event.stored.frame, time_ns=event.at_ns)
        for event in events
        if isinstance(event.stored.frame, KeypointFrame) and sources_named(event.stored.frame.topology.name) is not None
    ]
    if not frames:
        raise InputError(
            "has no keypoints of people", file=paths[0], fix="give a take of mocapella people, or of node keypoints"
        )
    return sorted(frames, key=lambda frame: (frame.sensor, frame.time_ns))


def detected_frames(
    found: Sequence[CameraDetections], old: CameraRig | None, size_px: tuple[int, int] | None, fps: float | None
) -> list[KeypointFrame]:
    """Return the frames of all cameras, named as in an older rig if there is one.

    Raises:
        InputError: there is no image size, no time, or no person's keypoints, or they are in larger images.
        SettingsError: a file's name is no camera's.
    """
    if old is not None:
        names = match_cameras([one.camera for one in found], old.cameras)
    else:
        names = [check_sensor_name(one.camera.removesuffix("_json")) for one in found]
    frames = []
    for name, one in zip(names, found, strict=True):
        size = size_px or (old.cameras[name].camera.size_px if old is not None else None)
        if size is None:
            raise InputError(
                "the files have no image size", file=one.camera, fix="give it with --size, such as --size 1280x720"
            )
        some = keypoint_frames(one, name, size, fps)
        stated = "the rig has" if size_px is None else "--size has"
        check_inside(name, some, file=one.camera, stated=stated, fix="give the size of the images with --size")
        frames += some
    return frames


def calibrate_frames(
    frames: Sequence[KeypointFrame], scale: RigScale | None = None, old: CameraRig | None = None,
    settings: RigFromPeopleSettings | None = None, progress: Progress = lambda text: None,
) -> RigFromPeople:  # fmt: skip
    """Calibrate cameras from keypoint frames, each camera's in the order of their times.

    Args:
        frames: the frames of all cameras, on the cameras' own clocks.
        scale, old, progress: as ``scale``, ``rig`` and ``progress`` of `calibrate_people`.
        settings: how; the defaults if None.

    Raises:
        CalibrationError: the people do not determine the cameras; says why, and what to do.
        SettingsError: a stated camera is not there.
    """
    tracks: Mapping[str, CameraTracks] = collect_tracks(frames)
    known: dict[str, Camera] = {} if old is None else {name: placed.camera for name, placed in old.cameras.items()}
    missing = [name for name in known if name not in tracks]
    if old is not None and len(missing) == len(known):
        raise CalibrationError(f"no camera of the given rig is there: it has {', '.join(known)}")
    found = solve_people(tracks, known, settings, progress)
    progress("placing the cameras …")
    return place_rig(found, scale, old)
