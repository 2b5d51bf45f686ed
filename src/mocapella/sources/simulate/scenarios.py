"""The study's scenarios, each a closed route that begins with standing still."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mocapella.errors import SettingsError, one_of
from mocapella.sources.simulate.postures import POSTURES, posture
from mocapella.sources.simulate.route import HALF_TURN_S, Point, Route, Spot

STILL_S = 6.6
"""Time for which all people stand still at first: 120 frames (4 s) even of a sensor that starts late [s]."""

FACING_MAIN = math.pi
"""Heading of a person who faces the main sensor, which is near the world's origin and looks along z [rad]."""


@dataclass(frozen=True)
class Cue:
    """The parameters of a scenario.

    Attributes:
        start: initial position of the person (world x, z) [m].
        target: centre of the obstacle, or position of the other person, depending on the scenario (world x, z) [m].
        first: whether this person moves first, if two people take turns.
    """

    start: Point
    target: Point
    first: bool


WRITTEN = "route"
"""Name of the scenario for a route given in the settings."""
_STEPS = (
    "stand SECONDS", "go X Z", "shift X Z", "turn DEGREES", "around X Z DEGREES", "roll X Z", "seat SECONDS",
    *(f"{name} SECONDS" for name in POSTURES),
)  # fmt: skip


def scenario_names() -> tuple[str, ...]:
    """Return the names that `plan` knows."""
    return tuple(_SCENARIOS)


def plan(scenario: str, start: Point, target: Point | None = None, *, first: bool = True) -> Route:
    """Plan the route of one person.

    Args:
        scenario: one of `scenario_names`.
        start: initial position (world x, z) [m].
        target: centre of the obstacle, or position of the other person (world x, z) [m]; None for other scenarios.
        first: whether this person moves first, if two people take turns.

    Raises:
        SettingsError: unknown scenario, or it needs a ``target`` and none is given.
    """
    if scenario not in _SCENARIOS:
        raise SettingsError(f"unknown scenario {scenario!r}; known: {one_of(scenario, _SCENARIOS)}")
    if target is None and scenario in _ABOUT_SOMETHING:
        raise SettingsError(f"scenario {scenario} needs a target: {_ABOUT_SOMETHING[scenario]}")
    route = Route(Spot(*start, FACING_MAIN))
    route.stand(STILL_S)
    _SCENARIOS[scenario](route, Cue(start, target or start, first))
    return route


def written_route(start: Point, words: Sequence[str]) -> Route:
    """Parse a route given step by step; the person faces the main sensor at first. No standing still is added.

    Args:
        start: initial position (world x, z) [m].
        words: ``stand SECONDS``, ``go X Z`` (turn there first), ``shift X Z`` (without turning), ``turn DEGREES`` (0
            along z, growing towards x), ``around X Z DEGREES`` (along a circle about that point), ``roll X Z`` (moved
            there on a wheelchair, without turning), ``seat SECONDS`` (in a wheelchair), and ``POSTURE SECONDS`` with a
            name of `mocapella.sources.simulate.postures.POSTURES`.

    Raises:
        SettingsError: there is no step, or one is invalid.
    """
    route = Route(Spot(*start, FACING_MAIN))
    if not words:
        raise SettingsError('scenario route needs a route, such as ["stand 2", "go 0.5 3"]')
    for step in words:
        verb, *texts = step.split()
        try:
            numbers = [float(text) for text in texts]
        except ValueError:
            numbers = []
        match verb, numbers:
            case "stand", [seconds] if seconds > 0:
                route.stand(seconds)
            case name, [seconds] if name in POSTURES and seconds > 0:
                route.stand(seconds, POSTURES[name])
            case "go", [x, z]:
                route.go((x, z))
            case "shift", [x, z]:
                route.shift((x, z))
            case "turn", [degrees]:
                route.turn(math.radians(degrees))
            case "roll", [x, z]:
                route.roll((x, z))
            case "seat", [seconds] if seconds > 0:
                route.seat(seconds)
            case "around", [x, z, degrees]:
                route.around((x, z), math.radians(degrees))
            case _:
                raise SettingsError(f"route: {step!r} is no step; write it as one of: {', '.join(_STEPS)}")
    return route


def _stand(route: Route, cue: Cue) -> None:
    route.stand(13.4)


def _steps(route: Route, cue: Cue) -> None:
    """Small steps forward, back, left and right, each from the centre and back to it."""
    x, z = cue.start
    for dx, dz in ((0.0, -0.35), (0.0, 0.35), (-0.35, 0.0), (0.35, 0.0)):
        for to in ((x + dx, z + dz), cue.start):
            route.shift(to)
            route.stand(0.4)


def _walk(route: Route, cue: Cue) -> None:
    """Forward, around the square (a whole turn), diagonal to front right, diagonal to back left, forward; and back.

    The start is the back left corner. Left and right are the person's own, facing the main sensor.
    """
    side = 1.2
    back_left = cue.start
    front_left, back_right = (back_left[0], back_left[1] - side), (back_left[0] + side, back_left[1])
    front_right = (back_right[0], front_left[1])
    for to in (front_left, front_right, back_right, back_left):
        route.go(to)
    route.turn(FACING_MAIN)
    for to in (front_right, back_left, front_left):
        route.go(to)
    route.stand(0.6)
    route.shift(back_left)
    route.stand(1.0)


def _obstacle(route: Route, cue: Cue) -> None:
    """Around the obstacle, once each way."""
    for by in (math.tau, -math.tau):
        route.around(cue.target, by)
        route.turn(FACING_MAIN)
        route.stand(1.0)


def _front_back(route: Route, cue: Cue) -> None:
    """Go in front of the other person and back; then the other does the same."""
    visit = Route(route.spot)
    visit.go((cue.target[0], cue.target[1] - 0.8))
    visit.turn(FACING_MAIN)
    visit.stand(2.0)
    visit.go(cue.start)
    visit.turn(FACING_MAIN)
    visit.stand(1.0)
    _in_turn(route, visit, cue.first)


def _around(route: Route, cue: Cue) -> None:
    """Go around the other person, who stands; then the other does the same."""
    visit = Route(route.spot)
    visit.around(cue.target, math.tau)
    visit.turn(FACING_MAIN)
    visit.stand(1.0)
    _in_turn(route, visit, cue.first)


def _exchange(route: Route, cue: Cue) -> None:
    """Both walk half a circle around the midpoint between them at the same time, stand, and walk back."""
    middle = ((cue.start[0] + cue.target[0]) / 2, (cue.start[1] + cue.target[1]) / 2)
    for _ in range(2):
        route.around(middle, math.pi)
        arrived = route.seconds
        route.turn(FACING_MAIN)
        route.stand_until(arrived + HALF_TURN_S + 2.0)


def _squats(route: Route, cue: Cue) -> None:
    route.stand(12.0, posture("squat"))
    route.stand(1.0)


def _sit(route: Route, cue: Cue) -> None:
    route.stand(12.4, posture("sit"))
    route.stand(1.0)


def _wave(route: Route, cue: Cue) -> None:
    route.stand(12.4, posture("wave"))
    route.stand(1.0)


def _bend(route: Route, cue: Cue) -> None:
    route.stand(12.0, posture("bend"))
    route.stand(1.0)


def _self_occlusion(route: Route, cue: Cue) -> None:
    """Turn the back to the main sensor, with the right arm in front of the chest."""
    route.turn(0.0)
    route.stand(8.0, posture("arm-across"))
    route.turn(FACING_MAIN)
    route.stand(1.0)


def _in_turn(route: Route, visit: Route, first: bool) -> None:
    """Let one person wait while the other moves. Both take equally long, since their positions are symmetrical."""
    if not first:
        route.stand(visit.seconds)
    route.then(visit)
    if first:
        route.stand(visit.seconds)


_SCENARIOS: dict[str, Callable[[Route, Cue], None]] = {
    "stand": _stand,
    "steps": _steps,
    "walk": _walk,
    "obstacle": _obstacle,
    "front-back": _front_back,
    "around": _around,
    "exchange": _exchange,
    "self-occlusion": _self_occlusion,
    "squats": _squats,
    "sit": _sit,
    "wave": _wave,
    "bend": _bend,
}

_ABOUT_SOMETHING = {
    "obstacle": "the obstacle's centre",
    "front-back": "where the other stands",
    "around": "where the other stands",
    "exchange": "where the other stands",
}
