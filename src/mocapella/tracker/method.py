"""Descriptors of tracking methods: all that the rest of the program knows of a method."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final, Literal

from mocapella.model.frame_types import FRAME_TYPES, what_it_sends
from mocapella.model.observations import Arrival
from mocapella.model.sensor_frame import SensorFrame, UnknownFrame
from mocapella.model.session import SensorPose
from mocapella.registry import Table
from mocapella.tracker.protocol import Tracker

Make = Callable[[Mapping[str, Any], int, Mapping[str, SensorPose]], Tracker]
"""Creates a tracker from settings by name, number of sensors expected, and sensors' poses by name."""
Practice = Callable[[], tuple[Tracker, Iterable[Arrival]]]
"""Creates a tracker, and arrivals that call all of its kernels, to compile these before the first frame."""


@dataclass(frozen=True)
class Method:
    """A tracking method.

    Attributes:
        interface: version of the descriptor's interface, see `mocapella.registry`.
        name: name of the method on the command line, in takes and in the view.
        summary: purpose of the method, in one line.
        settings: the frozen dataclass of its settings.
        frame_types: classes of the frames that it accepts, the main one first; others are rejected with the reason.
        parts: names of the types of scene parts that it makes, the main one first.
        make: function that creates a tracker from its settings by name, the number of sensors to wait for, and the
            sensors' tilt and height by name.
        warm_up_run: function that creates a tracker, and arrivals that call all of its kernels, so that these are
            compiled; None if nothing has to be compiled.
        warm_up_parts: ``module:name`` each of a function without arguments that calls kernels of ``warm_up_run``; they
            are compiled in other processes at the same time (`mocapella.live.compilation`).
        kernels: about how many kernels ``warm_up_run`` compiles, callees included, to show progress; 0 if unknown.
        camera_rig: whether it needs the poses of calibrated cameras, as ``rig`` in its settings.
        keeps_layout: whether its tracker estimates sensor poses that can be kept (`KeepsLayout`).
        files: for each option of ``mocapella serve`` (``rig``, ``hand`` …), ``module:name`` of a function that reads
            the files, a sequence of paths, into settings.
        stages: stages of the live view, ``module:name`` each, in display order; the last is always shown.
    """

    interface: int
    name: str
    summary: str
    settings: type
    frame_types: tuple[type[SensorFrame], ...]
    parts: tuple[str, ...]
    make: Make
    warm_up_run: Practice | None = None
    warm_up_parts: tuple[str, ...] = ()
    kernels: int = 0
    camera_rig: Literal["none", "optional", "required"] = "none"
    keeps_layout: bool = False
    files: Mapping[str, str] = field(default_factory=dict)
    stages: tuple[str, ...] = ("mocapella.viewer.stages:ROOM",)


METHODS: Final = Table("mocapella.methods", Method, "tracking method")
"""All methods, by name."""


def methods_making(part: str) -> tuple[str, ...]:
    """Return the names of the methods whose main scene parts are of a type, such as ``people``."""
    return tuple(method.name for method in METHODS.values() if method.parts[0] == part)


def not_taken(frame: SensorFrame, method: str) -> str:
    """Return why a method rejects a frame; empty if it accepts its type, and for frames that are only recorded."""
    return "" if frame.for_the_take else never_tracked(frame, method)


def never_tracked(frame: SensorFrame, method: str) -> str:
    """Return why a method makes no result of a frame, also of one that is only recorded; empty if it does."""
    return _not_taken(type(frame), what_it_sends(frame), method)


@lru_cache(maxsize=256)
def _not_taken(kind: type[SensorFrame], name: str, method: str) -> str:
    takers = [one.name for one in METHODS.values() if kind in one.frame_types]
    if method in takers:
        return ""
    if kind is UnknownFrame:
        return f"it sends {name}, which no installed package reads: install the one that does; a take keeps them"
    if not takers:
        hint = FRAME_TYPES[name].hint if name in FRAME_TYPES else ""
        return f"it sends {name}, which no method uses; {hint or 'a take keeps them'}"
    return f"it sends {name}, which the method {method} does not use: set up {' or '.join(takers)}; a take keeps them"
