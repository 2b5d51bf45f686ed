"""numba's ``njit`` for all kernels: IEEE arithmetic, a cache on disk that sees all sources, and word of compiling."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import config, event

from mocapella.kernel_cache import NotCompiledError, keep_on_disk, keeps_kernels, only_compiled
from mocapella.kernel_dispatcher import KernelDispatcher

__all__ = ["NotCompiledError", "keeps_kernels", "njit", "on_first_compilation", "only_compiled"]


@contextmanager
def on_first_compilation(tell: Callable[[], None]) -> Iterator[None]:
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


def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """numba's ``njit``, always with IEEE arithmetic, so that a take is replayed to the bit on the machine it is of.

    A kernel's code is also in the kernels that call it, where it is optimised once more, and which of these copies runs
    depends on what a process has compiled or loaded before. Where the optimiser may regroup or fuse, copies round
    differently.

    Args:
        cache: keep the machine code on disk (`mocapella.kernel_cache`).
        options: numba's.

    Raises:
        ValueError: ``fastmath`` is asked for.
    """
    if options.get("fastmath"):
        raise ValueError(f"fastmath={options['fastmath']!r}: kernels keep to IEEE arithmetic; write the faster sum out")

    def decorated(function: Callable[..., Any]) -> Any:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return function
        dispatcher = KernelDispatcher(function, {"nopython": True, "no_cfunc_wrapper": True, **options})
        if cache:
            keep_on_disk(dispatcher)
        return dispatcher

    return decorated
