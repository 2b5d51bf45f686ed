"""One person as a performer of the VMC protocol: bone rotations for avatars.

sh_akira, *VMC Protocol specification* (protocol.vmc.info). A datagram is a bundle of:

| address | arguments |
|---|---|
| ``/VMC/Ext/OK`` | 1, calibrated (3), normal (0), tracking: 1, or 0 while the person is not there |
| ``/VMC/Ext/T`` | capture time since the first scene [s] |
| ``/VMC/Ext/Root/Pos`` | ``root``, position, rotation: the origin |
| ``/VMC/Ext/Bone/Pos`` | bone of Unity's *HumanBodyBones*, position and rotation relative to its parent bone |

Coordinates are Unity's: left-handed, metres, y up. At rest the person looks along +z with the left hand at −x, as
Unity's humanoids do: p' = (−x, y, z), q' = (qx, −qy, −qz, qw).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.bone_rotations import local_rotations
from mocapella.geometry.swing_twist import quaternions
from mocapella.model.humanoid_motion import HumanoidMotion, hips_known, humanoid_motion
from mocapella.model.scene import Scene
from mocapella.model.trajectories import PARTS, IndividualRow, Trajectories
from mocapella.schema.osc_messages import osc_bundles, osc_message

Float64 = NDArray[np.float64]

HUMANOID: Final = "unity"
MOST_BYTES: Final = 60_000
"""Largest bundle [bytes]: all bones of a scene are in one datagram, so that no avatar has bones of two moments."""
FLOOR_RISES: Final = 0.05
"""Speed at which the floor rises towards the lowest joint [m/s]; it falls at once. A joint measured too low would else
keep the avatar in the air."""
_NO_TURN: Final = (0.0, 0.0, 0.0, 1.0)


class VmcPerformer:
    """Encoder of one person's pose.

    It sends the first person that it sees until this person leaves, then the next one. A bone whose joints are unknown
    keeps its last rotation relative to its parent. The floor, y = 0, is below the lowest joint of the last seconds.

    Args:
        individuals: names of the people who may be sent, such as ``person_0``, the first ones preferred; empty for all.
    """

    def __init__(self, individuals: tuple[str, ...] = ()) -> None:
        self._individuals = individuals
        self._name = ""
        self._turns: dict[str, Float64] = {}
        self._first_ns: int | None = None
        self._at_ns = 0
        self._floor = np.inf

    def datagrams(self, scene: Scene) -> list[bytes]:
        """Return one bundle; without a person, it says that nobody is tracked.

        Raises:
            SettingsError: the person's keypoints do not determine a humanoid.
        """
        if self._first_ns is None:
            self._first_ns = self._at_ns = scene.at_ns
        row = self._chosen(scene)
        motion = None if row is None else _motion(row)
        self._follow_floor(scene.at_ns, row)
        return list(osc_bundles(self._messages((scene.at_ns - self._first_ns) * 1e-9, motion), MOST_BYTES))

    def _chosen(self, scene: Scene) -> IndividualRow | None:
        """Return the person to send; a new one begins without remembered rotations."""
        there = {row.name: row for row in PARTS["people"](scene)}
        wanted = self._individuals or tuple(there)
        if self._name not in there:
            self._name = next((name for name in wanted if name in there), "")
            self._turns = {}
        return there.get(self._name)

    def _follow_floor(self, at_ns: int, row: IndividualRow | None) -> None:
        heights = np.empty(0) if row is None else row.positions[np.isfinite(row.positions).all(axis=1), 1]
        if len(heights):
            risen = self._floor + FLOOR_RISES * max(0, at_ns - self._at_ns) * 1e-9
            self._floor = min(float(heights.min()), risen)
        self._at_ns = at_ns

    def _messages(self, seconds: float, motion: HumanoidMotion | None) -> Iterator[bytes]:
        yield osc_message("/VMC/Ext/OK", 1, 3, 0, int(motion is not None))
        yield osc_message("/VMC/Ext/T", float(seconds))
        if motion is None:
            return
        yield osc_message("/VMC/Ext/Root/Pos", "root", 0.0, 0.0, 0.0, *_NO_TURN)
        skeleton = motion.skeleton
        turns = quaternions(local_rotations(skeleton.parents, motion.turns))[0]
        places = skeleton.offsets.copy()
        places[0] = motion.root[0] - [0.0, self._floor, 0.0]
        for k, bone in enumerate(skeleton.names):
            if motion.held[0, k]:
                turns[k] = self._turns.get(bone, turns[k])
            self._turns[bone] = turns[k]
            (x, y, z), (qx, qy, qz, qw) = places[k].tolist(), turns[k].tolist()
            yield osc_message("/VMC/Ext/Bone/Pos", bone, -x, y, z, qx, -qy, -qz, qw)


def _motion(row: IndividualRow) -> HumanoidMotion | None:
    """Return a person's pose in one frame; None while the hips are unknown."""
    shape = (1, 1, len(row.keypoints))
    one = Trajectories(
        "people", np.zeros(1), np.zeros(1, np.int64), (row.name,), row.keypoints, row.positions[None, None],
        row.states[None, None], np.full(shape, np.nan, np.float32),
    )  # fmt: skip
    return humanoid_motion(one, HUMANOID) if hips_known(one).any() else None
