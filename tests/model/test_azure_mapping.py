"""The Azure Kinect's joints lie where the Kinect v2 has them: proportions of real people, who are different people."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mocapella.model.skeleton import SKELETON, skeleton_mapping
from mocapella.model.topology import topology
from mocapella.recording.body_csv import read_body_csv
from mocapella.recording.study_log import read_study_log

Lengths = dict[str, float]
SPINE = ("SpineBase", "SpineMid", "SpineShoulder", "Neck", "Head")
GESTURES = ("Ges01_wavehand", "Ges02_balancinghands", "Ges03_drawlines")
WALKERS = ("Study_0_Kinect_0", "Study_4_Kinect_0", "Study_8_Kinect_0")


def length(positions: NDArray[np.float64], start: str, end: str) -> float:
    """Median distance of two joints of skeletons (frames, 25, 3) [m]."""
    across = positions[:, SKELETON.index(end)] - positions[:, SKELETON.index(start)]
    return float(np.nanmedian(np.linalg.norm(across, axis=-1)))


def proportions(positions: NDArray[np.float64]) -> Lengths:
    """Bones of skeletons (frames, 25, 3), relative to the spine or to the limb that they continue [ratio]."""
    spine = length(positions, "SpineBase", "SpineShoulder")
    found = {f"{a}–{b}": length(positions, a, b) / spine for a, b in pairwise(SPINE)}
    found["hips"] = length(positions, "HipLeft", "HipRight") / spine
    for name, (start, end), (of_start, of_end) in (
        ("hand", ("Wrist", "Hand"), ("Elbow", "Wrist")),
        ("hand tip", ("Wrist", "HandTip"), ("Elbow", "Wrist")),
        ("thumb", ("Wrist", "Thumb"), ("Elbow", "Wrist")),
        ("foot", ("Ankle", "Foot"), ("Knee", "Ankle")),
    ):
        sides = [
            length(positions, start + side, end + side) / length(positions, of_start + side, of_end + side)
            for side in ("Left", "Right")
        ]
        found[name] = float(np.mean(sides))
    return found


@pytest.fixture(scope="module")
def kinect(kinect_v2_gestures: Path, study_logs: Path) -> dict[str, NDArray[np.float64]]:
    """The proportions in six recordings of a Kinect v2."""
    gestures = [read_body_csv(kinect_v2_gestures / f"{name}.csv.gz").positions for name in GESTURES]
    logs = [read_study_log(next(study_logs.glob(f"{name}*"))).positions for name in WALKERS]
    people = [proportions(positions.astype(np.float64)) for positions in (*gestures, *logs)]
    return {name: np.array([one[name] for one in people]) for name in people[0]}


@pytest.fixture(scope="module")
def azure(azure_and_vicon: Path) -> Lengths:
    mapping = skeleton_mapping("azure_kinect")
    assert mapping is not None
    rows = read_body_csv(azure_and_vicon / "azure_positions.csv.gz")
    return proportions(mapping.positions(rows.positions.astype(np.float64)))


def test_every_bone_has_the_proportion_that_the_kinect_v2_reports(
    azure: Lengths, kinect: dict[str, NDArray[np.float64]]
) -> None:
    residuals = {name: round(azure[name] - float(np.median(kinect[name])), 3) for name in azure}
    largest = dict.fromkeys(residuals, 0.05) | {f"{a}–{b}": 0.02 for a, b in pairwise(SPINE)}
    assert {name: off for name, off in residuals.items() if abs(off) > largest[name]} == {}, residuals


def test_joints_of_the_same_name_are_elsewhere(azure_and_vicon: Path, kinect: dict[str, NDArray[np.float64]]) -> None:
    rows = read_body_csv(azure_and_vicon / "azure_positions.csv.gz")
    spine = [
        rows.positions[:, rows.topology.index(n)] for n in ("PELVIS", "SPINE_NAVEL", "SPINE_CHEST", "NECK", "HEAD")
    ]
    bones = [float(np.nanmedian(np.linalg.norm(b - a, axis=-1))) for a, b in pairwise(spine)]
    named = dict(zip((f"{a}–{b}" for a, b in pairwise(SPINE)), np.array(bones) / sum(bones[:2]), strict=True))
    assert named["SpineShoulder–Neck"] > 4 * kinect["SpineShoulder–Neck"].max()


PARTS = (("Shoulder", "Elbow"), ("Elbow", "Wrist"), ("Hip", "Knee"), ("Knee", "Ankle"))
BONES = [*pairwise(SPINE), *((a + side, b + side) for a, b in PARTS for side in ("Left", "Right"))]


def scatter(positions: NDArray[np.float64]) -> tuple[float, float]:
    """Standard deviation of the size of skeletons (frames, 25, 3), and of their bones' proportions [ratio]."""
    lengths = np.stack(
        [np.linalg.norm(positions[:, SKELETON.index(a)] - positions[:, SKELETON.index(b)], axis=-1) for a, b in BONES]
    )
    relative = np.log(lengths / np.nanmedian(lengths, axis=1, keepdims=True))
    size = np.nanmedian(relative, axis=0)
    return float(size.std()), float(np.nanmean(np.nanstd(relative - size, axis=1)))


def test_skeletons_of_fixed_proportions_change_their_size(azure_and_vicon: Path, kinect_v2_gestures: Path) -> None:
    """So the topology says; the body model follows their joints closely and their size, see docs/sensors.md."""
    rigid, mapping = topology("azure_kinect"), skeleton_mapping("azure_kinect")
    assert mapping is not None
    rows = read_body_csv(azure_and_vicon / "azure_positions.csv.gz")
    size, proportions = scatter(mapping.positions(rows.positions.astype(np.float64)))
    gestures = [read_body_csv(kinect_v2_gestures / f"{name}.csv.gz").positions for name in GESTURES]
    others = [scatter(positions.astype(np.float64)) for positions in gestures]
    assert proportions < rigid.noise * np.mean([other for _, other in others])
    assert 0.5 * rigid.scale_sd < size < 2 * rigid.scale_sd
    assert max(other for other, _ in others) < 0.5 * rigid.scale_sd
