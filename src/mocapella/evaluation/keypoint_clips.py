"""Recordings of people's keypoints with references in space: Pose2Sim's clips and Caliscope's MediaPipe session.

All keypoints are in Halpe's order (`mocapella.sources.simulate.keypoint_body.HALPE`); keypoints that a detector lacks
are missing. The references are results of those programs, no ground truth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.recording.detection_json import read_json_folder
from mocapella.recording.image_tracks_file import read_image_tracks
from mocapella.recording.trc_file import read_trc
from mocapella.sources.simulate.keypoint_body import HALPE

Float64 = NDArray[np.float64]

CLIPS: Final = {
    "pose2sim_two_people": (Path("Calib_qualisys.toml"), "pose"),
    "pose2sim_single_person": (Path("calibration", "Calib_qualisys.toml"), "pose"),
}
"""Rig and folder of the raw detections of each Pose2Sim clip, relative to its folder."""
POSE2SIM_HZ: Final = 60.0
"""Frame rate of the Pose2Sim clips [Hz]."""
MEDIAPIPE_HZ: Final = 24.0
"""Frame rate of the MediaPipe session [Hz]."""
_FIX: Final = "name the folder that has pose2sim_two_people and pose2sim_single_person"
_MEDIAPIPE: Final = {
    0: "Nose", 2: "LEye", 5: "REye", 7: "LEar", 8: "REar", 11: "LShoulder", 12: "RShoulder", 13: "LElbow",
    14: "RElbow", 15: "LWrist", 16: "RWrist", 23: "LHip", 24: "RHip", 25: "LKnee", 26: "RKnee", 27: "LAnkle",
    28: "RAnkle", 29: "LHeel", 30: "RHeel", 31: "LBigToe", 32: "RBigToe",
}  # fmt: skip
"""Caliscope's numbers of MediaPipe's body landmarks that Halpe has, too."""


class KeypointClip(msgspec.Struct, frozen=True, eq=False):
    """Detections of several synchronised cameras, and a reference.

    Attributes:
        name: name of the recording.
        rig: the cameras.
        frames: for each instant the frames of all cameras, in the order of the rig.
        reference: (people, frames, 26, 3) another program's result, world [m]; NaN where it has none.
        hz: frame rate [Hz].
    """

    name: str
    rig: CameraRig
    frames: tuple[tuple[KeypointFrame, ...], ...]
    reference: Float64
    hz: float


def pose2sim_clip(folder: Path, name: str) -> KeypointClip:
    """Read the raw detections of a Pose2Sim clip, and its authors' unfiltered result for each person.

    Args:
        folder: folder of the recordings.
        name: a key of `CLIPS`.

    Raises:
        InputError: a file is missing or has another format.
    """
    rig_file, detections = CLIPS[name]
    rig = load_camera_rig(folder / name / rig_file)
    tracks = sorted(path for path in (folder / name / "pose-3d").glob("*.trc") if "filt" not in path.name)
    if not tracks:
        raise InputError("no TRC with the authors' result", file=folder / name / "pose-3d", fix=_FIX)
    people = [_halpe_of_trc(path) for path in tracks]
    count = min(map(len, people))
    cameras = []
    for number, (camera, placed) in enumerate(rig.cameras.items(), 1):
        images = folder / name / detections / f"cam{number:02d}_json"
        cameras.append(_openpose_frames(images, camera, placed.camera.size_px, count))
    return KeypointClip(
        name, rig, tuple(zip(*cameras, strict=True)), np.stack([p[:count] for p in people]), POSE2SIM_HZ
    )


def mediapipe_clip(folder: Path) -> KeypointClip:
    """Read the body landmarks of ``mediapipe_holistic_4cam``, without confidences (1), and without a reference.

    Raises:
        InputError: a file is missing or has another format.
    """
    where = folder / "mediapipe_holistic_4cam"
    rig = load_camera_rig(where / "config.toml")
    tracks = read_image_tracks([where / "recording_1" / "HOLISTIC" / "xy_HOLISTIC.csv"])
    columns = [(HALPE.index(name), tracks.points.index(str(number))) for number, name in _MEDIAPIPE.items()]
    instants = []
    for k in range(len(tracks.frames)):
        row = []
        for c, (name, placed) in enumerate(rig.cameras.items()):
            points = np.full((1, len(HALPE), 2), np.nan)
            for to, column in columns:
                points[0, to] = tracks.pixels[k, c, column]
            found = np.isfinite(points).all(axis=2).any()
            at_ns = round(k * NS_PER_S / MEDIAPIPE_HZ)
            row.append(
                keypoint_frame(
                    name, HALPE, time_ns=at_ns, size_px=placed.camera.size_px, positions_px=points[: int(found)],
                    sequence=k,
                )
            )  # fmt: skip
        instants.append(tuple(row))
    return KeypointClip(
        "mediapipe_holistic_4cam",
        rig,
        tuple(instants),
        np.full((0, len(instants), len(HALPE), 3), np.nan),
        MEDIAPIPE_HZ,
    )


def _halpe_of_trc(path: Path) -> Float64:
    """(frames, 26, 3) in the rig's world: the TRC's y is the world's z."""
    found = read_trc(path)
    out = np.full((len(found), len(HALPE), 3), np.nan)
    for k, name in enumerate(found.keypoints):
        if name in HALPE.joints:
            out[:, HALPE.index(name)] = found.positions[:, 0, k][:, [2, 0, 1]]
    return out


def _openpose_frames(folder: Path, camera: str, size_px: tuple[int, int], count: int) -> list[KeypointFrame]:
    """The first frames of a folder of OpenPose's JSON (BODY_25B), in Halpe's order."""
    found = read_json_folder(folder, order="BODY_25B")
    if len(found.frames) < count:
        raise InputError(f"{len(found.frames)} images for {count} frames", file=folder, fix=_FIX)
    columns = [HALPE.index(name) for name in found.points]
    frames = []
    for k, one in enumerate(found.frames[:count]):
        positions, confidences = np.full((len(one.ids), len(HALPE), 2), np.nan), np.zeros((len(one.ids), len(HALPE)))
        positions[:, columns], confidences[:, columns] = one.positions_px, one.confidences
        at_ns = round(k * NS_PER_S / POSE2SIM_HZ)
        frames.append(
            keypoint_frame(
                camera, HALPE, time_ns=at_ns, size_px=size_px, sequence=k, positions_px=positions,
                confidences=confidences,
            )
        )  # fmt: skip
    return frames
