"""Spooling of a node: moves the frames that a take needs from memory to the disk while the server does not store them.

A kill of the node then costs at most the frames of the last seconds, and an outage of hours does not fill the memory.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, Protocol

from mocapella.errors import RecordingError
from mocapella.supervision import Boundary
from mocapella.wire.outbox import Hold, Outbox, Store

SPILL_AFTER_S: Final = 2.0
"""Frames that wait longer for an acknowledgement are moved to the disk [s]."""
NEGLECTED_S: Final = 60.0
"""A take counts as closed if a connected server has not asked about it for this long [s]; servers ask every second."""
_EVERY_S: Final = 0.5


class Spool(Store, Protocol):
    """A node's directory on the disk for frames that the server has not stored."""

    def keep(self, take: str, frames: Iterable[tuple[int, bytes]], numbers: range) -> Path:
        """Write frames that a take lacks into a file that can be merged into it; return its path.

        ``frames`` yields number and bytes of the available ones, ``numbers`` has all that the take lacks.

        Raises:
            RecordingError: the disk is full or failed.
        """
        ...

    def close(self) -> None:
        """Remove the files of `write`; files of `keep` stay."""
        ...


class Spooler:
    """A thread that spills an `Outbox`: moves frames that wait too long to the disk, from `begin` to `close`.

    Args:
        outbox: the node's frames.
        spool: the place on the disk; None if there is none.
        say: receives a message when frames are lost, or are kept in a file.
        server_since_ns: returns the time since which a server is connected, on the node's monotonic clock; None
            without one.

    Attributes:
        kept: paths of files with frames that takes lack, to be merged into them.
    """

    def __init__(
        self,
        outbox: Outbox,
        spool: Spool | None,
        say: Callable[[str], None],
        server_since_ns: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._outbox, self._spool, self._say = outbox, spool, say
        self._server_since_ns = server_since_ns
        self.kept: list[str] = []
        self._errors = Boundary(say)
        self._missing: dict[tuple[str, int], int] = {}
        self._told: set[str] = set()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._dropped = 0

    @property
    def missing(self) -> int:
        """Number of frames that no server has stored, of takes whose claim was given up: in ``kept`` files, or lost.

        A claim is given up when its take is closed, when its server has not asked for `NEGLECTED_S`, and in `close`.
        """
        return sum(self._missing.values())

    def begin(self) -> None:
        """Start the thread if a take claims frames and it does not run yet."""
        if self._thread is None and self._outbox.holds and not self._stop.is_set():
            self._thread = threading.Thread(target=self._run, name="spool", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """End the thread, and write all frames that takes lack into files; afterwards `missing` counts them."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        for take, hold in self._outbox.holds.items():
            self._keep(take, hold)
        if self._spool is not None and not self._outbox.spilled:
            self._spool.close()

    def update(self, now_ns: int) -> None:
        """Spill once if frames wait longer than `SPILL_AFTER_S`; without space, drop the oldest until it succeeds.

        Frames that a closed take lacks are written into a file for merging. So are those of a take that a connected
        server has not asked about for `NEGLECTED_S`: the node may have missed its end, and they would fill the disk.
        """
        outbox, since_ns = self._outbox, self._server_since_ns()
        for take, hold in outbox.holds.items():
            quiet_ns = 0 if since_ns is None else now_ns - max(since_ns, hold.heard_ns)
            if hold.closed or quiet_ns > NEGLECTED_S * 1e9:
                self._keep(take, hold)
        if outbox.waiting_ns(now_ns) > SPILL_AFTER_S * 1e9:
            while not outbox.spill() and outbox.crowded and outbox.spilled:
                outbox.drop_oldest()
        if outbox.dropped > self._dropped:
            self._say(f"{outbox.dropped - self._dropped} frames of an open take are lost: memory and disk are full")
            self._dropped = outbox.dropped

    def _keep(self, take: str, hold: Hold) -> None:
        numbers = hold.numbers(self._outbox.next)
        if numbers and self._spool is not None:
            try:
                path = self._spool.keep(take, self._outbox.frames(numbers), numbers)
            except RecordingError as error:
                if take not in self._told:
                    self._told.add(take)
                    self._say(f"{len(numbers)} frames that a take lacks cannot be kept: {error}")
                if self._stop.is_set():
                    self._missing[take, numbers.start] = len(numbers)
                return  # parts that were spilled before stay
            self.kept.append(str(path))
            self._say(f"{len(numbers)} frames that a take lacks are kept in {path}")
        self._missing[take, numbers.start] = len(numbers)
        self._outbox.release(take)

    def _run(self) -> None:
        while not self._stop.wait(_EVERY_S):
            self._errors.run("spool", lambda: self.update(time.monotonic_ns()))
