"""Comparison of recordings from Python."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocapella.comparison.comparison import Compared, compared
from mocapella.comparison.joint_names import Terms, read_joint_map
from mocapella.exports.comparison_report import as_dict, figure_of, findings, write_report
from mocapella.exports.new_file import new_file
from mocapella.library.recording import Recording, load

if TYPE_CHECKING:
    from mocapella.model.trajectories import Trajectories


class Comparison:
    """A recording compared with a reference; `mocapella.compare` makes it.

    Attributes:
        result: arrays and estimates, see `mocapella.comparison.comparison.Compared`.
        titles: names of the two files by role.
    """

    def __init__(self, result: Compared, titles: Mapping[str, str]) -> None:
        self.result, self.titles = result, titles

    def to_dict(self) -> dict[str, Any]:
        """Return all figures as ``mocapella compare --json`` writes them: metres, seconds, radians."""
        return as_dict(self.result)

    def plot(self) -> Any:
        """Return a matplotlib figure: errors over time, curves of angles, and their limits of agreement.

        Raises:
            SettingsError: matplotlib is not installed; names the extra.
        """
        return figure_of(self.result)

    def report(self, path: Path | str) -> None:
        """Write the report as one HTML page; an existing file is replaced.

        Raises:
            SettingsError: matplotlib is not installed, and it names the extra; or the file cannot be written.
        """
        with new_file(Path(path), force=True) as part:
            write_report(self.result, part, self.titles)

    def __repr__(self) -> str:
        return "\n".join([f"<Comparison of {' and '.join(self.titles.values())}", *findings(self.result)]) + ">"


def compare(
    recording: Recording | Path | str,
    reference: Recording | Path | str,
    *,
    kind: str | None = None,
    people: Mapping[str, str] | None = None,
    joints: Mapping[str, Terms] | Path | str | None = None,
    remove_bias: bool = False,
    same_clock: bool = False,
    same_space: bool = False,
) -> Comparison:
    """Compare a recording with a reference: time, rate and rigid motion between them, and agreement of joints.

    comparison = mocapella.compare("walk-1.mcap", "vicon.c3d")

    Args:
        recording, reference: files for `mocapella.load`, or its results.
        kind: results to compare, such as ``people``; None for those with most joints in common.
        people: the reference's individual by the recording's; None to match them by their motion, or by their distance
            if clock and space are the same.
        joints: markers of the reference with weights, by joint of the recording, or a file of them; None for the
            names.
        remove_bias: whether each joint's mean difference is subtracted, such as of a marker beside the joint.
        same_clock: whether both have one clock, such as a take and its re-tracking; no time is estimated then.
        same_space: whether both are in the same coordinates; no rigid motion is estimated then.

    Raises:
        InputError, SchemaVersionError: a file cannot be read, as in `mocapella.load`.
        SettingsError: a side is empty, a name is unknown, or no joints match; lists both sides' names.
        EvaluationError: a side is too short, the motions differ, or the match of individuals is ambiguous.
    """
    sides = [one if isinstance(one, Recording) else load(one) for one in (recording, reference)]
    table = read_joint_map(Path(joints)) if isinstance(joints, Path | str) else joints
    found = compared(
        _by_kind(sides[0]), _by_kind(sides[1]), kind=kind, people=people, joints=table, remove_bias=remove_bias,
        same_clock=same_clock, same_space=same_space,
    )  # fmt: skip
    return Comparison(found, {"recording": sides[0].path.name, "reference": sides[1].path.name})


def _by_kind(one: Recording) -> dict[str, Trajectories]:
    return dict(one.motion)
