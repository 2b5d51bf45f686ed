"""Read BVH, the animated skeleton of Blender and motion capture programs, by forward kinematics."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from mocapella.model.bvh import read_bvh
from mocapella.model.names import distinct
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories
from mocapella.recording.known_keypoints import known_keypoints
from mocapella.recording.trc_file import METRES

CM: Final = METRES["cm"]


def read_bvh_joints(path: Path, unit_m: float = CM) -> Trajectories:
    """Read the joints of a BVH as trajectories with bones, in metres and in the file's axes.

    The individual has the file's name. End sites are left out: they are no joints. All joints count as measured, as a
    BVH does not tell. Joints of a hand or of an arm are of the kind ``hands`` or ``arms``, others ``people``.

    Args:
        path: the file.
        unit_m: length of the file's unit, which a BVH does not state; centimetres by default [m].

    Raises:
        InputError: it cannot be read, or is no BVH with one root.
    """
    file = read_bvh(path)
    kept = [k for k, joint in enumerate(file.joints) if not joint.is_end]
    place = {k: i for i, k in enumerate(kept)}
    names = distinct(file.joints[k].name for k in kept)
    positions = unit_m * file.positions()[:, None, kept]
    count = len(positions)
    found = known_keypoints(names)
    return Trajectories(
        kind="people" if found.kind == "points" else found.kind,
        times_s=np.arange(count, dtype=np.float64) * file.frame_s,
        runs=np.zeros(count, np.int64),
        individuals=(path.stem,),
        keypoints=names,
        positions=positions,
        states=np.full(positions.shape[:3], JointState.TRACKED, np.uint8),
        sd=np.full(positions.shape[:3], np.nan, np.float32),
        bones=tuple((place[file.joints[k].parent], place[k]) for k in kept[1:]),
        rate_hz=1.0 / file.frame_s,
    )
