"""Animate a walking body along a route, with feet that do not slide.

Each step plants a foot where the body will be half way through that foot's stance; it stays there until its next step.
The pelvis is as high as both legs reach, knees follow from the two bone lengths (law of cosines), and arms swing with
the opposite leg. A person who stays in place may assume a posture (`postures`). The constants are ours, chosen to look
like a strolling person.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.sources.simulate.body import BODY, JOINT, body_template
from mocapella.sources.simulate.motion import POSE_HZ, Motion, normalised, smooth_step
from mocapella.sources.simulate.postures import ARM_POSES, RISE_S, WAVE, WAVE_PERIOD_S, BodyPosture
from mocapella.sources.simulate.route import STEP_S, Leg

Float64 = NDArray[np.float64]

SIDES = ("Left", "Right")
DOUBLE_SUPPORT = 0.12
"""Share of a step for which both feet are on the floor, at its beginning and again at its end."""
STANCE_HALF_WIDTH = 0.055
"""Half the distance of the feet, in fractions of stature."""
LYING_SHANK = float(np.radians(20.0))
"""Angle between the floor and a shank up to which the foot is stretched; from twice that on, the sole stands [rad]."""
ANKLE_HEIGHT = 0.039
STEP_HEIGHT_M = 0.07
REACH = 0.995
"""Greatest extension of a leg, as a fraction of its length: knees are never locked."""
PELVIS_SMOOTHING = 11
"""Number of poses over which the height of the pelvis is smoothed."""
UP = np.array([0.0, 1.0, 0.0])
_DEVIATIONS = ("sink", "back", "lean")
"""Fields of a posture that are the first columns of `GaitTracks.postures`."""
_COLUMNS = len(_DEVIATIONS) + len(ARM_POSES)


@dataclass(frozen=True, eq=False)
class GaitTracks:
    """Position of the body and motion of the feet along a route, for each of the motion's poses (`POSE_HZ`).

    Headings are in the world: 0 toward +z, π/2 toward +x. Pairs are left, right.

    Attributes:
        spots: (poses, 3) x, z [m] and heading [rad] of the body in the world.
        ankles: (poses, 2, 3) positions of the ankles in the world [m].
        yaws: (poses, 2) headings of the feet [rad].
        swings: (poses, 2) phase of a foot's swing, from 0 to below 1; 0 on the floor.
        postures: (poses, 3 + arm poses) deviations from standing: sink, back and lean as in `postures.BodyPosture`,
            and the weight of each of `postures.ARM_POSES`, 0 to 1.
    """

    spots: Float64
    ankles: Float64
    yaws: Float64
    swings: Float64
    postures: Float64


def animate(
    legs: list[Leg], lengths: Float64, stature: float, rng: np.random.Generator, *, lifeless: bool = False
) -> Motion:
    """Animate a body along a closed route; the motion has `POSE_HZ` poses per second of the route.

    Args:
        legs: legs of the route, in order; the last should end where the first begins, since the motion repeats.
        lengths: (25,) length of the bone that ends at each joint [m].
        stature: height of the person, for the width of the stance and the thickness of the limbs [m].
        rng: random numbers for the phases of breathing and swaying, which differ between people.
        lifeless: whether the body neither breathes nor sways, as a mannequin.
    """
    tracks = _tracks(legs, stature)
    sway = _sway(len(tracks.spots), rng)
    if lifeless:
        sway = _Sway(0 * sway.breath, 0 * sway.aside, 0 * sway.ahead)
    direction = np.zeros((len(tracks.spots), len(BODY), 3))
    lead = np.einsum("ni,ni->n", tracks.ankles[:, 1] - tracks.ankles[:, 0], _ahead(tracks.spots[:, 2])) / 0.5
    lead = np.clip(lead, -1, 1)
    pelvis_yaw, chest_yaw = tracks.spots[:, 2] + 0.08 * lead, tracks.spots[:, 2] - 0.1 * lead
    sink, back, lean, *arms = tracks.postures.T
    root = _root(tracks, sway, pelvis_yaw, lengths, stature)
    root[:, 1] -= sink * (lengths[JOINT["KneeLeft"]] + lengths[JOINT["AnkleLeft"]])
    root -= (back * stature)[:, None] * _ahead(pelvis_yaw)
    _legs(direction, root, pelvis_yaw, tracks, lengths)
    _trunk(direction, chest_yaw, pelvis_yaw, 0.05 * _speed_ahead(tracks.spots) + lean, sway)
    for side, name in enumerate(SIDES):
        _arm(direction, name, chest_yaw, lead * (1 - 2 * side), _held(chest_yaw, name, arms))
    return Motion(root, direction, lengths, body_template().radii * stature)


def _tracks(legs: list[Leg], stature: float) -> GaitTracks:
    counts = [round(leg.seconds * POSE_HZ) for leg in legs]
    spots = np.concatenate([leg.at(np.arange(n) / n) for leg, n in zip(legs, counts, strict=True)])
    poses = len(spots)
    tracks = GaitTracks(
        spots, np.empty((poses, 2, 3)), np.empty((poses, 2)), np.zeros((poses, 2)), np.zeros((poses, _COLUMNS))
    )
    for side in (0, 1):
        tracks.ankles[:, side], tracks.yaws[:, side] = _planted(spots[:1], side, stature)[0], spots[0, 2]
    first = 0
    for leg, count in zip(legs, counts, strict=True):
        for step in range(leg.steps):
            _step(tracks, leg, step, first, stature)
        if leg.on_wheels:
            for side in (0, 1):
                tracks.ankles[first:, side] = _carried(spots[first:], count, side, stature)
        tracks.postures[first : first + count] = _deviation(leg.posture, count, held=leg.on_wheels)
        first += count
    tracks.ankles[..., 1] += STEP_HEIGHT_M * np.sin(np.pi * tracks.swings) ** 2
    return tracks


def _carried(spots: Float64, moved: int, side: int, stature: float) -> Float64:
    """Positions (poses, 3) of an ankle that is carried along for the first ``moved`` poses, and stays there."""
    at = spots[np.minimum(np.arange(len(spots)), moved - 1)]
    return _planted(at, side, stature)


def _deviation(posture: BodyPosture, poses: int, *, held: bool = False) -> Float64:
    """Columns of `GaitTracks.postures` over a leg in which a posture is assumed, perhaps repeatedly, and left.

    With ``held``, it is held throughout.
    """
    at_s = np.arange(poses) / POSE_HZ
    weight = np.ones(poses) if held else smooth_step(np.minimum(at_s, poses / POSE_HZ - at_s) / RISE_S)
    if posture.period_s > 0:
        weight = weight * (0.5 - 0.5 * np.cos(2 * np.pi * at_s / posture.period_s))
    arms = [float(name == posture.arms) for name in ARM_POSES]
    return np.asarray(weight[:, None] * [*(getattr(posture, name) for name in _DEVIATIONS), *arms])


def _step(tracks: GaitTracks, leg: Leg, step: int, first: int, stature: float) -> None:
    """Swing one foot to its next position, and keep it there for the rest of the time. Writes into ``tracks``."""
    side = (step + (not leg.left_first)) % 2
    ankle, yaw, swings = tracks.ankles[:, side], tracks.yaws[:, side], tracks.swings[:, side]
    last = step >= leg.steps - 2
    target = leg.at(np.array([1.0 if last else (step + 1.5) / leg.steps]))
    place, heading = _planted(target, side, stature)[0], target[0, 2]
    per_step = round(STEP_S * POSE_HZ)
    begin = first + step * per_step + round(DOUBLE_SUPPORT * per_step)
    end = first + (step + 1) * per_step - round(DOUBLE_SUPPORT * per_step)
    swings[begin:end] = np.arange(end - begin) / (end - begin)
    moved = smooth_step(swings[begin:end])
    ankle[begin:end] += moved[:, None] * (place - ankle[begin])
    yaw[begin:end] += moved * (heading - yaw[begin])
    ankle[end:], yaw[end:] = place, heading


def _planted(spots: Float64, side: int, stature: float) -> Float64:
    """Positions (n, 3) of an ankle of a body that stands at spots (n, 3)."""
    out = (1 - 2 * side) * STANCE_HALF_WIDTH * stature
    place = np.stack([spots[:, 0], np.full(len(spots), ANKLE_HEIGHT * stature), spots[:, 1]], axis=1)
    return np.asarray(place + out * _aside(spots[:, 2]))


@dataclass(frozen=True, eq=False)
class _Sway:
    breath: Float64
    aside: Float64
    ahead: Float64


def _sway(poses: int, rng: np.random.Generator) -> _Sway:
    """Slow waves of amplitude 1 with a whole number of periods in the motion."""

    def wave(period_s: float) -> Float64:
        cycles = max(1, round(poses / POSE_HZ / period_s))
        return np.asarray(np.sin(2 * np.pi * cycles * np.arange(poses) / poses + rng.uniform(0, 2 * np.pi)))

    return _Sway(wave(4.0), 0.7 * wave(5.3) + 0.3 * wave(2.2), 0.7 * wave(6.1) + 0.3 * wave(2.7))


def _root(tracks: GaitTracks, sway: _Sway, yaw: Float64, lengths: Float64, stature: float) -> Float64:
    """Root positions (poses, 3): above the feet, shifted to the stance foot, as high as both legs reach."""
    from scipy.ndimage import minimum_filter1d, uniform_filter1d

    lifts = np.sin(np.pi * tracks.swings) ** 2
    shift = 0.02 * (lifts[:, 1] - lifts[:, 0]) + 0.004 * sway.aside
    root = np.zeros((len(yaw), 3))
    root[:, 0], root[:, 2] = tracks.spots[:, 0], tracks.spots[:, 1]
    root += shift[:, None] * _aside(yaw) + 0.004 * sway.ahead[:, None] * _ahead(yaw)
    height = np.full(len(yaw), np.inf)
    for side, name in enumerate(SIDES):
        leg = REACH * (lengths[JOINT[f"Knee{name}"]] + lengths[JOINT[f"Ankle{name}"]])
        ankle = tracks.ankles[:, side]
        apart = root + (1 - 2 * side) * lengths[JOINT[f"Hip{name}"]] * _aside(yaw) - ankle
        reach = np.sqrt(np.maximum(leg**2 - apart[:, 0] ** 2 - apart[:, 2] ** 2, 0.0))
        height = np.minimum(height, ankle[:, 1] + reach)
    # The mean of local minima never exceeds the height, so the result is smooth and both feet stay in reach.
    lowest = minimum_filter1d(height, PELVIS_SMOOTHING, mode="wrap")
    root[:, 1] = uniform_filter1d(lowest, PELVIS_SMOOTHING, mode="wrap")
    return root


def _legs(direction: Float64, root: Float64, yaw: Float64, tracks: GaitTracks, lengths: Float64) -> None:
    for side, name in enumerate(SIDES):
        hip, knee, ankle, foot = (JOINT[f"{joint}{name}"] for joint in ("Hip", "Knee", "Ankle", "Foot"))
        direction[:, hip] = (1 - 2 * side) * _aside(yaw)
        start = root + lengths[hip] * direction[:, hip]
        thigh, shank = _two_bones(tracks.ankles[:, side] - start, lengths[knee], lengths[ankle], _ahead(yaw))
        direction[:, knee], direction[:, ankle] = thigh, shank
        rest = body_template().offsets[foot]
        flat = np.arctan2(rest[1], rest[2])
        pitch = flat - 0.4 * np.sin(np.pi * tracks.swings[:, side]) ** 2
        ahead = _ahead(tracks.yaws[:, side])
        direction[:, foot] = _pitched(ahead, pitch - _stretched(shank, ahead) * (np.pi + 2 * flat))


def _stretched(shank: Float64, ahead: Float64) -> Float64:
    """Return how far the feet of shanks (n, 3) point back, as a part of that way: 1 where people kneel, 0 to stand.

    An ankle bends by less than the angle between the floor and a lying shank, so the instep lies on the floor instead.
    """
    lying = np.arccos(np.clip(-np.einsum("ni,ni->n", shank, ahead), -1.0, 1.0))
    return smooth_step(2.0 - lying / LYING_SHANK)


def _two_bones(reach: Float64, first: float, second: float, bend: Float64) -> tuple[Float64, Float64]:
    """Unit directions of two bones whose ends are ``reach`` (n, 3) apart, bent towards ``bend`` (law of cosines)."""
    distance = np.linalg.norm(reach, axis=1)
    towards = reach / distance[:, None]
    distance = np.clip(distance, abs(first - second) + 1e-6, (first + second) * (1 - 1e-6))
    along = (first**2 - second**2 + distance**2) / (2 * distance)
    out = np.sqrt(np.maximum(first**2 - along**2, 0.0))
    side = normalised(bend - np.einsum("ni,ni->n", bend, towards)[:, None] * towards)
    middle = along[:, None] * towards + out[:, None] * side
    return middle / first, (distance[:, None] * towards - middle) / second


def _trunk(direction: Float64, chest_yaw: Float64, pelvis_yaw: Float64, forward: Float64, sway: _Sway) -> None:
    """Write the trunk's directions; it leans ``forward`` by an angle [rad]."""
    lean = np.pi / 2 - forward - 0.004 * sway.ahead
    direction[:, JOINT["SpineMid"]] = _pitched(_ahead(pelvis_yaw), lean)
    direction[:, JOINT["SpineShoulder"]] = _pitched(_ahead(chest_yaw), lean + 0.004 * sway.breath)
    direction[:, JOINT["Neck"]] = _pitched(_ahead(chest_yaw), lean - 0.05)
    direction[:, JOINT["Head"]] = _pitched(_ahead(chest_yaw), lean - 0.1 + 0.004 * sway.breath)
    rise = (-0.05 + 0.015 * sway.breath)[:, None] * UP
    for side, name in enumerate(SIDES):
        direction[:, JOINT[f"Shoulder{name}"]] = normalised((1 - 2 * side) * _aside(chest_yaw) + rise)


@dataclass(frozen=True, eq=False)
class _HeldArm:
    """A held arm: its weight (poses,), and directions (poses, 3) of the upper arm, the forearm and the thumb."""

    weight: Float64
    upper: Float64
    fore: Float64
    thumb: Float64


def _held(yaw: Float64, side: str, weights: list[Float64]) -> list[_HeldArm]:
    """Held poses of one arm, with weights (arm poses, poses) in the order of `ARM_POSES`."""
    ahead, out = _ahead(yaw), _aside(yaw) * (1 if side == "Left" else -1)
    axes = np.stack([ahead, out, np.broadcast_to(UP, ahead.shape)], axis=1)
    angle = WAVE * np.sin(2 * np.pi * np.arange(len(yaw)) / POSE_HZ / WAVE_PERIOD_S)[:, None]
    held = []
    for pose, weight in zip(ARM_POSES.values(), weights, strict=True):
        if side not in pose.sides or not weight.any():
            continue
        upper, fore, thumb = (direction @ axes for direction in (pose.upper, pose.fore, pose.thumb))
        if pose.waves:  # from hanging to up, the forearm passes in front
            fore = np.cos(angle) * fore + np.sin(angle) * out + 2 * (1 - weight)[:, None] * ahead
        held.append(_HeldArm(weight, upper, fore, thumb))
    return held


def _arm(direction: Float64, side: str, yaw: Float64, swing: Float64, held: list[_HeldArm]) -> None:
    """Write an arm's directions: hanging, with a swing from −1 to 1, or as ``held``."""
    ahead, out = _ahead(yaw), _aside(yaw) * (1 if side == "Left" else -1)
    angle, bend = 0.35 * swing, 0.15 + 0.2 * np.maximum(swing, 0.0)
    upper = _pitched(ahead, angle - np.pi / 2) + 0.12 * out
    fore = _pitched(ahead, angle + bend - np.pi / 2) + 0.05 * out
    hangs = 1 - sum((arm.weight for arm in held), np.zeros(len(yaw)))[:, None]
    upper, fore, thumb = hangs * upper, hangs * fore, hangs * ahead
    for arm in held:
        w = arm.weight[:, None]
        upper, fore, thumb = upper + w * arm.upper, fore + w * arm.fore, thumb + w * arm.thumb
    upper, fore = normalised(upper), normalised(fore)
    direction[:, JOINT[f"Elbow{side}"]] = upper
    for joint in ("Wrist", "Hand", "HandTip"):
        direction[:, JOINT[f"{joint}{side}"]] = fore
    # The thumb points ahead on a hanging arm, and up on an arm that points ahead.
    direction[:, JOINT[f"Thumb{side}"]] = normalised(fore + 0.66 * thumb)


def _speed_ahead(spots: Float64) -> Float64:
    moved = np.roll(spots, -1, axis=0) - np.roll(spots, 1, axis=0)
    velocity = np.stack([moved[:, 0], np.zeros(len(spots)), moved[:, 1]], axis=1) * POSE_HZ / 2
    return np.asarray(np.einsum("ni,ni->n", velocity, _ahead(spots[:, 2])))


def _ahead(yaw: Float64) -> Float64:
    return np.stack([np.sin(yaw), np.zeros_like(yaw), np.cos(yaw)], axis=-1)


def _aside(yaw: Float64) -> Float64:
    """Direction to the left of a body with this yaw."""
    return np.stack([np.cos(yaw), np.zeros_like(yaw), -np.sin(yaw)], axis=-1)


def _pitched(ahead: Float64, angle: Float64) -> Float64:
    """Raise a horizontal direction by an angle."""
    a = np.asarray(angle)[:, None]
    return np.asarray(np.cos(a) * ahead + np.sin(a) * UP)
