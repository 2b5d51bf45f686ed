"""Measures and prints figures, in the same way for every group.

The machine's speed drifts by some ten per cent, so our code and the peer's are timed in turns within one run, and
medians over the repetitions are compared.
"""

from __future__ import annotations

import gc
import math
import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

UNITS_PER_SECOND: Final = {"s": 1.0, "ms": 1e3, "µs": 1e6, "ns": 1e9}


@dataclass(frozen=True)
class Goal:
    """What a value, or its ratio to the peer, is to reach.

    Attributes:
        limit: in the row's unit, or times the peer.
        at_most: whether the limit is from above.
        of_ratio: whether it is the ratio that is compared.
    """

    limit: float
    at_most: bool
    of_ratio: bool = False

    def met_by(self, value: float, ratio: float | None) -> bool:
        compared = ratio if self.of_ratio else value
        if compared is None or not math.isfinite(compared):
            return False
        return compared <= self.limit if self.at_most else compared >= self.limit

    def text(self, unit: str) -> str:
        sign = "≤" if self.at_most else "≥"
        return f"{sign} {self.limit:g} {'× the peer' if self.of_ratio else unit}".rstrip()


def at_most(limit: float) -> Goal:
    """The value stays at or under ``limit``, in the row's unit."""
    return Goal(limit, at_most=True)


def at_least(limit: float) -> Goal:
    """The value reaches ``limit``, in the row's unit."""
    return Goal(limit, at_most=False)


def times_the_peer(limit: float) -> Goal:
    """Ours is at least ``limit`` times as fast as the peer."""
    return Goal(limit, at_most=False, of_ratio=True)


@dataclass(frozen=True)
class Row:
    """One figure; its fields are the fields of the JSON rows.

    Attributes:
        name: group and measured operation, such as ``codec: encode``.
        value: in ``unit``.
        peer: the compared program and its value in the same run; without one, a note that there is none, and
            the machine.
        ratio: the peer's value divided by ours, above 1 where ours is faster; None without a peer.
        goal: such as ``≤ 5 µs``; None where there is none.
        met: None where there is no goal.
    """

    name: str
    value: float
    unit: str
    peer: str
    ratio: float | None
    goal: str | None
    met: bool | None


def measured(name: str, value: float, unit: str, *, goal: Goal | None = None) -> Row:
    """A figure without a peer."""
    met = None if goal is None else goal.met_by(value, None)
    return Row(name, value, unit, f"none ({machine()})", None, goal.text(unit) if goal else None, met)


def compared(name: str, value: float, unit: str, *, peer: str, peer_value: float, goal: Goal | None = None) -> Row:
    """A figure beside that of a peer measured in the same run; of both, less is better."""
    ratio = peer_value / value
    met = None if goal is None else goal.met_by(value, ratio)
    said = f"{peer} {peer_value:.3g} {unit}"
    return Row(name, value, unit, said, ratio, goal.text(unit) if goal else None, met)


def median_seconds(fn: Callable[[], Any], repeat: int = 7, number: int = 1000) -> float:
    """Seconds a call: the median over ``repeat`` of the mean over ``number`` calls."""
    return statistics.median(_seconds(fn, number) for _ in range(repeat))


def against_peer(
    name: str,
    ours: Callable[[], Any],
    peer: Callable[[], Any],
    peer_name: str,
    *,
    goal: Goal | None = None,
    unit: str = "µs",
    repeat: int = 7,
    number: int = 1000,
    peer_number: int | None = None,
) -> Row:
    """Time a call of ours and one of the peer's, in turns, and compare their medians.

    Args:
        name, goal, unit: of the row; the unit is one of `UNITS_PER_SECOND`.
        ours, peer: the functions to call, without arguments; both do the same work.
        peer_name: what the peer is called.
        repeat: how many turns.
        number: calls a turn.
        peer_number: calls a turn of the peer, where it is much slower; ``number`` where not given.
    """
    turns = [(_seconds(ours, number), _seconds(peer, peer_number or number)) for _ in range(repeat)]
    scale = UNITS_PER_SECOND[unit]
    value, peer_value = (scale * statistics.median(column) for column in zip(*turns, strict=True))
    return compared(name, value, unit, peer=peer_name, peer_value=peer_value, goal=goal)


def wait_until(what: str, holds: Callable[[], bool], patience_s: float, every_s: float = 0.05) -> None:
    """Wait until a condition holds, and look again and again.

    Raises:
        TimeoutError: it does not within ``patience_s``; the text has ``what``.
    """
    until_s = time.monotonic() + patience_s
    while not holds():
        if time.monotonic() > until_s:
            raise TimeoutError(f"waited {patience_s:g} s in vain: {what}")
        time.sleep(every_s)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def machine() -> str:
    """The processor, how many cores this process may use, and the Python."""
    return f"{_processor()}, {cores()} cores, {platform.python_implementation()} {platform.python_version()}"


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _seconds(fn: Callable[[], Any], number: int) -> float:
    """The mean of ``number`` calls, with the garbage collector out of the way, as `timeit` does."""
    fn()
    collecting = gc.isenabled()
    gc.disable()
    try:
        begin = time.perf_counter()
        for _ in range(number):
            fn()
        return (time.perf_counter() - begin) / number
    finally:
        if collecting:
            gc.enable()
