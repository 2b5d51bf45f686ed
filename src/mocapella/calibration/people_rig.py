"""Place cameras that people calibrated in a world: floor, scale, an older rig, and the quality in figures and words.

People determine cameras up to a scale. A stated distance of two cameras, height of a camera or stature of the people
gives it; without a statement it is a guess from the mean stature of adults, and is marked as one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.keypoint_bundle import CLOCK, FOCAL
from mocapella.calibration.keypoint_gauge import aligned_sds
from mocapella.calibration.keypoint_lenses import WrongLens
from mocapella.calibration.people_floor import PeopleFloor, find_floor, world_frame
from mocapella.calibration.rig_from_people import STATURE_M, PeopleSolution
from mocapella.errors import CalibrationError, SettingsError, one_of
from mocapella.geometry.rigid import inverse, rigid
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.settings import check

Float64 = NDArray[np.float64]

STATURE_SD: Final = 0.03
"""Relative standard deviation of the scale by a stated stature: detectors find neither the crown nor the sole."""
GUESS_SD: Final = 0.07
"""Relative standard deviation of the scale by the mean stature of adults."""
HEIGHT_SD_M: Final = 0.03
"""Standard deviation of the floor's height under a camera of stated height [m]."""
DISTANCE_SD_M: Final = 0.005
"""Standard deviation of a measured distance of two cameras [m]."""
LEAST_EXTENT_M: Final = 0.35
"""Extent of people's ways (root mean square distance from their middle) below which they should walk more [m]."""
POOR_MM: Final = 40.0
"""Error of a position above which a camera is not well placed [mm]."""
POOR_DEG: Final = 1.0
"""Error of a direction above which a camera is not well placed [°]."""
SURE: Final = 1.8
"""An error is less than this many standard deviations with a probability of about 95 %: between 1.61, if it is alike
along all three axes, and 1.96, if it is along one. The standard deviation is that of all axes together."""
POOR_FOCAL: Final = 0.05
"""Relative standard deviation of a focal length above which it is not determined."""


@dataclass(frozen=True)
class RigScale:
    """What is stated about lengths; at most one field. Without any, the scale is a guess.

    Attributes:
        stature_m: mean stature of the people who are seen [m].
        distance_m: distance of the cameras ``between`` [m].
        between: names of two cameras.
        camera_height_m: height of ``camera`` above the floor [m].
        camera: name of a camera.

    Raises:
        SettingsError: a value is out of range, or several lengths are stated; says what can be.
    """

    stature_m: float | None = None
    distance_m: float | None = None
    between: tuple[str, str] = ("", "")
    camera_height_m: float | None = None
    camera: str = ""

    def __post_init__(self) -> None:
        given = [value for value in (self.stature_m, self.distance_m, self.camera_height_m) if value is not None]
        if len(given) > 1:
            raise SettingsError("several lengths are stated; state one: a stature, a distance, or a camera's height")
        if self.stature_m is not None:
            check(0.5 <= self.stature_m <= 2.5, "stature", self.stature_m, "from 0.5 to 2.5 m")
        if self.distance_m is not None:
            check(0.01 <= self.distance_m <= 100, "distance", self.distance_m, "from 0.01 to 100 m")
        if self.camera_height_m is not None:
            check(0.05 <= self.camera_height_m <= 20, "camera height", self.camera_height_m, "from 0.05 to 20 m")


class PlacedByPeople(msgspec.Struct, frozen=True):
    """Quality of one camera.

    Attributes:
        keypoints: number of keypoints that were used.
        residual_px: median distance of the keypoints from the adjusted joints [px].
        position_sd_mm: standard deviation of the position, without the scale's, after the rigid motion that aligns all
            cameras best [mm].
        rotation_sd_deg: of the orientation, about all axes together, after the same motion [°].
        focal_sd_percent: of the focal length; 0 if the lens was given [%].
        clock_sd_ms: of the clock [ms].
        clock_ms: the camera's clock minus the first's [ms].
        moved: whether it was moved since the given rig.
    """

    keypoints: int
    residual_px: float
    position_sd_mm: float
    rotation_sd_deg: float
    focal_sd_percent: float
    clock_sd_ms: float
    clock_ms: float
    moved: bool = False

    @property
    def likely_mm(self) -> float:
        """Limit of the position's error, with a probability of about 95 % (`SURE`) [mm]."""
        return SURE * self.position_sd_mm

    @property
    def likely_deg(self) -> float:
        """Limit of the direction's error, with a probability of about 95 % (`SURE`) [°]."""
        return SURE * self.rotation_sd_deg

    @property
    def well_placed(self) -> bool:
        """Whether the errors of position and direction are small, with a probability of about 95 %."""
        return self.likely_mm <= POOR_MM and self.likely_deg <= POOR_DEG


class RigFromPeople(msgspec.Struct, frozen=True, eq=False):
    """A rig that people calibrated, and its quality.

    Attributes:
        rig: the cameras; y is up and the floor is at 0 if ``floor_known``.
        cameras: quality of each camera.
        scale_words: where the scale is from.
        scale_sd: its relative standard deviation.
        guessed: whether the scale is only a guess.
        floor_known: whether feet on the floor were seen.
        up_sd_deg: standard deviation of the upward direction [°].
        people: number of people.
        instants: number of instants at which two cameras or more saw a person.
        stature_m: median stature of the people with this scale [m].
        extent_m: root mean square distance of a person from its own middle place, of the one who walks most [m].
        notes: what would make it better.
        wrong_lenses: cameras whose given lenses the people contradict; their standard deviations say so.
    """

    rig: CameraRig
    cameras: dict[str, PlacedByPeople]
    scale_words: str
    scale_sd: float
    guessed: bool
    floor_known: bool
    up_sd_deg: float
    people: int
    instants: int
    stature_m: float
    extent_m: float
    notes: list[str]
    wrong_lenses: tuple[str, ...] = ()

    @property
    def good(self) -> bool:
        """Whether people walked about and contradict no given lens, and each camera is known well.

        Its errors are at most 40 mm and 1° with a probability of 95 % (`SURE`), and the standard deviation of its
        focal length is at most 5 %.
        """
        known = self.extent_m >= LEAST_EXTENT_M and not self.wrong_lenses
        return known and all(c.well_placed and c.focal_sd_percent <= 100 * POOR_FOCAL for c in self.cameras.values())


@dataclass(frozen=True)
class _Scaled:
    """The scale from the solution's unit to metres."""

    factor: float
    sd: float
    words: str
    guessed: bool = False


def place_rig(found: PeopleSolution, scale: RigScale | None = None, old: CameraRig | None = None) -> RigFromPeople:
    """Place solved cameras in a world.

    Args:
        found: the solution.
        scale: a stated length; None for a guess.
        old: an older rig with some of the cameras, whose world, and scale without a stated one, is kept; None without.

    Raises:
        SettingsError: a stated camera is not there.
        CalibrationError: a height is stated and no feet were seen, or the older rig contradicts the people so that it
            is not known which camera was moved.
    """
    bundle = found.adjusted.bundle
    floor = find_floor(found.people, found.views.person, found.at_s, bundle.log_lengths)
    fit = _fit_old(found, old) if old is not None else None
    stated = scale or RigScale()
    none = stated == RigScale()
    scaled = _Scaled(fit.scale, fit.scale_sd, "by the given rig") if fit and none else _scale(found, floor, stated)
    first = world_frame(bundle.T_camera_world[0], floor)
    T_world_joints = first if fit is None else fit.T_world_joints
    between = None if stated.distance_m is None else stated.between
    covariance = scaled_covariance(found, scaled.factor, scaled.sd, between)
    scaled_T = bundle.T_camera_world.copy()
    scaled_T[:, :3, 3] *= scaled.factor
    sds = aligned_sds(scaled_T, _without_scale(found, scaled.factor, between))
    cameras, quality = {}, {}
    for k, name in enumerate(found.names):
        T = _scaled_pose(bundle.T_camera_world[k], T_world_joints, scaled.factor)
        camera = Camera(name, found.sizes_px[k], bundle.lenses[k])
        placed = PlacedCamera(camera, T, covariance[k], float(found.clocks_s[k]))
        moved = fit is not None and name in fit.moved
        if old is not None and none and not moved and name in old.cameras:
            placed = combined(placed, old.cameras[name])
        cameras[name] = placed
        quality[name] = _quality(found, k, (float(sds[0][k]), float(sds[1][k])), moved=moved)
    rig = CameraRig(cameras)
    extent = scaled.factor * _extent(found)
    seen = RigFromPeople(
        rig, quality, scaled.words, scaled.sd, scaled.guessed, bool(np.isfinite(floor.height_m)),
        math.degrees(floor.up_sd_rad), len(bundle.log_lengths), len(np.unique(found.at_s)),
        scaled.factor * floor.stature_m, extent, [], tuple(found.names[one.camera] for one in found.wrong_lenses),
    )  # fmt: skip
    return msgspec.structs.replace(
        seen, notes=[*_notes(seen), *map(_contradiction, found.wrong_lenses, seen.wrong_lenses)]
    )


def _contradiction(wrong: WrongLens, name: str) -> str:
    """Describe a given lens that people contradict, with the likely one and the remedy."""
    focal, sd = wrong.likely_focal_px
    x, y = wrong.likely_centre_px
    return (
        f"camera {name}: the people contradict its given lens by {wrong.sds:.0f} standard deviations: its focal length "
        f"of {wrong.focal_px:.0f} px is more likely {focal:.0f} ± {sd:.0f} px, with the principal point near "
        f"({x:.0f}, {y:.0f}) px: calibrate the lens with a board, or leave it out"
    )


def combined(new: PlacedCamera, old: PlacedCamera) -> PlacedCamera:
    """Return a camera at the mean of two estimates of its pose, weighted by their covariances.

    An estimate of unknown covariance is not used; the older one's clock is not either.
    """
    if not (np.isfinite(old.covariance).all() and np.isfinite(new.covariance).all()):
        return new
    total = old.covariance + new.covariance
    gain = old.covariance @ np.linalg.pinv(total, rcond=1e-12, hermitian=True)
    apart = log_motion(new.T_camera_world @ inverse(old.T_camera_world))
    covariance = (np.eye(6) - gain) @ old.covariance
    T = exp_twist(gain @ apart) @ old.T_camera_world
    return PlacedCamera(new.camera, T, 0.5 * (covariance + covariance.T), new.clock_s)


def _scaled_pose(T_camera_joints: Float64, T_world_joints: Float64, factor: float) -> Float64:
    """Return ``T_camera_world``, with positions times a factor about the world's origin."""
    T = T_camera_joints @ inverse(T_world_joints)
    T[:3, 3] *= factor
    return T


def _scale(found: PeopleSolution, floor: PeopleFloor, stated: RigScale) -> _Scaled:
    centres = np.stack([inverse(T)[:3, 3] for T in found.adjusted.bundle.T_camera_world])
    if stated.distance_m is not None:
        a, b = (_number(found, name) for name in stated.between)
        apart = float(np.linalg.norm(centres[a] - centres[b]))
        if not apart > 1e-6:
            raise SettingsError(f"the distance of {stated.between[0]} from itself is stated; name two cameras")
        sd = DISTANCE_SD_M / stated.distance_m
        return _Scaled(stated.distance_m / apart, sd, f"by the distance of {stated.between[0]} and {stated.between[1]}")
    if stated.camera_height_m is not None:
        if not np.isfinite(floor.height_m):
            raise CalibrationError("no feet were seen, so a camera's height gives no scale: film whole bodies")
        height = float(centres[_number(found, stated.camera)] @ floor.up - floor.height_m)
        if height <= 0.05:
            raise CalibrationError(f"camera {stated.camera} seems to be at the floor: state a distance instead")
        sd = HEIGHT_SD_M / stated.camera_height_m
        return _Scaled(stated.camera_height_m / height, sd, f"by the height of {stated.camera}")
    if stated.stature_m is not None:
        return _Scaled(stated.stature_m / floor.stature_m, STATURE_SD, f"by people's stature of {stated.stature_m:g} m")
    words = f"guessed: people are taken to be {STATURE_M:g} m tall"
    return _Scaled(STATURE_M / floor.stature_m, GUESS_SD, words, guessed=True)


def _number(found: PeopleSolution, name: str) -> int:
    if name not in found.names:
        raise SettingsError(f"there is no camera {name!r}; there are {one_of(name, found.names)}")
    return found.names.index(name)


def scaled_covariance(
    found: PeopleSolution, factor: float, sd: float, between: tuple[str, str] | None = None
) -> Float64:
    """Return the covariance (cameras, 6, 6) of the poses, in the cameras' frames, relative to the first camera.

    A small motion x of a camera moves its centre by −Rᵀ x; so a relative change of the scale is a motion of t, the
    translation of ``T_camera_first``, per unit.

    Args:
        found: the solution.
        factor: scale from its unit to metres.
        sd: relative standard deviation of the scale.
        between: cameras whose distance is known, so that an error of it is one of the scale; None for none.
    """
    moved, cameras = _without_scale(found, factor, between), len(found.names)
    t = factor * found.adjusted.bundle.T_camera_world[:, :3, 3]
    out = np.stack([moved[c, :, c] for c in range(cameras)])
    out[:, :3, :3] += sd**2 * t[:, :, None] * t[:, None, :]
    return np.asarray(0.5 * (out + np.swapaxes(out, 1, 2)))


def _without_scale(found: PeopleSolution, factor: float, between: tuple[str, str] | None) -> Float64:
    """Return the covariance (cameras, 6, cameras, 6) of all poses as `scaled_covariance`, of an exact scale."""
    T, joint = found.adjusted.bundle.T_camera_world, found.adjusted.covariance
    cameras = len(T)
    full = joint[:, :6, :, :6].copy()
    full[:, :3] *= factor
    full[:, :, :, :3] *= factor
    J = np.eye(6 * cameras).reshape(cameras, 6, cameras, 6)
    t = factor * T[:, :3, 3]
    if between is not None:
        a, b = (found.names.index(name) for name in between)
        R = T[:, :3, :3]
        apart = -(R[a].T @ t[a]) + R[b].T @ t[b]
        along = apart / (apart @ apart)
        J[:, :3, a, :3] -= t[:, :, None] * -(R[a] @ along)
        J[:, :3, b, :3] -= t[:, :, None] * (R[b] @ along)
    return np.asarray(np.einsum("aibj,bjck,dlck->aidl", J, full, J))


def _quality(found: PeopleSolution, k: int, sds: tuple[float, float], *, moved: bool) -> PlacedByPeople:
    covariance, mine = found.adjusted.covariance[k, :, k], found.views.camera == k
    residual = np.linalg.norm(found.adjusted.residual_px[mine], axis=1)
    variances = np.diag(covariance)
    return PlacedByPeople(
        int(mine.sum()),
        float(np.median(residual)) if len(residual) else math.inf,
        1e3 * sds[0],
        math.degrees(sds[1]),
        100 * math.sqrt(variances[FOCAL]),
        1e3 * math.sqrt(variances[CLOCK]),
        1e3 * float(found.clocks_s[k]),
        moved,
    )


def _extent(found: PeopleSolution) -> float:
    """Return the largest root mean square distance of a person from its own middle place, in units of the solution."""
    seen = np.asarray(np.isfinite(found.people).all(axis=-1))
    some = seen.any(axis=1)
    people, seen, person = found.people[some], seen[some], found.views.person[some]
    middles = np.where(seen[..., None], people, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
    ways = [middles[person == one] for one in np.unique(person)]
    return max((float(np.sqrt(((way - way.mean(axis=0)) ** 2).sum(axis=1).mean())) for way in ways), default=0.0)


def _notes(seen: RigFromPeople) -> list[str]:
    notes = []
    if seen.guessed:
        notes.append(
            "the scale is a guess from people's mean stature, ±7 %: state a stature, or the distance of two cameras"
        )
    if seen.extent_m < LEAST_EXTENT_M:
        notes.append(
            f"people stayed within {seen.extent_m:.1f} m, where errors exceed the stated ones: walk about the room"
        )
    for name, camera in seen.cameras.items():
        if not camera.well_placed:
            notes.append(
                f"camera {name} may be off by {camera.likely_mm:.0f} mm and {camera.likely_deg:.1f}°: walk about for "
                "longer, where it and others see you"
            )
        if camera.focal_sd_percent > 100 * POOR_FOCAL:
            notes.append(
                f"camera {name}: its focal length is uncertain by {camera.focal_sd_percent:.0f} %: walk nearer and "
                "farther, or give its lens in --rig"
            )
        if camera.moved:
            notes.append(f"camera {name} was moved since the given rig; its pose is new")
    if not seen.floor_known:
        notes.append("no feet were seen: the floor is not known, and the origin is the first camera")
    return notes


@dataclass(frozen=True)
class _OldFit:
    """How the solution fits an older rig.

    Attributes:
        T_world_joints: (4, 4) pose of the solution's frame in the older rig's world; its translation is in units of the
            solution.
        scale: from the solution's unit to the older rig's.
        scale_sd: its relative standard deviation.
        moved: cameras that do not fit.
    """

    T_world_joints: Float64
    scale: float
    scale_sd: float
    moved: tuple[str, ...]


MOVED_M: Final = 0.05
"""Least distance of a camera from its old position at which it counts as moved [m]."""
MOVED_DEG: Final = 1.5
"""Least change of its direction at which a camera counts as moved [°]."""


def _fit_old(found: PeopleSolution, old: CameraRig) -> _OldFit:
    """Align the solution with the cameras of an older rig that kept their places."""
    shared = [name for name in found.names if name in old.cameras]
    if len(shared) < 2:
        raise CalibrationError(
            f"the given rig has {len(shared)} of the cameras {', '.join(found.names)}: give one with two or more"
        )
    new = {name: inverse(T) for name, T in zip(found.names, found.adjusted.bundle.T_camera_world, strict=True)}
    before = {name: inverse(old.cameras[name].T_camera_world) for name in shared}
    own = aligned_sds(found.adjusted.bundle.T_camera_world, found.adjusted.covariance[:, :6, :, :6])
    sds = dict(zip(found.names, np.stack(own, axis=1), strict=True))
    best: tuple[int, float, list[str]] | None = None
    for a in range(len(shared)):
        for b in range(a + 1, len(shared)):
            R, t, scale = _aligned([shared[a], shared[b]], new, before)
            off = {name: _off(new[name], before[name], (R, t, scale), sds[name]) for name in shared}
            fits = [name for name in shared if off[name] <= 1.0]
            total = sum(min(value, 1.0) for value in off.values())
            if best is None or (len(fits), -total) > (best[0], -best[1]):
                best = len(fits), total, fits
    assert best is not None
    fits = best[2]
    if len(fits) < 2 or 2 * len(fits) <= len(shared) - 1:
        raise CalibrationError(
            f"the given rig contradicts the people, and it is not known which of {', '.join(shared)} was moved: "
            "calibrate anew without --rig"
        )
    R, t, scale = _aligned(fits, new, before)
    sd = float(np.sqrt((own[0] ** 2).mean() / 3))
    apart = float(np.linalg.norm(np.ptp(np.stack([new[name][:3, 3] for name in fits]), axis=0)))
    return _OldFit(
        rigid(R, t / scale), scale, sd / max(apart, 1e-9), tuple(name for name in shared if name not in fits)
    )


def _aligned(
    names: list[str], new: Mapping[str, Float64], before: Mapping[str, Float64]
) -> tuple[Float64, Float64, float]:
    """Return rotation, translation and scale from the solution's frame to the older rig's, by cameras' poses."""
    U, _, Vt = np.linalg.svd(sum(before[name][:3, :3] @ new[name][:3, :3].T for name in names))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    q, p = (np.stack([of[name][:3, 3] for name in names]) for of in (new, before))
    q0, p0 = q.mean(axis=0), p.mean(axis=0)
    scale = float(np.linalg.norm(p - p0)) / max(float(np.linalg.norm(q - q0)), 1e-9)
    return R, p0 - scale * R @ q0, scale


def _off(new: Float64, before: Float64, motion: tuple[Float64, Float64, float], sds: Float64) -> float:
    """Return how far a camera is from its old pose, in units of the least motion that counts.

    Args:
        new, before: (4, 4) ``T_world_camera`` in the solution's frame and in the older rig's.
        motion: rotation, translation and scale from the one frame to the other.
        sds: standard deviations of the position, in units of the solution, and of the direction [rad].
    """
    R, t, scale = motion
    apart = float(np.linalg.norm(scale * R @ new[:3, 3] + t - before[:3, 3]))
    turn = before[:3, :3].T @ R @ new[:3, :3]
    angle = math.degrees(math.acos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))
    least_m, least_deg = 3 * scale * float(sds[0]), 3 * math.degrees(float(sds[1]))
    return max(apart / max(MOVED_M, least_m), angle / max(MOVED_DEG, least_deg))
