"""Cost of reading marker datagrams, and the effect of a sender that sends a thousand times too many.

Two cameras at 60 Hz; the left one's port is flooded by another process, as fast as it can: from an address of its own
while the port belongs to the camera, or first, so that the port belongs to the flood.
"""

from __future__ import annotations

import multiprocessing
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from benchmarks.harness import Row, at_least, at_most, measured, median_seconds
from mocapella.schema.marker_datagrams import decode_marker_datagram
from mocapella.sources.datagram_settings import DatagramSettings
from mocapella.sources.marker_datagrams import MarkerDatagrams

HZ: Final = 60
MARKERS: Final = ("red", "yellow", "green", "blue", "magenta", "cyan")
DATAGRAM: Final = b"123.25,234.50;133.25,234.50;143.25,234.50;153.25,234.50;163.25,234.50;,"
MOST_LOAD: Final = 0.25
"""Of a core, under a flood."""


def run(quick: bool = False) -> list[Row]:
    seconds = 1.0 if quick else 6.0
    number = 500 if quick else 5000
    decode = 1e6 * median_seconds(lambda: decode_marker_datagram(DATAGRAM, MARKERS, (640, 480)), number=number)
    rows = [measured("datagrams: decode one of six markers", decode, "µs", goal=at_most(100))]
    for case in ("nobody else", "a stranger floods", "the sender floods"):
        load, left, right, rate = watched(case, seconds)
        name = f"datagrams: {case}"
        if rate:
            rows.append(measured(f"{name}, times the camera's rate", rate / HZ, "", goal=at_least(1000)))
        rows.append(measured(f"{name}, of a core", 100 * load, "%", goal=at_most(100 * MOST_LOAD)))
        if case != "the sender floods":
            rows.append(measured(f"{name}, frames of its camera", 100 * left, "%", goal=at_least(98)))
        rows.append(measured(f"{name}, frames of the other camera", 100 * right, "%", goal=at_least(98)))
    return rows


def watched(case: str, seconds: float) -> tuple[float, float, float, float]:
    """Load of the reading thread, the parts of both cameras' frames that came, and datagrams a second of the flood."""
    settings = DatagramSettings((("left", 0), ("right", 0)), MARKERS)
    with MarkerDatagrams(settings) as source:
        ports = [address[1] for address in source.addresses.values()]
        if case == "the sender floods":
            with flood(ports[0]) as flooded:
                while not source.report["left"].frames:
                    source.poll(0.1)
                return *_polled(source, ports[1:], seconds), _rate(flooded, seconds)
        with cameras(ports) as sent:
            while not all(report.frames for report in source.report.values()):
                source.poll(0.1)
            if case == "nobody else":
                return *_shares(source, sent, seconds), 0.0
            with flood(ports[0]) as flooded:
                while not source.report["left"].other_senders:
                    source.poll(0.1)
                return *_shares(source, sent, seconds), _rate(flooded, seconds)


def _polled(source: MarkerDatagrams, ports: list[int], seconds: float) -> tuple[float, float, float]:
    with cameras(ports) as sent:
        load, _, right = _shares(source, [[0], sent[0]], seconds)
    return load, 0.0, right


def _shares(source: MarkerDatagrams, sent: list[list[int]], seconds: float) -> tuple[float, float, float]:
    before = [(report.frames, count[0]) for report, count in zip(source.report.values(), sent, strict=True)]
    busy, end = time.thread_time(), time.monotonic() + seconds
    while time.monotonic() < end:
        source.poll(0.1)
    load = (time.thread_time() - busy) / seconds
    after = [(report.frames, count[0]) for report, count in zip(source.report.values(), sent, strict=True)]
    left, right = ((f - f0) / max(1, n - n0) for (f0, n0), (f, n) in zip(before, after, strict=True))
    return load, left, right


def _rate(flooded: Any, seconds: float) -> float:
    before = flooded.value
    time.sleep(min(seconds, 1.0))
    return float((flooded.value - before) / min(seconds, 1.0))


@contextmanager
def cameras(ports: list[int]) -> Iterator[list[list[int]]]:
    """One sender at 60 Hz for each port; how many each has sent."""
    over, sent = threading.Event(), [[0] for _ in ports]

    def send() -> None:
        sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in ports]
        while not over.wait(1.0 / HZ):
            for one, port, count in zip(sockets, ports, sent, strict=True):
                one.sendto(DATAGRAM, ("127.0.0.1", port))
                count[0] += 1
        for one in sockets:
            one.close()

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield sent
    finally:
        over.set()
        thread.join()


@contextmanager
def flood(port: int) -> Iterator[Any]:
    """A process that sends to the port; how many it has sent so far."""
    spawn = multiprocessing.get_context("spawn")
    over, sent = spawn.Event(), spawn.Value("q", 0, lock=False)
    process = spawn.Process(target=_flood, args=(port, over, sent))
    process.start()
    try:
        yield sent
    finally:
        over.set()
        process.join()


def _flood(port: int, over: Any, sent: Any) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        while not over.is_set():
            for _ in range(1000):
                one.sendto(DATAGRAM, ("127.0.0.1", port))
            sent.value += 1000
