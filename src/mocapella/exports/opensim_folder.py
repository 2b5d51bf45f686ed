"""Write what OpenSim needs to scale a skeleton and to solve inverse kinematics: one folder for one person."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, visible
from mocapella.exports.opensim_model import (
    MIDDLES,
    SOLES,
    OpenSimSkeleton,
    ik_xml,
    measurements,
    model_xml,
    scale_xml,
    skeleton_for,
)
from mocapella.exports.storage_file import write_mot
from mocapella.exports.trc_file import write_trc
from mocapella.model.anatomy import anatomy_of, with_body
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories

_NEEDED: Final = ("hip_r", "hip_l", "shoulder_r", "shoulder_l", "knee_r", "knee_l")
_README: Final = """\
OpenSim scaling and inverse kinematics of {name}, written by Mocapella

    opensim-cmd run-tool scale.xml     # writes scaled.osim and scale_factors.xml
    opensim-cmd run-tool ik.xml        # writes ik.mot and mocapella_ik_marker_errors.sto

Run these in this folder, with OpenSim 4. In Python: opensim.ScaleTool("scale.xml").run() and
opensim.InverseKinematicsTool("ik.xml").run(). In the program: File, Open Model, scaled.osim; File, Load Motion, ik.mot.

markers.trc   the joints, and points for the scaling between them, X forward, Y up [m]; unknown ones are NaN
angles.mot    joint angles that Mocapella computes without a model; unknown ones are NaN
model.osim    a skeleton of average lengths, with a marker at each joint; no muscles
scale.xml     scales each body by the distances between joints from {begin:.2f} to {end:.2f} s
ik.xml        fits the scaled skeleton to markers.trc

The joints are estimates of joint centres, not markers on the skin. docs/joint-angles.md of Mocapella defines the
angles, and says which of them joints do not determine: of these, the inverse kinematics gives a value nevertheless.
"""


def write_opensim(trajectories: Trajectories, path: Path) -> list[str]:
    """Write a folder with markers.trc, angles.mot, model.osim, scale.xml, ik.xml and README.txt.

    Args:
        trajectories: one person at a constant rate, with the axes of OpenSim's ground: X forward, Y up.
        path: the folder, which must not exist.

    Returns:
        Sentences about unknown angles and joints.

    Raises:
        SettingsError: the keypoints are of no body, or the joints for the scaling are never all known in two frames in
            a row.
        OSError: a file cannot be written.
    """
    anatomy = anatomy_of(trajectories.keypoints)
    skeleton = skeleton_for(trajectories.keypoints, anatomy)
    if not all(point in skeleton.points for point in _NEEDED):
        raise SettingsError(
            f"no skeleton for OpenSim: the keypoints of {trajectories.kind} are of no body; topologies with one: "
            f"{', '.join(with_body())}"
        )
    all_markers = _with_made(trajectories, skeleton)
    first, last = _longest(_known(all_markers, skeleton))
    if last <= first:
        raise SettingsError(f"{trajectories.individuals[0]} has no two frames in a row with all joints for the scaling")
    path.mkdir()
    times = trajectories.times_s - trajectories.times_s[0]
    write_trc(all_markers, path / "markers.trc")
    notes = write_mot(trajectories, path / "angles.mot")
    begin, end = float(times[first]), float(times[last])
    for name, text in (
        ("model.osim", model_xml(skeleton)),
        ("scale.xml", scale_xml(skeleton, begin, end)),
        ("ik.xml", ik_xml(skeleton, float(times[-1]))),
        ("README.txt", _README.format(name=visible(trajectories.individuals[0]), begin=begin, end=end)),
    ):
        (path / name).write_text(text, encoding="utf-8", newline="")
    return notes


def _with_made(own: Trajectories, skeleton: OpenSimSkeleton) -> Trajectories:
    """Return trajectories with the keypoints of `MIDDLES` and `SOLES` that the skeleton has; their sd is unknown."""
    at = {point: own.positions[:, :, own.keypoints.index(name)] for point, name in skeleton.points.items()}
    made = []
    for name in skeleton.made:
        if name in MIDDLES:
            a, b = (at[point] for point in MIDDLES[name])
            made.append(0.5 * (a + b))
        else:
            point, a, b = (at[point] for point in SOLES[name])
            with np.errstate(invalid="ignore", divide="ignore"):
                share = np.sum((point - a) * (b - a), axis=2, keepdims=True) / np.sum(
                    (b - a) ** 2, axis=2, keepdims=True
                )
            made.append(a + share * (b - a))
    positions = np.stack(made, axis=2)
    states = np.where(np.isfinite(positions).all(axis=3), JointState.INFERRED, JointState.NOT_TRACKED)
    return replace(
        own, keypoints=(*own.keypoints, *skeleton.made), positions=np.concatenate([own.positions, positions], axis=2),
        sd=np.concatenate([own.sd, np.full(states.shape, np.nan, np.float32)], axis=2),
        states=np.concatenate([own.states, states.astype(np.uint8)], axis=2),
    )  # fmt: skip


def _known(trajectories: Trajectories, skeleton: OpenSimSkeleton) -> NDArray[np.bool_]:
    """Return whether all joints of the scaling's marker pairs are known (frames,)."""
    used = {name for pairs, _ in measurements(skeleton).values() for pair in pairs for name in pair}
    columns = [trajectories.keypoints.index(name) for name in sorted(used)]
    return np.asarray(np.isfinite(trajectories.positions[:, 0, columns]).all(axis=(1, 2)))


def _longest(known: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first and the last index of the longest run of True; 0, -1 without one."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(np.int8)))
    if not len(edges):
        return 0, -1
    begins, ends = edges[::2], edges[1::2]
    k = int(np.argmax(ends - begins))
    return int(begins[k]), int(ends[k]) - 1
