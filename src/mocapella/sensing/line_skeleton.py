"""The detector `line-skeleton`: an arm of eight joints by the image processing of 2012.

A baseline that follows its source document; `docs/detectors/line-skeleton.md` describes the stages, the choices that
the document leaves open, and the failures. It uses neither earlier images nor a hand model: fingers are named by the
order of their angles alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.lens import undistort
from mocapella.model.arms import ARM_JOINTS, ARM_POINTS, SeenArm, SeenArms
from mocapella.model.camera import Camera
from mocapella.model.hand import ANGLES
from mocapella.model.observations import JointState
from mocapella.sensing.line_skeleton_joints import HandJoints, PointGrid, grid, hand, nearest
from mocapella.sensing.line_skeleton_outline import ArmOutline, Lines, Separated, lines, outline, separated
from mocapella.sensing.line_skeleton_settings import LineSkeletonSettings

__all__ = ["LineSkeleton", "LineSkeletonSettings", "Looked"]

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

MEASURED_SD_M: Final = 0.03
"""Standard deviation of a coordinate of a detected joint; measured errors are in `docs/detectors/line-skeleton.md`."""
INFERRED_SD_M: Final = 0.1
"""Standard deviation of an undetected finger, which is placed at the palm: a finger's length."""


@dataclass(frozen=True, eq=False)
class Looked:
    """Results of the detector's stages; None for stages that were not reached.

    Attributes:
        separated: the near part of the depth image.
        outline: the arm's outline.
        lines: the lines of its skeleton.
        grid: a grid of points on the arm.
        hand: the joints in the image.
        joints: (8, 3) in the camera frame (x right, y down) [m], in the order of `ARM_JOINTS`.
        found: (8,) bool; False for a finger placed at the palm, and for a joint that is NaN because it is outside the
            lens's domain; not None if ``joints`` is not.
        reason: why there are no joints; empty if there are.
    """

    separated: Separated
    outline: ArmOutline | None = None
    lines: Lines | None = None
    grid: PointGrid | None = None
    hand: HandJoints | None = None
    joints: Float64 | None = None
    found: NDArray[np.bool_] | None = None
    reason: str = ""


class LineSkeleton:
    """Detects one arm in each image independently; a `mocapella.detectors.ArmDetector`.

    The outline is segmented by depth and thinned to straight lines, and the joints are placed along them. The arm is
    always reported as a right one, with certainty 0.5.

    Args:
        camera: name, size and lens of the depth camera.
        settings: thresholds; the defaults if None.

    Attributes:
        camera, settings: as given.
    """

    name = "line-skeleton"

    def __init__(self, camera: Camera, settings: LineSkeletonSettings | None = None) -> None:
        self.camera = camera
        self.settings = settings or LineSkeletonSettings()
        width, height = camera.size_px
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float64)
        rays = undistort(pixels, camera.lens)
        self._rays = rays[:, ::-1] if self.settings.mirror else rays
        self.reset()

    def reset(self) -> None:
        """Restart ids at 0; there is no other state."""
        self._id, self._seen = 0, False

    def update(self, depth: Float32, at_s: float) -> SeenArms:
        """Detect the arm in a depth image (height, width) [m]; see `mocapella.detectors.ArmDetector`.

        Args:
            depth: (height, width) [m]; values not above 0 were not measured.
            at_s: not used.

        Returns:
            One arm, whose id changes after images without an arm; or none and the reason. An undetected finger is
            inferred at the palm. Points other than the eight joints, and angles, are NaN.

        Raises:
            SettingsError: the image has another size than the camera's.
        """
        looked = self.look(depth)
        if looked.joints is None:
            self._id, self._seen = self._id + self._seen, False
            return SeenArms((), looked.reason)
        assert looked.found is not None
        self._seen = True
        points = np.full((len(ARM_POINTS), 3), np.nan)
        states = np.full(len(ARM_POINTS), JointState.NOT_TRACKED, np.uint8)
        sd, joints = np.full(len(ARM_POINTS), np.nan, dtype=np.float32), list(ARM_JOINTS)
        points[joints] = looked.joints
        known = np.isfinite(looked.joints).all(axis=-1)  # unknown outside the lens's domain
        guessed = np.where(known, JointState.INFERRED, JointState.NOT_TRACKED)
        states[joints] = np.where(looked.found, JointState.TRACKED, guessed)
        sd[joints] = np.where(looked.found, MEASURED_SD_M, np.where(known, INFERRED_SD_M, np.nan))
        return SeenArms((SeenArm(self._id, False, 0.5, points, states, sd, np.full(len(ANGLES), np.nan)),))

    def look(self, depth: Float32) -> Looked:
        """Return the results of all stages of an image.

        Args:
            depth: (height, width) [m]; values not above 0 were not measured.

        Raises:
            SettingsError: the image has another size than the camera's.
        """
        s, (width, height) = self.settings, self.camera.size_px
        metres = np.asarray(depth, dtype=np.float32)
        if metres.shape != (height, width):
            given = " × ".join(map(str, metres.shape[::-1]))
            raise SettingsError(f"the depth image is {given}; camera {self.camera.name} has {width} × {height} px")
        first = separated(metres, s)
        if not first.gray.any():
            return Looked(first, reason=self._nothing(first))
        second = outline(first, s)
        if second is None:
            return Looked(first, reason=f"no outline is larger than {s.least_area_px:g} px²: no arm, or it is too far")
        if np.count_nonzero(second.arm) > s.fills_most * second.arm.size:
            return Looked(first, second, reason=f"the near part takes up more than {s.fills_most:.0%} of the image: "
                          "the arm is too near, or it is a wall")  # fmt: skip
        third, points = lines(second, s), grid(second, self._rays, s)
        if not len(third.segments):
            return Looked(
                first, second, third, points, reason="no line in the skeleton: the nearest object is not an arm"
            )
        if not len(points.metres):
            return Looked(first, second, third, points, reason="no point of the grid is in the arm and the cube region")
        fourth = self._hand(second, third, points)
        return Looked(first, second, third, points, fourth, *self._placed(points, fourth))

    def stages(self, depth: Float32) -> Mapping[str, UInt8]:
        """Return an image of each stage by its name, in order: (height, width) gray, or (height, width, 3) BGR.

        Stages that were not reached are omitted. The detector's state does not change.

        Raises:
            SettingsError: the image has another size than the camera's.
        """
        from mocapella.sensing.line_skeleton_sheet import pictures

        return pictures(self.look(depth))

    @property
    def focal_px(self) -> float:
        """Mean focal length of the camera [px]."""
        return 0.5 * float(self.camera.lens[0] + self.camera.lens[1])

    def _hand(self, of: ArmOutline, found: Lines, points: PointGrid) -> HandJoints:
        """Locate the joints in the image; methods that find fingers otherwise replace it."""
        return hand(of, found, points, self.focal_px, self.settings)

    def _nothing(self, first: Separated) -> str:
        s, seen = self.settings, first.millimetres[first.millimetres > 0]
        if not seen.size:
            return "nothing was measured in the whole image"
        return (
            f"nothing lies between {s.near_m:g} and {s.far_m:g} m; the nearest is at {seen.min() / 1000:.2f} m, the "
            f"median at {np.median(seen) / 1000:.2f} m: move the arm, or give the right unit"
        )

    def _placed(self, points: PointGrid, found: HandJoints) -> tuple[Float64, NDArray[np.bool_]]:
        """Return joints in space, by the depth of the grid's nearest points and the position rules."""
        s = self.settings
        pixels = np.concatenate([[found.elbow, found.wrist, found.palm], found.tips])
        z = points.metres[[nearest(points, pixel) for pixel in pixels]]
        z[2] -= s.palm_forward_m
        joints = self._in_space(pixels, z)
        seen = np.asarray(np.isfinite(joints).all(axis=-1))
        seen[3:] &= (found.tips != 0).any(axis=-1) & (np.linalg.norm(joints[3:] - joints[2], axis=-1) <= s.longest_m)
        joints[3:][~seen[3:]] = joints[2]
        return joints, seen

    def _in_space(self, pixels: Float64, z: Float64) -> Float64:
        """Return (n, 3) points of pixels of the mirrored image at a depth."""
        unmirrored: Any = pixels.copy()
        if self.settings.mirror:
            unmirrored[:, 0] = self.camera.size_px[0] - 1 - unmirrored[:, 0]
        rays = np.concatenate([undistort(unmirrored, self.camera.lens), np.ones((len(z), 1))], axis=-1)
        return np.asarray(rays * z[:, None])
