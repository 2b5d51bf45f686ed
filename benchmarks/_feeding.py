"""Feed damaged inputs to one reader, within limits of memory and of processor time.

The limits do not depend on what else the machine does: the kernel refuses memory beyond the limit (``RLIMIT_DATA``),
and time is this process's time on the processor.
"""

from __future__ import annotations

import faulthandler
import os
import random
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Iterator, MutableSequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final

from benchmarks._doors import Door
from mocapella.errors import MocapellaError

SEED: Final = 23
MOST_BYTES: Final = 256 << 20
MOST_SECONDS: Final = 5.0
HANGS_S: Final = 600.0
"""A process in which no Python has run for so long is ended: it hangs, and not only waits for a processor [s]."""
_TICK_S: Final = 1.0
_NO_MEMORY: Final = -4
"""OpenCV's code of an allocation that failed, ``StsNoMem``."""


class TooSlowError(BaseException):
    """An input took more than `MOST_SECONDS`; no reader catches it."""


@dataclass
class Report:
    """Results of one door.

    Attributes:
        inputs: number of damaged inputs.
        refused: of these, with an error of ours.
        escaped: number of other errors by type and place, with the first input of each.
        starved: number of inputs that asked for more memory than `MOST_BYTES`, also if the reader caught the error.
        seconds: processor time in the reader.
        whole_s: processor time with the making of the inputs.
        slowest_s: processor time of one input.
    """

    name: str
    inputs: int = 0
    refused: int = 0
    escaped: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    starved: int = 0
    seconds: float = 0.0
    whole_s: float = 0.0
    slowest_s: float = 0.0

    @property
    def escapes(self) -> int:
        """Number of errors that are not ours."""
        return sum(count for count, _ in self.escaped.values())

    def add(self, other: Report) -> None:
        """Add the results of more inputs of the same door."""
        self.inputs, self.refused = self.inputs + other.inputs, self.refused + other.refused
        self.starved, self.seconds = self.starved + other.starved, self.seconds + other.seconds
        self.whole_s, self.slowest_s = self.whole_s + other.whole_s, max(self.slowest_s, other.slowest_s)
        for place, (count, data) in other.escaped.items():
            self.note(place, data, count)

    def note(self, place: str, data: bytes, count: int = 1) -> None:
        """Count an error that escaped."""
        before, first = self.escaped.get(place, (0, data))
        self.escaped[place] = (before + count, first)


class Watch:
    """Ends inputs that do not end; as a context it takes the signal ``SIGPROF``.

    An input that has used `MOST_SECONDS` raises `TooSlowError` where it is. If a library does not return to Python for
    `HANGS_S`, the process prints where it is and ends.

    Attributes:
        since_s: processor time at which the present input began [s].
    """

    def __init__(self, tick_s: float = _TICK_S, most_s: float = MOST_SECONDS) -> None:
        self._tick_s, self._most_s, self.since_s = tick_s, most_s, float("inf")

    def __enter__(self) -> Watch:
        faulthandler.dump_traceback_later(HANGS_S, exit=True)
        self._before = signal.signal(signal.SIGPROF, self._tick)
        signal.setitimer(signal.ITIMER_PROF, self._tick_s, self._tick_s)
        return self

    def __exit__(self, *_: object) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, self._before)
        faulthandler.cancel_dump_traceback_later()

    def _tick(self, *_: object) -> None:
        faulthandler.dump_traceback_later(HANGS_S, exit=True)
        if time.process_time() - self.since_s > self._most_s:
            self.since_s = float("inf")
            raise TooSlowError


def feed(
    door: Door, count: int, seed: object = SEED, *, watch: Watch | None = None, now: MutableSequence[int] | None = None
) -> Report:
    """Read damaged inputs, and count what happens.

    Args:
        door: the reader.
        count: number of inputs.
        seed: the same one gives the same inputs.
        watch: learns when each input begins.
        now: its first element is set to the number of inputs begun.
    """
    report, watch, now = Report(door.name), watch or Watch(), [0] if now is None else now
    started = time.process_time()
    with warnings.catch_warnings(), limited(MOST_BYTES):
        warnings.simplefilter("ignore")
        for number, (read, data) in enumerate(islice(door.inputs(random.Random(f"{seed}/{door.name}")), count)):
            now[0], watch.since_s = number + 1, time.process_time()
            begin = watch.since_s
            try:
                read()
            except KeyboardInterrupt:
                raise
            except BaseException as error:  # noqa: BLE001  counted; a panic in Rust is no Exception
                _count(report, error, data)
            finally:
                watch.since_s = float("inf")
            took = time.process_time() - begin
            report.seconds, report.slowest_s = report.seconds + took, max(report.slowest_s, took)
            report.inputs += 1
    report.whole_s = time.process_time() - started
    return report


def _count(report: Report, error: BaseException, data: bytes) -> None:
    report.starved += _starved(error)
    if not isinstance(error, MocapellaError):
        report.note(_place(error), data)
        return
    report.refused += 1
    if "\n" in str(error):
        report.note(f"{type(error).__name__} of several lines", data)


def _starved(error: BaseException | None) -> bool:
    """Return whether an error, or one that it replaced, is of memory that was refused."""
    while error is not None:
        if isinstance(error, MemoryError) or getattr(error, "code", None) == _NO_MEMORY:
            return True
        error = error.__cause__ or error.__context__
    return False


def _place(error: BaseException) -> str:
    """Return the error's type and the last place of ours that it came through."""
    ours = [frame for frame in traceback.extract_tb(error.__traceback__) if f"mocapella{os.sep}" in frame.filename]
    where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
    return f"{type(error).__name__} at {where} ({str(error)[:80]})"


@contextmanager
def limited(most_bytes: int) -> Iterator[None]:
    """Let this process have at most so much more memory; beyond it, allocations fail. Does nothing but on Linux."""
    if sys.platform != "linux":
        yield
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (_data_bytes() + most_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _data_bytes() -> int:
    """Return the size of what this process has mapped for data, which is what ``RLIMIT_DATA`` limits."""
    found: Any = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmData"))
    return int(found.split()[1]) << 10
