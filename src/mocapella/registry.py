"""Tables of descriptors that packages register by entry points; Mocapella's own are registered in the same way.

    METHODS = Table("mocapella.methods", Method, "tracking method")
    METHODS.find("default").make(...)

A table maps names to frozen descriptors of one class. A descriptor is imported on first use. One that is unusable is
skipped, and `Table.skipped` has its name, its package and the reason; all others work.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, MutableMapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final, Generic, Protocol, TypeVar

from mocapella.errors import PluginError, SettingsError, one_of

INTERFACE: Final = 1
"""Version of the descriptors' interface. Descriptors of plug-ins give the version they are written for as a number."""
OURS: Final = "mocapella"


class Descriptor(Protocol):
    """Fields of every descriptor.

    Attributes:
        interface: the version of the interface it was written for.
        name: its key in the table, and on the command line.
    """

    @property
    def interface(self) -> int:
        """Version of the descriptor interface that it was written for."""

    @property
    def name(self) -> str:
        """Its key in the table, and on the command line."""


D = TypeVar("D", bound=Descriptor)


@dataclass(frozen=True)
class Skipped:
    """An unusable entry point.

    Attributes:
        group, name: the entry point's group and name.
        package: its package, with the version.
        why: the fault and its remedy.
    """

    group: str
    name: str
    package: str
    why: str

    def __str__(self) -> str:
        return f"{self.package}: {self.group} {self.name!r} is skipped: {self.why}"


class Table(MutableMapping[str, D], Generic[D]):
    """The descriptors of one entry point group by name: Mocapella's first, then by package and name.

    ``table[name]`` imports a descriptor once and raises `KeyError` if it is unknown or unusable; ``in``, iteration and
    ``len`` import descriptors too, and leave out unusable ones. If two packages register a name, the first has it.
    ``table[name] = descriptor`` and ``del table[name]`` change the table of this process alone, for example in a
    notebook or a test; a descriptor that is set is not checked.

    Args:
        group: the entry point group, such as ``mocapella.methods``.
        kind: class of the descriptors; an entry point to an object of another class is unusable.
        what: noun for a descriptor in errors, such as ``tracking method``.

    Attributes:
        group, what: as given.
    """

    def __init__(self, group: str, kind: type[D], what: str) -> None:
        self.group, self.what, self._kind = group, what, kind
        self._found: dict[str, EntryPoint | None] | None = None
        self._loaded: dict[str, D] = {}
        self._lock = threading.Lock()
        self._skipped: list[Skipped] = []

    @property
    def skipped(self) -> tuple[Skipped, ...]:
        """Unusable entry points among those loaded so far; call `plugins` first to load those of all other packages."""
        self._points()
        return tuple(self._skipped)

    def plugins(self) -> dict[str, str]:
        """Load the descriptors of other packages; return the package of each usable one, with its version, by name."""
        points = tuple(self._points().items())
        return {n: _package(p) for n, p in points if p is not None and _distribution(p) != OURS and n in self}

    def package(self, name: str) -> str:
        """Return the package that registers a name, with its version; empty if none does or the name was set here."""
        point = self._points().get(name)
        return "" if point is None else _package(point)

    def find(self, name: str) -> D:
        """Return the descriptor of a name.

        Raises:
            SettingsError: the name is unknown; lists the known ones.
            PluginError: the descriptor is unusable; names its package and the fault.
        """
        if name in self:
            return self[name]
        for one in self.skipped:
            if one.name == name:
                raise PluginError(f"{self.what} {name!r} of {one.package} cannot be used: {one.why}")
        raise SettingsError(f"unknown {self.what} {name!r}; known: {one_of(name, self)}")

    def __getitem__(self, name: str) -> D:
        if name not in self._loaded:
            point = self._points()[name]
            assert point is not None  # descriptors that were set are already in `_loaded`
            try:
                self._loaded[name] = self._load(point)
            except PluginError as error:
                del self._points()[name]
                self._skip(point, str(error))
                raise KeyError(name) from error
        return self._loaded[name]

    def __setitem__(self, name: str, descriptor: D) -> None:
        self._points()[name] = None
        self._loaded[name] = descriptor

    def __delitem__(self, name: str) -> None:
        del self._points()[name]
        self._loaded.pop(name, None)

    def __contains__(self, name: object) -> bool:
        try:
            self[str(name)]
        except KeyError:
            return False
        return True

    def __iter__(self) -> Iterator[str]:
        return (name for name in tuple(self._points()) if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _points(self) -> dict[str, EntryPoint | None]:
        if self._found is None:
            found: dict[str, EntryPoint | None] = {}
            skipped = []
            for point in sorted(entry_points(group=self.group), key=_order):
                first = found.setdefault(point.name, point)
                assert first is not None
                if (first.value, _package(first)) != (point.value, _package(point)):
                    skipped.append((point, f"{_package(first)} has this name; uninstall one of the two"))
            with self._lock:  # another thread may have been faster; none may see a part of the table
                if self._found is None:
                    self._found = found
                    for point, why in skipped:
                        self._skip(point, why)
        return self._found

    def _load(self, point: EntryPoint) -> D:
        value = _imported(point.load, point.value)
        if not isinstance(value, self._kind):
            raise PluginError(
                f"{point.value} is a {type(value).__name__}, not a {self._kind.__name__}; update the package"
            )
        if value.interface != INTERFACE:
            older, newer = f"it was written for interface {value.interface}", f"this Mocapella has {INTERFACE}"
            raise PluginError(f"{older}, and {newer}; update the package or Mocapella")
        if value.name != point.name:
            raise PluginError(f"{point.value} calls itself {value.name!r}; its package must register that name")
        return value

    def _skip(self, point: EntryPoint, why: str) -> None:
        self._skipped.append(Skipped(self.group, point.name, _package(point), why))


def _distribution(point: EntryPoint) -> str:
    return "" if point.dist is None else point.dist.name


def _package(point: EntryPoint) -> str:
    return "an unknown package" if point.dist is None else f"{point.dist.name} {point.dist.version}"


def _order(point: EntryPoint) -> tuple[bool, str, str]:
    return _distribution(point) != OURS, _distribution(point), point.name


def plugin_points() -> list[EntryPoint]:
    """Return all entry points of other packages in Mocapella's groups, without importing them."""
    found = entry_points()  # reads the metadata of all packages
    groups = [group for group in found.groups if group.startswith(f"{OURS}.")]
    return sorted((p for group in groups for p in found.select(group=group) if _distribution(p) != OURS), key=_order)


def wrong_groups(groups: Iterable[str]) -> list[Skipped]:
    """Return other packages' entry points in misspelt groups, which no table would find.

    These are groups that begin with ``mocapella.`` and are not among ``groups``, the existing ones.
    """
    known = sorted(groups)
    return [
        Skipped(p.group, p.name, _package(p), f"there is no such group; known: {one_of(p.group, known)}")
        for p in plugin_points()
        if p.group not in known
    ]


@cache
def load(reference: str) -> Any:
    """Import the object of a reference ``module:name``, once for each reference.

    Descriptors refer in this way to objects that most processes never need, such as a stage of the live view.

    Raises:
        PluginError: the module or name does not exist, or its import fails.
    """
    module, _, name = reference.partition(":")
    return _imported(lambda: getattr(import_module(module), name), reference)


def _imported(get: Callable[[], Any], reference: str) -> Any:
    try:
        return get()
    except (Exception, SystemExit) as error:  # a plug-in's module may raise anything
        what = f"{type(error).__name__}: {error}".partition("\n")[0]
        raise PluginError(f"{reference} cannot be imported ({what}); update or uninstall its package") from error
