"""A person's route on the floor: a sequence of stretches, called legs, each with a number of steps.

`mocapella.sources.simulate.gait` animates a body along it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.sources.simulate.postures import POSTURES, STANDING, BodyPosture

Float64 = NDArray[np.float64]
Point = tuple[float, float]

STEP_S = 0.56
"""Duration of a step [s]: 107 steps a minute, an adult's leisurely cadence."""
STEP_M = 0.45
TURN_PER_STEP = math.radians(50)
HALF_TURN_S = math.ceil(math.pi / TURN_PER_STEP) * STEP_S
SEATED: Final = POSTURES["sit"]
"""Posture in a wheelchair."""
RAMP_S = 0.6
"""Duration of the acceleration at the start, and of the deceleration at the end [s]."""


@dataclass(frozen=True)
class Spot:
    """Position on the floor (world x, z) [m] and heading: 0 along z, growing towards x [rad]."""

    x: float
    z: float
    heading: float


@dataclass(frozen=True)
class Leg:
    """A part of a route: standing, a straight line or an arc about a centre; the body rotates with its progress.

    Attributes:
        start, end: first and last position; headings are not wrapped, so ``end.heading - start.heading`` is the body's
            rotation.
        steps: number of steps; 0 stands still.
        seconds: duration [s].
        centre: centre of an arc (world x, z) [m], along which the person goes from ``start`` by the angle of the body's
            rotation, so ``end`` must lie there (not checked); None without an arc.
        posture: posture that is assumed during the leg and left at its end.
        on_wheels: whether the body is moved as it sits, with its feet: the posture is held throughout, without steps.
    """

    start: Spot
    end: Spot
    steps: int
    seconds: float
    centre: Point | None = None
    posture: BodyPosture = STANDING
    on_wheels: bool = False

    def at(self, progress: Float64) -> Float64:
        """Return x, z [m] and heading [rad] (n, 3) at fractions (n,) of the leg's duration, 0 to 1."""
        u = _eased(progress, min(0.5, RAMP_S / self.seconds))[:, None]
        start = np.array([self.start.x, self.start.z, self.start.heading])
        end = np.array([self.end.x, self.end.z, self.end.heading])
        spots = (1 - u) * start + u * end
        if self.centre is not None:
            angle = u[:, 0] * (self.end.heading - self.start.heading)
            spots[:, 0], spots[:, 1] = _about(self.centre, (self.start.x, self.start.z), angle)
        return np.asarray(spots)

    @property
    def left_first(self) -> bool:
        """Whether the left foot steps first: True if the person moves or turns to the left."""
        h, dx, dz = self.start.heading, self.end.x - self.start.x, self.end.z - self.start.z
        sideways = dx * math.cos(h) - dz * math.sin(h)
        return sideways + 0.2 * (self.end.heading - self.start.heading) > 0


class Route:
    """Builder of a route, leg by leg; each method adds legs that begin where the last one ended.

    Args:
        start: initial position and heading.

    Attributes:
        legs: the legs so far.
        spot: position and heading at the end of the legs so far.
    """

    def __init__(self, start: Spot) -> None:
        self.legs: list[Leg] = []
        self.spot = start

    @property
    def seconds(self) -> float:
        """Duration of the route so far [s]."""
        return sum(leg.seconds for leg in self.legs)

    def stand(self, seconds: float, posture: BodyPosture = STANDING) -> None:
        """Stay in one place for a time [s]; with a ``posture``, assume it and return to standing at the end."""
        self.legs.append(Leg(self.spot, self.spot, 0, seconds, posture=posture))

    def stand_until(self, seconds: float) -> None:
        """Stand still until the route has this duration [s], so that two people can begin the next leg together.

        Nothing is added if the route is already as long.
        """
        if seconds > self.seconds + 1e-9:
            self.stand(seconds - self.seconds)

    def turn(self, heading: float) -> None:
        """Turn on the spot to a heading [rad], the shorter way; nothing is added if the person has that heading."""
        by = math.remainder(heading - self.spot.heading, math.tau)
        if abs(by) > 1e-9:
            self._leg(Spot(self.spot.x, self.spot.z, self.spot.heading + by))

    def shift(self, to: Point) -> None:
        """Go to a point (world x, z) [m] without turning: forward, backward or sideways."""
        self._leg(Spot(*to, self.spot.heading))

    def go(self, to: Point) -> None:
        """Turn to a point (world x, z) [m] and go there."""
        self.turn(math.atan2(to[0] - self.spot.x, to[1] - self.spot.z))
        self.shift(to)

    def around(self, centre: Point, by: float) -> None:
        """Turn onto the circle around a centre and go along it by an angle [rad]; positive turns left.

        The first turn always takes the time of half a turn, so that two people who go around together stay opposite.
        """
        ready = self.seconds + HALF_TURN_S
        outward = math.atan2(self.spot.x - centre[0], self.spot.z - centre[1])
        self.turn(outward + math.copysign(math.pi / 2, by))
        self.stand_until(ready)
        x, z = _about(centre, (self.spot.x, self.spot.z), np.array([by]))
        self._leg(Spot(float(x[0]), float(z[0]), self.spot.heading + by), centre)

    def roll(self, to: Point) -> None:
        """Be moved to a point (world x, z) [m] on a wheelchair, without turning, as quickly as a person who goes."""
        self.legs.append(replace(self._next(Spot(*to, self.spot.heading)), steps=0, posture=SEATED, on_wheels=True))
        self.spot = self.legs[-1].end

    def seat(self, seconds: float) -> None:
        """Sit in a wheelchair that stands still for a time [s]."""
        self.legs.append(Leg(self.spot, self.spot, 0, seconds, posture=SEATED, on_wheels=True))

    def then(self, other: Route) -> None:
        """Append the legs of another route, which must begin at the end of this one (not checked)."""
        self.legs.extend(other.legs)
        self.spot = other.spot

    def _leg(self, end: Spot, centre: Point | None = None) -> None:
        self.legs.append(self._next(end, centre))
        self.spot = end

    def _next(self, end: Spot, centre: Point | None = None) -> Leg:
        by = abs(end.heading - self.spot.heading)
        far = math.hypot(end.x - self.spot.x, end.z - self.spot.z)
        if centre is not None:
            far = by * math.hypot(end.x - centre[0], end.z - centre[1])
        steps = max(2, math.ceil(far / STEP_M) + 1, math.ceil(by / TURN_PER_STEP))
        return Leg(self.spot, end, steps, steps * STEP_S, centre)


def _about(centre: Point, point: Point, angle: Float64) -> tuple[Float64, Float64]:
    """Rotate a point about a centre, in the direction of growing headings (from z to x)."""
    x, z = point[0] - centre[0], point[1] - centre[1]
    return centre[0] + x * np.cos(angle) + z * np.sin(angle), centre[1] - x * np.sin(angle) + z * np.cos(angle)


def _eased(u: Float64, ramp: float) -> Float64:
    """Progress with a trapezoidal speed profile; ``ramp`` is the share of the time of each of its slopes."""
    speed = 1 / (1 - ramp)
    rising, falling = u**2 / (2 * ramp), 1 / speed - (1 - u) ** 2 / (2 * ramp)
    return np.asarray(speed * np.select([u < ramp, u > 1 - ramp], [rising, falling], u - ramp / 2))
