"""Compile a method's kernels before the first frame."""

from __future__ import annotations

from typing import Final

from mocapella.tracker.method import METHODS

_READY: Final[set[str]] = set()


def warm_up(method: str) -> None:
    """Compile a method's kernels, the first time on a machine; load compiled ones, the first time in a process.

    A tracker that is given its first frames would compile in the middle of them, while others come in.

    Args:
        method: key of `METHODS`.
    """
    warm_up_run = METHODS[method].warm_up_run if method in METHODS else None
    if warm_up_run is None or method in _READY:
        return
    tracker, arrivals = warm_up_run()
    for arrival in arrivals:
        tracker.update(arrival)
    tracker.restore(tracker.snapshot())
    _READY.add(method)


def is_compiled(method: str) -> bool:
    """Load a method's kernels if all of them are on disk.

    Returns:
        Whether `warm_up` has nothing left to compile.
    """
    from mocapella.compiled import NotCompiledError, only_compiled  # numba, which a view need not import

    try:
        with only_compiled():
            warm_up(method)
    except NotCompiledError:
        return False
    return True
