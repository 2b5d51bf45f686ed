"""Functions for commands of ``mocapella node``, also of plug-ins: the epoch, and serving frames on time."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Final

import typer

from mocapella.cli.command_settings import KeySpec
from mocapella.cli.common import say, write_json

if TYPE_CHECKING:
    from mocapella.live.node import DueFrame

REPORT: Final = KeySpec("Interval between status lines; 0: problems only.", "s", least=0)
LOOP: Final = KeySpec("Restart a recording when it ends.")
LINGER: Final = KeySpec("Stay this long after the last frame, so that a take gets frames it missed.", "s", least=0)
DROP_AFTER_MS: Final = KeySpec("Drop results older than this after their image was captured.", "ms", least=1)
DELAY_MS: Final = KeySpec("Time from an image's exposure to its arrival, of network cameras.", "ms", least=0)
READY: Final = "ready"
"""Printed by a node when it waits for its epoch on standard input."""
Epoch = Annotated[
    float | None,
    typer.Option(
        "--epoch", metavar="TIME", help="Unix time of the source's time 0 [s]; nodes with one epoch are synchronous."
    ),
]
EpochFromInput = Annotated[
    bool, typer.Option("--epoch-from-input", hidden=True, help="Say `ready`, and read the epoch from standard input.")
]
NAME_HELP: Final = "Name of the sensor."
SENSOR_HELP: Final = "Sensor of the scene or recording: its name, or in a scene its number from 1."
SensorName = Annotated[str | None, typer.Option("--name", metavar="SENSOR", help=NAME_HELP)]
Listen = Annotated[
    str, typer.Option("--listen", metavar="HOST:PORT", help="Address to listen on; 127.0.0.1 is this machine only.")
]


def read_epoch() -> float:
    """Report on standard output that the source is ready, and read its epoch (Unix time of its time 0) [s] from
    standard
    input."""
    typer.echo(READY)
    line = sys.stdin.readline()
    if not line:  # who started it is gone
        raise typer.Exit(1)
    return float(line)


def serve_frames(
    frames: Callable[[], Iterable[DueFrame]],
    sensor: str,
    connect: str,
    epoch: float | None,
    json: str | None,
    *,
    wait: bool,
    linger_s: float = 0.0,
    history_frames: int | None = None,
) -> None:
    """Serve a sensor's frames, each at its due time, until they end or Ctrl-C; report the result at the end.

    Args:
        frames: function that returns them in the order of their times; called when the run begins.
        sensor: its name.
        connect: address of the server.
        epoch: Unix time [s] of the frames' time 0; None: the beginning of the run.
        json: target of the summary, as for ``--json``.
        wait: whether the run begins only once a server is running.
        linger_s: time to keep running after the last frame, so that a take can fetch missed frames [s].
        history_frames: number of frames that are stored for a server that missed them.

    Raises:
        NameTakenError: another node serves a sensor of this name.
        NoServerError: no server was found during the whole run.
    """
    from mocapella.live.node import run_node
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.frame_types import HISTORY_FRAMES
    from mocapella.wire.node import NodeLink

    kept = HISTORY_FRAMES if history_frames is None else history_frames
    with stop_on_signals() as stop, NodeLink(connect, sensor, history_frames=kept) as link:
        summary = run_node(link, frames, epoch=epoch, stop=stop, wait=wait, say=say, linger_s=linger_s)
        if summary.served:
            say(f"{sensor}: {summary.published} frames published, {summary.late} of them late")
        else:
            say(f"{sensor}: no server was at {link.address}; it received none of {summary.published} frames")
        write_json(json, asdict(summary))
