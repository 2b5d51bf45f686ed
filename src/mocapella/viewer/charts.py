"""Charts of joint angles over time, in one browser's panel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

Float64 = NDArray[np.float64]

_COLOURS: Final = ("#5eb0ff", "#ff9f1c", "#9ae648", "#ff5ca8", "#b084ff", "#ffe240")


def groups(joint_names: Sequence[str]) -> dict[str, list[int]]:
    """Group joint angles for charts: return the indices of left and right, or of one joint, by name without side.

    Args:
        joint_names: names of the body model's joint angles, such as ``left knee flexion``, in their order.
    """
    found: dict[str, list[int]] = {}
    for k, name in enumerate(joint_names):
        plain = name.removeprefix("left ").removeprefix("right ")
        found.setdefault(plain, []).append(k)
    return found


class Chart:
    """Chart of the angles of one group of a body's joints over time [°], in one browser's panel.

    Args:
        gui: controls of the browser.
        names: names of the body's joint angles.
        first: group that is shown at first, a key of `groups`; the user chooses another in the chart's menu.
    """

    def __init__(self, gui: viser.GuiApi, names: Sequence[str], first: str) -> None:
        self._gui, self._names, self._groups = gui, tuple(names), groups(names)
        self._folder = gui.add_folder(_title(first), expand_by_default=True)
        with self._folder:
            self._choice = gui.add_dropdown("Angle", tuple(self._groups), initial_value=first)
            self._handle: viser.GuiUplotHandle | None = None
        self._shown: tuple[str, tuple[str, ...]] = ("", ())

    def draw(self, names: Sequence[str], at_s: Float64, angles: Float64) -> None:
        """Plot the angles of the group that the user has chosen over time, in place of the earlier plot.

        Args:
            names: names of all joint angles of the body. If they differ from before, the menu has the new groups.
            at_s: (n,) times of the scenes, on the common clock [s].
            angles: (n, joints) [rad].
        """
        if tuple(names) != self._names:
            self._names, self._groups = tuple(names), groups(names)
            self._choice.options = tuple(self._groups)  # viser replaces a choice that is missing by the first option
        chosen = str(self._choice.value)
        columns = self._groups[chosen]
        data = (at_s, *(np.degrees(angles[:, k]) for k in columns))
        if (chosen, self._names) == self._shown and self._handle is not None:
            self._handle.data = data
            return
        if self._handle is not None:
            self._handle.remove()
        self._shown = chosen, self._names
        self._folder.label = _title(chosen)
        series = [uplot.Series(label="s")]
        for k, colour in zip(columns, _COLOURS, strict=False):
            label = self._names[k].removesuffix(chosen).strip() or "angle"
            series.append(uplot.Series(label=label, stroke=colour, width=2))
        axis = uplot.Axis(stroke="#8a97ab", grid=uplot.Axis_Grid(stroke="#2c384c"), size=42)
        with self._folder:
            self._handle = self._gui.add_uplot(
                data, tuple(series), scales={"x": uplot.Scale(time=False)}, axes=(axis, axis), aspect=2.1,
                legend=uplot.Legend(show=True), padding=(10, 8, 0, 0),
            )  # fmt: skip


def _title(joint: str) -> str:
    return f"{joint.capitalize()} [°]"
