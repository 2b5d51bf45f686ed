"""The sensors' views that a scene shows with its people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mocapella.model.scene import PotentialSkeleton
from mocapella.tracker.people import People
from mocapella.tracker.people_memory import Bools

Views = dict[int, dict[str, PotentialSkeleton]]
"""By person's number, and sensor."""


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
    columns = [(sensor, people.sensors.index(sensor), newest.get(sensor)) for sensor in shown]
    everywhere = len(columns) == fresh.shape[1]
    views = Views()
    for row, (number, is_fresh) in enumerate(zip(people.numbers, fresh.tolist(), strict=True)):
        known = before.get(number, {})
        count = is_fresh.count(True) if everywhere else sum(is_fresh[column] for _, column, _ in columns)
        if len(known) == count and newest.keys() <= known.keys():  # as usual: the same sensors see the person
            now = views[number] = dict(known)
            for sensor, new in newest.items():
                now[sensor] = new[row]
            continue
        views[number] = {
            sensor: known[sensor] if new is None else new[row]
            for sensor, column, new in columns
            if is_fresh[column] and (new is not None or sensor in known)
        }
    return views
