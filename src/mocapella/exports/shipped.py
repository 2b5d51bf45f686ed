"""The exports that ship with Mocapella."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from mocapella.exports.export import TRAJECTORIES, Export
from mocapella.model.trajectories import PARTS

STUDY_LOG: Final = Export(
    interface=1,
    name="study-log",
    summary="The study log: the thesis' 87 columns, a row for each sensor's view of each person.",
    parts=("people",),
    command="mocapella.cli.export:study_log",
)
ARMS: Final = Export(
    interface=1,
    name="arms",
    summary="Arms in the world: a row for each joint of each arm, with its state.",
    parts=("arms",),
    command="mocapella.cli.export:arms",
)
JSON: Final = Export(
    interface=1,
    name="json",
    summary="Everything: a line of JSON for each result, with all fields of its parts.",
    parts=None,
    command="mocapella.cli.export:json_lines",
)


def _trajectories(
    name: str, summary: str, write: str, suffix: str, *, parts: tuple[str, ...] = tuple(PARTS), alone: bool = False,
    space: str = "world", with_labels: bool = False,
) -> Export:  # fmt: skip
    where = f"mocapella.exports.{write}"
    return Export(1, name, summary, parts, TRAJECTORIES, where, suffix, alone, alone, space, with_labels)


CSV: Final = _trajectories(
    "csv", "Table: a row for each keypoint of each frame, with its state and uncertainty.",
    "trajectory_tables:write_csv", ".csv", with_labels=True,
)  # fmt: skip
CSV_WIDE: Final = _trajectories(
    "csv-wide", "Table: a row for each frame, with columns for all keypoints.", "trajectory_tables:write_wide_csv",
    ".wide.csv", with_labels=True,
)  # fmt: skip
PARQUET: Final = _trajectories(
    "parquet", "The table of csv as Parquet, for polars, pandas and R.", "trajectory_tables:write_parquet", ".parquet",
    with_labels=True,
)  # fmt: skip
NPZ: Final = _trajectories(
    "npz", "All arrays, for numpy.load.", "trajectory_arrays:write_npz", ".npz", with_labels=True
)
NETCDF: Final = _trajectories(
    "netcdf", "A data set in the layout of movement, for xarray.", "trajectory_arrays:write_netcdf", ".nc",
    with_labels=True,
)  # fmt: skip
TRC: Final = _trajectories(
    "trc", "Markers for OpenSim: one individual, constant rate, metres, Y up.", "trc_file:write_trc", ".trc",
    alone=True,
)  # fmt: skip
C3D: Final = _trajectories(
    "c3d", "Points for biomechanics: one individual, constant rate, millimetres.", "c3d_file:write_c3d", ".c3d",
    alone=True, with_labels=True,
)  # fmt: skip
_WITH_BONES: Final = ("people", "hands", "arms", "bodies")


def _animation(name: str, summary: str, write: str, suffix: str) -> Export:
    return replace(_trajectories(name, summary, write, suffix, parts=_WITH_BONES, alone=True), humanoids=True)


BVH: Final = _animation(
    "bvh", "Animated skeleton for Blender and games: one individual, constant rate, centimetres.", "bvh_file:write_bvh",
    ".bvh",
)  # fmt: skip
GLB: Final = _animation(
    "glb", "Animated skeleton with a skin (glTF, VRM animation): one individual, metres.", "glb_file:write_glb", ".glb"
)
USD: Final = _animation(
    "usd", "Animated skeleton with a skin (UsdSkel): one individual, metres.", "usd_file:write_usd", ".usda"
)
HTML: Final = _trajectories(
    "html", "A page that plays the motion in 3D in any browser, without a server.", "motion_page:write_page", ".html"
)
ANGLES: Final = _trajectories(
    "angles", "Table of joint angles: a row for each angle of each frame, with its state and uncertainty.",
    "angle_tables:write_angles", ".angles.csv", parts=_WITH_BONES, with_labels=True,
)  # fmt: skip
ANGLES_PLOT: Final = _trajectories(
    "angles-plot", "Picture of all joint angles over time, a panel for each angle (PNG).",
    "angle_plot:write_angle_plot", ".angles.png", parts=_WITH_BONES,
)  # fmt: skip
MOT: Final = _trajectories(
    "mot", "Joint angles as OpenSim's coordinates: one person, constant rate, degrees.", "storage_file:write_mot",
    ".mot", parts=("people",), alone=True, space="opensim",
)  # fmt: skip
STO: Final = _trajectories(
    "sto", "All joint angles in OpenSim's storage: one individual, constant rate, degrees.", "storage_file:write_sto",
    ".sto", parts=_WITH_BONES, alone=True, space="opensim",
)  # fmt: skip
OPENSIM: Final = _trajectories(
    "opensim", "Folder for OpenSim: TRC, skeleton, and set-ups of scaling and inverse kinematics.",
    "opensim_folder:write_opensim", ".opensim", parts=("people",), alone=True, space="opensim",
)  # fmt: skip
ROSBAG2: Final = _trajectories(
    "rosbag2", "Bag for ROS 2, RViz and Foxglove: transforms, markers and joint states.", "rosbag2:write_rosbag2",
    ".rosbag2",
)  # fmt: skip
