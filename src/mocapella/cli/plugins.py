"""Plug-ins: descriptors that other packages register, and the reasons why some cannot be used."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from mocapella.cli.common import say
from mocapella.registry import Skipped, Table, plugin_points, wrong_groups

if TYPE_CHECKING:
    from mocapella.sources.source import Finding


def tables() -> tuple[Table[Any], ...]:
    """Return all tables of descriptors that packages can extend."""
    from mocapella.detectors import DETECTORS
    from mocapella.detectors.keypoint_detector import KEYPOINT_DETECTORS
    from mocapella.exports.export import EXPORTS
    from mocapella.model.frame_types import FRAME_TYPES
    from mocapella.model.part_types import PART_TYPES
    from mocapella.sources.source import SOURCES
    from mocapella.streams.stream import STREAMS
    from mocapella.studies.measures.measure import MEASURES
    from mocapella.tracker.method import METHODS

    return METHODS, DETECTORS, KEYPOINT_DETECTORS, FRAME_TYPES, PART_TYPES, SOURCES, EXPORTS, STREAMS, MEASURES


def plugins() -> tuple[list[tuple[str, str]], list[Skipped]]:
    """Load the descriptors of all plug-ins.

    Returns:
        (package, its registration) of each usable descriptor, and the skipped entry points.
    """
    if not plugin_points():
        return [], []
    every = tables()
    usable = [(package, f"{one.what} {name}") for one in every for name, package in one.plugins().items()]
    skipped = [each for one in every for each in one.skipped]
    return usable, skipped + wrong_groups(one.group for one in every)


def tell_of_skipped() -> None:
    """Print a line for each unusable plug-in, unless a parent process of this program has done so already."""
    from mocapella.live.signals import STARTED_BY_US

    if STARTED_BY_US not in os.environ:
        for one in plugins()[1]:
            say(str(one))


def plugin_findings() -> Iterator[Finding]:
    """Yield the findings of `mocapella doctor` about plug-ins."""
    from mocapella.sources.source import Finding

    usable, skipped = plugins()
    for package, what in usable:
        yield Finding(f"plug-in {package}", "ok", what)
    for one in skipped:
        problem, _, advice = one.why.partition("; ")
        yield Finding(f"plug-in {one.package}", "note", f"{one.group} {one.name}: {problem}", advice)
