"""The live view with six people and six sensors: what a picture costs, and how many a second a browser is sent.

The browser is Debian's chromium, which draws in software here and shares the machine with everything else.
"""

from __future__ import annotations

import itertools
import statistics
import threading
import time
from collections.abc import Iterator
from typing import Any

import msgspec

from benchmarks._browser import open_page
from benchmarks._live_load import standing_people
from benchmarks.harness import Row, at_least, measured
from mocapella.live.launch import free_port
from mocapella.live.session import Session
from mocapella.live.view import RATE_HZ, beats
from mocapella.model.observations import Arrival, BodyFrame
from mocapella.model.scene import Scene
from mocapella.model.session import CommandReply, Setup
from mocapella.viewer import Viewer

SENSORS = 6
PEOPLE = 6
PERIOD_NS = 33_333_333


def run(quick: bool = False) -> list[Row]:
    seconds = 5.0 if quick else 20.0
    pictures = _pictures()
    viewer = Viewer("127.0.0.1", free_port(), command=lambda verb, arguments: CommandReply(True))
    label = f"view: {PEOPLE} people × {SENSORS} sensors,"
    try:
        cost, _ = _show(viewer, pictures, seconds)
        rows = [measured(f"{label} no browser: a picture", cost * 1e3, "ms")]
        with open_page() as page:
            if page is not None:
                page.goto(viewer.url)
                _show(viewer, pictures, 5.0)
                cost, rate = _show(viewer, pictures, seconds)
                rows.append(measured(f"{label} one browser: a picture, CPU", cost * 1e3, "ms"))
                rows.append(measured(f"{label} one browser: pictures sent", rate, "Hz", goal=at_least(29.5)))
    finally:
        viewer.close()
    return rows


def _pictures() -> Iterator[tuple[Scene, dict[str, BodyFrame]]]:
    """Scenes of a tracker that is tracking, for ever."""
    session = Session(Setup(sensors_expected=SENSORS))
    names = [f"s{k}" for k in range(SENSORS)]
    streams = [itertools.cycle(standing_people(name, PEOPLE, seed)) for seed, name in enumerate(names)]
    made = []
    for k in range(160):
        frames: dict[str, BodyFrame] = {}
        scene: Scene | None = None
        for name, stream in zip(names, streams, strict=True):
            frames[name] = msgspec.structs.replace(next(stream), time_ns=k * PERIOD_NS, sequence=k)
            scene = session.step(Arrival(frames[name], k * PERIOD_NS))
        if scene is not None and scene.people:
            made.append((scene, frames))
    return itertools.cycle(made)


def _show(viewer: Viewer, pictures: Iterator[Any], seconds: float) -> tuple[float, float]:
    """Median CPU seconds of a picture, and pictures a second, as the view's own loop shows them."""
    costs, stop, began = [], threading.Event(), time.monotonic()
    for now in beats(RATE_HZ, stop):
        cpu = time.process_time()
        viewer.show(*next(pictures), None)
        costs.append(time.process_time() - cpu)
        if now - began >= seconds:
            stop.set()
    return statistics.median(costs), len(costs) / (time.monotonic() - began)
