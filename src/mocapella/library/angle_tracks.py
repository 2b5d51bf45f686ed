"""Joint angles as other libraries take them: pandas, polars and matplotlib."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mocapella.exports.angle_plot import angle_figure
from mocapella.exports.angle_tables import angles_as_pandas, angles_as_polars
from mocapella.model.joint_angles import JointAngles


@dataclass(frozen=True, eq=False, repr=False)
class AngleTracks(JointAngles):
    """Joint angles of several individuals over time, with their states and uncertainties; see `JointAngles`."""

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` with a row for each angle of each individual with a known one in a frame.

        Raises:
            SettingsError: pandas is not installed; names the extra.
        """
        return angles_as_pandas(self)

    def to_polars(self) -> Any:
        """Return a `polars.DataFrame` with the rows of `to_pandas`.

        Raises:
            SettingsError: polars is not installed; names the extra.
        """
        return angles_as_polars(self)

    def plot(self, *names: str) -> Any:
        """Return a matplotlib figure of angles over time [degrees]; both sides of an angle share a panel.

        Left sides are solid and right sides dashed. Lines are measured angles, dots inferred ones; the band is one
        standard deviation.

        Args:
            names: names of the angles, such as ``knee_angle_r``; all that are ever known without any.

        Raises:
            SettingsError: an angle is unknown, none is ever known, or matplotlib is not installed.
        """
        return angle_figure(self, names)

    def __repr__(self) -> str:
        known = np.isfinite(self.angles)
        return (
            f"<joint angles of {self.kind}: {', '.join(self.individuals)}; {len(self.names)} angles, {len(self)} "
            f"frames, {known.mean() if known.size else 0.0:.0%} known>"
        )
