"""What an export is: the descriptor of a verb of ``mocapella export``."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from mocapella.registry import Table


@dataclass(frozen=True)
class Export:
    """An export of a take's results.

    Attributes:
        interface: of `mocapella.registry`.
        name: the verb after ``mocapella export``.
        summary: its output, in a line.
        parts: names of the types of scene parts that it carries; None where it carries every type.
        command: ``module:function`` of its typer command, which has the take's path as its argument ``take``. The
            module is imported when the verb runs.
    """

    interface: int
    name: str
    summary: str
    parts: tuple[str, ...] | None
    command: str


EXPORTS: Final = Table("mocapella.exports", Export, "export")
"""By name."""


def left_out(export: Export, parts: Mapping[str, int]) -> dict[str, int]:
    """Which parts an export does not carry.

    Args:
        export: the export.
        parts: how many parts of each type a take has, by the type's name.

    Returns:
        How many are left out, by the type's name.
    """
    return {} if export.parts is None else {name: n for name, n in parts.items() if name not in export.parts}


def exports_of(parts: Collection[str]) -> tuple[str, ...]:
    """Names of the exports that carry any of these types of scene parts, such as those that a method makes."""
    return tuple(each.name for each in EXPORTS.values() if each.parts is None or not set(parts).isdisjoint(each.parts))
