"""How well one sensor measures the joints of a person, by where it sees the person from.

    Σ(α) = Σ turned + bias biasᵀ + sd² I           over the measured errors of a Kinect v2 (docs/simulation.md)

α is the person's facing relative to the direction towards the sensor. The turn of the labels is averaged by
Gauss–Hermite quadrature. Swapped labels are assumed to be corrected, as the method ``default`` does, and left and right
of the body have equal errors. Which joints the own body hides is looked up by the direction of the sensor.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.sources.simulate import PersonSettings, SceneSettings, SensorSettings, build_room
from mocapella.sources.simulate.body import BODY, JOINT, body_template
from mocapella.sources.simulate.measured import Errors, measured_errors
from mocapella.sources.simulate.occlusion import hidden, obstacles

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

SCORED: Final = (
    "Head", "SpineShoulder", "SpineBase",
    *(part + side for part in ("Shoulder", "Elbow", "Wrist", "Knee", "Ankle") for side in ("Left", "Right")),
)  # fmt: skip
"""Joints of the trunk and of the limbs whose error is expected."""
SCORED_JOINTS: Final = np.array([JOINT[name] for name in SCORED])
TURNS: Final = 72
"""Number of directions around a person for which a view is tabulated."""
RISES_DEG: Final = np.arange(-60.0, 81.0, 10.0)
"""Elevations of a sensor, as seen from a person's middle, for which hidden joints are tabulated [deg]."""
LEVELS: Final = np.array([0.039, 0.285, 0.53, 0.67, 0.818, 0.936])
"""Heights of the body's test points, in fractions of stature: ankle, knee, hip, waist, shoulder and eyes."""
SIDEWAYS_M: Final = 0.2
"""Distance of the body's side points from its axis, across the line of sight [m]."""
OFF_AXIS_M: Final = 0.1
"""A joint farther than this from the axis, across the line of sight, is seen if the side point is [m]."""
_NODES: Final = ((0.0, 2 / 3), (3**0.5, 1 / 6), (-(3**0.5), 1 / 6))
"""Deviates and weights of a normal distribution's quadrature; exact up to the fifth moment."""
_AWAY_M: Final = 3.0


class PersonTables:
    """Tables of one sensor's errors on a person in given postures.

    Args:
        postures: names of postures, ``stand`` or keys of `mocapella.sources.simulate.postures.POSTURES`.
        stature: height of the person [m].
        errors: measured errors of a sensor; None for this version's errors.

    Attributes:
        stature: as given.
        moments: (postures, `TURNS`, joints, 2, 3, 3) mean squares of the error of a joint that is visible or hidden by
            the own body, in the view's axes: to the side, up, and towards the sensor [m²].
        hides: (postures, elevations, `TURNS`, joints) whether the own body hides the joint.
        point: (postures, `TURNS`, joints) index of the body's test point next to the joint, see `body_points`.

    Joints are `SCORED`; entry k of `TURNS` is for α = k · 360° / `TURNS`.
    """

    def __init__(self, postures: tuple[str, ...], stature: float, errors: Errors | None = None) -> None:
        errors = errors or measured_errors()
        self.stature = stature
        bodies = [standing_body(name, stature) for name in postures]
        self.moments = np.stack([_moments(body, errors) for body in bodies])
        self.hides = np.stack([_hides(body, stature) for body in bodies])
        self.point = np.stack([_points_of(body, stature) for body in bodies])


def standing_body(posture: str, stature: float) -> Float64:
    """Return the joints (25, 3) of a person in a posture who faces along z, the root above the origin [m]."""
    person = PersonSettings((0.0, 0.0), "route", route=(f"{posture} 4",), stature=stature, lifeless=True)
    room = build_room(SceneSettings("posture", (SensorSettings("one"),), (person,)))
    joints = room.positions_at(2_000_000_000)[0]
    return np.asarray(joints * (-1.0, 1.0, -1.0))  # people begin by facing against z


def body_points(stature: float) -> Float64:
    """Return the body's test points (18, 2): across the line of sight, and up from the floor [m].

    Three in each of `LEVELS`: on the body's axis, and at both sides of it.
    """
    side = np.array([0.0, -SIDEWAYS_M, SIDEWAYS_M])
    up, across = np.meshgrid(LEVELS * stature, side, indexing="ij")
    return np.stack([across, up], axis=-1).reshape(-1, 2)


ON_AXIS: Final = 3 * np.arange(len(LEVELS))
"""Indices of the points of `body_points` on the body's axis."""


def turned(bodies: Float64, yaw: Float64) -> Float64:
    """Return bodies (..., 3), y up, turned about the vertical axis at the origin by angles [rad] that broadcast."""
    x, y, z = np.moveaxis(bodies, -1, 0)
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.asarray(np.stack(np.broadcast_arrays(cos * x + sin * z, y, cos * z - sin * x), axis=-1))


def angles_of_turns() -> Float64:
    """Return the angles α (`TURNS`,) of the tables [rad]."""
    return np.asarray(np.arange(TURNS) * (2 * np.pi / TURNS), dtype=np.float64)


def _moments(body: Float64, errors: Errors) -> Float64:
    alpha = angles_of_turns()
    world = turned(body, alpha[:, None])
    eye = np.array([0.0, 1.0, 1e6])  # so far that the direction towards it is z for all joints
    seen, still = np.ones(world.shape[:2], dtype=np.bool_), np.zeros_like(world)
    swapped = np.interp(np.degrees(np.abs(np.angle(np.exp(1j * alpha)))), errors.data.alpha_deg, errors.data.mirrored)
    moments = np.zeros((*world.shape[:2], 3, 3))
    for is_swapped, share in ((False, 1 - swapped), (True, swapped)):
        chance = np.full(TURNS, -1.0 if is_swapped else 2.0)
        for deviate, weight in _NODES:
            noise = (still, np.full(TURNS, deviate), chance)
            error = errors.put_on(world, eye, seen, noise)[0] - world
            moments += (share * weight)[:, None, None, None] * error[..., :, None] * error[..., None, :]
    side = np.digitize(np.degrees(np.abs(np.angle(np.exp(1j * alpha)))), (60.0, 120.0))
    spread = errors.sd_m[:, :, side].transpose(2, 0, 1) ** 2 * (1 + errors.white**2)[:, None]
    total = moments[:, :, None] + spread[..., None, None] * np.eye(3)
    return np.asarray((total + _mirrored(total))[:, SCORED_JOINTS] / 2)


def _mirrored(moments: Float64) -> Float64:
    """Moments (turns, joints, 2, 3, 3) of a mirrored person: left for right, and α for −α.

    The recorded people walked one route; what their left and right differ by is chance.
    """
    sign = np.array([-1.0, 1.0, 1.0])
    back = moments[-np.arange(TURNS)][:, list(BODY.mirror)]
    return np.asarray(back * sign[:, None] * sign)


def _hides(body: Float64, stature: float) -> Bools:
    """Whether the own body hides each joint (elevations, turns, joints), seen from `_AWAY_M`."""
    radii, empty = (body_template().radii * stature)[None], obstacles((), ())
    middle = body[JOINT["SpineMid"]]
    out = np.zeros((len(RISES_DEG), TURNS, len(SCORED)), dtype=np.bool_)
    for i, rise in enumerate(np.radians(RISES_DEG)):
        for k, alpha in enumerate(angles_of_turns()):
            # Where the body faces α from the line of sight, the sensor is at −α from where the body faces.
            toward = np.array([-np.sin(alpha) * np.cos(rise), np.sin(rise), np.cos(alpha) * np.cos(rise)])
            out[i, k] = hidden(middle + _AWAY_M * toward, body[None], radii, empty)[0, SCORED_JOINTS]
    return out


def _points_of(body: Float64, stature: float) -> NDArray[np.int64]:
    """Index of the test point next to each joint (turns, joints)."""
    seen = turned(body, angles_of_turns()[:, None])[:, SCORED_JOINTS]
    level = np.abs(seen[..., 1, None] - LEVELS * stature).argmin(axis=-1)
    across = np.where(np.abs(seen[..., 0]) <= OFF_AXIS_M, 0, np.where(seen[..., 0] < 0, 1, 2))
    return np.asarray(3 * level + across)
