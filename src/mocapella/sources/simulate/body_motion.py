"""Motions of bodies with 26 degrees of freedom: knee bends, running, walking, a cartwheel, a flick-flack, sitting.

    motion = body_motion("cartwheel", mesh)
    motion.pose(0.7)

A motion is a table of key poses, or a cycle of them. Between keys, angles are interpolated monotonically (F. Fritsch,
J. Butland, "A Method for Constructing Local Monotone Piecewise Cubic Interpolants", SIAM J. Sci. Stat. Comput. 5, 1984)
and smoothed by a Gaussian. Neither leaves the keys' range, so joint limits that the keys keep are kept. Splines through
the results are twice continuously differentiable.

The body's position follows from ground contact: its lowest point is on the floor, and contact points do not slide.
While a key marks the body as airborne, its centre follows a ballistic trajectory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.geometry.rigid import rigid, rotation_about_x, rotation_about_y
from mocapella.model.rigged_mesh import RiggedMesh, posed
from mocapella.model.twist_tree import TreePose
from mocapella.settings import check

Float64 = NDArray[np.float64]
Key = tuple[float, Mapping[str, float]]

GRID_HZ: Final = 200.0
SMOOTH_S: Final = 0.035
"""Standard deviation of the Gaussian that smooths motions [s]."""
GRAVITY_M_PER_S2: Final = 9.81
_CONTACT_M: Final = 0.006
_IN_THE_AIR_M: Final = 1e-3
_THROUGH_AIR: Final = 0.5
"""Horizontal speed in the air, relative to that before and after, which rotation about the feet makes higher."""
_TURNS: Final = ("yaw", "pitch", "roll")
"""Rotations of the whole body: about y, x (positive forwards) and z (positive to the right); see `turned`."""
_WORDS: Final = {
    "bend": ("waist bend forwards",), "lean": ("waist bend to the left",), "swing": ("shoulder swing forwards",),
    "raise": ("shoulder raise sidewards",), "turn": ("shoulder turn outwards",), "elbow": ("elbow flexion",),
    "hip": ("hip flexion",), "open": ("hip abduction",), "outwards": ("hip turn outwards",), "knee": ("knee flexion",),
    "ankle": ("ankle flexion",),
}  # fmt: skip
"""Joint angles by the words that keys use for them; "left " or "right " before a word means one side only."""


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """A motion: a pose at any time; before its beginning and after its end the body stands still.

    Attributes:
        seconds: duration of the motion [s].
        angles: spline from times [s] to joint angles (..., joints) [rad].
        turns: spline from times [s] to yaw, pitch and roll of the whole body (..., 3) [rad]; see `turned`.
        place: spline from times [s] to the root point's position (..., 3), world [m].
        root: (3,) the root point in the rest pose [m].
    """

    seconds: float
    angles: Callable[[Any], Float64]
    turns: Callable[[Any], Float64]
    place: Callable[[Any], Float64]
    root: Float64

    def pose(self, at_s: Any) -> TreePose:
        """Return the poses at times (...,) since the motion's beginning [s], with the same batch axes.

        Times before 0 and after ``seconds`` give the first and the last pose.
        """
        at = np.clip(np.asarray(at_s, np.float64), 0.0, self.seconds)
        R = turned(self.turns(at))
        return TreePose(rigid(R, self.place(at) - (R @ self.root[:, None])[..., 0]), self.angles(at))


def motion_names() -> tuple[str, ...]:
    """Return the names that `body_motion` knows."""
    return tuple(_MOTIONS)


def usual_seconds(name: str) -> float:
    """Return the default duration of a motion [s].

    Raises:
        SettingsError: unknown motion; lists the known ones.
    """
    return _MOTIONS[_known(name)][1]


def body_motion(name: str, mesh: RiggedMesh, seconds: float | None = None, seed: int = 0) -> BodyMotion:
    """Make a motion for a body.

    Args:
        name: one of `motion_names`.
        mesh: the body, made by `body_meshes.body_mesh`.
        seconds: duration [s]; cyclic motions repeat, others stand still after their end. None: the default.
        seed: random seed of small variations of tempo and width.

    Raises:
        SettingsError: unknown motion, invalid duration, or the mesh does not have the joints of a body.
    """
    make, usual = _MOTIONS[_known(name)]
    seconds = usual if seconds is None else seconds
    check(0.1 <= seconds <= 600, "seconds", seconds, "from 0.1 to 600 s")
    rng = np.random.default_rng([seed, 31])
    keys, travels = make(seconds, rng)
    return _made(mesh, keys, seconds, travels=travels)


def grounded(
    mesh: RiggedMesh, angles: Float64, turns: Float64, above: Float64, *, stays: bool, path: Float64 | None = None
) -> Float64:
    """Compute the root point's positions (n, 3) in the world [m] of a body that stands on the floor without sliding.

    The path is centred: the middle of its range in x and z is 0. Heights are smoothed, without sinking into the floor.

    Args:
        mesh: the body.
        angles: (n, joints) joint angles at a rate of `GRID_HZ` [rad].
        turns: (n, 3) yaw, pitch and roll of the whole body [rad].
        above: (n,) height of the body's lowest point above the floor; where it exceeds 1 mm, the body is airborne and
            its centre's trajectory is ballistic [m].
        stays: whether to remove the net travel, as on a treadmill; without effect if ``path`` is given.
        path: (n, 2) x and z of the hips in the world, if known; otherwise it follows from the ground contact [m].
    """
    from scipy.ndimage import gaussian_filter1d, maximum_filter1d

    n, sd = len(angles), SMOOTH_S * GRID_HZ
    R = turned(turns)
    lowest, middle, step = np.empty(n), np.empty(n), np.zeros((n, 2))
    before: Float64 | None = None
    for k in range(n):
        T = rigid(R[k], -R[k] @ mesh.tree.root)
        at = posed(mesh, TreePose(T, angles[k]))
        lowest[k], middle[k] = at[:, 1].min(), at[:, 1].mean()
        if before is not None:  # the lowest points do not move between two instants
            height = 0.5 * (at[:, 1] + before[:, 1])
            share = np.exp(-(height - height.min()) / _CONTACT_M)
            step[k] = -(share @ (at - before)[:, [0, 2]]) / share.sum()
        before = at
    wanted = _thrown(above - lowest, middle, above > _IN_THE_AIR_M)
    y = gaussian_filter1d(wanted, sd, mode="nearest")
    reach = int(1.5 * sd + 0.5)  # of the second filter, which lifts whatever the first one leaves below the floor
    below = maximum_filter1d(np.maximum(wanted - y, 0.0), 2 * reach + 1, mode="nearest")
    y = y + gaussian_filter1d(below, sd, mode="nearest", truncate=1.5)
    if path is None:
        free = above > _IN_THE_AIR_M
        if free.any() and not free.all():  # in the air, about as fast as before and after
            for i in range(2):
                step[free, i] = _THROUGH_AIR * np.interp(np.flatnonzero(free), np.flatnonzero(~free), step[~free, i])
        path = np.cumsum(gaussian_filter1d(step, sd, axis=0, mode="nearest"), axis=0)
        if stays:
            path = path - np.linspace(0, 1, n)[:, None] * (path[-1] - path[0])
    path = path - 0.5 * (path.max(axis=0) + path.min(axis=0))
    return np.stack([path[:, 0], y, path[:, 1]], axis=1)


def _thrown(y: Float64, middle: Float64, free: NDArray[np.bool_]) -> Float64:
    """Heights (n,) of the root at `GRID_HZ`, with a ballistic trajectory of the body's centre while it is airborne.

    Args:
        y: (n,) heights from the ground contact.
        middle: (n,) height of the body's centre above the root.
        free: (n,) whether it is airborne.
    """
    out = y.copy()
    edges = np.flatnonzero(np.diff(free.astype(np.int8)))
    for start, end in zip(edges[::2], edges[1::2] + 1, strict=False) if not free[0] else ():
        t = np.arange(end - start + 1) / GRID_HZ
        low, high = y[start] + middle[start], y[end] + middle[end]
        thrown = low + (high - low) * t / t[-1] + 0.5 * GRAVITY_M_PER_S2 * t * (t[-1] - t)
        out[start : end + 1] = thrown - middle[start : end + 1]
    return out


def splined(
    mesh: RiggedMesh, angles: Float64, turns: Float64, above: Float64, *, stays: bool = False,
    path: Float64 | None = None,
) -> BodyMotion:  # fmt: skip
    """Make a motion of sampled poses: put the body on the floor with `grounded`, and connect them by cubic splines.

    Args:
        mesh: the body.
        angles, turns, above: (n, joints), (n, 3), (n,) joint angles, rotation of the body and height of its lowest
            point, at a rate of `GRID_HZ`, see `grounded`.
        stays: whether to remove the net travel, as on a treadmill.
        path: (n, 2) x and z of the hips in the world, if known; otherwise it follows from the ground contact [m].
    """
    from scipy.interpolate import CubicSpline

    place = grounded(mesh, angles, turns, above, stays=stays, path=path)
    at = np.arange(len(angles)) / GRID_HZ
    angle, turn, where = (CubicSpline(at, values) for values in (angles, turns, place))
    return BodyMotion(float(at[-1]), angle, turn, where, mesh.tree.root)


def smoothed(values: Float64) -> Float64:
    """Smooth values (n, …), sampled at `GRID_HZ`, along the first axis with a Gaussian of sd `SMOOTH_S` [s]."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, SMOOTH_S * GRID_HZ, axis=0, mode="nearest"))


def _made(mesh: RiggedMesh, keys: Sequence[Key], seconds: float, *, travels: bool) -> BodyMotion:
    from scipy.interpolate import PchipInterpolator

    columns = (*mesh.joint_names, *_TURNS, "above")
    rows, row = [], dict.fromkeys(columns, 0.0)
    for _, values in keys:
        for word, value in values.items():
            for name in _named(word, columns):
                row[name] = value
        rows.append([row[name] for name in columns])
    table = np.array(rows)
    times = np.array([at for at, _ in keys])
    at = np.arange(math.ceil(seconds * GRID_HZ) + 1) / GRID_HZ
    through = PchipInterpolator(times, table)(np.clip(at, times[0], times[-1]))
    through = smoothed(through)
    joints = len(mesh.joint_names)
    angles, turns = np.radians(through[:, :joints]), np.radians(through[:, joints : joints + 3])
    return splined(mesh, angles, turns, np.maximum(through[:, -1], 0.0), stays=not travels)


def _named(word: str, columns: tuple[str, ...]) -> list[str]:
    """The columns that a key's word sets."""
    if word in columns:
        return [word]
    side, _, rest = word.partition(" ")
    if side in ("left", "right"):
        return [f"{side} {name}" for name in _WORDS[rest]]
    found = [name for name in columns for end in _WORDS[word] if name == end or name.endswith(f" {end}")]
    check(len(found) > 0, "joints of the mesh", columns, f"such that one is called {_WORDS[word]}")
    return found


def turned(turns: Float64) -> Float64:
    """Convert yaw, pitch and roll (..., 3) [rad] to rotation matrices (..., 3, 3) R_y(yaw) R_x(pitch) R_z(roll).

    The axes are fixed, roll comes first, and positive angles are right-handed.
    """
    yaw, pitch, roll = np.moveaxis(turns, -1, 0)
    about_z = np.zeros((*roll.shape, 3, 3))
    about_z[..., 0, 0] = about_z[..., 1, 1] = np.cos(roll)
    about_z[..., 1, 0] = np.sin(roll)
    about_z[..., 0, 1] = -np.sin(roll)
    about_z[..., 2, 2] = 1.0
    return np.asarray(rotation_about_y(yaw) @ rotation_about_x(pitch) @ about_z)


def _known(name: str) -> str:
    if name not in _MOTIONS:
        raise SettingsError(f"unknown motion {name!r}; known: {one_of(name, _MOTIONS)}")
    return name


def _forwards(lift: float, side: str = "") -> dict[str, float]:
    """Arms that are lifted forwards: 0 hang down, 90 reach ahead, 175 are up."""
    return {f"{side}swing": lift, f"{side}raise": -40.0 + 0.5 * lift}


def _cycle(keys: Sequence[Key], period: float, seconds: float) -> list[Key]:
    """Keys at phases 0 … 1, again and again, from before the start to after the end."""
    count = math.ceil(seconds / period) + 2
    return [((cycle + phase) * period, values) for cycle in range(-1, count) for phase, values in keys]


def _t_pose(_seconds: float, _rng: np.random.Generator) -> tuple[list[Key], bool]:
    pose = {"raise": 45.0}
    return [(0.0, pose), (1.0, pose)], False


def _knee_bend(seconds: float, rng: np.random.Generator) -> tuple[list[Key], bool]:
    period, deep = rng.uniform(1.9, 2.4), rng.uniform(0.85, 1.0)
    hip, knee, ankle = 92.0 * deep, 104.0 * deep, 18.0 * deep
    up: Mapping[str, float] = {
        "hip": 4.0, "knee": 6.0, "ankle": 2.0, "pitch": 0.0, "bend": 2.0, "elbow": 8.0, **_forwards(20.0)
    }  # fmt: skip
    low: Mapping[str, float] = {
        "hip": hip, "knee": knee, "ankle": ankle, "pitch": hip - knee + ankle, "bend": 24.0, "elbow": 12.0,
        **_forwards(88.0),
    }  # fmt: skip
    return _cycle([(0.0, up), (0.08, up), (0.46, low), (0.54, low), (0.92, up)], period, seconds), False


def _leg(phase: float, side: str, keys: Sequence[tuple[float, float, float, float]]) -> dict[str, float]:
    """Hip, knee and ankle of one side at a phase, of (phase, hip, knee, ankle)."""
    from scipy.interpolate import PchipInterpolator

    table = np.array([[p + c, *values] for c in (-1, 0, 1) for p, *values in keys])
    hip, knee, ankle = PchipInterpolator(table[:, 0], table[:, 1:])(phase % 1.0)
    return {f"{side} hip": float(hip), f"{side} knee": float(knee), f"{side} ankle": float(ankle)}


def _strides(
    keys: Sequence[tuple[float, float, float, float]], period: float, seconds: float, *, arm: float, elbow: float,
    still: Mapping[str, float], above: Callable[[float], float],
) -> list[Key]:  # fmt: skip
    """A gait: legs half a period apart, and each arm swings against the leg of its side."""
    poses: list[Key] = []
    for phase in np.arange(24) / 24:
        swing = arm * math.cos(2 * math.pi * phase)
        poses.append((float(phase), {
            **still, **_leg(phase, "left", keys), **_leg(phase + 0.5, "right", keys),
            **_forwards(8.0 - swing, "left "), **_forwards(8.0 + swing, "right "),
            "left elbow": elbow - 0.3 * swing, "right elbow": elbow + 0.3 * swing,
            "lean": 2.5 * math.sin(2 * math.pi * phase), "above": above(float(phase)),
        }))  # fmt: skip
    return _cycle(poses, period, seconds)


def _runner(seconds: float, rng: np.random.Generator) -> tuple[list[Key], bool]:
    period, lift = rng.uniform(0.68, 0.8), rng.uniform(52.0, 66.0)
    # Foot down at 0.00, off at 0.36; the knee is highest at 0.66.
    keys = ((0.0, 18, 16, 2), (0.16, 10, 32, 16), (0.36, -8, 14, -22), (0.5, 12, 72, -12), (0.66, lift, 98, -4),
            (0.84, 40, 52, 2))  # fmt: skip

    def above(phase: float) -> float:
        p = (phase % 0.5) / 0.5
        return 0.06 * max(math.sin(math.pi * (p - 0.72) / 0.28), 0.0) ** 2 if p > 0.72 else 0.0

    still = {"bend": 6.0, "pitch": 4.0, "open": 3.0, "turn": -15.0}
    return _strides(keys, period, seconds, arm=-34.0, elbow=88.0, still=still, above=above), False


def _walk(seconds: float, rng: np.random.Generator) -> tuple[list[Key], bool]:
    period, wide = rng.uniform(1.05, 1.25), rng.uniform(0.9, 1.1)
    keys = ((0.0, 24 * wide, 5, 0), (0.12, 20 * wide, 16, -4), (0.3, 2, 8, 7), (0.5, -15 * wide, 12, 4),
            (0.62, -4, 42, -18), (0.74, 20 * wide, 62, -2), (0.9, 28 * wide, 16, 2))  # fmt: skip
    still = {"bend": 2.0, "pitch": 2.0, "open": 2.0}
    return _strides(keys, period, seconds, arm=20.0 * wide, elbow=22.0, still=still, above=lambda _: 0.0), True


def _sits(seconds: float, rng: np.random.Generator) -> tuple[list[Key], bool]:
    period, bend = rng.uniform(3.0, 4.5), rng.uniform(2.0, 7.0)
    still: Mapping[str, float] = {
        "hip": rng.uniform(82.0, 90.0), "open": rng.uniform(4.0, 12.0), "knee": rng.uniform(80.0, 92.0),
        "bend": bend, "elbow": 62.0, **_forwards(32.0),
    }  # fmt: skip
    sways = {"bend": bend + 1.5, "right elbow": 70.0, "lean": 1.0}
    return _cycle([(0.0, {**still, "lean": 0.0}), (0.5, sways)], period, seconds), False


def _shifts(seconds: float, rng: np.random.Generator) -> tuple[list[Key], bool]:
    """Sit still, shift once in the middle of the time, and sit still again."""
    still: dict[str, float] = {
        "hip": rng.uniform(82.0, 90.0), "open": rng.uniform(4.0, 12.0), "knee": rng.uniform(80.0, 92.0),
        "bend": rng.uniform(2.0, 7.0), "elbow": 62.0, "lean": 0.0, **_forwards(32.0),
    }  # fmt: skip
    side, bends, turns = ("left", "right")[rng.integers(2)], rng.uniform(14.0, 30.0), rng.uniform(-10.0, 10.0)
    after = {
        f"{side} knee": still["knee"] - bends, f"{side} open": still["open"] + rng.uniform(4.0, 12.0),
        "bend": still["bend"] + rng.uniform(4.0, 10.0), "lean": rng.uniform(-6.0, 6.0), "yaw": turns, "elbow": 75.0,
    }  # fmt: skip
    begins, ends = 0.5 * seconds - 0.3, 0.5 * seconds + 0.3
    # Its net travel is not spread over the time at rest.
    return [(-1.0, still), (begins, {}), (ends, after), (seconds + 1.0, {})], True


def _cartwheel(_seconds: float, rng: np.random.Generator) -> tuple[list[Key], bool]:
    slow, wide = rng.uniform(0.95, 1.15), rng.uniform(26.0, 31.0)
    stand: Mapping[str, float] = {"raise": -36.0, "open": 4.0, "elbow": 6.0, "roll": 0.0, "lean": 0.0, "knee": 2.0,
                                  "hip": 1.0}  # fmt: skip
    keys: list[Key] = [
        (0.0, stand), (0.15, stand),
        (0.6, {"raise": 118.0, "open": 10.0, "elbow": 4.0}),
        (0.95, {"roll": -26.0, "left open": 38.0, "right open": 26.0, "left knee": 16.0, "left hip": 10.0, "lean": 28.0,
                "left raise": 84.0, "right raise": 110.0}),
        (1.2, {"roll": -72.0, "left open": 43.0, "right open": wide, "left knee": 6.0, "left hip": 2.0, "lean": 33.0,
               "left raise": 72.0, "right raise": 112.0}),
        (1.45, {"roll": -136.0, "open": wide, "lean": 14.0, "left raise": 106.0}),
        (1.65, {"roll": -184.0, "lean": 0.0, "raise": 118.0}),
        (1.85, {"roll": -230.0, "lean": -14.0, "right raise": 106.0}),
        (2.1, {"roll": -292.0, "right open": 43.0, "lean": -33.0, "right raise": 72.0, "left raise": 110.0}),
        (2.4, {"roll": -336.0, "right open": 38.0, "left open": 26.0, "lean": -24.0, "right knee": 10.0,
               "right raise": 80.0, "left raise": 90.0}),
        (2.75, {"roll": -360.0, "open": 10.0, "lean": 0.0, "knee": 3.0, "raise": 40.0}),
        (3.2, {**stand, "roll": -360.0}), (3.4, {**stand, "roll": -360.0}),
    ]  # fmt: skip
    return [(slow * at, values) for at, values in keys], True


def _flick_flack(_seconds: float, rng: np.random.Generator) -> tuple[list[Key], bool]:
    slow, high = rng.uniform(1.15, 1.28), rng.uniform(0.12, 0.2)
    stand: Mapping[str, float] = {"hip": 1.0, "knee": 2.0, "ankle": 1.0, "bend": 0.0, "elbow": 6.0, "open": 3.0}
    keys: list[Key] = [
        (0.0, {**stand, **_forwards(10.0), "pitch": 0.0}), (0.15, {}),
        (0.5, {**_forwards(95.0)}),
        (0.85, {"hip": 82.0, "knee": 86.0, "ankle": 14.0, "pitch": 10.0, "bend": 12.0, **_forwards(-25.0)}),
        (1.02, {"hip": 30.0, "knee": 45.0, "ankle": -10.0, "pitch": -25.0, "bend": -8.0, **_forwards(80.0)}),
        (1.14, {"hip": -8.0, "knee": 10.0, "ankle": -35.0, "pitch": -62.0, "bend": -20.0, "above": 0.0,
                **_forwards(150.0)}),
        (1.26, {"hip": -20.0, "knee": 18.0, "pitch": -112.0, "bend": -23.0, "above": high, **_forwards(172.0)}),
        (1.4, {"hip": -18.0, "knee": 30.0, "pitch": -160.0, "bend": -18.0, "above": 0.0, "elbow": 12.0}),
        (1.52, {"hip": 5.0, "knee": 12.0, "pitch": -200.0, "bend": 0.0, "above": 0.0}),
        (1.64, {"hip": 52.0, "knee": 8.0, "ankle": -20.0, "pitch": -248.0, "bend": 22.0, "above": 0.0, "elbow": 6.0}),
        (1.76, {"hip": 62.0, "knee": 18.0, "ankle": 0.0, "pitch": -300.0, "bend": 26.0, "above": 0.7 * high,
                **_forwards(150.0)}),
        (1.9, {"hip": 48.0, "knee": 38.0, "ankle": 12.0, "pitch": -338.0, "bend": 14.0, "above": 0.0,
               **_forwards(110.0)}),
        (2.15, {"hip": 40.0, "knee": 46.0, "ankle": 12.0, "pitch": -354.0, "bend": 8.0, **_forwards(80.0)}),
        (2.6, {**stand, **_forwards(20.0), "pitch": -360.0}), (2.8, {}),
    ]  # fmt: skip
    return [(slow * at, values) for at, values in keys], True


_MOTIONS: Final[dict[str, tuple[Callable[[float, np.random.Generator], tuple[list[Key], bool]], float]]] = {
    "t-pose": (_t_pose, 1.0),
    "knee-bend": (_knee_bend, 4.0),
    "runner": (_runner, 3.0),
    "walk": (_walk, 2.4),
    "cartwheel": (_cartwheel, 3.6),
    "flick-flack": (_flick_flack, 3.6),
    "sits": (_sits, 4.0),
    "shifts": (_shifts, 4.0),
}
