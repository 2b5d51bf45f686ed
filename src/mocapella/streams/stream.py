"""The descriptor of a stream, a subcommand of ``mocapella stream``, and the table of all streams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from mocapella.model.scene import Scene
from mocapella.registry import Table


class Encoder(Protocol):
    """Encodes scenes as datagrams; it may remember earlier scenes of the same run."""

    def datagrams(self, scene: Scene) -> Sequence[bytes]:
        """Return the datagrams of a scene, in the order in which they are sent; none if it has nothing to send."""


class MakeEncoder(Protocol):
    """Makes the encoder of one run of a stream."""

    def __call__(self, individuals: tuple[str, ...]) -> Encoder:
        """Return an encoder.

        Args:
            individuals: names of the individuals to send, such as ``person_0``; empty for all.
        """


@dataclass(frozen=True)
class Stream:
    """Descriptor of a stream, which a package registers as an entry point of ``mocapella.streams``.

    Attributes:
        interface: version of the plug-in interface, see `mocapella.registry`.
        name: name of the subcommand of ``mocapella stream``.
        summary: description of the datagrams, in one line.
        parts: names of the types of scene parts that it sends.
        port: UDP port on which receivers of such datagrams usually listen.
        make: ``module:function`` that returns its encoder, a `MakeEncoder`. The module is imported when the subcommand
            runs.
        command: ``module:function`` of the typer command that sends; the usual one has all options.
    """

    interface: int
    name: str
    summary: str
    parts: tuple[str, ...]
    port: int
    make: str
    command: str = "mocapella.cli.stream:stream"


STREAMS: Final = Table("mocapella.streams", Stream, "stream")
"""All registered streams by name."""
