"""Find the upward direction, the floor and the stature of people from their joints.

People's bodies are upright on average, and feet that rest are on the floor. The stature follows from the bones, and
from the height of eyes and ears above the floor where this is not smaller.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.keypoint_bundle import STATURES
from mocapella.calibration.keypoint_contact import CONTACTS, FEET, no_floor
from mocapella.calibration.keypoint_tracks import HALPE
from mocapella.geometry.rigid import rigid

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
_Rests = tuple[Int64, Int64, Int64, NDArray[np.bool_]]

UPRIGHT_SD: Final = np.radians(5.0)
"""Standard deviation of the mean direction of people's bodies from the vertical [rad]."""
HEAD: Final = {"LEye": 0.936, "REye": 0.936, "LEar": 0.93, "REar": 0.93, "Nose": 0.912}
"""Heights of the keypoints of the head of a standing person, in statures (Drillis, Contini 1966; our estimates)."""
RESTS_MPS: Final = 0.25
"""Speed below which a foot rests [m/s]."""
_FLOOR_SD_M: Final = 0.02
_FEWEST: Final = 20
"""Least number of resting keypoints of feet."""


@dataclass(frozen=True)
class PeopleFloor:
    """Where up and the floor are.

    Attributes:
        up: (3,) unit vector in the joints' frame.
        up_sd_rad: standard deviation of its direction [rad].
        height_m: ``up · p`` of points on the floor [m]; NaN if no feet were seen.
        stature_m: median stature of the people [m]; NaN if unknown.
    """

    up: Float64
    up_sd_rad: float
    height_m: float
    stature_m: float


def find_floor(joints: Float64, person: Int64, at_s: Float64, log_lengths: Float64) -> PeopleFloor:
    """Find the floor under people.

    Args:
        joints: (bodies, 26, 3) in any frame [m]; NaN where not known.
        person: (bodies,) number of the person; the bodies of each are in the order of their times.
        at_s: (bodies,) time of each body [s].
        log_lengths: (people, bones) logarithms of the bones' lengths [m].
    """
    up = _upright(joints)
    stature = float(np.median(np.exp(log_lengths) / STATURES))
    points, above = _resting(joints, _rests(joints, person, at_s, up), stature)
    if len(points) < _FEWEST:
        return PeopleFloor(up, UPRIGHT_SD, float("nan"), stature)
    up, sd, height = _plane(points, above, up)
    head = _stature(joints, up, height, stature)
    by_head = np.isfinite(head) and 1.0 < head / stature < 1.15  # a bent person's head is low
    return PeopleFloor(up, sd, height, 0.5 * (head + stature) if by_head else stature)


def _upright(joints: Float64) -> Float64:
    """Return the mean direction from the ankles to the shoulders; without these, to whatever is known of both ends."""
    at = HALPE.index
    top = _mean(joints[:, [at("LShoulder"), at("RShoulder")]])
    legs = _mean(joints[:, [at("LAnkle"), at("RAnkle")]])
    hips = _mean(joints[:, [at("LHip"), at("RHip")]])
    along = np.where(np.isfinite(legs), top - legs, top - hips)
    along = along[np.isfinite(along).all(axis=1)]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    up = np.median(along, axis=0) if len(along) else np.array([0.0, -1.0, 0.0])
    for _ in range(5):
        if len(along):
            weight = 1.0 / (1.0 + ((along - up) ** 2).sum(axis=1) / 0.2**2)
            up = (weight[:, None] * along).sum(axis=0)
        up = up / np.linalg.norm(up)
    return up


def _mean(points: Float64) -> Float64:
    seen = np.isfinite(points).all(axis=-1, keepdims=True)
    count = seen.sum(axis=1)
    return np.asarray(np.where(count > 0, np.where(seen, points, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan))


def _resting(joints: Float64, found: _Rests, stature: float) -> tuple[Float64, Float64]:
    """Return (n, 3) keypoints of feet that rest, and (n,) their expected heights above the floor [m]."""
    one, other, feet, rests = found
    middle = 0.5 * (joints[one[:, None], feet] + joints[other[:, None], feet])
    above = np.broadcast_to(stature * np.array(list(FEET.values())), rests.shape)
    return middle[rests], above[rests]


def _rests(joints: Float64, person: Int64, at_s: Float64, up: Float64) -> _Rests:
    """Return neighbouring bodies of a person, (n,) the one and (n,) the other, the keypoints (n, 4) of the one's lower
    foot, and (n, 4) whether these rest between both. A raised foot may rest, too, so only the lower one counts.
    """
    order = np.lexsort((at_s, person))
    one, other = order[:-1], order[1:]
    gap = at_s[other] - at_s[one]
    pair = (person[one] == person[other]) & (gap > 0) & (gap < 0.5)
    one, other, gap = one[pair], other[pair], gap[pair]
    sides = np.array([[HALPE.index(side + name) for name in FEET] for side in "LR"])
    heights = np.stack([_mean(joints[one][:, of] @ up[:, None])[:, 0] for of in sides])
    feet = sides[np.where(np.isnan(heights), np.inf, heights).argmin(axis=0)]
    apart = np.linalg.norm(joints[other[:, None], feet] - joints[one[:, None], feet], axis=-1)
    return one, other, feet, apart < RESTS_MPS * gap[:, None]


def find_contacts(joints: Float64, person: Int64, at_s: Float64, stature: float) -> tuple[NDArray[np.bool_], Float64]:
    """Find the keypoints of feet that rest on the floor, and the floor, as `keypoint_contact` uses them.

    Args:
        joints, person, at_s: as in `find_floor`.
        stature: mean stature of the people [m].

    Returns:
        (bodies, 26) whether each keypoint rests, all False if there is no floor that is level for the people;
        (7,) values of the floor.
    """
    resting, up = np.zeros(joints.shape[:2], dtype=bool), _upright(joints)
    found = _rests(joints, person, at_s, up)
    points, above = _resting(joints, found, stature)
    if len(points) < _FEWEST:
        return resting, no_floor()
    normal, sd, height = _plane(points, above, up)
    if sd >= UPRIGHT_SD:
        return resting, no_floor()
    one, other, feet, rests = found
    for of in (one, other):
        resting[np.broadcast_to(of[:, None], feet.shape)[rests], feet[rests]] = True
    kinds = [np.median(joints[:, of][resting[:, of]] @ normal) if resting[:, of].any() else height for of in _KINDS]
    return resting, np.concatenate([normal, kinds])


_KINDS: Final = np.array(CONTACTS).reshape(-1, 2)


def _plane(points: Float64, above: Float64, up: Float64) -> tuple[Float64, float, float]:
    """Return the plane's normal, its standard deviation [rad], and the height of the floor along it [m].

    The slopes of the floor against ``up`` are estimated with `UPRIGHT_SD` as their prior. Each spot of the floor, a
    square of `_SPOT_M`, is one observation, because the errors of one step are alike. A slope that contradicts the
    prior is not believed: people may stand on different levels.
    """
    x, z = np.linalg.svd(up[None])[2][1:]
    middle = points.mean(axis=0)
    off = points - middle
    across, y = np.stack([off @ x, off @ z], axis=1), off @ up - above
    _, spot = np.unique(np.round(across / _SPOT_M).astype(np.int64), axis=0, return_inverse=True)
    spots = [spot.ravel() == k for k in range(int(spot.max()) + 1)]
    A = np.stack([np.r_[1.0, across[mine].mean(axis=0)] for mine in spots])
    heights = np.array([float(np.median(y[mine])) for mine in spots])
    prior = np.diag([1e-6, UPRIGHT_SD**-2, UPRIGHT_SD**-2])
    weight, found, H = np.ones(len(A)), np.zeros(3), prior
    for _ in range(10):
        scaled = A * (weight / _FLOOR_SD_M**2)[:, None]
        H = scaled.T @ A + prior
        found = np.linalg.solve(H, scaled.T @ heights)
        weight = 1.0 / (1.0 + ((heights - A @ found) / (2 * _FLOOR_SD_M)) ** 2)
    sd = float(np.sqrt(np.trace(np.linalg.inv(H)[1:, 1:]) / 2))
    if np.hypot(found[1], found[2]) > 3 * UPRIGHT_SD:
        found, sd = np.zeros(3), UPRIGHT_SD
    normal = up - found[1] * x - found[2] * z
    normal /= np.linalg.norm(normal)
    return normal, sd, float(np.median(off @ normal - above) + middle @ normal)


_SPOT_M: Final = 0.3
"""Side of a spot of the floor [m]."""


def _stature(joints: Float64, up: Float64, height: float, rough: float) -> float:
    """Return the stature of upright people by the height of eyes, ears and nose above the floor; NaN without any."""
    shares = np.array(list(HEAD.values()))
    above = joints[:, [HALPE.index(name) for name in HEAD]] @ up - height
    seen = np.isfinite(above)
    count = seen.sum(axis=1)
    statures = np.where(seen, above / shares, 0.0).sum(axis=1)[count >= 2] / count[count >= 2]
    upright = statures[np.abs(statures / rough - 1) < 0.2]
    return float(np.median(upright)) if len(upright) >= _FEWEST else float("nan")


def world_frame(T_first_joints: Float64, floor: PeopleFloor) -> Float64:
    """Return ``T_world_joints``: y up, the floor at 0, the first camera above the origin, x to its right.

    Without a floor, the first camera is at the origin.

    Args:
        T_first_joints: (4, 4) pose of the first camera in the joints' frame.
        floor: the floor in the joints' frame.
    """
    R, t = T_first_joints[:3, :3], T_first_joints[:3, 3]
    centre, y = -R.T @ t, floor.up
    x = R[0] - (R[0] @ y) * y
    if np.linalg.norm(x) < 1e-6:  # a camera that lies on its side
        x = R[1] - (R[1] @ y) * y
    x /= np.linalg.norm(x)
    R_world = np.stack([x, y, np.cross(x, y)])
    origin = centre - (centre @ y - floor.height_m) * y if np.isfinite(floor.height_m) else centre
    return rigid(R_world, -R_world @ origin)
