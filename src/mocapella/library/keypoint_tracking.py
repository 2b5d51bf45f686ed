"""Track people from keypoint frames with the method ``webcams``: what `triangulate_people` and films share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.geometry.rigid import rigid
from mocapella.library.recording import Recording, load
from mocapella.library.tracked_scenes import TrackedScenes
from mocapella.live.given_frames import GivenFrames
from mocapella.live.recorded import track_again
from mocapella.live.track_again import Changes
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.tracker.webcams_settings import numbered_time_sd_s

Float64 = NDArray[np.float64]
Progress = Callable[[str], None]

METHOD: Final = "webcams"
"""Name of the tracking method."""
UP: Final = {
    "y": np.eye(3),
    "z": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "-y": np.diag([1.0, -1.0, -1.0]),
}
"""Rotation from a rig's world to one with y up, by the upward axis of the rig's world; as of a TRC of points."""


def rig_with_y_up(rig: CameraRig, up: str) -> CameraRig:
    """Return a rig whose world has y up.

    Args:
        rig: the cameras.
        up: the upward axis of its world, a key of `UP`.

    Raises:
        SettingsError: the axis is unknown.
    """
    if up not in UP:
        raise SettingsError(f"up is {up!r}; it must be one of {', '.join(UP)}")
    T_old_new = rigid(UP[up].T, np.zeros(3))
    placed = {
        name: PlacedCamera(one.camera, one.T_camera_world @ T_old_new, one.covariance, one.clock_s)
        for name, one in rig.cameras.items()
    }
    return rig if up == "y" else CameraRig(placed)


def wrong_up(upright: Float64) -> str:
    """Return a sentence if people do not stand along the world's y axis, with the remedy; empty if they do.

    Args:
        upright: (3,) mean or sum of the vectors from people's ankles to their necks, world [m]; 0 without a person.
    """
    axis = int(np.abs(upright).argmax())
    if not upright.any() or (axis == 1 and upright[1] > 0):
        return ""
    along = ("-" if upright[axis] < 0 else "") + "xyz"[axis]
    return f"people stand along {along} of the results' world, which should be y: give the rig's upward axis with --up"


def arrivals_of(frames: Mapping[str, Sequence[KeypointFrame]], rig: CameraRig) -> list[Arrival]:
    """Return the frames of several cameras in the order of their capture times on the rig's clock.

    Args:
        frames: by name of the camera in the rig, with times on the camera's own clock.
        rig: the cameras, with the offsets of their clocks.
    """
    found = [
        Arrival(frame, frame.time_ns - round(rig.cameras[name].clock_s * NS_PER_S))
        for name, some in frames.items()
        for frame in some
    ]
    return sorted(found, key=lambda arrival: (arrival.at_ns, arrival.frame.sensor))


def _times_of(arrivals: Sequence[Arrival]) -> dict[str, float]:
    """Return the setting ``time_sd_s`` for frames that have equal times in all cameras: films, by number; else none."""
    times, cameras = np.unique([one.at_ns for one in arrivals], return_counts=True)
    if len(times) < 2 or np.median(cameras) < 2:
        return {}
    period_s = float(np.median(np.diff(times))) / NS_PER_S
    return {"time_sd_s": numbered_time_sd_s(1.0 / period_s)}


def track_arrivals(
    arrivals: Iterable[Arrival],
    rig: CameraRig,
    *,
    source: Path,
    record: Path | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: Progress = lambda text: None,
) -> tuple[Recording, list[Scene]]:
    """Track people with the method ``webcams``, with a new tracker.

    Args:
        arrivals: keypoint frames in the order of tracking, see `arrivals_of`.
        rig: the cameras, with y up.
        source: named as the recording's path if no take is written.
        record: new take to write; None for none.
        settings: settings of the method; ``time_sd_s`` is that of films if the frames have equal times in all cameras.
        progress: called with a line about the progress.

    Returns:
        The recording, and the scene of each arrival that the tracker could use.

    Raises:
        InputError: there are no frames, or none can be tracked; says why.
        SettingsError: a setting is invalid.
        TakeExistsError, DiskFullError, RecordingError: the take cannot be written.
    """
    given = list(arrivals)
    values = {**_times_of(given), **(settings or {}), "rig": encode_camera_rig(rig)}
    recording = GivenFrames(given, Changes(METHOD, values))
    scenes: list[Scene] = []

    def on_scene(_run: int, scene: Scene) -> None:
        scenes.append(scene)
        if len(scenes) % 50 == 0:
            progress(f"tracking {100 * len(scenes) // len(given)} %")

    runs = recording.runs_to_track()
    wall_ns = runs[0].info.started_unix_ns - runs[0].info.started_ns
    found = track_again(recording, runs, on_scene, record)
    if record is not None:
        return load(record), scenes
    unusable = [f"{count} frames could not be used: {why}" for why, count in found.notes["unusable"].items()]
    timed = [(0, scene.at_ns + wall_ns, scene) for scene in scenes]
    problems = (*found.notes["problems"], *unusable)
    return Recording(source, None, tracked=TrackedScenes(timed, recording.sensors, found.seconds, {}, problems)), scenes


def without_gaps(frames: Sequence[KeypointFrame], times: Mapping[int, int]) -> list[KeypointFrame]:
    """Return a camera's frames, with a frame without detections at each time that it lacks.

    Programs that list only their detections write nothing for an image without people.

    Args:
        frames: the frames of one camera; at least one.
        times: capture time of each instant [ns], by its number; the frames' ``sequence`` becomes the number.
    """
    there = {frame.time_ns: frame for frame in frames}
    first = frames[0]
    joints = len(first.topology)
    made = []
    for number, time_ns in sorted(times.items(), key=lambda item: item[1]):
        frame = there.get(time_ns)
        if frame is None:
            frame = msgspec.structs.replace(
                first, time_ns=time_ns, ids=np.empty(0, np.int64), positions_px=np.empty((0, joints, 2), np.float32),
                confidences=np.empty((0, joints), np.float32), relative=None,
            )  # fmt: skip
        made.append(msgspec.structs.replace(frame, sequence=number))
    return made
