"""Keep compiled kernels on disk, and invalidate them when any of their sources changes.

numba's own cache checks only the file that defines a kernel. But a kernel's machine code includes the kernels that it
calls and the constants that it imports from other files: after an update it would still use the old ones, and if their
arrays had another layout, it would write out of bounds. So each cache entry and its file name carry a digest of the
kernel's file and of all files of this package that it imports. Outdated entries are never read; a save removes them.
"""

from __future__ import annotations

import hashlib
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from functools import cache, cached_property
from pathlib import Path
from typing import IO, Any, Final

from numba.core import caching

from mocapella.kernel_dispatcher import compiling, is_callee, rebuild_callee

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

LOCK: Final = "kernels.lock"
"""Name of the file, in each folder of cache entries, that a process locks while it saves an entry."""
CLAIM_S: Final = 600.0
"""Longest wait for another process that compiles the same kernel, as on a busy machine [s]; then both compile it.

The wait ends as soon as that process ends; only one that stands still is waited for in vain."""
_RETRY_S: Final = 0.02
_compiling_allowed: ContextVar[bool] = ContextVar("compiling_allowed", default=True)
_PACKAGE: Final = Path(__file__).resolve().parent
_IMPORT: Final = re.compile(r"^from mocapella\.([\w.]+) import (?:\(([^)]*)\)|(.*))$", re.MULTILINE)


class NotCompiledError(Exception):
    """A kernel would have to be compiled where `only_compiled` forbids it; the text is its name and signature.

    It is a signal to the caller that a compilation is needed, and no `MocapellaError`.
    """


@contextmanager
def only_compiled() -> Iterator[None]:
    """Forbid compilation within the context, so that calls test whether a method's kernels are compiled already.

    Kernels may be loaded from disk. It holds for the current thread, and only for kernels with ``cache=True``.

    Raises:
        NotCompiledError: a kernel that is called within is neither loaded nor on disk.
    """
    before = _compiling_allowed.set(False)
    try:
        yield
    finally:
        _compiling_allowed.reset(before)


def sources_of(file: Path, package: Path = _PACKAGE) -> list[Path]:
    """Return the file and every file of the package that it imports, directly or not, sorted by path.

    Only ``from mocapella.… import …`` at the beginning of a line is followed.

    Args:
        file: a Python source.
        package: folder of the package ``mocapella``.

    Raises:
        OSError: a file cannot be read.
    """
    found, open_ = set[Path](), [file]
    while open_:
        one = open_.pop()
        if one not in found:
            found.add(one)
            open_ += _imported(one, package)
    return sorted(found)


def source_digest(file: Path, package: Path = _PACKAGE) -> str:
    """Return 24 hexadecimal digits, a digest of the contents of all `sources_of` a file.

    Each file is read once in a process: a later change is not noticed.

    Args:
        file: a Python source.
        package: folder of the package ``mocapella``.

    Raises:
        OSError: the file cannot be read.
    """
    total = hashlib.blake2s(digest_size=12)
    for source in sources_of(file, package):
        total.update(hashlib.blake2s(_contents(source)).digest())
    return total.hexdigest()


def keep_on_disk(dispatcher: Any) -> None:
    """Make a kernel load its machine code from disk, and save newly compiled code there.

    The folder is ``NUMBA_CACHE_DIR`` if that is set, else ``__pycache__`` beside the source, else the user's cache. It
    is looked for at the kernel's first call. Where none of them can be written, each process compiles the kernel.

    Args:
        dispatcher: numba's dispatcher of the kernel; its cache is replaced.
    """
    dispatcher._cache = _AtFirstCall(dispatcher.py_func)


def keeps_kernels() -> bool:
    """Whether a folder for compiled kernels can be written, so that processes can share compiled kernels."""
    try:
        _KernelCacheImpl(source_digest)
    except RuntimeError:
        return False
    return True


class _AtFirstCall(caching.NullCache):
    """Chooses the folder at a kernel's first call, so that an import reads and writes nothing."""

    def __init__(self, py_func: Callable[..., Any]) -> None:
        self._py_func = py_func

    @cached_property
    def _cache(self) -> Any:
        try:
            return _KernelCache(self._py_func)
        except RuntimeError:  # no locator found a folder
            return caching.NullCache()

    @property
    def cache_path(self) -> str | None:
        return self._cache.cache_path  # type: ignore[no-any-return]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._cache.load_overload(sig, target_context)
        if found is None and not _compiling_allowed.get():
            raise NotCompiledError(f"{self._py_func.__module__}.{self._py_func.__qualname__}{sig}")
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        self._cache.save_overload(sig, data)


class _BySources:
    """Names entries by the digest of all sources, beside one of numba's locators."""

    _py_file: str

    def get_source_stamp(self) -> str:
        return _digest(Path(self._py_file))

    def get_disambiguator(self) -> str:
        return self.get_source_stamp()


class _InGivenFolder(_BySources, caching.UserProvidedCacheLocator):
    pass


class _BesideSource(_BySources, caching.InTreeCacheLocator):
    pass


class _InUsersCache(_BySources, caching.UserWideCacheLocator):
    pass


class _KernelCacheImpl(caching.CompileResultCacheImpl):
    def __init__(self, py_func: Callable[..., Any]) -> None:
        self._locator_classes = [_InGivenFolder, _BesideSource, _InUsersCache]
        super().__init__(py_func)  # type: ignore[no-untyped-call]

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        if is_callee(payload):
            return rebuild_callee(target_context, payload)
        return super().rebuild(target_context, payload)  # type: ignore[no-untyped-call]


class _KernelCache(caching.FunctionCache):
    """numba's cache for processes that start at the same time.

    A process claims a kernel before it compiles it; the others wait and load the result. An exclusive lock guards each
    save, because two processes that save the same kernel would choose the same file name.
    """

    _impl_class = _KernelCacheImpl

    def __init__(self, py_func: Callable[..., Any]) -> None:
        super().__init__(py_func)  # type: ignore[no-untyped-call]
        self._claim: ExitStack | None = None
        self._of_callee = False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._load(sig, target_context)
        if found is not None:
            return found
        if self._claim is None and _compiling_allowed.get():  # else a signature of this kernel calls another one
            self._claim = ExitStack()
            with suppress(OSError):  # a folder that was removed: compile without a claim
                self._claim.enter_context(_claimed(Path(self._cache_path) / f"{self._impl.filename_base}.claim"))
            found = self._load(sig, target_context)
            if found is not None:
                self._release()
        return found

    def _load(self, sig: Any, target_context: Any) -> Any:
        """Load an entry of a callee while another kernel is compiled; one with machine code does as well."""
        for self._of_callee in (True, False) if compiling() else (False,):
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is not None:
                return found
        return None

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), self._of_callee)  # type: ignore[no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        self._of_callee = compiling()
        try:
            with _locked(Path(self._cache_path)):
                self._remove_outdated()
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError:  # a full disk, a folder that was removed: the kernel runs, and is compiled again another time
            return
        finally:
            self._release()

    def _release(self) -> None:
        if self._claim is not None:
            self._claim.close()
            self._claim = None

    def _remove_outdated(self) -> None:
        current = str(self._impl.filename_base).rpartition(".")[0]  # without the version of Python
        for pattern in ("nb[ci]", "claim"):
            for entry in Path(self._cache_path).glob(f"{current.rpartition('-')[0]}-*.{pattern}"):
                if not entry.name.startswith(f"{current}."):
                    entry.unlink(missing_ok=True)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    with (folder / LOCK).open("a") as lock:
        if sys.platform == "win32":
            msvcrt.locking(lock.fileno(), msvcrt.LK_LOCK, 1)
        else:
            fcntl.flock(lock, fcntl.LOCK_EX)  # closing the file unlocks it
        yield


@contextmanager
def _claimed(file: Path) -> Iterator[None]:
    """Hold a file's lock, or go on without it after `CLAIM_S`: its holder may have failed to compile."""
    with file.open("a") as claim:
        deadline = time.monotonic() + CLAIM_S
        while not _try_lock(claim) and time.monotonic() < deadline:
            time.sleep(_RETRY_S)
        yield


def _try_lock(file: IO[str]) -> bool:
    try:
        if sys.platform == "win32":
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


_digest: Callable[[Path], str] = cache(source_digest)  # sources do not change for a process that has imported them


@cache
def _contents(file: Path) -> bytes:
    return file.read_bytes()


def _imported(file: Path, package: Path) -> list[Path]:
    """Files of the package that a source imports from: ``from mocapella.a import b`` may be a/b.py, or a.py."""
    found = []
    for module, several, one in _IMPORT.findall(_contents(file).decode(errors="replace")):
        folder = module.replace(".", "/")
        names = [name.split(" as ")[0].strip() for name in (several or one).split("#")[0].split(",")]
        candidates = [f"{folder}.py", f"{folder}/__init__.py", *(f"{folder}/{name}.py" for name in names if name)]
        found += [package / path for path in candidates if _exists(package / path)]
    return found


@cache
def _exists(file: Path) -> bool:
    return file.is_file()
