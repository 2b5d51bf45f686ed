"""numba's ``njit``, for all files of kernels: what was compiled of older sources is gone before the first is loaded.

And who waits for them is told.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import event

from mocapella.kernel_cache import discard_stale

__all__ = ["njit", "told_of_compiling"]

discard_stale(Path(__file__).parent)


@contextmanager
def told_of_compiling(tell: Callable[[], None]) -> Iterator[None]:
    """``tell`` is called when numba begins to compile the first time; loading what it has kept is no such time."""

    class First(event.Listener):
        told = False

        def on_start(self, event: Any) -> None:
            if not self.told:
                self.told = True
                tell()

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", First()):
        yield
