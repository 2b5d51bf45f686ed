"""Track a rigid object's pose from the pixels of its markers in any number of cameras, each pixel at its own time.

    tracker = ObjectPoses(rig, places_m, planes=((0, 1, 2, 3),))
    tracker.update("left", pixels, sd_px, at_s)
    pose = tracker.at(at_s)

The state is position, rotation, velocity and angular velocity of the object, all in the world, with white-noise
acceleration (Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation, 2001, section
6.2.2). A camera's frame corrects the prediction to its time by Gauss–Newton over all its pixels, with later times of
lower rows for rolling shutters: the iterated extended Kalman filter (B. Bell, F. Cathey, IEEE Trans. Automatic Control
38 (1993) 294), with small rotations from the left. So nothing is triangulated from observations at different times, one
marker in one camera adds information, and there is a covariance. A late frame is inserted in order.

The least cost is chi-squared with two degrees of freedom per marker. Beyond the gate, the object may have turned
suddenly (the process noise is increased, as in section 11.2.2 of the book), or the marker is left out whose removal
reduces the cost most, and so on: the prediction identifies an outlier among four corners.

An object is initialised by three markers that two cameras see, or by four or more on a plane (a tag) in one camera. A
plane that is small in the image has two poses, related by a rotation about the line of sight (G. Schweighofer, A. Pinz,
IEEE PAMI 28 (2006) 2024; T. Collins, A. Bartoli, Int. J. Computer Vision 109 (2014) 252). Both are tracked, each by its
own prediction, until the pixels of many frames or of another camera decide; until then the pose is *ambiguous*. Three
markers in one camera do not initialise an object (four poses fit them), but continue its tracking.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.fusion.marker_rays import RayState, captured, views_of
from mocapella.fusion.object_pose_values import (
    Hypothesis,
    MarkerPixels,
    ObjectPose,
    ObjectReport,
    PosePrediction,
    PoseResult,
    SeenFrame,
)
from mocapella.geometry.alignment import align, moments
from mocapella.geometry.homography import plane_pose
from mocapella.geometry.lens import undistort
from mocapella.geometry.rigid import inverse, rigid
from mocapella.geometry.triangulation import PointState, triangulate
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.model.camera import CameraRig
from mocapella.settings import check

Float64 = NDArray[np.float64]

_FOUND_POSITION_SD: Final = 1.0
_FOUND_ROTATION_SD: Final = 1.0
"""Prior standard deviations of a new pose, before the filter uses its first pixels [m], [rad]."""
_SAME_RAD: Final = 0.05
_REFUSED_IN_A_ROW: Final = 6
_LEAST_POINTS: Final = 3
_LEAST_WIDTH: Final = 1e-3
"""Least extent of a plane in the image, in focal lengths."""


@dataclass(frozen=True)
class ObjectPoseSettings:
    """Motion of objects, and gating of frames.

    Attributes:
        acceleration_density: power spectral density of the white-noise acceleration along an axis; larger: less lag,
            more jitter [m²/s³].
        turn_density: power spectral density of the white-noise angular acceleration about an axis; larger: less lag,
            more jitter [rad²/s³].
        manoeuvre: factor of ``acceleration_density`` and ``turn_density`` that is tried if a frame does not fit; then
            its square; larger: more sudden motion is followed [ratio].
        speed_sd: standard deviation of a new object's speed along an axis; larger: its motion is followed sooner, with
            more jitter at first [m/s].
        turn_sd: standard deviation of a new object's angular speed about an axis; larger: its rotation is followed
            sooner, with more jitter at first [rad/s].
        gate_sd: largest excess of a frame's cost over its expectation for the frame to be used; larger: wrong markers
            are left out more rarely [standard deviations].
        keep_s: a frame that is older than the newest one by more than this is dropped; larger: later cameras count, at
            more work [s].
        together_s: largest time between the frames that initialise an object [s].
        image_speed_px: assumed speed of a marker in an image; the standard deviation of the older frames' pixels grows
            by it with time [px/s].
        undecided_cost: largest difference of cost of two poses of a tag that are both tracked; larger: the pose is
            ambiguous for longer, and wrong more rarely [χ²].
        alone_s: an object with too few visible markers for this long is inferred: it needs two cameras, or four markers
            in one [s].
        forget_after_s: an object unseen for this long is lost [s].
        tracked_sd_m: an object is inferred if the standard deviation of its position along an axis is larger [m].
        tracked_sd_rad: an object is inferred if the standard deviation of its rotation about an axis is larger [rad].
        largest_sd_m: an object is lost if the standard deviation of its position along an axis is larger; larger: it is
            predicted for longer [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    acceleration_density: float = 0.3
    turn_density: float = 30.0
    manoeuvre: float = 60.0
    speed_sd: float = 1.0
    turn_sd: float = 5.0
    gate_sd: float = 5.0
    keep_s: float = 0.06
    together_s: float = 0.05
    image_speed_px: float = 1500.0
    undecided_cost: float = 25.0
    alone_s: float = 0.08
    forget_after_s: float = 0.3
    tracked_sd_m: float = 0.02
    tracked_sd_rad: float = 0.3
    largest_sd_m: float = 0.1

    def __post_init__(self) -> None:
        above = (
            *("acceleration_density", "turn_density", "speed_sd", "turn_sd", "gate_sd", "alone_s", "forget_after_s"),
            *("tracked_sd_m", "tracked_sd_rad", "largest_sd_m", "manoeuvre"),
        )
        for name in above:
            check(0 < getattr(self, name) < 1e6, name, getattr(self, name), "above 0")
        for name in ("keep_s", "together_s", "image_speed_px", "undecided_cost"):
            check(0 <= getattr(self, name) < 1e6, name, getattr(self, name), "0 or more")


class ObjectPoses:
    """Tracker of one object with the cameras of a rig: call `update` with each frame, and `at` for the pose.

    Its state is the present hypotheses of the pose, the latest frames with the hypotheses before each, and the time and
    number of markers of each camera's last used frame.

    Args:
        rig: the cameras' lenses, poses, clock offsets and readout times.
        places_m: (points, 3) positions of three markers or more in the object's frame [m].
        settings: motion and gates; the defaults if None.
        planes: groups of four or more markers on a plane, such as a tag's corners, as indices of ``places_m``; one
            camera that sees four of a group initialises the object.

    Raises:
        SettingsError: ``places_m`` has another shape, or is not finite.
    """

    def __init__(
        self,
        rig: CameraRig,
        places_m: Any,
        settings: ObjectPoseSettings | None = None,
        *,
        planes: Sequence[Sequence[int]] = (),
    ) -> None:
        """Create a tracker of a lost object; the class describes the arguments."""
        self.settings = settings or ObjectPoseSettings()
        self.rig, self.places = rig, np.ascontiguousarray(places_m, dtype=np.float64)
        good = self.places.ndim == 2 and self.places.shape[1] == 3 and len(self.places) >= _LEAST_POINTS
        check(
            bool(good and np.isfinite(self.places).all()), "places_m", self.places.shape, "(points, 3), three or more"
        )
        self._planes = [np.array(plane) for plane in planes]
        self._order = list(rig.cameras)
        self._views = views_of(rig)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._hypotheses: tuple[Hypothesis, ...] = ()
        self._frames: list[SeenFrame] = []
        self._believed: dict[str, tuple[float, int]] = {}
        self._refused = 0
        self._counts = dict.fromkeys(ObjectReport.__struct_fields__, 0)

    @property
    def report(self) -> ObjectReport:
        """Counts of frames (used, rejected by the gate, late) since the last `reset`."""
        return ObjectReport(**self._counts)

    def update(self, camera: str, pixels: Any, sd_px: Any, at_s: float) -> None:
        """Update the object with a camera's frame, or initialise it; see `at` for the result.

        A frame without a visible marker does nothing. One older than the newest frame by more than ``keep_s`` is only
        counted as late; other late ones are inserted, and the newer frames are filtered again.

        Args:
            camera: its name in the rig.
            pixels: (points, 2) x, y in its distorted image [px]; NaN where a marker is not seen.
            sd_px: standard deviation of a pixel's coordinate, a number or (points,); a pixel where it is not finite and
                above 0 is ignored [px].
            at_s: capture time of the image's first row, on the camera's clock [s].

        Raises:
            SettingsError: there is no such camera, or another number of points.
        """
        if camera not in self.rig.cameras:
            raise SettingsError(f"camera {camera!r} is not of the rig; known: {one_of(camera, self._order)}")
        px = np.array(pixels, dtype=np.float64)
        if px.shape != (len(self.places), 2):
            raise SettingsError(f"pixels of the shape {px.shape}; there are {len(self.places)} points")
        sd = np.empty(len(px))
        sd[:] = sd_px
        px[~(np.isfinite(px).all(axis=1) & (sd > 0) & np.isfinite(sd))] = np.nan
        if not np.isfinite(px).any():
            return
        self._counts["received"] += 1
        seen = SeenFrame(float(captured(self.rig.cameras[camera], 0.0, at_s)), camera, px, sd)
        newest = self._frames[-1].at_s if self._frames else -math.inf
        if seen.at_s < newest - self.settings.keep_s:
            self._counts["late"] += 1
            return
        self._take(seen)
        oldest = self._frames[-1].at_s - max(self.settings.keep_s, self.settings.together_s)
        self._frames = [frame for frame in self._frames if frame.at_s >= oldest]

    def at(self, at_s: float) -> ObjectPose:
        """Predict the object to the time ``at_s`` on the rig's clock [s], from all frames.

        The pose is None (LOST) before the object is initialised, and where the position is too uncertain. An object
        that is unseen for longer than ``forget_after_s`` at that time is forgotten, and must be initialised again.
        """
        s = self.settings
        lately = [count for last_s, count in self._believed.values() if at_s - last_s <= s.alone_s]
        last_s = max((last for last, _ in self._believed.values()), default=-math.inf)
        if self._hypotheses and at_s - last_s > s.forget_after_s:
            self._lose()
        if not self._hypotheses:
            return _lost(at_s)
        best = _predicted(self._hypotheses[0], at_s, s)
        covariance = best.covariance[:6, :6]
        sd_m, sd_rad = (math.sqrt(np.trace(covariance[k : k + 3, k : k + 3]) / 3) for k in (0, 3))
        if not sd_m <= s.largest_sd_m:
            return _lost(at_s)
        ambiguous = len(self._hypotheses) > 1
        enough = len(lately) >= 2 or max(lately, default=0) >= 4
        sure = enough and not ambiguous and sd_m <= s.tracked_sd_m and sd_rad <= s.tracked_sd_rad
        state = RayState.TRACKED if sure else RayState.INFERRED
        return ObjectPose(at_s, best.T, best.twist, covariance, state, ambiguous, at_s - last_s)

    def _lose(self) -> None:
        self._counts["lost"] += bool(self._hypotheses)
        self._hypotheses, self._refused = (), 0
        self._believed = {}

    def _take(self, seen: SeenFrame) -> None:
        """Insert a frame in order of time, and filter the later ones again."""
        last_s = max((last for last, _ in self._believed.values()), default=-math.inf)
        if self._hypotheses and seen.at_s - last_s > self.settings.forget_after_s:
            self._lose()
        after = [frame for frame in self._frames if frame.at_s > seen.at_s]
        if after:
            self._hypotheses = after[0].before
            self._frames = self._frames[: len(self._frames) - len(after)]
        self._use(seen)
        counts = dict(self._counts)
        for frame in after:
            self._use(frame)
        if after:
            self._counts = counts  # the later frames were counted before

    def _use(self, seen: SeenFrame) -> None:
        before = self._hypotheses
        self._frames.append(msgspec.structs.replace(seen, before=before))
        if not before:
            self._find(seen)
            return
        self._hypotheses, used = self._corrected(before, seen)
        if used:
            self._believe(seen, used)
            self._refused = 0
            return
        self._counts["refused"] += 1
        self._refused += 1
        if self._refused >= _REFUSED_IN_A_ROW:
            self._lose()
            self._find(seen)

    def _believe(self, seen: SeenFrame, used: int) -> None:
        self._counts["used"] += 1
        self._counts["outliers"] += int(np.isfinite(seen.pixels[:, 0]).sum()) - used
        last_s = self._believed.get(seen.camera, (-math.inf, 0))[0]
        if seen.at_s >= last_s:
            self._believed[seen.camera] = (seen.at_s, used)

    def _corrected(
        self, before: tuple[Hypothesis, ...], seen: SeenFrame, *, spare: bool = True
    ) -> tuple[tuple[Hypothesis, ...], int]:
        """Return the hypotheses after a frame, the best first, and its number of used markers; 0 if all reject it."""
        results = [self._correct(one, seen, spare) for one in before]
        good = [(one, used) for one, used in results if used]
        if not good:
            return before, 0
        good.sort(key=lambda pair: pair[0].cost)
        (best, used), s = good[0], self.settings
        kept = [msgspec.structs.replace(best, cost=0.0)]
        for other, _ in good[1:]:
            apart = np.linalg.norm(log_motion(rigid(other.T[:3, :3] @ best.T[:3, :3].T, np.zeros(3)))[3:])
            if other.cost - best.cost <= s.undecided_cost and apart > _SAME_RAD:
                kept.append(msgspec.structs.replace(other, cost=other.cost - best.cost))
        return tuple(kept), used

    def _correct(self, h: Hypothesis, seen: SeenFrame, spare: bool) -> tuple[Hypothesis, int]:
        """Correct a hypothesis by a frame; return it, and the number of used markers, 0 if the frame is rejected.

        All markers are used, if necessary with more process noise; otherwise the worst are left out. A marker that is
        left out costs as much as one at the gate, so that the pose with the fewest inliers is not preferred.
        """
        s, there = self.settings, np.isfinite(seen.pixels[:, 0])
        count = int(there.sum())
        factors = (1.0, s.manoeuvre, s.manoeuvre**2) if spare else (1.0,)
        for factor in factors[:2]:
            made, cost = self._least_squares(_predicted(h, seen.at_s, s, factor), seen, there)
            if cost <= self._gate(count):
                return msgspec.structs.replace(made, cost=h.cost + cost), count
        predicted = _predicted(h, seen.at_s, s)
        for used in range(count - 1, (count - 1) // 2, -1) if spare else ():
            tried = []
            for k in np.flatnonzero(there):
                without = there.copy()
                without[k] = False
                tried.append((*self._least_squares(predicted, seen, without), without))
            made, cost, there = min(tried, key=lambda one: one[1])
            if cost <= self._gate(used):
                cost += s.gate_sd**2 * (count - used)
                return msgspec.structs.replace(made, cost=h.cost + cost), used
        for factor in factors[2:]:
            there = np.isfinite(seen.pixels[:, 0])
            made, cost = self._least_squares(_predicted(h, seen.at_s, s, factor), seen, there)
            if cost <= self._gate(count):
                return msgspec.structs.replace(made, cost=h.cost + cost), count
        return predicted, 0

    def _gate(self, points: int) -> float:
        return 2 * points + self.settings.gate_sd * math.sqrt(4 * points)

    def _least_squares(self, h: Hypothesis, seen: SeenFrame, chosen: NDArray[np.bool_]) -> tuple[Hypothesis, float]:
        """Run Gauss–Newton from a prediction over the chosen pixels; return posterior and cost, infinite on failure."""
        placed = self.rig.cameras[seen.camera]
        later = captured(placed, seen.pixels[:, 1], placed.clock_s)
        R, x, covariance = np.empty((3, 3)), np.empty(9), np.empty((12, 12))
        R_0, x_0 = np.ascontiguousarray(h.T[:3, :3]), np.concatenate([h.T[:3, 3], h.twist])
        markers = MarkerPixels(self._order.index(seen.camera), self.places, seen.pixels, seen.sd_px, later, chosen)
        prediction = PosePrediction(R_0, x_0, np.asarray(np.linalg.inv(h.covariance), dtype=np.float64))
        cost = _kernels().correct(self._views.numbers, markers, prediction, PoseResult(R, x, covariance))
        if not math.isfinite(cost):
            return h, math.inf
        return Hypothesis(h.at_s, rigid(R, x[:3]), x[3:].copy(), covariance, h.cost), cost

    def _find(self, seen: SeenFrame) -> None:
        """Initialise the object from each camera's newest frame within `together_s`."""
        newest: dict[str, SeenFrame] = {}
        for frame in self._frames:
            if seen.at_s - frame.at_s <= self.settings.together_s:
                newest[frame.camera] = frame
        frames = sorted(newest.values(), key=lambda frame: frame.at_s)
        starts = self._by_triangulation(frames, seen.at_s) or self._by_plane(seen)
        s = self.settings
        spread = [_FOUND_POSITION_SD] * 3 + [_FOUND_ROTATION_SD] * 3 + [s.speed_sd] * 3 + [s.turn_sd] * 3
        prior = np.diag(np.square(spread))
        found: tuple[Hypothesis, ...] = tuple(Hypothesis(frames[0].at_s, T, np.zeros(6), prior) for T in starts)
        believed = []
        for frame in frames:
            if not found:
                return
            found, used = self._corrected(found, frame, spare=False)
            if not used:
                return
            believed.append((frame, used))
        if found:
            self._hypotheses = found
            self._counts["found"] += 1
            self._refused = 0
            for frame, used in believed:
                self._believe(frame, used)

    def _by_triangulation(self, frames: Sequence[SeenFrame], at_s: float) -> list[Float64]:
        """Return the pose from three markers, not on a line, that two cameras see."""
        if len(frames) < 2:
            return []
        pixels = np.full((len(self.places), len(self._order), 2), np.nan)
        sd = np.full(pixels.shape[:2], np.nan)
        for frame in frames:
            k = self._order.index(frame.camera)
            pixels[:, k] = frame.pixels
            sd[:, k] = np.hypot(frame.sd_px, self.settings.image_speed_px * (at_s - frame.at_s))
        points = triangulate(pixels, self._views, sd)
        good = points.states == PointState.SEEN
        if good.sum() < _LEAST_POINTS:
            return []
        places = self.places[good]
        if np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] < 0.003:
            return []
        T = align(moments(points.points[good], places))
        return [T] if np.isfinite(T).all() else []

    def _by_plane(self, seen: SeenFrame) -> list[Float64]:
        """Return both poses of the plane with the most visible points; empty if no plane has four of them."""
        there = np.isfinite(seen.pixels[:, 0])
        planes = [plane[there[plane]] for plane in self._planes]
        best: NDArray[np.intp] = max(planes, key=len, default=np.empty(0, dtype=np.intp))
        if len(best) < 4:
            return []
        places = self.places[best]
        middle = places.mean(axis=0)
        x, y, _ = np.linalg.svd(places - middle)[2]
        T_object_plane = rigid(np.stack([x, y, np.cross(x, y)], axis=1), middle)
        placed = self.rig.cameras[seen.camera]
        rays = undistort(seen.pixels[best], placed.camera.lens)
        flat = (places - middle) @ T_object_plane[:3, :2]
        if not np.isfinite(rays).all() or np.linalg.svd(rays - rays.mean(axis=0), compute_uv=False)[1] < _LEAST_WIDTH:
            return []
        try:
            T = plane_pose(flat, rays)
        except np.linalg.LinAlgError:
            return []
        if not np.isfinite(T).all():
            return []
        T_world_camera = inverse(placed.T_camera_world)
        return [T_world_camera @ one @ inverse(T_object_plane) for one in (T, turned_over(T))]


def turned_over(T_camera_plane: Float64) -> Float64:
    """Return the second pose (4, 4) of a plane that fits nearly the same image as a given one.

    Its depths about the plane's origin are reversed along the line of sight. ``T_camera_plane`` (4, 4) maps from the
    plane's frame, the plane z = 0, to the camera frame; it is not changed.

    With S = I − 2 v vᵀ, v the direction to the plane's origin, the axes in the plane become S x and S y.
    """
    v = T_camera_plane[:3, 3] / np.linalg.norm(T_camera_plane[:3, 3])
    S = np.eye(3) - 2.0 * np.outer(v, v)
    x, y = S @ T_camera_plane[:3, 0], S @ T_camera_plane[:3, 1]
    return rigid(np.stack([x, y, np.cross(x, y)], axis=1), T_camera_plane[:3, 3])


def _predicted(h: Hypothesis, at_s: float, s: ObjectPoseSettings, manoeuvre: float = 1.0) -> Hypothesis:
    """Predict at constant velocity and angular velocity, forwards or backwards in time."""
    dt = at_s - h.at_s
    if dt == 0:
        return h
    turn = exp_twist(np.r_[np.zeros(3), dt * h.twist[3:]])[:3, :3]
    T = rigid(turn @ h.T[:3, :3], h.T[:3, 3] + dt * h.twist[:3])
    F = np.eye(12)
    F[:3, 6:9] = dt * np.eye(3)
    F[3:6, 3:6] = turn
    F[3:6, 9:] = dt * np.eye(3)
    P = F @ h.covariance @ F.T
    a = manoeuvre * abs(dt)
    for k, q in ((0, s.acceleration_density), (3, s.turn_density)):
        for i in range(k, k + 3):
            P[i, i] += q * a * dt**2 / 3
            P[i, i + 6] += q * dt * a / 2
            P[i + 6, i] += q * dt * a / 2
            P[i + 6, i + 6] += q * a
    return Hypothesis(at_s, T, h.twist, P, h.cost)


def _lost(at_s: float) -> ObjectPose:
    return ObjectPose(at_s, None, np.full(6, np.nan), np.full((6, 6), np.nan), RayState.LOST, False, math.inf)


@cache
def _kernels() -> Any:
    """Return the compiled steps; numba is imported at the first use."""
    from mocapella.fusion import object_pose_kernels

    return object_pose_kernels
