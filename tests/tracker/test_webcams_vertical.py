"""The method webcams finds the upward direction of its world from people who stand in it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.webcam_people import frames, run, walker

from mocapella.geometry.rigid import rigid
from mocapella.geometry.twists import exp_twist
from mocapella.library.keypoint_tracking import UP
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.topology import topology
from mocapella.testing.trackers import check_tracker
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_identity import floor_of
from mocapella.tracker.webcams_memory import LONG_SEEN, PeopleArrays, no_people
from mocapella.tracker.webcams_vertical import FIRST_COUNT, Vertical, upward
from mocapella.tracker.webcams_warmup import circle_of_cameras, standing_person

Float64 = NDArray[np.float64]

FOUR = circle_of_cameras(4)
Y = np.array([0.0, 1.0, 0.0])
NECK, HIP = (topology("halpe_26").index(name) for name in ("Neck", "Hip"))
AXES = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]


def people_of(joints: Float64) -> PeopleArrays:
    """One confirmed person whom two cameras see."""
    people = no_people(10, 4)
    people.ids[0], people.cameras[0], people.positions[0] = 0, 2, joints
    people.sure[0], people.heights[0] = LONG_SEEN, joints[:, 1]
    return people


def standing_along(up: Float64) -> Float64:
    """A person (26, 3) who stands along a direction (3,)."""
    axis = np.cross(Y, up)
    angle = np.arctan2(np.linalg.norm(axis), Y @ up)
    axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return standing_person() @ exp_twist(np.r_[np.zeros(3), angle * axis])[:3, :3].T


@pytest.mark.parametrize("up", AXES)
def test_the_axis_along_which_people_stand_is_upward(up: Float64) -> None:
    people, vertical = people_of(standing_along(up)), Vertical()
    changes = [vertical.update(people) for _ in range(4 * FIRST_COUNT)]
    np.testing.assert_array_equal(vertical.up, up)
    assert changes[: FIRST_COUNT - 1] == [False] * (FIRST_COUNT - 1)
    assert sum(changes) == (up @ Y < 1)
    heights = people.positions[0] @ up
    np.testing.assert_allclose(people.heights[0], heights, atol=1e-12)
    people.height_variances[0] = 0.0
    assert floor_of(people, vertical.up) == pytest.approx(heights.min(), abs=0.15)


@given(st.integers(0, 5), st.floats(0.0, 19.0), st.floats(0.0, 2 * np.pi))
def test_a_direction_near_an_axis_is_the_axis(which: int, degrees: float, turn: float) -> None:
    axis = AXES[which]
    aside = np.cross(axis, np.roll(axis, 1))
    aside = np.cos(turn) * aside + np.sin(turn) * np.cross(axis, aside)
    found = upward(0.9 * (np.cos(np.radians(degrees)) * axis + np.sin(np.radians(degrees)) * aside))
    assert found is not None
    np.testing.assert_array_equal(found, axis)


@given(st.floats(25.0, 65.0))
def test_a_tilted_world_has_its_own_direction(degrees: float) -> None:
    mean = 0.9 * np.array([0.0, np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    found = upward(mean)
    assert found is not None
    np.testing.assert_allclose(found, mean / 0.9)


def test_bodies_that_differ_and_bent_bodies_tell_no_direction() -> None:
    assert upward(np.array([0.0, 0.5, 0.5])) is None
    bent, lying = standing_along(Y), standing_along(np.array([0.0, 0.0, 1.0]))
    above = np.arange(26) != HIP
    above &= bent[:, 1] > bent[HIP, 1]
    bent[above] = bent[HIP] + (bent[above] - bent[HIP])[:, [0, 2, 1]]  # the trunk is level
    vertical = Vertical()
    assert not any(vertical.update(people_of(bent)) for _ in range(4 * FIRST_COUNT))
    assert not vertical.compared
    assert not any(vertical.update(people_of(one)) for _ in range(40) for one in (lying, standing_along(Y)))
    np.testing.assert_array_equal(vertical.up, Y)


def test_who_lay_at_first_and_then_stands_tells_the_direction_again() -> None:
    vertical, lying = Vertical(), people_of(standing_along(np.array([0.0, 0.0, 1.0])))
    assert any(vertical.update(lying) for _ in range(FIRST_COUNT))
    assert any(vertical.update(people_of(standing_along(Y))) for _ in range(20 * FIRST_COUNT))
    np.testing.assert_array_equal(vertical.up, Y)


def in_world(up: str) -> CameraRig:
    """The rig in a world where another axis is upward."""
    T_y_world = rigid(UP[up], np.zeros(3))
    return CameraRig({
        name: PlacedCamera(one.camera, one.T_camera_world @ T_y_world, one.covariance)
        for name, one in FOUR.cameras.items()
    })  # fmt: skip


def path(at_s: float) -> tuple[float, float, float]:
    return 0.0, -max(at_s - 2.2, 0.0) * 0.9, np.pi


@pytest.mark.slow
@pytest.mark.parametrize("up", ["z", "-y"])
def test_a_person_before_one_camera_keeps_the_distance_in_every_world(up: str) -> None:
    R, there = UP[up], in_world(up)
    arrivals = frames(FOUR, [lambda t: walker(t, path)], seconds=3.4)
    kept = [one for one in arrivals if one.frame.sensor == "cam-0" or one.at_ns < 3.4e9]
    own, other = (run(WebcamsTracker(rig), kept)[-1].people[0] for rig in (FOUR, there))
    np.testing.assert_allclose(np.asarray(other.positions) @ R.T, own.positions, atol=0.12)


@pytest.mark.slow
def test_a_tracker_whose_upward_direction_changes_keeps_its_promises() -> None:
    there = in_world("z")
    arrivals = frames(FOUR, [lambda t: walker(t, path)], seconds=1.2)
    scenes = check_tracker(lambda: WebcamsTracker(there), arrivals)
    assert len(scenes[-1].people) == 1
