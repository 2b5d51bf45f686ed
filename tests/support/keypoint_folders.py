"""Folders of keypoints of simulated people, as OpenPose writes them, with the rig of their cameras."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import save_camera_rig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.point_tracks import match_cameras
from mocapella.model.topology import topology
from mocapella.recording.detection_files import read_detections
from mocapella.recording.detections import keypoint_frames
from mocapella.tracker.webcams_warmup import circle_of_cameras, seen_people, standing_person

Float64 = NDArray[np.float64]
RATE_HZ = 30.0


def walkers(frames: int, count: int = 2) -> Float64:
    """Return the joints of `halpe_26` (frames, people, 26, 3) of people who shift slowly, 1 m apart, y up [m]."""
    at = np.arange(frames)[:, None] / RATE_HZ
    x = np.linspace(-0.5, 0.5, count)[None] + 0.2 * at if count > 1 else 0.2 * at
    shift = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=-1)
    return standing_person() + shift[:, :, None]


def write_openpose(
    folder: Path, people: Sequence[Float64] | Float64, *, cameras: int = 4, kind: str = "halpe_26"
) -> CameraRig:
    """Write ``folder/rig.toml`` and ``folder/pose/cam-0_json/…`` of people (frames, people, 26, 3); return the rig."""
    rig = circle_of_cameras(cameras)
    folder.mkdir(parents=True, exist_ok=True)
    save_camera_rig(folder / "rig.toml", rig)
    own = topology(kind)
    table = own.mappings.get("halpe_26", {k: {k: 1.0} for k in range(26)})
    for number, joints in enumerate(people):
        for arrival in seen_people(rig, list(joints), at_ns=1):
            camera = folder / "pose" / f"{arrival.frame.sensor}_json"
            camera.mkdir(parents=True, exist_ok=True)
            rows = []
            for px in arrival.frame.positions_px:  # type: ignore[attr-defined]
                values = np.zeros((len(own), 3))
                for joint, terms in table.items():
                    (keypoint,) = terms
                    if np.isfinite(px[joint]).all():
                        values[keypoint] = (*px[joint], 0.9)
                rows.append({"pose_keypoints_2d": values.ravel().tolist()})
            (camera / f"{camera.name}_{number:06}.json").write_text(json.dumps({"people": rows}))
    return rig


def frames_of(folder: Path, rig: CameraRig) -> dict[str, list[KeypointFrame]]:
    """The frames in a folder of `write_openpose`, by the rig's camera names."""
    found = read_detections([one for one in sorted(folder.iterdir()) if one.is_dir()])
    names = match_cameras([one.camera for one in found], rig.cameras)
    return {
        name: keypoint_frames(one, name, rig.cameras[name].camera.size_px, RATE_HZ)
        for name, one in zip(names, found, strict=True)
    }
