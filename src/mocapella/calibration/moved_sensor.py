"""Whether a sensor was moved, and which.

Somebody whom two sensors saw in the same place, and now see in different ones, for longer than sensors err: then one of
the sensors is not where it was. That both still hold the same tracking ids, or that nobody at all agrees any more,
tells it from two people who are taken for one.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_calibration import PairCalibration

Pair = tuple[str, str]


def disagrees_for(pair: PairCalibration, now: float) -> float:
    """For how long nobody whom both see has been where this estimate says [s]; 0 where somebody is, or nobody is seen.

    Only people count who agreed for `AGREED_BEFORE_S` before, and are seen by both now.
    """
    since = []
    for body in pair.bodies.values():
        if now - body[at.STEP_AT] > SEEN_WITHIN_S:
            continue
        if np.isnan(body[at.DISAGREES_SINCE]):
            return 0.0
        if body[at.AGREED] >= AGREED_BEFORE_S:
            since.append(body[at.DISAGREES_SINCE])
    return max(now - max(since), 0.0) if since else 0.0


def moved_sensors(disagreeing: Collection[Pair], agreeing: Collection[Pair], order: Sequence[str]) -> list[str]:
    """Which sensors moved, given the pairs of sensors that disagree and those that agree.

    The fewest that explain it: again and again the sensor with the most disagreeing pairs. Of equals it is the one with
    fewer agreeing pairs, then the last in ``order``: of two sensors alone nobody can tell which moved, and the first
    one's frame is kept.
    """
    rest, moved = set(disagreeing), []
    while rest:
        blame = {
            sensor: (
                sum(sensor in pair for pair in rest),
                -sum(sensor in pair for pair in agreeing),
                order.index(sensor),
            )
            for pair in rest
            for sensor in pair
        }
        worst = max(blame, key=blame.__getitem__)
        moved.append(worst)
        rest = {pair for pair in rest if worst not in pair}
    return moved


SEEN_WITHIN_S = 0.5
"""A body that was not compared for longer is not seen by both now [s]."""
AGREED_BEFORE_S = 1.0
"""So long two views must have agreed before their disagreement says anything [s]."""
