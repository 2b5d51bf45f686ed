"""Lift keypoints of colour images to joints in space, with the depth image of the same instant.

    lift = KeypointLift(colour_lens, depth_lens=depth_lens, T_colour_depth=T, size_px=(640, 480))
    joints = lift.joints(keypoint_frame, depth_m)
    joints.positions, joints.states          # (people, keypoints, 3), (people, keypoints)

A depth image measures skin and clothes, and whatever stands in front. For each person, the surface of every keypoint is
chosen together with the other keypoints', so that limbs have possible lengths and continuous surfaces
(`keypoint_layer_kernels`). Joints lie under the surface by the limb's radius. A keypoint that is behind something, or
whose pixel has no depth, is inferred from the joints next to it and is never tracked (`keypoint_joint_kernels`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.lens import undistort
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.observations import BodyFrame, JointState, body_frame
from mocapella.model.topology import Topology
from mocapella.sensing.keypoint_limbs import keypoint_limbs
from mocapella.settings import check

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


@dataclass(frozen=True)
class LiftSettings:
    """Settings of `KeypointLift`.

    Attributes:
        sure: least confidence of a tracked joint; larger: more joints are only inferred [ratio].
        seen: least confidence of a keypoint that is used; larger: fewer joints, and fewer wrong ones [ratio].
        joints: least number of tracked joints of a person; larger: people at the border of the image are left out
            [joints].

    Raises:
        SettingsError: a value is out of range.
    """

    sure: float = 0.4
    seen: float = 0.1
    joints: int = 4

    def __post_init__(self) -> None:
        check(0 <= self.sure <= 1, "sure", self.sure, "from 0 to 1")
        check(0 <= self.seen <= 1, "seen", self.seen, "from 0 to 1")
        check(1 <= self.joints <= 133, "joints", self.joints, "from 1 to 133")


class LiftedJoints(msgspec.Struct, frozen=True, eq=False):
    """The people of one image in space: arrays over (people, keypoints).

    Attributes:
        detection: (people,) index of each person's detection in the keypoint frame.
        positions: (people, keypoints, 3) camera frame, x right, y down, z out of the lens [m]; NaN where not tracked.
        states: (people, keypoints) `mocapella.model.observations.JointState`.
        statures_m: (people,) stature that the limbs tell [m].
    """

    detection: NDArray[np.int64]
    positions: Float64
    states: UInt8
    statures_m: Float64


class KeypointLift:
    """Lifts the keypoints of one colour camera with a depth camera beside it; has no memory of earlier images.

    Args:
        lens: (9,) lens of the colour camera, see `mocapella.geometry.lens`.
        size_px: (width, height) of the colour images.
        depth_lens: (9,) lens of the depth images; None if they are registered to the colour images, pixel by pixel.
        T_colour_depth: (4, 4) from the depth camera's frame to the colour camera's, both x right, y down, z out of the
            lens [m]; the identity if None.
        settings: the settings; the defaults if None.

    Raises:
        SettingsError: a motion without a lens of the depth images, or one that is not (4, 4).
    """

    def __init__(
        self, lens: Any, size_px: tuple[int, int], *, depth_lens: Any = None, T_colour_depth: Any = None,
        settings: LiftSettings | None = None,
    ) -> None:  # fmt: skip
        self.settings, self.size_px = settings or LiftSettings(), size_px
        self._lens = np.array(lens, np.float64)
        self._depth_lens = None if depth_lens is None else np.array(depth_lens, np.float64)
        T = np.eye(4) if T_colour_depth is None else np.array(T_colour_depth, np.float64)
        if T.shape != (4, 4):
            raise SettingsError(f"T_colour_depth has the shape {T.shape}; (4, 4) is wanted")
        if depth_lens is None and T_colour_depth is not None:
            raise SettingsError("T_colour_depth is given without depth_lens; give both, or register the depth images")
        self._T = T
        self._rays: Float64 | None = None

    def joints(self, frame: KeypointFrame, depth_m: Float32) -> LiftedJoints:
        """Return the people of a keypoint frame in space; those without a body in the depth image are left out.

        Args:
            frame: keypoints of the colour image, with its lens' distortion.
            depth_m: (height, width) float32 distances along the optical axis of the depth image of the same instant
                [m]; 0 where not measured.

        Raises:
            SettingsError: the frame or the registered depth image has another size than the colour images.
        """
        if frame.size_px != self.size_px:
            raise SettingsError(f"size_px of the keypoints is {frame.size_px}; the camera's is {self.size_px}")
        pinhole, depth = self._lens[:4], self._registered(np.ascontiguousarray(depth_m, np.float32))
        n, people = len(frame.topology), len(frame.ids)
        pixels = np.array(frame.positions_px, np.float64)
        confidences = np.array(frame.confidences, np.float64)
        pixels[~(confidences >= self.settings.seen) | ~(confidences > 0)] = np.nan
        rays = undistort(pixels, self._lens)
        if self._depth_lens is not None:  # the drawn image has no distortion
            pixels = rays * pinhole[:2] + pinhole[2:]
        positions, states = np.full((people, n, 3), np.nan), np.zeros((people, n), np.uint8)
        statures = np.full(people, np.nan)
        limbs, focal = keypoint_limbs(frame.topology), float(pinhole[0])
        taken, count = np.empty((people * (n + 36), 7)), 0
        found = np.zeros(people, np.bool_)
        # People in front are seen more surely: their surfaces belong to no person behind them.
        for k in np.argsort(-confidences.mean(axis=1), kind="stable").tolist():
            statures[k] = _kernels().lift_person(
                depth, focal, limbs, rays[k], pixels[k], confidences[k], taken[:count], float(self.settings.sure),
                positions[k], states[k],
            )  # fmt: skip
            tracked = np.count_nonzero(states[k] == JointState.TRACKED)
            found[k] = np.isfinite(statures[k]) and tracked >= self.settings.joints
            if found[k]:
                count += _kernels().limbs_of(limbs, positions[k], statures[k], taken[count:])
        there = np.flatnonzero(found)
        return LiftedJoints(there, positions[there], states[there], statures[there])

    def warm_up(self, own: Topology) -> None:
        """Compile the kernels for keypoints of a topology, by an image without people."""
        width, height = self.size_px
        shape = (height, width) if self._depth_lens is None else (3, 4)
        pixels = np.full((1, len(own), 2), 1.0)
        nobody = keypoint_frame("camera", own, time_ns=1, size_px=self.size_px, positions_px=pixels)
        self.joints(nobody, np.zeros(shape, np.float32))

    def _registered(self, depth: Float32) -> Float32:
        """Return the depth image [m] where keypoints are looked up, in the pixels of the colour images."""
        width, height = self.size_px
        if self._depth_lens is None:
            if depth.shape != (height, width):
                size = f"{depth.shape[1]} × {depth.shape[0]}"
                raise SettingsError(f"the depth image has {size} px, and the colour image {width} × {height}; give "
                                    "the lens of the depth images, or register them")  # fmt: skip
            return depth
        if self._rays is None or self._rays.shape[:2] != depth.shape:
            rows, columns = np.indices(depth.shape, dtype=np.float64)
            self._rays = undistort(np.stack([columns, rows], axis=-1), self._depth_lens)
        out = np.empty((height, width), np.float32)
        splat = max(1, math.ceil(self._lens[0] / self._depth_lens[0]))
        _kernels().register(depth, self._rays, self._T, self._lens[:4], splat, out)
        return out


def body_frame_of(joints: LiftedJoints, frame: KeypointFrame, ids: Any = None) -> BodyFrame:
    """Return lifted joints as the frame of a body sensor at the colour camera.

    Args:
        joints: the people, see `KeypointLift.joints`.
        frame: the keypoint frame that they are from; name, time and topology are taken from it.
        ids: (people,) ids that last from image to image; if None, 0, 1, ….
    """
    pixels = frame.positions_px[joints.detection]
    return body_frame(
        frame.sensor, frame.topology, time_ns=frame.time_ns, positions=joints.positions * (-1.0, -1.0, 1.0),
        states=joints.states, tracking_ids=ids, depth_px=pixels, depth_size_px=frame.size_px,
        node_id=frame.node_id, sequence=frame.sequence, sent_ns=frame.sent_ns,
    )  # fmt: skip


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.sensing import keypoint_joint_kernels

    return keypoint_joint_kernels
