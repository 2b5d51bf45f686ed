"""The descriptor of an export, a verb of ``mocapella export``."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from mocapella.registry import Table


@dataclass(frozen=True)
class Export:
    """An export of a take's scenes.

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
"""All exports by name."""


def left_out(export: Export, parts: Mapping[str, int]) -> dict[str, int]:
    """Return the parts that an export does not carry.

    Args:
        export: the export.
        parts: number of parts of each type in a take, by the type's name.

    Returns:
        The number of parts left out, by the type's name.
    """
    return {} if export.parts is None else {name: n for name, n in parts.items() if name not in export.parts}


def exports_of(parts: Collection[str]) -> tuple[str, ...]:
    """Return the names of the exports that carry any of these part types, for example those of a method."""
    return tuple(each.name for each in EXPORTS.values() if each.parts is None or not set(parts).isdisjoint(each.parts))
