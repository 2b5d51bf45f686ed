"""Keypoints of the Pose2Sim clips in `../shared/data`, as frames, and the authors' own results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.observations import Arrival
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
RATE_HZ = 60.0
BODY_25B = topology("body_25b").joints


def rig_of(folder: Path) -> CameraRig:
    """The cameras of a clip; their names are those of its folders of keypoints."""
    path = next(folder.rglob("Calib_qualisys.toml"))
    rig = load_camera_rig(path)
    names = sorted(one.name.removesuffix("_json") for one in (folder / "pose").iterdir())
    import msgspec

    cameras = {}
    for name, own in zip(names, sorted(rig.cameras), strict=True):
        placed = rig.cameras[own]
        camera = msgspec.structs.replace(placed.camera, name=name)
        cameras[name] = msgspec.structs.replace(placed, camera=camera)
    return CameraRig(cameras)


def detections(path: Path) -> Float64:
    """(people, 26, 3) x, y and confidence of the people in an OpenPose file, in the order of halpe_26."""
    halpe = topology("halpe_26")
    people = []
    for one in json.loads(path.read_text())["people"]:
        values = np.array(one["pose_keypoints_2d"], dtype=np.float64).reshape(-1, 3)
        if len(values) != len(BODY_25B):
            continue
        placed = np.zeros((26, 3))
        for name, value in zip(BODY_25B, values, strict=True):
            placed[halpe.index(name)] = value
        people.append(placed)
    return np.array(people).reshape(-1, 26, 3)


def arrivals_of(folder: Path, rig: CameraRig) -> list[Arrival]:
    """The frames of all cameras of a clip, instant by instant."""
    found = []
    files = {name: sorted((folder / "pose" / f"{name}_json").glob("*.json")) for name in sorted(rig.cameras)}
    for k in range(min(map(len, files.values()))):
        for name, paths in files.items():
            people = detections(paths[k])
            at_ns = round(1e9 * (1.0 + k / RATE_HZ))
            frame = keypoint_frame(
                name, topology("halpe_26"), time_ns=at_ns, size_px=rig.cameras[name].camera.size_px,
                positions_px=people[..., :2], confidences=people[..., 2] if len(people) else 1.0, sequence=k,
            )  # fmt: skip
            found.append(Arrival(frame, at_ns))
    return found


def result_of(path: Path) -> Float64:
    """(frames, 26, 3) joints of a TRC of Pose2Sim in the cameras' world [m]; NaN for joints that it has not."""
    lines = path.read_text().split("\n")
    names = [name for name in lines[3].split("\t")[2:] if name.strip()]
    rows = [[float(x) if x.strip() else np.nan for x in line.split("\t")[2:]] for line in lines[5:] if line.strip()]
    points = np.array([row[: 3 * len(names)] for row in rows]).reshape(len(rows), len(names), 3)
    out = np.full((len(rows), 26, 3), np.nan)
    for i, name in enumerate(names):
        out[:, topology("halpe_26").index(name)] = points[:, i][:, [2, 0, 1]]
    return out
