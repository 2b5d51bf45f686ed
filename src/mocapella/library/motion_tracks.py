"""Trajectories as other libraries take them: xarray, pandas, polars and matplotlib."""

from __future__ import annotations

import html
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from mocapella.errors import SettingsError, one_of
from mocapella.exports.motion_page import page_of
from mocapella.exports.needs import needed
from mocapella.exports.new_file import new_file
from mocapella.exports.trajectory_arrays import as_dataset
from mocapella.exports.trajectory_tables import as_pandas, as_polars
from mocapella.library.angle_tracks import AngleTracks
from mocapella.model.observations import JointState
from mocapella.model.resampling import resampled
from mocapella.model.trajectories import Trajectories


@dataclass(frozen=True, repr=False)
class MotionView:
    """A page that plays a motion; a notebook shows it.

    Attributes:
        page: the page as HTML, which needs no other file.
        height_px: its height in a notebook [px].
    """

    page: str
    height_px: int

    def save(self, path: Path | str) -> None:
        """Write the page to a file, which any browser opens; an existing file is replaced.

        Raises:
            SettingsError: the file cannot be written.
        """
        with new_file(Path(path), force=True) as part:
            part.write_text(self.page, encoding="utf-8")

    def __repr__(self) -> str:
        return "<MotionView: a notebook shows it; .save(path) writes a page>"

    def _repr_html_(self) -> str:
        style = f"width:100%;height:{self.height_px}px;border:0"
        return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{html.escape(self.page)}"></iframe>'


@dataclass(frozen=True, eq=False, repr=False)
class MotionTracks(Trajectories):
    """Keypoints of several individuals over time, with their states and uncertainties; see `Trajectories`."""

    source: str = ""

    @staticmethod
    def of_file(trajectories: Trajectories, source: str) -> MotionTracks:
        """Return trajectories as a motion that knows the file it is from."""
        return MotionTracks(
            **{one.name: getattr(trajectories, one.name) for one in fields(Trajectories)}, source=source
        )

    def at_rate(self, rate_hz: float | None = None) -> MotionTracks:
        """Return the motion at a constant rate, as `mocapella.model.resampling.resampled` does [Hz].

        Raises:
            SettingsError: the rate is out of range.
        """
        return resampled(self, rate_hz)

    def joint_angles(self) -> AngleTracks:
        """Return the joint angles of people, as docs/joint-angles.md defines them, or a fitted model's own.

        Raises:
            SettingsError: the keypoints determine no angle; lists the topologies.
        """
        return AngleTracks.of(self)

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset` in the layout of ``movement``.

        Its dimensions are time, space, keypoints and individuals; its variables ``position`` [m], ``confidence`` (1
        measured, 0.5 inferred, 0 unknown), ``sd`` [m], ``state``, and ``angle`` [rad] where there are angles.

        Raises:
            SettingsError: xarray is not installed; names the extra.
        """
        return as_dataset(self, self.source)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` with a row for each keypoint of each individual that is present in a frame.

        Raises:
            SettingsError: pandas is not installed; names the extra.
        """
        return as_pandas(self)

    def to_polars(self) -> Any:
        """Return a `polars.DataFrame` with the rows of `to_pandas`.

        Raises:
            SettingsError: polars is not installed; names the extra.
        """
        return as_polars(self)

    def plot(self, keypoint: str | None = None) -> Any:
        """Return a matplotlib figure of one keypoint's coordinates over time, for each individual.

        Measured samples are lines; inferred ones are dots.

        Args:
            keypoint: name of the keypoint; None for the first.

        Raises:
            SettingsError: the keypoint is unknown, or matplotlib is not installed.
        """
        name = self.keypoints[0] if keypoint is None else keypoint
        if name not in self.keypoints:
            raise SettingsError(f"no keypoint {name!r}; known: {one_of(name, self.keypoints)}")
        k = self.keypoints.index(name)
        figure = needed("matplotlib.figure", extra="plots").Figure(figsize=(8.0, 6.0), layout="constrained")
        axes = figure.subplots(3, 1, sharex=True)
        for axis, letter in enumerate("xyz"):
            for i, individual in enumerate(self.individuals):
                values, states = self.positions[:, i, k, axis], self.states[:, i, k]
                (line,) = axes[axis].plot(
                    self.times_s, np.where(states == JointState.TRACKED, values, np.nan), label=individual
                )
                inferred = states == JointState.INFERRED
                axes[axis].plot(self.times_s[inferred], values[inferred], ".", ms=2, color=line.get_color(), alpha=0.5)
            axes[axis].set_ylabel(f"{letter} [m]")
        axes[0].set_title(f"{name} (dots: inferred)")
        axes[0].legend(loc="upper right", fontsize="small")
        axes[2].set_xlabel("time [s]")
        return figure

    def show(self, height_px: int = 480) -> MotionView:
        """Return a view of the motion in 3D for a notebook's cell: drag to turn it, and use the wheel to come nearer.

        Args:
            height_px: height of the view [px].

        Raises:
            SettingsError: nothing is known, or the motion is too long for a page.
        """
        return MotionView(page_of(self, self.source), height_px)

    def __repr__(self) -> str:
        seconds = float(self.times_s[-1] - self.times_s[0]) if len(self) else 0.0
        return (
            f"<{self.kind}: {', '.join(self.individuals)}; {len(self.keypoints)} keypoints, {len(self)} frames in "
            f"{seconds:.1f} s>"
        )

    def _repr_html_(self) -> str:
        if not len(self):
            return f"<p>{html.escape(repr(self))}</p>"
        shares = "".join(
            f"<tr><td>{html.escape(name)}</td><td>{present.mean():.0%}</td><td>{measured:.0%}</td></tr>"
            for name, present, measured in zip(self.individuals, self.present.T, self._measured(), strict=True)
        )
        head = "<tr><th>individual</th><th>frames present</th><th>keypoints measured while present</th></tr>"
        return f"<p>{html.escape(repr(self))}</p><table>{head}{shares}</table>"

    def _measured(self) -> list[float]:
        tracked = self.states == JointState.TRACKED
        present = self.present
        return [
            float(tracked[present[:, i], i].mean()) if present[:, i].any() else 0.0
            for i in range(len(self.individuals))
        ]
