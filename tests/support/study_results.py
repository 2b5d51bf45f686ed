"""Results of studies that never were: differences with known means, spread, slopes and gaps, from a seed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np

from mocapella.model.topology import topology
from mocapella.studies.results import (
    BIN_M,
    BINS,
    TIMELINE_S,
    CleaningStep,
    ComparedViews,
    DifferenceSums,
    FileResults,
    MeasuredFigure,
    PoseStrip,
    StudyFinding,
    StudyResults,
)

KINECT = topology("kinect_v2").joints
MEANS_CM = {
    ("stationary", "parallel"): 1.9, ("stationary", "45"): 5.2, ("stationary", "90"): 8.1,
    ("steps", "parallel"): 2.2, ("steps", "45"): 5.0, ("steps", "90"): 9.3,
    ("walk", "parallel"): 5.6, ("walk", "45"): 8.1, ("walk", "90"): 11.4,
}  # fmt: skip


def differences(key: ComparedViews, courses_cm: np.ndarray, *, joints: int = 4, per_bin: int = 3) -> DifferenceSums:
    """Differences whose Δd in each timeline bin is this course (bins,), with a fixed factor for each joint."""
    factors = np.linspace(0.7, 1.3, joints)
    distances = np.abs(courses_cm[:, None]) / 100.0 * factors
    counts = np.full(distances.shape, per_bin)
    pairs = per_bin * len(distances)
    histogram = np.zeros((joints, BINS), np.int64)
    for joint, column in enumerate(distances.T):
        np.add.at(histogram[joint], np.minimum((column / BIN_M).astype(int), BINS - 1), per_bin)
    dd = distances.sum(axis=0) * per_bin
    sums = np.stack([dd * part for part in (0.6, 0.3, 0.5, 1.0)], axis=1)
    return DifferenceSums(
        key, pairs, sums, sums**2 / pairs, np.full(joints, pairs), histogram, distances.max(axis=0),
        distances * per_bin, counts,
    )  # fmt: skip


def study(
    seed: int = 0,
    *,
    participants: int = 10,
    means_cm: Mapping[tuple[str, str], float] = MEANS_CM,
    spread_cm: float = 0.5,
    noise_cm: float = 0.6,
    slope_cm_per_min: float = 0.0,
    seconds: float = 6.0,
    joints: tuple[str, ...] = ("Head", "Neck", "HandLeft", "HandRight"),
    missing: Collection[tuple[str, str]] = (),
    code: Callable[[int], str] = str,
    method: str = "stand-still",
) -> StudyResults:
    """A study in which participants differ by ``spread_cm``, and their tasks by ``noise_cm``.

    ``missing`` has pairs of a participant's number as a text and a placement that this one lacks.
    """
    rng = np.random.default_rng(seed)
    people = rng.normal(0.0, spread_cm, participants)
    bins = np.arange(round(seconds / TIMELINE_S)) * TIMELINE_S
    summaries = []
    for who in range(participants):
        for (task, placement), mean in means_cm.items():
            level = mean + people[who] + rng.normal(0.0, noise_cm)
            course = level + slope_cm_per_min * (bins - bins.mean()) / 60.0 + rng.normal(0.0, 0.05, len(bins))
            key = ComparedViews(method, placement, task, code(who), "front", "side")
            if (str(who), placement) not in missing:
                summaries.append(differences(key, course, joints=len(joints)))
    return gathered(tuple(summaries), joints)


def gathered(summaries: tuple[DifferenceSums, ...], joints: tuple[str, ...], **more: object) -> StudyResults:
    """Results with one recording for each participant and placement."""
    keys = sorted({(one.key.participant, one.key.placement) for one in summaries})
    files = tuple(
        FileResults(
            f"Study_{who}_Kinect_{place}.csv.gz", 1000, 960, joints,
            (CleaningStep("scenario 4 after 8 read as 8", 0, False), CleaningStep("rows without a partner", 40, True)),
        )
        for who, place in keys
    )  # fmt: skip
    finding = StudyFinding("Study_3_Kinect_90.csv.gz", "the file ends within a row", "the rows before are analysed", 1)
    return StudyResults(files, joints, tuple(sorted(summaries, key=lambda one: one.key)), (), (), (finding,), **more)  # type: ignore[arg-type]


def strip(task: str = "obstacle", participant: str = "7", person: int = 0, seed: int = 0) -> PoseStrip:
    """A standing person at five instants, whom the second sensor loses at one and sees in part at another."""
    rng = np.random.default_rng(seed)
    pose = standing() + np.array([0.4 * person - 0.2, 0.0, 2.4])
    at_s = np.array([0.0, 2.5, 5.0, 7.5, 10.0])
    positions = pose + rng.normal(0.0, 0.01, (5, 3, len(pose), 3)) + 0.1 * np.arange(5)[:, None, None, None] * [1, 0, 0]
    positions[2, 1] = np.nan
    measured = np.ones((5, 3, len(pose)), bool)
    measured[2:4, 2, 8:16] = False
    positions[3, 1, 12:20] = np.nan
    names = ("front", "side", "fused")
    return PoseStrip(
        "stand-still", "90", task, participant, person, names, at_s, positions.astype(np.float32), measured
    )


def standing() -> np.ndarray:
    """(25, 3) a standing body in the order of `KINECT`, facing the sensor [m]."""
    heights = {
        "SpineBase": (0, 0), "SpineMid": (0, 0.3), "Neck": (0, 0.55), "Head": (0, 0.7), "SpineShoulder": (0, 0.5),
        "Shoulder": (0.18, 0.48), "Elbow": (0.25, 0.2), "Wrist": (0.28, -0.03), "Hand": (0.29, -0.1),
        "HandTip": (0.29, -0.17), "Thumb": (0.24, -0.1), "Hip": (0.09, -0.02), "Knee": (0.1, -0.45),
        "Ankle": (0.1, -0.85), "Foot": (0.12, -0.9),
    }  # fmt: skip
    rows = []
    for name in KINECT:
        side = 1 if name.endswith("Left") else -1 if name.endswith("Right") else 0
        x, y = heights[name.removesuffix("Left").removesuffix("Right")]
        rows.append((side * x, y, 0.0))
    return np.array(rows)


def figures(value_cm: float = 3.0, seed: int = 0, participants: int = 8) -> tuple[MeasuredFigure, ...]:
    """Figures of the measure `filled`: an error in cm and the share that was not filled, in the obstacle task."""
    rng = np.random.default_rng(seed)
    found = []
    for who in range(participants):
        common = ("stand-still", "90", "obstacle", str(who), "side")
        found.append(
            MeasuredFigure("filled", "hidden joints", "cm", *common, value_cm + float(rng.normal(0, 0.5)), 100)
        )
        found.append(MeasuredFigure("filled", "hidden joints not filled", "%", *common, 9 + float(rng.normal()), 100))
    return tuple(found)
