"""The boxes where a detector is told to expect people."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.observations import JointState
from mocapella.model.scene import Person
from mocapella.tracker.expected_regions import FEWEST, MARGIN, expected_regions
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_warmup import circle_of_cameras, standing_person

CAMERA = circle_of_cameras(2).cameras["cam-0"]
SIZE = np.array(CAMERA.camera.size_px)


def person(joints: NDArray[np.float64], known: int = 26) -> Person:
    states = np.full(26, JointState.NOT_TRACKED, dtype=np.uint8)
    states[:known] = JointState.INFERRED
    return Person(0, joints, states, (), np.full(26, 0.01, dtype=np.float32), "", "")


def test_a_box_surrounds_the_known_joints_with_a_margin() -> None:
    pixels = project(apply(CAMERA.T_camera_world, standing_person()), CAMERA.camera.lens)
    (box,) = expected_regions([person(standing_person())], CAMERA)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    wider = MARGIN * (high - low).max()
    assert (low > wider).all()
    assert (high + wider < SIZE - 1).all()
    np.testing.assert_allclose(box, [*(low - wider), *(high + wider)], rtol=1e-5)


@pytest.mark.parametrize("step", [-1.0, 1.0])
def test_a_box_stays_within_the_image(step: float) -> None:
    aside = standing_person() + step * CAMERA.T_camera_world[0, :3]
    for box in expected_regions([person(aside), person(standing_person())], CAMERA):
        assert (box >= 0).all()
        assert (box <= [*(SIZE - 1), *(SIZE - 1)]).all()
        assert (box[:2] < box[2:]).all()


def test_people_with_few_known_joints_or_outside_the_image_have_no_box() -> None:
    behind = standing_person() - 20.0 * CAMERA.T_camera_world[2, :3]
    people = [person(standing_person(), FEWEST - 1), person(behind), person(standing_person(), FEWEST)]
    assert expected_regions(people, CAMERA).shape == (1, 4)
    assert expected_regions(people[:2], CAMERA).shape == (0, 4)
    assert expected_regions([], CAMERA).dtype == np.float32


def test_a_tracker_expects_nobody_before_its_first_scene_or_for_an_unknown_camera() -> None:
    tracker = WebcamsTracker(circle_of_cameras(2))
    for sensor in ("cam-0", "cam-9"):
        assert tracker.expected_regions(sensor).shape == (0, 4)
