"""Keypoints of people beside the images of the method ``silhouettes``: waiting frames, and whose keypoints they are.

waiting.add(frame, at_ns)                           a camera's keypoints, before its image
seen  = waiting.take("left", image_ns, within_ns)   of the image's time
own   = keypoints_of_bodies(seen, places, eyes)     lines of each body, `mocapella.kinematics.keypoint_lines`
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocapella.association.keypoint_rays import SPREADS, halpe_keypoints, sources_named
from mocapella.geometry.plucker import camera_rays
from mocapella.geometry.rigid import inverse
from mocapella.kinematics.keypoint_lines import KeypointLineSettings, LandmarkLines
from mocapella.kinematics.silhouette_fit import Eye, seen_at
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.openpose_names import LANDMARKS
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

MOST_WAITING: Final = 64
"""Number of keypoint frames of a camera that wait for their images."""
LEAST_SHARED: Final = 4
"""Least number of landmarks that a detection shares with a body to be its own."""
FAR: Final = 0.25
"""A keypoint that is farther from a body's landmark than this share of the person's size is not its own [ratio]."""
MOST_COST: Final = 0.6
"""Largest mean distance of a detection from a body, in units of `FAR`, each at most 1."""


class SeenKeypoints(msgspec.Struct, frozen=True, eq=False):
    """Detections in one image, with the joints of ``halpe_26``.

    Attributes:
        at_ns: capture time, on the common clock.
        pixels: (detections, 26, 2) x, y, with the lens' distortion [px]; NaN where not seen.
        confidences: (detections, 26) 0 to 1; 0 where not seen.
    """

    at_ns: int
    pixels: Float64
    confidences: Float64


def seen_keypoints(frame: KeypointFrame, at_ns: int) -> SeenKeypoints | None:
    """Return a frame's detections with the joints of ``halpe_26``; None if its topology has no mapping to them.

    Joints that the topology shifts are shifted, see `mocapella.association.keypoint_rays.halpe_keypoints`.
    """
    if sources_named(frame.topology.name) is None:
        return None
    places, sure = halpe_keypoints(frame.topology.name, frame.positions_px, frame.confidences)
    pixels = np.where((sure > 0)[..., None], places, np.nan).astype(np.float64)
    return SeenKeypoints(at_ns, pixels, np.where(np.isfinite(pixels).all(axis=-1), sure, 0.0))


class WaitingKeypoints:
    """Keypoint frames that wait for the images of their times, by camera."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self._waiting: dict[str, deque[SeenKeypoints]] = {}

    def memory(self) -> dict[str, list[SeenKeypoints]]:
        """Return all state, for `recall` and a tracker's snapshot."""
        return {name: list(some) for name, some in self._waiting.items()}

    def recall(self, memory: Mapping[str, Sequence[SeenKeypoints]]) -> None:
        """Restore the state that `memory` returned."""
        self._waiting = {name: deque(some, maxlen=MOST_WAITING) for name, some in memory.items()}

    def add(self, camera: str, seen: SeenKeypoints) -> None:
        """Keep a frame of a camera; the oldest is dropped beyond `MOST_WAITING`."""
        self._waiting.setdefault(camera, deque(maxlen=MOST_WAITING)).append(seen)

    def take(self, camera: str, at_ns: int, within_ns: float) -> SeenKeypoints | None:
        """Return the frame of a camera nearest to a time, and forget all up to it; None if none is near.

        Args:
            camera: name of the camera.
            at_ns: capture time of the image, on the common clock.
            within_ns: largest distance in time [ns].
        """
        waiting = self._waiting.get(camera)
        if not waiting:
            return None
        best = min(waiting, key=lambda one: abs(one.at_ns - at_ns))
        found = best if abs(best.at_ns - at_ns) <= within_ns else None
        while waiting and (waiting[0].at_ns <= at_ns or waiting[0] is found):
            waiting.popleft()
        return found


class BodyKeypoints(msgspec.Struct, frozen=True, eq=False):
    """One body's keypoints of one instant.

    Attributes:
        cameras: names of the cameras, in the order of the arrays.
        pixels: (landmarks, cameras, 2) x, y of each landmark's keypoint [px]; NaN where not seen.
        lines: the lines of sight.
    """

    cameras: tuple[str, ...]
    pixels: Float64
    lines: LandmarkLines


def landmark_joints(landmarks: Sequence[str]) -> Int64:
    """Return for each landmark of a body the index of its joint in ``halpe_26``; −1 for landmarks without one.

    Keypoints of the head, and of the neck and the middle of the hips, have no landmark at the same place.
    """
    joints = {LANDMARKS[name]: k for k, name in enumerate(topology("halpe_26").joints) if name in LANDMARKS}
    of_head = ("nose", "head", "left eye", "right eye", "left ear", "right ear")
    return np.array([-1 if name in of_head else joints.get(name, -1) for name in landmarks], np.int64)


def keypoints_of_bodies(
    seen: Mapping[str, SeenKeypoints],
    bodies: Mapping[str, tuple[Sequence[str], Float64]],
    eyes: Mapping[str, Eye],
    settings: KeypointLineSettings,
) -> dict[str, BodyKeypoints]:
    """Assign the detections of each image to bodies, and return each body's keypoints with their lines of sight.

    In each image the sum of distances between keypoints and expected landmarks is minimal
    (H. Kuhn, "The Hungarian method for the assignment problem", Naval Research Logistics 2, 1955).

    Args:
        seen: detections by camera.
        bodies: names (n) and expected positions (n, 3) of the landmarks, world [m], by the body's name.
        eyes: the cameras by name.
        settings: the settings.

    Returns:
        By the body's name; bodies that no detection was assigned to are missing.
    """
    cameras = tuple(name for name in eyes if name in seen)
    empty = {name: _nothing(len(marks), [eyes[c] for c in cameras]) for name, (marks, _) in bodies.items()}
    joints = {name: landmark_joints(marks) for name, (marks, _) in bodies.items()}
    found: set[str] = set()
    for c, camera in enumerate(cameras):
        by, one = eyes[camera], seen[camera]
        pixels = np.where((one.confidences >= settings.least_confidence)[..., None], one.pixels, np.nan)
        sizes, names = _sizes_px(pixels), list(bodies)
        cost = np.full((len(names), len(pixels)), 1.0)
        for i, name in enumerate(names):
            expected = seen_at(bodies[name][1], by)
            for d in range(len(pixels)):
                cost[i, d] = _cost(_of_landmarks(pixels[d], joints[name]), expected, sizes[d])
        for i, d in zip(*linear_sum_assignment(cost), strict=True):
            if cost[i, d] < MOST_COST:
                own = joints[names[i]]
                sure = np.where(own >= 0, one.confidences[d, own], 0.0)
                sd_px = np.hypot(settings.least_sd_px, settings.joint_sd * sizes[d] * SPREADS[own])
                sd_px = sd_px / np.sqrt(np.minimum(1.0, 0.1 + sure))  # as of the method webcams
                _fill(empty[names[i]], c, by, _of_landmarks(pixels[d], own), sd_px)
                found.add(names[i])
    return {name: BodyKeypoints(cameras, px, lines) for name, (px, lines) in empty.items() if name in found}


def _nothing(count: int, eyes: Sequence[Eye]) -> tuple[Float64, LandmarkLines]:
    origins = np.array([inverse(by.T_camera_world)[:3, 3] for by in eyes]).reshape(-1, 3)
    shape = count, len(eyes)
    return np.full((*shape, 2), np.nan), LandmarkLines(np.full((*shape, 6), np.nan), origins, np.full(shape, np.nan))


def _fill(into: tuple[Float64, LandmarkLines], c: int, by: Eye, pixels: Float64, sd_px: Float64) -> None:
    """Write the pixels (landmarks, 2) and lines of camera ``c``, whose keypoints have standard deviations [px]."""
    own, lines = into
    own[:, c] = pixels
    lines.lines[:, c] = camera_rays(pixels, by.lens, by.T_camera_world)
    along = lines.lines[:, c, :3] @ by.T_camera_world[2, :3]
    # A pixel is a smaller angle beside the middle of the image.
    lines.sds_rad[:, c] = sd_px * along**2 / (0.5 * (by.lens[0] + by.lens[1]))


def _of_landmarks(pixels: Float64, joints: Int64) -> Float64:
    """Return the pixel (landmarks, 2) of each landmark's joint; NaN without one."""
    return np.where((joints >= 0)[:, None], pixels[joints], np.nan)


def _sizes_px(pixels: Float64) -> Float64:
    """Return the size (detections,) of each person: the side of a square of the keypoints' area, as of ``webcams``."""
    out = np.zeros(len(pixels))
    for d, one in enumerate(pixels):
        there = one[np.isfinite(one).all(axis=-1)]
        if len(there):
            wide, high = np.ptp(there, axis=0)
            out[d] = np.sqrt(max(wide, 0.35 * high) * max(high, 0.35 * wide))
    return out


def _cost(pixels: Float64, expected: Float64, size_px: float) -> float:
    """Return the mean distance of keypoints (landmarks, 2) from a body's landmarks, in units of `FAR`, at most 1."""
    away = np.linalg.norm(pixels - expected, axis=-1)
    away = away[np.isfinite(away)]
    if len(away) < LEAST_SHARED or not size_px > 0:
        return 1.0
    return float(np.minimum(away / (FAR * size_px), 1.0).mean())


REMEMBERED: Final[tuple[type[Any], ...]] = (SeenKeypoints,)
"""Classes in the state that `WaitingKeypoints.memory` returns, for `mocapella.model.memory`."""
