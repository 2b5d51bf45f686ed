"""Plots of joint angles over time; matplotlib is optional."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.exports.needs import needed
from mocapella.model.joint_angles import JointAngles
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories

COLUMNS: Final = 3
"""Largest number of panels side by side."""
_SIDES: Final = {"_l": "left", "_r": "right"}
_STYLES: Final = {"": "-", "left": "-", "right": "--"}
_DOTTED: Final = 2
"""Size of the dots of inferred angles [pt]."""


def angle_figure(angles: JointAngles, names: Sequence[str] = ()) -> Any:
    """Return a matplotlib figure of angles over time [degrees], with a panel for each angle.

    Both sides of an angle share a panel: left ones are solid, right ones dashed. Lines are measured, dots inferred; the
    shaded band is one standard deviation. A line is interrupted where an angle is unknown.

    Args:
        angles: the angles of any number of individuals, which have a colour each.
        names: names of the angles, such as ``knee_angle_r``; empty for all that are ever known.

    Raises:
        SettingsError: an angle is unknown, none is ever known, or matplotlib is not installed.
    """
    for name in names:
        if name not in angles.names:
            raise SettingsError(f"no angle {name!r}; known: {one_of(name, angles.names)}")
    ever = np.asarray(np.isfinite(angles.angles).any(axis=(0, 1)))
    chosen = list(dict.fromkeys(names)) or [name for name, known in zip(angles.names, ever, strict=True) if known]
    if not chosen:
        raise SettingsError(f"no angle of {angles.kind} is ever known, so there is nothing to plot")
    panels: dict[str, list[str]] = {}
    for name in chosen:
        panels.setdefault(_without_side(name), []).append(name)
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    size = (2.0 + 3.6 * columns, 0.8 + 2.2 * rows)
    figure = needed("matplotlib.figure", extra="plots").Figure(figsize=size, layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axes, (panel, own) in zip(grid, panels.items(), strict=False):
        for name in own:
            _draw(axes, angles, name)
        axes.set_title(panel, fontsize="medium")
        axes.set_ylabel("[°]")
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    for axes in grid[max(0, len(panels) - columns) : len(panels)]:
        axes.set_xlabel("time [s]")
        axes.tick_params(labelbottom=True)
    figure.suptitle(_key(chosen), fontsize="medium")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize="small")
    return figure


def write_angle_plot(trajectories: Trajectories, path: Path) -> None:
    """Write a plot of all joint angles of trajectories as a PNG file.

    Raises:
        SettingsError: the keypoints determine no angle, none is ever known, or matplotlib is not installed.
        OSError: the file cannot be written.
    """
    angle_figure(JointAngles.of(trajectories)).savefig(path, format="png")


def _draw(axes: Any, angles: JointAngles, name: str) -> None:
    k, side = angles.names.index(name), _SIDES.get(name[-2:], "")
    for i, individual in enumerate(angles.individuals):
        deg, states = np.degrees(angles.angles[:, i, k]), angles.states[:, i, k]
        measured, inferred = states == JointState.TRACKED, states == JointState.INFERRED
        shown = _only(deg, measured)
        label = f"{individual} {side}".strip()
        (line,) = axes.plot(angles.times_s, shown, _STYLES[side], lw=1.2, color=f"C{i}", label=label)
        axes.plot(angles.times_s[inferred], deg[inferred], ".", ms=_DOTTED, color=line.get_color(), alpha=0.5)
        sd = np.degrees(angles.sd[:, i, k].astype(np.float64))
        if np.isfinite(sd[measured]).any():
            axes.fill_between(angles.times_s, shown - sd, shown + sd, color=line.get_color(), alpha=0.15, lw=0)


def _only(values: NDArray[np.float64], there: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.where(there, values, np.nan)


def _without_side(name: str) -> str:
    return name[:-2] if name[-2:] in _SIDES else name


def _key(names: Sequence[str]) -> str:
    sides = "left: solid, right: dashed; " if any(name[-2:] in _SIDES for name in names) else ""
    return f"joint angles ({sides}lines: measured, dots: inferred, band: 1 sd)"
