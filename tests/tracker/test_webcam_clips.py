"""The method webcams on two clips of Pose2Sim with OpenPose's raw detections, against the authors' result."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support.webcam_clips import DATA, arrivals_of, result_of, rig_of
from support.webcam_people import last_of_each, run

from mocapella.tracker.webcams import WebcamsTracker

Float64 = NDArray[np.float64]

pytestmark = pytest.mark.slow

CLIPS = [
    ("pose2sim_two_people", ("P1_0-100", "P2_0-100"), 0.025, 0.080),
    ("pose2sim_single_person", ("BalancingTrial_0-100",), 0.025, 0.080),
]


@pytest.mark.parametrize(("clip", "results", "median_m", "p95_m"), CLIPS, ids=[clip[0] for clip in CLIPS])
def test_people_of_a_clip_are_found_in_all_frames_and_nobody_else(
    clip: str, results: tuple[str, ...], median_m: float, p95_m: float
) -> None:
    if not (DATA / clip).is_dir():
        pytest.skip(f"{clip} is not there")
    rig = rig_of(DATA / clip)
    tracker = WebcamsTracker(rig)
    scenes = last_of_each(run(tracker, arrivals_of(DATA / clip, rig)))
    assert len(scenes) == 100
    assert {len(scene.people) for scene in scenes} == {len(results)}
    assert len({one.id for scene in scenes for one in scene.people}) == len(results)
    for name in results:
        truth = result_of(next((DATA / clip / "pose-3d").glob(f"*{name}.trc")))
        errors: list[Float64] = []
        for scene, expected in zip(scenes, truth, strict=True):
            apart = [np.linalg.norm(one.positions - expected, axis=1) for one in scene.people]
            errors.append(min(apart, key=lambda one: float(np.nanmedian(one))))
        known = np.array(errors)[np.isfinite(errors)]
        assert np.median(known) <= median_m
        assert np.percentile(known, 95) <= p95_m
