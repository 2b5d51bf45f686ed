"""Detections that are compared with people at known places: laws of the pairs, and of strangers in people's stead."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.association.image_agreement import CONTRARY, image_agreement
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.tracker.webcams_conditions import LEAST_MET, count_strangers, elsewhere, place_of, problems
from mocapella.tracker.webcams_memory import no_counts
from mocapella.tracker.webcams_warmup import circle_of_cameras, standing_person

RIG = circle_of_cameras(3)
CAMERA = next(iter(RIG.cameras.values()))


def crowd(places: list[float]) -> np.ndarray:
    return np.array([standing_person() + np.array([x, 0.0, 0.0]) for x in places])


def pixels(joints: np.ndarray) -> np.ndarray:
    return project(apply(CAMERA.T_camera_world, joints), CAMERA.camera.lens)


@given(order=st.permutations([0, 1, 2]), shift_px=st.floats(-3.0, 3.0))
def test_each_detection_is_of_its_person_in_any_order(order: list[int], shift_px: float) -> None:
    joints = crowd([-0.9, 0.0, 0.9])
    found = image_agreement(pixels(joints)[order] + shift_px, joints, CAMERA)
    assert sorted(found.pairs) == list(enumerate(order))
    assert found.contrary == 0
    assert np.nanmax([found.far[i, k] for i, k in found.pairs]) == pytest.approx(abs(shift_px) * 2**0.5, abs=1e-6)


def test_a_stranger_in_a_persons_stead_contradicts() -> None:
    here, there = crowd([0.0]), crowd([0.9])
    assert image_agreement(pixels(there), here, CAMERA).contrary == 1
    assert image_agreement(pixels(crowd([0.0, 0.9])), here, CAMERA).contrary == 0  # a bystander beside the person
    assert image_agreement(np.empty((0, 26, 2)), here, CAMERA).contrary == 0  # nobody: hidden, or missed
    few = np.where(np.arange(26)[:, None] < 7, pixels(there), np.nan)
    assert image_agreement(few, here, CAMERA).contrary == 0  # too few keypoints to be somebody
    behind = np.linalg.inv(CAMERA.T_camera_world)[:3, :3] @ np.array([0.0, 0.0, -20.0])
    assert image_agreement(pixels(there), here + behind, CAMERA).contrary == 0  # not in the image


def counted(*shares: float, met: float = 100.0) -> np.ndarray:
    counts = no_counts(len(shares))
    counts.met[:] = met
    counts.contrary[:] = met * np.array(shares)
    return elsewhere(counts)


def test_a_camera_is_elsewhere_if_it_stands_out() -> None:
    assert counted(0.0, 0.01, 0.3).tolist() == [False, False, True]
    assert counted(0.0, 0.01, CONTRARY / 2).tolist() == [False] * 3
    assert counted(0.2, 0.24, 0.27).tolist() == [False] * 3  # all: the calibration is poor
    assert counted(0.0, 0.3).tolist() == [True, True]
    assert counted(0.0, 0.3, met=LEAST_MET - 1).tolist() == [False, False]


def test_a_camera_that_is_put_right_is_forgiven_and_the_remedy_is_told() -> None:
    counts = no_counts(2)
    here, there = crowd([0.0]), crowd([0.9])
    for _ in range(30):
        count_strangers(counts, 0, pixels(there), here, CAMERA)
    places = tuple(place_of(one) for one in list(RIG.cameras.values())[:2])
    told = problems(places, counts, "calibrate again")
    for remedy in ("sees another room", "is mirrored or upside down", "switch mirroring off, or calibrate again"):
        assert all(remedy in one.problem for one in told)
    for _ in range(1000):
        count_strangers(counts, 0, pixels(here), here, CAMERA)
    assert problems(places, counts) == places
