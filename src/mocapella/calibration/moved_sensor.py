"""Detect which sensor was moved.

If two sensors agreed about a person's position and now disagree for longer than sensor errors last, one of them was
moved. Two people mistaken for one also disagree; so both sensors must still have the same tracking ids, or no other
person may agree.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_calibration import PairCalibration

Pair = tuple[str, str]


def disagrees_for(pair: PairCalibration, now: float) -> float:
    """Return for how long all persons whom both sensors see have contradicted the estimate [s].

    It is 0 if one of them agrees, or if no person counts: one counts only after having agreed for `AGREED_BEFORE_S`.

    Args:
        pair: the estimate and the state of its bodies.
        now: capture time of the newest frame, on the common clock [s].
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
    """Return the smallest set of moved sensors that explains the disagreeing pairs.

    The sensor with the most disagreeing pairs is chosen repeatedly. Ties go to the one with fewer agreeing pairs, then
    to the last in ``order``: of two sensors alone either may have moved, and the first one's frame is kept.

    Args:
        disagreeing, agreeing: pairs of sensors whose observations contradict, and confirm, their relative pose.
        order: all sensors.

    Returns:
        The moved sensors, the most contradicted first; none if no pair disagrees.
    """
    rest, moved = set(disagreeing), list[str]()
    agree = Counter(sensor for pair in agreeing for sensor in pair)
    rank = {sensor: i for i, sensor in enumerate(order)}
    while rest:
        disagree = Counter(sensor for pair in rest for sensor in pair)
        worst = max(disagree, key=lambda sensor: (disagree[sensor], -agree[sensor], rank[sensor]))
        moved.append(worst)
        rest = {pair for pair in rest if worst not in pair}
    return moved


SEEN_WITHIN_S = 0.5
"""Time without a comparison after which a body does not count [s]."""
AGREED_BEFORE_S = 1.0
"""Time for which two views must have agreed before a disagreement counts [s]."""
