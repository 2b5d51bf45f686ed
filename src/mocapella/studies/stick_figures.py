"""Timelines of stick figures: what each sensor and the fused person show at a few instants of a task."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.exports.needs import needed
from mocapella.model.names import plural
from mocapella.model.topology import topology
from mocapella.studies.picture_files import COLOURS, MARKERS, StudyPicture, empty_figure, file_stem, rendered
from mocapella.studies.pooled_tasks import natural_order, placement_rank, task_rank
from mocapella.studies.results import PoseStrip, StudyResults

MOST_STRIPS: Final = 12
"""Largest number of timelines that are drawn."""
_WIDTH_IN: Final = 7.2
_MARGIN_M: Final = 0.15
"""Space around the people of a row [m]."""


def stick_pictures(results: StudyResults) -> list[StudyPicture]:
    """Draw the strips of a study, all people of a recording's task in one picture; `MOST_STRIPS` at most.

    Measured joints are filled, inferred ones hollow, and bones at an inferred joint dashed. The view is the reference
    sensor's: its camera space, x mirrored to the right, y up.
    """
    groups: dict[tuple[str, str, str, str], list[PoseStrip]] = {}
    for strip in results.strips:
        if strip.positions.size:
            groups.setdefault((strip.method, strip.placement, strip.task, strip.participant), []).append(strip)
    named = results.order

    def rank(key: tuple[str, str, str, str]) -> tuple[object, ...]:
        method, placement, task, participant = key
        return (
            task_rank(named, task), placement_rank(named, placement), natural_order(method), natural_order(participant)
        )  # fmt: skip

    order = sorted(groups, key=rank)
    chosen = _spread_over_tasks(order)[:MOST_STRIPS]
    left = len(order) - len(chosen)
    beside = f" {plural(left, 'other timeline is', 'other timelines are')} not drawn." if left else ""
    return [
        StudyPicture(
            file_stem("sticks", *key),
            f"Stick figures: {key[2]}, participant {key[3]}, {key[1]}",
            "Rows: views; columns: instants. Filled: measured joints; hollow and dashed: inferred. Colours and "
            f"marks: people.{beside}",
            key[0],
            rendered(_timeline(groups[key], results.joints)),
        )
        for key in chosen
    ]


def _spread_over_tasks(keys: Sequence[tuple[str, str, str, str]]) -> list[tuple[str, str, str, str]]:
    """Order keys so that the first one of every task comes first, then the second ones."""
    seen: dict[str, int] = {}
    ranked = []
    for place, key in enumerate(keys):
        seen[key[2]] = seen.get(key[2], 0) + 1
        ranked.append((seen[key[2]], place, key))
    return [key for *_, key in sorted(ranked)]


def bones_of(joints: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    """Return the bones between named joints, as pairs of indices; none for names that a Kinect v2 has not."""
    skeleton = topology("kinect_v2")
    at = {name: k for k, name in enumerate(joints)}
    named = ((skeleton.joints[a], skeleton.joints[b]) for a, b in skeleton.bones)
    return tuple((at[a], at[b]) for a, b in named if a in at and b in at)


def _timeline(strips: Sequence[PoseStrip], joints: tuple[str, ...]) -> Any:
    """Draw the strips of one recording's task in one panel: a row for each view, a column for each instant."""
    instants = np.unique(np.concatenate([strip.at_s for strip in strips]))
    names = list(dict.fromkeys(name for strip in strips for name in strip.names))
    low, high = _reach(strips)
    cell = high - low
    whole = cell * (len(instants), len(names))
    figure = empty_figure(_WIDTH_IN, min(9.0, (_WIDTH_IN - 0.6) * float(whole[1] / whole[0])) + 0.4)
    axes = figure.subplots()
    bones = bones_of(joints)
    for row, name in enumerate(names):
        for column, at_s in enumerate(instants):
            corner = cell * (column, len(names) - 1 - row)
            shown = [
                _draw(axes, (points - low + corner, measured), bones, (COLOURS[k % 8], MARKERS[k % 8]))
                for k, strip in enumerate(strips)
                for points, measured in _poses(strip, name, at_s)
            ]
            if not any(shown):
                axes.text(*(corner + cell / 2), "no skeleton", ha="center", va="center", color="0.35", size=7)
    axes.set(xlim=(0, whole[0]), ylim=(0, whole[1]), aspect="equal", xlabel="time from the task's first frame")
    axes.set_xticks(cell[0] * (np.arange(len(instants)) + 0.5), [f"{at_s:.1f} s" for at_s in instants])
    axes.set_yticks(cell[1] * (np.arange(len(names)) + 0.5), names[::-1])
    axes.vlines(cell[0] * np.arange(len(instants) + 1), 0, whole[1], colors="0.8", linewidths=0.6)
    axes.hlines(cell[1] * np.arange(len(names) + 1), 0, whole[0], colors="0.8", linewidths=0.6)
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    return figure


Pose = tuple[NDArray[np.floating[Any]], NDArray[np.bool_]]


def _poses(strip: PoseStrip, name: str, at_s: float) -> Iterator[Pose]:
    """Yield the (joints, 2) points and (joints,) measured flags of one view at one instant."""
    for k in np.flatnonzero(strip.at_s == at_s):
        if name in strip.names:
            view = strip.names.index(name)
            yield strip.positions[k, view, :, :2] * np.array([-1.0, 1.0]), strip.measured[k, view]


def _draw(axes: Any, pose: Pose, bones: Sequence[tuple[int, int]], look: tuple[str, str]) -> bool:
    """Draw one skeleton, and return whether any joint is known."""
    (points, measured), (colour, marker) = pose, look
    known = np.asarray(np.isfinite(points).all(axis=1))
    drawn = [pair for pair in bones if known[list(pair)].all()]
    for sure, style, width in ((True, "-", 1.1), (False, (0, (2, 1.4)), 0.7)):
        lines = [points[list(pair)] for pair in drawn if measured[list(pair)].all() == sure]
        collection = needed("matplotlib.collections", extra="studies").LineCollection
        axes.add_collection(collection(lines, colors=colour, linewidths=width, linestyles=[style]))
    for flags, face in ((known & measured, colour), (known & ~measured, "white")):
        axes.plot(*points[flags].T, marker, ms=2.2, mfc=face, mec=colour, mew=0.6)
    return bool(known.any())


def _reach(strips: Sequence[PoseStrip]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (2,) of a rectangle around everything in the picture's plane [m]."""
    points = np.concatenate([strip.positions[..., :2].reshape(-1, 2) for strip in strips]).astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)] * np.array([-1.0, 1.0])
    if not len(points):
        return np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    return points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
