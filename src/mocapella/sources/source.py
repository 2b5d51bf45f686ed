"""The descriptor of a source of frames: one verb of ``mocapella node``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from mocapella.registry import Table


@dataclass(frozen=True)
class Finding:
    """One line of the report of `mocapella doctor`, which checks the installation.

    Attributes:
        what: the subject, such as a device or package.
        verdict: ``ok``, ``note`` or ``problem``.
        found: the finding, in words.
        advice: the remedy; may be empty.
    """

    what: str
    verdict: Literal["ok", "note", "problem"]
    found: str
    advice: str = ""


@dataclass(frozen=True)
class Source:
    """The descriptor of a source of frames, which a package registers as an entry point of ``mocapella.sources``.

    Attributes:
        interface: version of the descriptor's interface, see `mocapella.registry`.
        name: the verb after ``mocapella node``.
        summary: purpose of the source, in one line.
        frame_types: names of the frame types that it sends; empty for all that are installed.
        command: ``module:function`` of its typer command. The module is imported when the verb runs.
        looks: ``module:function`` that returns `Finding` values for `mocapella doctor`, such as which devices are
            connected; may be empty.
    """

    interface: int
    name: str
    summary: str
    frame_types: tuple[str, ...]
    command: str
    looks: str = ""


SOURCES: Final = Table("mocapella.sources", Source, "source")
"""The installed sources by name."""
