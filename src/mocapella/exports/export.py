"""The descriptor of an export, a subcommand of ``mocapella export``, and the table of all exports."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from mocapella.registry import Table


@dataclass(frozen=True)
class Export:
    """Descriptor of an export of a take's scenes to a file.

    Attributes:
        interface: version of the plug-in interface, see `mocapella.registry`.
        name: name of the subcommand of ``mocapella export``.
        summary: description of the output, in one line.
        parts: names of the types of scene parts that the file contains; None for all types.
        command: ``module:function`` of the typer command that writes the file; its argument ``take`` is the take's
            path, or ``takes`` several. The module is imported when the subcommand runs.
        write: ``module:function`` that writes trajectories to a path, ``write(trajectories, path)``, and may return
            sentences for the user; for `TRAJECTORIES` as the command, which has all options and names the files.
        suffix: ending of such a file, such as ``.trc``.
        alone: whether such a file has one individual only.
        constant_rate: whether such a file has a constant frame rate.
        space: the coordinates that such a file has by default, world or opensim.
        with_labels: whether such a file has the labels of each run; for others, the command says when they change.
        humanoids: whether ``write`` also takes ``humanoid=``, a name of `mocapella.model.humanoid_bones` or None.
    """

    interface: int
    name: str
    summary: str
    parts: tuple[str, ...] | None
    command: str
    write: str = ""
    suffix: str = ""
    alone: bool = False
    constant_rate: bool = False
    space: str = "world"
    with_labels: bool = False
    humanoids: bool = False


TRAJECTORIES: Final = "mocapella.cli.export_trajectories:export"
"""The command of exports that only write trajectories."""
EXPORTS: Final = Table("mocapella.exports", Export, "export")
"""All registered exports by name."""


def left_out(export: Export, parts: Mapping[str, int]) -> dict[str, int]:
    """Return the parts of a take that an export will not write, so that the user can be told.

    Args:
        export: the export.
        parts: number of scene parts in the take, by the name of their type, such as people or arms.

    Returns:
        The entries of ``parts`` whose type the export does not contain; empty if it contains all types.
    """
    return {} if export.parts is None else {name: n for name, n in parts.items() if name not in export.parts}


def exports_of(parts: Collection[str]) -> tuple[str, ...]:
    """Return the names of the registered exports that contain at least one of the types of scene parts.

    Args:
        parts: names of part types, such as a method's types. Exports of all types are always returned.
    """
    return tuple(each.name for each in EXPORTS.values() if each.parts is None or not set(parts).isdisjoint(each.parts))
