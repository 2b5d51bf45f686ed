"""`mocapella node heat`: a simulated heat camera; a real one would read its device here."""

import math
import time
from collections.abc import Iterator
from itertools import count
from typing import Annotated

import typer

from mocapella.cli.common import DEFAULT_ADDRESS, Connect, JsonOut
from mocapella.cli.nodes import serve_frames
from mocapella.live.node import DueFrame
from mocapella.sources.source import Source
from mocapella_thermal.frame import HeatFrame

RATE_HZ, SEES_M = 20, 2.0


def heat(
    name: Annotated[str, typer.Option(metavar="SENSOR", help="The camera's name.")] = "heat",
    x: Annotated[float, typer.Option(metavar="METRES", help="Position.")] = 0.0,
    connect: Connect = DEFAULT_ADDRESS,
    json: JsonOut = None,
) -> None:
    """Serve a simulated heat camera that sees two hot spots.

    Example:  mocapella node heat --name north --x -0.5
    """
    serve_frames(lambda: frames(name, x), name, connect, epoch=0.0, json=json, wait=False)


def frames(name: str, x: float) -> Iterator[DueFrame]:
    """Yield frames from now on; two spots circle the middle of the room."""
    for k in count(math.ceil(time.time() * RATE_HZ)):
        t = k / RATE_HZ
        world = [(math.cos(t), math.sin(t), 36.5), (-math.cos(t), -math.sin(t), 60.0)]
        seen = tuple((X - x, z, celsius) for X, z, celsius in world if math.hypot(X - x, z) < SEES_M)
        yield DueFrame(t, HeatFrame(name, 0, 0, round(1e9 * t), 0, seen))


HEAT = Source(
    interface=1,
    name="heat",
    summary="A simulated heat camera.",
    frame_types=("heat",),
    command="mocapella_thermal.source:heat",
)
