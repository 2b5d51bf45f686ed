"""Times at which a take's sensors and people had problems, such as a camera that was moved, from its statuses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from mocapella.conventions import NS_PER_S
from mocapella.model.conditions import problems

LONGEST_GAP_S: Final = 5.0
"""After a longer time without a status, such as an interruption, a problem that persists is a new interval [s]."""


@dataclass(frozen=True)
class ConditionInterval:
    """Time in which a sensor had a problem, or a person a condition.

    Attributes:
        sensor: name of the sensor; empty for a person.
        condition: the problem and its remedy, as the view showed it; a person's begins with ``person ID: ``.
        from_s, to_s: times of the first status with the problem, and of the first without it or else of the last
            status [s]; a server stores five a second.
    """

    sensor: str
    condition: str
    from_s: float
    to_s: float


def condition_intervals(statuses: Iterable[tuple[int, dict[str, Any]]], began_ns: int) -> list[ConditionInterval]:
    """Return the intervals with problems in the order of their beginning, then by sensor and condition.

    Args:
        statuses: time [ns] and content of each `mocapella.model.session.SessionStatus`, as `Take.statuses` yields them.
        began_ns: the time that counts as 0 s, on the statuses' clock [ns].
    """
    since: dict[tuple[str, str], float] = {}
    found: list[ConditionInterval] = []
    last_s = float("-inf")
    for at_ns, status in statuses:
        at_s = (at_ns - began_ns) / NS_PER_S
        if not 0 <= at_s - last_s <= LONGEST_GAP_S:
            found += [ConditionInterval(*key, began, last_s) for key, began in since.items()]
            since = {}
        now = _problems(status)
        found += [ConditionInterval(*key, since.pop(key), at_s) for key in list(since) if key not in now]
        since |= {key: at_s for key in now if key not in since}
        last_s = at_s
    found += [ConditionInterval(*key, began, last_s) for key, began in since.items()]
    return sorted(found, key=lambda one: (one.from_s, one.sensor, one.condition))


def _problems(status: dict[str, Any]) -> dict[tuple[str, str], None]:
    """Return (sensor, problem) of each problem in a status; the sensor is empty for people's."""
    sensors = {str(one.get("name")) for one in _objects(status.get("sensors"))}
    found = {(name, text): None for name, text in problems(str(status.get("reason", "")), sensors) if name}
    people = _objects(status.get("people_conditions"))
    return found | {("", f"person {one.get('person')}: {one.get('condition')}"): None for one in people}


def _objects(value: object) -> list[dict[str, Any]]:
    """Return the JSON objects of an array; none of anything else."""
    return [one for one in value if isinstance(one, dict)] if isinstance(value, list) else []
