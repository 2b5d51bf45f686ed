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
        before: the views in use before this frame.
        newest: views of sensors that replace those before, one for each row of people.
        shown: the sensors whose views are shown.
        people: the people.
        fresh: (people, sensors) whether a view is recent enough.
    """
    index = {sensor: column for column, sensor in enumerate(people.sensors)}
    columns = [(sensor, index[sensor], newest.get(sensor)) for sensor in shown]
    counts = np.count_nonzero(fresh if len(columns) == fresh.shape[1] else fresh[:, [i for _, i, _ in columns]], axis=1)
    rows = zip(people.numbers, counts.tolist(), strict=True)
    views, names = Views(), newest.keys()
    for row, (number, count) in enumerate(rows):
        known = before.get(number, _NONE)
        if len(known) == count and names <= known.keys():  # as usual: the same sensors see the person
            now = views[number] = known.copy()
            for sensor, new in newest.items():
                now[sensor] = new[row]
            continue
        is_fresh = fresh[row].tolist()
        views[number] = {
            sensor: known[sensor] if new is None else new[row]
            for sensor, column, new in columns
            if is_fresh[column] and (new is not None or sensor in known)
        }
    return views
