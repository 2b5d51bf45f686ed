"""Shorten the tracker's state for display: sensors with the same problem are grouped."""

from __future__ import annotations

from collections.abc import Collection

from mocapella.model.condition_texts import UNFINISHED


def conditions(reason: str, sensors: Collection[str]) -> list[str]:
    """Turn ``front: with left: walk; left: with front: walk; moved`` into ``["front, left: walk", "moved"]``.

    The other sensor of a pair is left out, because it changes several times a second, and the display would flicker.
    A problem of all sensors begins with ``all sensors: ``.

    Args:
        reason: text of the tracker's state: parts separated by ``; ``, some of them with the prefix ``SENSOR: ``.
        sensors: names of all sensors of the session.
    """
    of: dict[str, list[str]] = {}
    for name, text in problems(reason, sensors):
        of.setdefault(text, []).extend([name] if name else [])
    return [f"{_names(names, sensors)}{text}" for text, names in of.items()]


def problems(reason: str, sensors: Collection[str]) -> list[tuple[str, str]]:
    """Split a state's reason into its parts; return the sensor and the problem of each, in order.

    Arguments as in `conditions`. The sensor is empty where a part names none. A problem does not name the other sensor
    of a pair, see `trouble`.
    """
    found: list[tuple[str, str]] = []
    for part in filter(None, reason.split("; ")):
        name, _, text = part.partition(": ")
        found.append((name, trouble(text)) if name in sensors and text else ("", part))
    return found


def trouble(problem: str) -> str:
    """Return a sensor's problem without the other sensor of its pair: ``with left: walk`` gives ``walk``."""
    return problem.partition(": ")[2] if problem.startswith("with ") and ": " in problem else problem


def is_warning(problem: str) -> bool:
    """Return whether something is wrong; False without a problem, or if a calibration is only unfinished.

    Texts of other methods and plug-ins are warnings.
    """
    return bool(problem) and trouble(problem) not in UNFINISHED


def _names(names: Collection[str], sensors: Collection[str]) -> str:
    if not names:
        return ""
    return "all sensors: " if len(names) == len(sensors) > 1 else ", ".join(names) + ": "
