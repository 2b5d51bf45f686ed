"""numba's ``njit``, for all files of kernels: what was compiled of older sources is gone before the first is loaded.

And who waits for them is told.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
from numba.core import event

from mocapella.kernel_cache import discard_stale

__all__ = ["njit", "told_of_compiling"]

_CACHE_DIR: Any = numba.config.CACHE_DIR  # type: ignore[attr-defined]
discard_stale(Path(__file__).parent, Path(_CACHE_DIR) if _CACHE_DIR else None)


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


def njit(*function: Any, **options: Any) -> Any:
    """numba's ``njit``, always with IEEE arithmetic, so that a take is replayed to the bit on the machine it is of.

    A kernel's code is also in the kernels that call it, where it is optimised once more, and which of these copies runs
    depends on what a process has compiled or loaded before. Where the optimiser may regroup or fuse, copies round
    differently.

    Raises:
        ValueError: ``fastmath`` is asked for.
    """
    if options.get("fastmath"):
        raise ValueError(f"fastmath={options['fastmath']!r}: kernels keep to IEEE arithmetic; write the faster sum out")
    compile_kernel: Any = numba.njit  # an option that its types do not list: nobody calls kernels from C
    return compile_kernel(*function, no_cfunc_wrapper=True, **options)
