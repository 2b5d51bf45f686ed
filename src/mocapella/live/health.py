"""Health of the server itself: errors, limits reached, latency, disk space, and parts that have ended."""

from __future__ import annotations

import errno
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from mocapella.model.session import Descriptors, ServerHealth

_DISK_EVERY_S: Final = 5.0
"""Interval between two looks at the free disk space [s]."""


def free_bytes(folder: Path) -> int | None:
    """Return the free space of a folder's disk [bytes], also of a folder that does not exist yet; None if unknown."""
    there = next((path for path in (folder.absolute(), *folder.absolute().parents) if path.is_dir()), None)
    try:
        return None if there is None else shutil.disk_usage(there).free
    except OSError:
        return None


def open_descriptors() -> Descriptors | None:
    """Return the numbers of open and of allowed file descriptors of this process; None if the system reports none."""
    try:
        import resource  # not on Windows

        limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        used = sum(1 for _ in Path("/dev/fd").iterdir()) - 1  # one is that of the listing
    except OSError as error:
        return Descriptors(limit, limit) if error.errno == errno.EMFILE else None
    except ImportError:
        return None
    return Descriptors(used, limit)


class HealthWatch:
    """Collects the state of the server for its status. Only `beat` accesses the disk, which may be slow.

    Args:
        takes: folder of the takes.
        reserve_bytes: free disk space that a recording leaves.
        log: file of the structured log; empty if there is none.
        clock: the monotonic clock, in seconds.
    """

    def __init__(
        self, takes: Path, reserve_bytes: int, log: str, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._takes, self._reserve_bytes, self._log, self._clock = takes, reserve_bytes, log, clock
        self._free: int | None = None
        self._looked_s = -_DISK_EVERY_S
        self._ended: tuple[str, ...] = ()
        self._descriptors: Descriptors | None = None

    def beat(self, take: str) -> None:
        """Count the file descriptors, and measure the free disk space if it is due, every 5 s.

        Args:
            take: path of the present or last take, whose disk is measured; empty measures that of the takes' folder.
        """
        self._descriptors = open_descriptors()
        if self._clock() - self._looked_s >= _DISK_EVERY_S:
            self._looked_s = self._clock()
            self._free = free_bytes(Path(take).parent if take else self._takes)

    def ended(self, part: str) -> None:
        """Note that a part of the session, such as ``view``, has ended by itself; from now on `health` lists it."""
        if part not in self._ended:
            self._ended = (*self._ended, part)

    def full(self) -> str:
        """Return why no new sensor can be admitted; an empty text if one can."""
        files = self._descriptors
        if files is None or not files.scarce:
            return ""
        return f"the server has {files.used} of {files.limit} file descriptors in use; raise its limit (ulimit -n)"

    def health(
        self, errors: Mapping[str, int], turned_away: Mapping[str, int], latency_ms: Mapping[str, float]
    ) -> ServerHealth:
        """Return the present state.

        Args:
            errors: number of unexpected errors, by reason.
            turned_away: number of refused messages and the like, by type; zero counts are left out.
            latency_ms: percentiles of the latency, by name [ms].
        """
        return ServerHealth(
            errors=dict(errors),
            turned_away={what: count for what, count in turned_away.items() if count},
            latency_ms=dict(latency_ms),
            disk_free_bytes=self._free,
            reserve_bytes=self._reserve_bytes,
            ended=self._ended,
            log=self._log,
            descriptors=self._descriptors,
        )
