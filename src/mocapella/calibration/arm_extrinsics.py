"""Estimate the pose of a depth camera from an arm that it and a calibrated camera both see in motion.

The eight joints of the arm at many times are paired points; T_world_camera and the clock difference δ minimise
Σ w |p − T (q + δ v)|² with Geman–McClure weights (`geometry.alignment`, which names the sources). The calibrated
camera's joints are interpolated to the time of each frame. The error estimate comes from the scatter of half-second
blocks (K.-Y. Liang, S. Zeger, Biometrika 73 (1986) 13), because errors of neighbouring frames are correlated.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.alignment import align, moments, normal_equations, robust_align, robust_weights
from mocapella.geometry.rigid import apply
from mocapella.model.arms import ARM_JOINTS, SeenArm
from mocapella.model.observations import JointState
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_JOINTS: Final = list(ARM_JOINTS)
_BLOCK_S: Final = 0.5
_UNSAID_SD_M: Final = 0.02
_ROUNDS: Final = 8
_LONGEST_S: Final = 0.3


@dataclass(frozen=True)
class ArmExtrinsicsSettings:
    """Requirements of a calibration by an arm.

    Attributes:
        instants: least number of shared frames of an estimate, and the number after which collection stops; larger:
            more accurate, but later [frames].
        most_hz: highest rate of the shared frames that are used; larger: their number is reached sooner, with less
            motion between them [Hz].
        gap_s: largest gap between the calibrated camera's frames across which the arm is interpolated [s].
        space_m: least motion of the joints about their means, as a standard deviation along its second principal axis;
            larger: the user must move the arm farther [m].
        scale_m: scale of the robust weights: at this residual the weight is a quarter; larger: outliers count more [m].
        largest_residual_m: largest median distance between the cameras' joints for which the pose is used; above it,
            they do not see the same arm [m].
        largest_sd_m: largest standard deviation of a point near the arm, mapped to the world by the pose, for which
            the pose is used; smaller: the arm must be moved for longer [m].
        largest_sd_rad: largest standard deviation of the camera's rotation for which the pose is used; smaller: the arm
            must be moved for longer [rad].
        delay_sd_s: prior standard deviation of the delay between the two cameras; larger: a longer delay can be
            estimated, from more motion [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    instants: tuple[int, int] = (60, 300)
    most_hz: float = 20.0
    gap_s: float = 0.1
    space_m: float = 0.025
    scale_m: float = 0.03
    largest_residual_m: float = 0.03
    largest_sd_m: float = 0.01
    largest_sd_rad: float = 0.035
    delay_sd_s: float = 0.02

    def __post_init__(self) -> None:
        least, most = self.instants
        check(10 <= least <= most <= 10_000, "instants", self.instants, "two numbers from 10 to 10000, rising")
        above = ("most_hz", "gap_s", "space_m", "scale_m", "largest_residual_m", "largest_sd_m", "largest_sd_rad")
        for name in (*above, "delay_sd_s"):
            check(0 < getattr(self, name) <= 1000, name, getattr(self, name), "above 0 and at most 1000")


class ArmExtrinsicsResult(msgspec.Struct, frozen=True, eq=False):
    """A camera's estimated pose and its quality.

    Attributes:
        T_world_camera: (4, 4).
        delay_s: delay of its frames relative to the calibrated camera's clock [s].
        position_sd_m: standard deviation of a point near the arm's positions, mapped to the world by the pose [m].
        rotation_sd_rad: standard deviation of the rotation [rad].
        residual_m: median distance between the cameras' joints [m].
        missing: instruction for the user before the pose can be used; empty if it can be used.
    """

    T_world_camera: Float64
    delay_s: float
    position_sd_m: float
    rotation_sd_rad: float
    residual_m: float
    missing: str = ""


class Instant(msgspec.Struct, frozen=True, eq=False):
    """Eight joints that two cameras saw at the same time.

    Attributes:
        at_s: capture time, on the common clock [s].
        world: (8, 3) from the calibrated camera [m].
        own: (8, 3) from the other camera, in its frame [m].
        velocity: (8, 3) velocities of ``own`` [m/s].
        weights: (8,) weight of each joint [1/m²]; 0 for one that a camera does not measure.
    """

    at_s: float
    world: Float64
    own: Float64
    velocity: Float64
    weights: Float64


class ArmSights(msgspec.Struct, frozen=True, eq=False):
    """One camera's frame: its arms in the camera's frame, and its capture time on the common clock [s]."""

    at_s: float
    arms: tuple[SeenArm, ...]


class ArmExtrinsics:
    """Estimates poses of cameras from the arms that they see together with calibrated cameras.

    Args:
        settings: requirements of a calibration; the defaults if None.

    Attributes:
        found: newest estimate, by camera; it may be used once nothing is ``missing``.
        instants: shared frames collected so far, by camera without a pose.
        seen: up to eight newest frames, by camera.
    """

    def __init__(self, settings: ArmExtrinsicsSettings | None = None) -> None:
        self.settings = settings or ArmExtrinsicsSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.found: dict[str, ArmExtrinsicsResult] = {}
        self.instants: dict[str, list[Instant]] = {}
        self.seen: dict[str, deque[ArmSights]] = {}

    def update(self, camera: str, arms: Sequence[SeenArm], at_s: float, places: Mapping[str, Float64]) -> list[str]:
        """Update the estimates with a camera's frame, in the order of its capture times.

        Frames are left out where the arm is ambiguous, because a camera sees several of one side.

        Args:
            camera: name of the camera.
            arms: its arms, in its own frame.
            at_s: capture time on the common clock [s].
            places: ``T_world_camera`` (4, 4) of the calibrated cameras; poses of all others are estimated.

        Returns:
            The cameras with a new estimate.
        """
        self.seen.setdefault(camera, deque(maxlen=8)).append(ArmSights(at_s, tuple(arms)))
        if camera not in places:
            self.instants.setdefault(camera, [])
            return []
        return [other for other in sorted(self.instants) if other not in places and self._pair(other, camera, places)]

    def needs(self, camera: str) -> str:
        """Return an instruction for the user while the camera has no pose that can be used; empty once it has one."""
        found = self.found.get(camera)
        if found is not None:
            return found.missing
        have = len(self.instants.get(camera, ())) / self.settings.instants[0]
        return f"move one arm about where another camera sees it too ({10 * int(10 * have)} % done)"

    def _pair(self, camera: str, reference: str, places: Mapping[str, Float64]) -> bool:
        """Pair the camera's frames between two of the reference's; return whether that gave a new estimate.

        A frame is paired once the next one is there, so a slow camera's are between earlier frames of the reference.
        Its newest frame is left out, so that the order of simultaneous frames changes nothing.
        """
        s, instants, sights = self.settings, self.instants[camera], self.seen[camera]
        earlier = list(self.seen[reference])[:-1]
        if len(instants) >= s.instants[1]:
            return False
        added = False
        for before, sight, after in zip(sights, islice(sights, 1, None), islice(sights, 2, None), strict=False):
            due = not instants or sight.at_s - instants[-1].at_s >= 0.999 / s.most_hz
            around = next((two for two in pairwise(earlier) if _is_between(sight, *two)), None)
            if not due or around is None or around[1].at_s - around[0].at_s > s.gap_s:
                continue
            instant = _instant((before, sight, after), *around, places[reference])
            if instant is not None:
                instants.append(instant)
                added = True
        n = len(instants)
        if not added or n < s.instants[0] or n % 10:
            return False
        self.found[camera] = extrinsics_from_arm(instants, s)
        return True


def _instant(
    sights: tuple[ArmSights, ArmSights, ArmSights], early: ArmSights, late: ArmSights, T_world_reference: Float64
) -> Instant | None:
    """Return the one arm that both cameras saw, or None if that is ambiguous.

    Its velocity comes from the frames before and after. That of its own frame would share the position's error, and
    this would look like a delay.
    """
    before, sight, after = sights
    own = _only(sight.arms, early.arms)
    theirs = _only(early.arms, sight.arms)
    if own is None or theirs is None:
        return None
    own_before, own_after, theirs_later = _same(before, own), _same(after, own), _same(late, theirs)
    if own_before is None or own_after is None or theirs_later is None or after.at_s - before.at_s > _LONGEST_S:
        return None
    share = (sight.at_s - early.at_s) / (late.at_s - early.at_s)
    world = apply(T_world_reference, (1.0 - share) * theirs.joints + share * theirs_later.joints)
    velocity = (own_after.joints - own_before.joints) / (after.at_s - before.at_s)
    arms = (own, own_before, own_after, theirs, theirs_later)
    measured = np.all([arm.joint_states == JointState.TRACKED for arm in arms], axis=0)
    sd = np.array([arm.sd[_JOINTS] for arm in (own, theirs)], dtype=np.float64)
    sd = np.maximum(np.where(np.isfinite(sd), sd, _UNSAID_SD_M), 0.003)
    weights = np.where(measured, 1.0 / (sd * sd).sum(axis=0), 0.0)
    if np.count_nonzero(weights) < 3:
        return None
    return Instant(sight.at_s, world, own.joints, velocity, weights)


def _is_between(sight: ArmSights, early: ArmSights, late: ArmSights) -> bool:
    return early.at_s <= sight.at_s < late.at_s


def _same(sights: ArmSights, arm: SeenArm) -> SeenArm | None:
    return next((one for one in sights.arms if one.id == arm.id), None)


def _only(arms: Sequence[SeenArm], others: Sequence[SeenArm]) -> SeenArm | None:
    """Return the arm that the other camera sees, too: the only one, or the only one of a side; None if ambiguous."""
    if len(arms) == 1 and len(others) == 1:
        return arms[0]
    for left in (True, False):
        mine = [arm for arm in arms if arm.left == left]
        if len(mine) == 1 and sum(arm.left == left for arm in others) == 1:
            return mine[0]
    return None


def extrinsics_from_arm(
    instants: Sequence[Instant], settings: ArmExtrinsicsSettings | None = None
) -> ArmExtrinsicsResult:
    """Estimate the pose of the camera that measured ``Instant.own``, and the missing requirements.

    Args:
        instants: simultaneous observations of one arm by a calibrated camera and this one; one or more.
        settings: requirements of a calibration; the defaults if None.

    Returns:
        The estimate, however uncertain; its ``missing`` is the requirement that it does not fulfil. The delay is within
        ±0.1 s.
    """
    s = settings or ArmExtrinsicsSettings()
    p, q = np.array([one.world for one in instants]), np.array([one.own for one in instants])
    v, w = np.array([one.velocity for one in instants]), np.array([one.weights for one in instants])
    flat = (p.reshape(-1, 3), q.reshape(-1, 3), w.ravel())
    centre = np.average(np.nan_to_num(flat[0]), axis=0, weights=flat[2])
    T = robust_align(flat[0] - centre, flat[1], flat[2], kernel="geman-mcclure", scale=s.scale_m)
    delay, p = 0.0, p - centre
    for _ in range(_ROUNDS):
        residual = np.linalg.norm(p - apply(T, q + delay * v), axis=-1)
        fits = robust_weights(residual, "geman-mcclure", s.scale_m)
        counted = np.where(np.isfinite(residual), w * fits, 0.0)
        M = moments(p.reshape(-1, 3), q.reshape(-1, 3), counted.ravel(), v.reshape(-1, 3))
        H, g = normal_equations(M, T, delay)
        H[6, 6] += 1.0 / s.delay_sd_s**2
        g[6] -= delay / s.delay_sd_s**2
        delay = float(np.clip(delay + np.linalg.solve(H, g)[6], -0.1, 0.1))
        T = align(M, delay)
    at_s = np.array([one.at_s for one in instants])
    covariance = np.linalg.pinv(H)
    blocks = np.unique(((at_s - at_s[0]) / _BLOCK_S).astype(np.int64), return_inverse=True)[1]
    scatter = _scatter(p, q, v, counted, T, delay, blocks)
    covariance = covariance @ scatter @ covariance
    away = residual[w > 0]
    position_sd, rotation_sd = (math.sqrt(float(np.trace(covariance[k : k + 3, k : k + 3]))) for k in (0, 3))
    T = T.copy()
    T[:3, 3] += centre
    place = ArmExtrinsicsResult(T, delay, position_sd, rotation_sd, float(np.median(away)))
    return msgspec.structs.replace(place, missing=_missing(place, _space(p, w), s))


def _scatter(  # noqa: PLR0917 - one fit, in its parts
    p: Float64, q: Float64, v: Float64, w: Float64, T: Float64, delay: float, blocks: Int64
) -> Float64:
    """Return Σ g gᵀ (7, 7) of the gradients, summed over blocks of frames."""
    _, g = normal_equations(moments(p, q, w, v), np.broadcast_to(T, (len(p), 4, 4)), np.full(len(p), delay))
    of_block = np.zeros((int(blocks.max()) + 1, 7))
    np.add.at(of_block, blocks, g)
    return np.asarray(of_block.T @ of_block)


def _space(p: Float64, w: Float64) -> float:
    """Return the standard deviation of the joints about their means along the second principal axis [m]."""
    there = w > 0
    seen = np.where(there[..., None], p, 0.0)
    mean = seen.sum(axis=0) / np.maximum(there.sum(axis=0), 1)[:, None]
    moved = np.where(there[..., None], p - mean, 0.0).reshape(-1, 3)
    return math.sqrt(max(float(np.linalg.eigvalsh(moved.T @ moved / max(int(there.sum()), 1))[1]), 0.0))


def _missing(place: ArmExtrinsicsResult, space_m: float, s: ArmExtrinsicsSettings) -> str:
    if space_m < s.space_m:
        return "move the arm farther about, to all sides"
    if place.residual_m > s.largest_residual_m:
        return (
            f"its joints are {1e2 * place.residual_m:.0f} cm from another camera's: show both one arm only, "
            "and check intrinsics and unit"
        )
    if place.position_sd_m > s.largest_sd_m or place.rotation_sd_rad > s.largest_sd_rad:
        return f"go on moving the arm: its position is known to {1e3 * place.position_sd_m:.0f} mm only"
    return ""


REMEMBERED: Final = (ArmExtrinsicsResult, Instant, ArmSights, SeenArm)
"""Classes in the state of an `ArmExtrinsics`, see `mocapella.model.memory`."""
