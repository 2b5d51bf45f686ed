"""Shorten the tracker's state for display: sensors with the same problem are grouped."""

from __future__ import annotations

from collections.abc import Collection


def conditions(reason: str, sensors: Collection[str]) -> list[str]:
    """Turn ``front: with left: walk; left: with front: walk; moved`` into ``["front, left: walk", "moved"]``.

    The pair of sensors with a problem changes several times a second; the remedy does not.

    Args:
        reason: text of the tracker's state: parts separated by ``; ``, some of them with the prefix ``SENSOR: ``.
        sensors: names of all sensors of the session.
    """
    of: dict[str, list[str]] = {}
    for part in reason.split("; "):
        name, _, text = part.partition(": ")
        if name in sensors and text:
            of.setdefault(trouble(text), []).append(name)
        elif part:
            of.setdefault(part, [])
    return [f"{_names(names, sensors)}{text}" for text, names in of.items()]


def trouble(problem: str) -> str:
    """Return a sensor's problem without the other sensor of its pair: ``with left: walk`` gives ``walk``."""
    return problem.partition(": ")[2] if problem.startswith("with ") and ": " in problem else problem


def _names(names: Collection[str], sensors: Collection[str]) -> str:
    if not names:
        return ""
    return "all sensors: " if len(names) == len(sensors) > 1 else ", ".join(names) + ": "
