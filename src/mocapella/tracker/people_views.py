"""The sensors' views that a scene shows with its people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from mocapella.model.scene import PotentialSkeleton
from mocapella.tracker.people import People
from mocapella.tracker.people_memory import Bools

Views = dict[int, dict[str, PotentialSkeleton]]
"""By person's number, and sensor."""
_NONE: Final[dict[str, PotentialSkeleton]] = {}


def followed(
    before: Views, newest: Mapping[str, Sequence[PotentialSkeleton]], shown: Sequence[str], people: People, fresh: Bools
) -> Views:
    """Return the views in use of all people, in the order of their rows; within a person, in that of ``shown``.

    Args:
        before: the views in use before this frame; a person's views are replaced in place where the same sensors see
            the person.
        newest: views of sensors that replace those before, one for each row of people.
        shown: the sensors whose views are shown.
        people: the people.
        fresh: (people, sensors) whether a view is recent enough.
    """
    everyone = len(shown) == fresh.shape[1]
    seen = fresh if everyone else fresh[:, [column for column, name in enumerate(people.sensors) if name in shown]]
    counts: list[int] = np.add.reduce(seen, axis=1).tolist()
    views, names = Views(), newest.keys()
    for row, (number, count) in enumerate(zip(people.numbers, counts, strict=True)):
        known = before.get(number, _NONE)
        if len(known) == count and names <= known.keys():  # as usual: the same sensors see the person
            for sensor, new in newest.items():
                known[sensor] = new[row]
            views[number] = known
        else:
            is_fresh = dict(zip(people.sensors, fresh[row].tolist(), strict=True))
            views[number] = {
                sensor: newest[sensor][row] if sensor in newest else known[sensor]
                for sensor in shown
                if is_fresh[sensor] and (sensor in newest or sensor in known)
            }
    return views
