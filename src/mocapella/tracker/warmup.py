"""Compile a method's kernels before the first frame.

Numba compiles a kernel at its first call, which takes seconds; a warm-up run calls them with synthetic frames.
"""

from __future__ import annotations

from typing import Final

from mocapella.tracker.method import METHODS

_READY: Final[set[str]] = set()


def warm_up(method: str) -> None:
    """Compile a method's kernels, the first time on a machine; load compiled ones, the first time in a process.

    Otherwise a tracker would compile during its first frames, while others come in. A method without kernels, an
    unknown one, and the second call in a process do nothing.

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
    """Load a method's compiled kernels from the cache on disk, but compile none.

    Returns:
        Whether all of them were compiled on disk (or there are none), so that `warm_up` has nothing left to do.
    """
    from mocapella.compiled import NotCompiledError, only_compiled  # numba, which a view need not import

    try:
        with only_compiled():
            warm_up(method)
    except NotCompiledError:
        return False
    return True
