"""numba's ``njit`` for all kernels: IEEE arithmetic, a disk cache keyed by all sources, and a notice of compilation."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from numba import typeof
from numba.core import config, event

from mocapella.kernel_cache import NotCompiledError, keep_on_disk, keeps_kernels, only_compiled
from mocapella.kernel_dispatcher import KernelDispatcher

__all__ = [
    "NotCompiledError",
    "entry_point",
    "keeps_kernels",
    "njit",
    "on_compilation",
    "on_first_compilation",
    "only_compiled",
]


@contextmanager
def on_compilation(tell: Callable[[], None]) -> Iterator[None]:
    """Call ``tell`` after each compilation of a kernel for a signature within the context, to show progress.

    It is called without arguments, in the thread that compiles; also after a compilation that failed. Loading a kernel
    from disk is no compilation.
    """

    class Each(event.Listener):
        def on_start(self, event: Any) -> None:
            pass

        def on_end(self, event: Any) -> None:
            if isinstance(event.data["dispatcher"], KernelDispatcher):  # else it is part of numba
                tell()

    with event.install_listener("numba:compile", Each()):
        yield


@contextmanager
def on_first_compilation(tell: Callable[[], None]) -> Iterator[None]:
    """Call ``tell`` once if numba compiles any kernel within the context, to announce the wait to a user.

    It is called without arguments before the first compilation, in the thread that compiles. Loading a kernel from
    disk is no compilation.
    """

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


def entry_point(kernel: Any, arguments: Sequence[Any]) -> Callable[..., Any] | None:
    """Return the compiled function that a kernel calls for arguments of these types, which it checks no more.

    Args:
        kernel: a function of `njit`.
        arguments: its arguments.

    Returns:
        The function; None if none is compiled for these types, or with ``NUMBA_DISABLE_JIT``.
    """
    found = getattr(kernel, "overloads", {}).get(tuple(map(typeof, arguments)))
    return None if found is None else found.entry_point


def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return numba's ``njit`` decorator with IEEE arithmetic, so that one machine replays a take to the bit.

    A kernel is compiled again inside each kernel that calls it. With ``fastmath``, the optimiser may regroup sums
    differently in each copy, and the copies round differently. Write ``@njit()`` with parentheses. With
    ``NUMBA_DISABLE_JIT``, the decorator returns the Python function itself.

    Args:
        cache: whether the machine code is kept on disk (`mocapella.kernel_cache`).
        options: further options of numba's ``njit``.

    Raises:
        ValueError: ``options`` turn ``fastmath`` on.
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
