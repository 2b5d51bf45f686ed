"""Pictures of a study's differences, for each figure of the thesis (9.1–9.5) and the paper (10–17) its own.

Bars by task and placement, Δd by joint and over time, heat maps of joint × time and joint × value, and stick figures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.names import distinct
from mocapella.studies.hypotheses import LIMIT_CM
from mocapella.studies.picture_files import (
    COLOURS,
    HATCHES,
    HEAT,
    LINES,
    MARKERS,
    StudyPicture,
    drawing,
    empty_figure,
    file_stem,
    rendered,
)
from mocapella.studies.pooled_tasks import (
    CM,
    PooledTask,
    StudyComparison,
    added,
    participants_of,
    placements_of,
    pooled_tasks,
    ratio,
    tasks_of,
)
from mocapella.studies.results import BIN_M, TIMELINE_S, StudyResults
from mocapella.studies.stick_figures import stick_pictures

Float64 = NDArray[np.float64]

_WIDTH_IN: Final = 7.2
"""Width of a page's text [inch]."""
_SECONDS: Final = 0.5
"""Width of a column of the pictures over time [s]."""
_MOST_COLUMNS: Final = 3
_MOST_SHOWN: Final = 0.98
"""Share of the pairs that a heat map of values shows; the rest lies beyond its right end."""
_HIGHEST: Final = 99.5
"""Percentile of a heat map's values at which its colours end [%]."""


def study_pictures(results: StudyResults) -> tuple[StudyPicture, ...]:
    """Draw all pictures of a study; names are distinct.

    Raises:
        SettingsError: matplotlib is not installed; names the extra.
    """
    with drawing():
        found = [
            picture
            for comparison, tasks in pooled_tasks(results).items()
            for picture in _pictures_of(comparison, tasks, results.joints)
        ]
        found += stick_pictures(results)
    names = distinct([one.name for one in found])
    return tuple(
        StudyPicture(file_stem(name), one.title, one.caption, one.about, one.files)
        for name, one in zip(names, found, strict=True)
    )


def _pictures_of(
    comparison: StudyComparison, tasks: tuple[PooledTask, ...], joints: tuple[str, ...]
) -> Iterator[StudyPicture]:
    def made(name: str, title: str, caption: str, figure: Any) -> StudyPicture:
        stem = file_stem(name, comparison.method, comparison.views)
        return StudyPicture(stem, title, caption, comparison.title, rendered(figure))

    yield made(
        "bars",
        "Δd by task and placement",
        "Bars: mean over participants; whiskers: ± one standard deviation over participants; points: participants. "
        f"Dotted: the limit of {LIMIT_CM:g} cm.",
        _bars(tasks),
    )
    names = tasks_of(tasks)
    for first in range(0, len(names), _MOST_COLUMNS):
        shown = names[first : first + _MOST_COLUMNS]
        yield made(
            f"joints-{'-'.join(shown)}",
            f"Δd by joint: {', '.join(shown)}",
            "Mean over participants, with one standard deviation over participants. Dotted: the limit of "
            f"{LIMIT_CM:g} cm.",
            _by_joint(tasks, shown, joints),
        )
    yield made(
        "time",
        "Δd over time",
        "Line: median over participants of the mean Δd over joints, in steps of half a second; band: quartiles. Times "
        "that fewer than half of a placement's participants reach are not drawn.",
        _over_time(tasks),
    )
    for task in names:
        own = [one for one in tasks if one.task == task]
        yield made(
            f"joint-time-{task}",
            f"Δd by joint and time: {task}",
            "Mean over all participants' pairs in steps of half a second. White: nothing measured.",
            _heat(own, joints, over_time=True),
        )
        yield made(
            f"joint-value-{task}",
            f"Distribution of Δd by joint: {task}",
            "Share of all pairs in each centimetre. At most 2 % of a placement's pairs lie beyond the right end.",
            _heat(own, joints, over_time=False),
        )


def _bars(tasks: Sequence[PooledTask]) -> Any:
    names, placements = tasks_of(tasks), placements_of(tasks)
    figure = empty_figure(_WIDTH_IN, 3.2)
    axes = figure.subplots()
    thick = 0.8 / len(placements)
    for k, placement in enumerate(placements):
        for i, task in enumerate(names):
            values = np.array([one.dd_cm for one in tasks if (one.task, one.placement) == (task, placement)])
            values = values[np.isfinite(values)]
            if not len(values):
                continue
            at = i + (k - (len(placements) - 1) / 2) * thick
            axes.bar(
                at, values.mean(), thick * 0.94, color=COLOURS[k % 8], hatch=HATCHES[k % 8], edgecolor="black",
                linewidth=0.6, alpha=0.75, label=placement if placement not in _labels(axes) else None,
            )  # fmt: skip
            spread = np.linspace(-0.28, 0.28, len(values)) * thick if len(values) > 1 else np.zeros(1)
            axes.plot(at + spread, np.sort(values), "o", ms=2.6, mfc="white", mec="black", mew=0.6, zorder=3)
            if len(values) > 1:
                axes.errorbar(at, values.mean(), values.std(ddof=1), color="black", lw=1.0, capsize=2.5, zorder=4)
    axes.axhline(LIMIT_CM, color="black", ls=":", lw=0.9, zorder=0)
    axes.set_xticks(range(len(names)), names, rotation=0 if len(names) < 8 else 30)
    axes.set_ylabel("mean Δd [cm]")
    axes.margins(y=0.03)
    axes.set_ylim(bottom=0)
    _finish(figure, [axes], 1, "placement")
    return figure


def _labels(axes: Any) -> list[str]:
    return list(axes.get_legend_handles_labels()[1])


def _by_joint(tasks: Sequence[PooledTask], names: Sequence[str], joints: tuple[str, ...]) -> Any:
    placements = placements_of(tasks)
    figure = empty_figure(_WIDTH_IN, 0.155 * len(joints) + 1.2)
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False).ravel()
    order = np.arange(len(joints))
    for axes, task in zip(panels, names, strict=False):
        for k, placement in enumerate(placements):
            values = np.array([one.joints_cm for one in tasks if (one.task, one.placement) == (task, placement)])
            if not len(values) or not np.isfinite(values).any():
                continue
            counts = np.isfinite(values).sum(axis=0)
            mean = ratio(np.nansum(values, axis=0), counts)
            spread = np.sqrt(ratio(np.nansum((values - mean) ** 2, axis=0), counts - 1))
            at = order + (k - (len(placements) - 1) / 2) * 0.22
            axes.errorbar(
                mean, at, xerr=spread, fmt=MARKERS[k % 8], color=COLOURS[k % 8], mec="black", mew=0.4, ms=3.6, lw=0.8,
                label=placement,
            )  # fmt: skip
        axes.set_title(task)
        axes.set_yticks(order, joints)
        axes.set_ylim(len(joints) - 0.4, -0.6)
        axes.set_xlim(left=0)
        axes.axvline(LIMIT_CM, color="black", ls=":", lw=0.8, zorder=0)
        axes.grid(axis="y", lw=0.3, color="0.85")
        axes.set_xlabel("mean Δd [cm]")
    _finish(figure, panels, len(names), "placement")
    return figure


def _finish(figure: Any, panels: Sequence[Any], used: int, title: str) -> None:
    """Remove unused panels, and put one legend for all panels above them."""
    for axes in panels[used:]:
        axes.remove()
    entries: dict[str, Any] = {}
    for axes in panels[:used]:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(entries.values(), entries.keys(), title=title, loc="outside upper center", ncols=len(entries) or 1)


def time_courses(tasks: Sequence[PooledTask]) -> tuple[Float64, Float64]:
    """Return the participants' mean Δd over a task's time, in steps of half a second.

    Args:
        tasks: pooled tasks of one task and placement.

    Returns:
        (steps,) middle of each step [s], and (participants, steps) mean Δd [cm], NaN where there is none.
    """
    each = round(_SECONDS / TIMELINE_S)
    courses = []
    for one in tasks:
        sums, counts = (_steps(own.sum(axis=1), each) for own in (one.timeline_sums, one.timeline_counts))
        courses.append(ratio(sums, counts.astype(np.int64)) * CM)
    longest = max(map(len, courses))
    table: Float64 = np.full((len(courses), longest), np.nan)
    for row, course in zip(table, courses, strict=True):
        row[: len(course)] = course
    return np.asarray((np.arange(longest) + 0.5) * _SECONDS, dtype=np.float64), table


def _steps(bins: NDArray[Any], each: int) -> Float64:
    """Sum groups of ``each`` bins (bins, ...)."""
    padded: Float64 = np.concatenate([bins, np.zeros((-len(bins) % each, *bins.shape[1:]))])
    return np.asarray(padded.reshape(-1, each, *bins.shape[1:]).sum(axis=1))


def _over_time(tasks: Sequence[PooledTask]) -> Any:
    names, placements = tasks_of(tasks), placements_of(tasks)
    rows = -(-len(names) // 2)
    figure = empty_figure(_WIDTH_IN, 2.1 * rows + 0.5)
    panels = figure.subplots(rows, min(2, len(names)), squeeze=False).ravel()
    for axes, task in zip(panels, names, strict=False):
        for k, placement in enumerate(placements):
            own = [one for one in tasks if (one.task, one.placement) == (task, placement)]
            if not own:
                continue
            at, courses = time_courses(own)
            shown = np.isfinite(courses).sum(axis=0) * 2 >= len(own)
            if not shown.any():
                continue
            low, middle, high = np.full((3, len(at)), np.nan)
            low[shown], middle[shown], high[shown] = np.nanpercentile(courses[:, shown], (25, 50, 75), axis=0)
            step = max(1, len(at) // 8)
            axes.fill_between(at, low, high, color=COLOURS[k % 8], alpha=0.2, lw=0)
            axes.plot(
                at, middle, LINES[k % 4], color=COLOURS[k % 8], lw=1.2, marker=MARKERS[k % 8], ms=3.2,
                markevery=(k * step // 3, step), label=placement,
            )  # fmt: skip
        axes.set_title(task)
        axes.set_xlabel("time from the task's first frame [s]")
        axes.set_ylabel("Δd [cm]")
        axes.margins(x=0)
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
    _finish(figure, panels, len(names), "placement")
    return figure


def _heat(tasks: Sequence[PooledTask], joints: tuple[str, ...], *, over_time: bool) -> Any:
    """Draw one heat map for each placement, all with one scale: joint × time, or joint × value."""
    placements = placements_of(tasks)
    owns = [[one for one in tasks if one.placement == placement] for placement in placements]
    tables = [_time_table(own) for own in owns] if over_time else _value_tables(owns)
    widest = max(1, *(table.shape[1] for table in tables))
    figure = empty_figure(_WIDTH_IN, 0.135 * len(joints) + 1.0)
    panels = figure.subplots(1, len(placements), sharey=True, squeeze=False).ravel()
    known = np.concatenate([table[np.isfinite(table)] for table in tables])
    top = float(np.percentile(known, _HIGHEST)) if len(known) else 1.0
    for axes, table, placement in zip(panels, tables, placements, strict=True):
        full = np.full((len(joints), widest), np.nan)
        full[:, : table.shape[1]] = table
        reach = widest * (_SECONDS if over_time else 1.0)
        picture = axes.imshow(
            full, aspect="auto", cmap=HEAT, vmin=0, vmax=max(top, 1e-9), extent=(0, reach, len(joints) - 0.5, -0.5),
            interpolation="none",
        )  # fmt: skip
        axes.set_title(f"{placement} (n = {len(participants_of(one for one in tasks if one.placement == placement))})")
        axes.set_yticks(range(len(joints)), joints)
        axes.set_xlabel("time [s]" if over_time else "Δd [cm]")
    figure.colorbar(picture, ax=list(panels), label="mean Δd [cm]" if over_time else "share of pairs [%]", extend="max")
    return figure


def _time_table(tasks: Sequence[PooledTask]) -> Float64:
    """Return (joints, steps) mean Δd over all pairs of these tasks [cm]."""
    sums, counts = tasks[0].timeline_sums, tasks[0].timeline_counts
    for one in tasks[1:]:
        sums, counts = added(sums, one.timeline_sums), added(counts, one.timeline_counts)
    each = round(_SECONDS / TIMELINE_S)
    return ratio(_steps(sums, each), _steps(counts, each).astype(np.int64)).T * CM


def _value_tables(owns: Sequence[Sequence[PooledTask]]) -> list[Float64]:
    """Return for each placement's tasks the (joints, centimetres) share of a joint's pairs [%], all equally wide.

    The width is the value that `_MOST_SHOWN` of the pairs of every placement are below.
    """
    each = round(1.0 / (BIN_M * CM))
    tables, shown = [], 5
    for own in owns:
        histogram = sum((one.histogram for one in own[1:]), start=own[0].histogram)
        total = histogram.sum(axis=1, keepdims=True)
        centimetres = _steps(histogram.T, each).T
        reached = np.cumsum(centimetres.sum(axis=0))
        shown = max(shown, int(np.searchsorted(reached, _MOST_SHOWN * reached[-1])) + 1)
        tables.append(ratio(centimetres * 100.0, np.broadcast_to(total, centimetres.shape)))
    return [table[:, :shown] for table in tables]
