"""Pointing at a plane: a ray hits what it points at, and corners are learnt from rays of two places, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import CalibrationError, SettingsError
from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import exp_twist
from mocapella.kinematics.pointing import CornerLearning, CornerSettings, plane_corners, plane_hit, ray_of
from mocapella.model.arms import ARM_POINTS, ELBOW
from mocapella.model.scene import TrackedArm

UNIT, METRES, SEED = st.floats(0, 1), st.floats(-3, 3), st.integers(0, 2**32 - 1)
PLANE = np.array([[-0.5, 1.4, 0.4], [0.5, 1.3, 0.4], [-0.5, 0.2, 0.6]])
PLACES = np.array([[-0.7, 1.2, 2.4], [0.7, 1.1, 2.5]])


@given(UNIT, UNIT, st.tuples(METRES, METRES, st.floats(0.7, 3)))
def test_a_ray_through_a_place_of_the_plane_hits_it(x: float, y: float, origin: tuple[float, ...]) -> None:
    place = PLANE[0] + x * (PLANE[1] - PLANE[0]) + y * (PLANE[2] - PLANE[0])
    towards = place - np.array(origin)
    np.testing.assert_allclose(plane_hit(np.array(origin), towards, PLANE), (x, y), atol=1e-7)
    assert np.isnan(plane_hit(np.array(origin), -towards, PLANE)).all()  # away from the plane


def test_a_ray_along_the_plane_and_an_unknown_one_hit_nothing() -> None:
    assert np.isnan(plane_hit(np.array([0.0, 0.0, 2.0]), PLANE[1] - PLANE[0], PLANE)).all()
    assert np.isnan(plane_hit(np.zeros(3), np.full(3, np.nan), PLANE)).all()


def taught(plane: np.ndarray, places: np.ndarray, *, noise_deg: float = 0.0, seed: int = 0) -> CornerLearning:
    """A learner that saw a hand point at each corner from each place for two seconds, ten frames a second."""
    learning, rng, frame = CornerLearning(), np.random.default_rng(seed), 0
    for place in places:
        for corner in plane:
            for _ in range(20):
                towards = (corner - place) / np.linalg.norm(corner - place)
                towards = towards + rng.normal(0, np.radians(noise_deg), 3)
                learning.update(place, 0.08 * towards, frame / 10)
                frame += 1
            frame += 10  # the hand goes on, uncertain
    return learning


@given(SEED)
def test_corners_are_where_the_rays_meet_in_any_frame(seed: int) -> None:
    T = exp_twist(np.random.default_rng(seed).normal(size=6))
    learning = taught(apply(T, PLANE), apply(T, PLACES))
    assert learning.request == ""
    np.testing.assert_allclose(learning.corners(), apply(T, PLANE), atol=1e-7)


@given(SEED)
def test_noise_is_averaged_over_the_time_of_holding(seed: int) -> None:
    learning = taught(PLANE, PLACES, noise_deg=0.7, seed=seed)
    assert np.linalg.norm(learning.corners() - PLANE, axis=-1).max() < 0.05  # one ray is 25 mm off at 2 m


def test_each_corner_is_asked_for_once_from_each_place_and_taken_when_held_long_enough() -> None:
    learning, asked = CornerLearning(), []
    for place in PLACES:
        for corner in PLANE:
            asked.append(learning.request)
            takes = [learning.update(place, corner - place, 10 * len(asked) + k / 30) for k in range(90)]
            assert takes.index(True) == 45  # at 1.5 s
            assert sum(takes) == 1  # and not again, however long it is held
    names = ("top left", "top right", "bottom left")
    assert [name in request for name, request in zip(names * 2, asked, strict=True)] == [True] * 6
    assert ["to the side" in request for request in asked] == [False] * 3 + [True] + [False] * 2
    assert learning.request == ""
    assert not learning.update(PLACES[0], PLANE[0] - PLACES[0], 99.0)
    learning.reset()
    assert learning.request == asked[0]


def test_a_hand_that_turns_moves_or_is_lost_at_times_is_not_still() -> None:
    towards = PLANE[0] - PLACES[0]
    for ray in (
        lambda k: (PLACES[0], np.array([np.sin(0.01 * k), 0, np.cos(0.01 * k)])),
        lambda k: (PLACES[0] + np.array([0.003 * k, 0, 0]), towards),
        lambda k: (PLACES[0], towards * (1.0 if k % 10 else np.nan)),
        lambda k: (PLACES[0], 0.0 * towards),
    ):
        learning, step_s = CornerLearning(CornerSettings(gap_s=0.05)), 1 / 30
        assert not any(learning.update(*ray(k), k * step_s) for k in range(300))


def test_corners_that_the_rays_do_not_determine_are_refused() -> None:
    with pytest.raises(CalibrationError, match="not all corners are taught; point at the top left corner"):
        CornerLearning().corners()
    beside = PLACES[0] + np.array([[0.0, 0, 0], [0.1, 0, 0]])
    with pytest.raises(CalibrationError, match=r"differ by \d degrees only.*farther apart"):
        taught(PLANE, beside).corners()
    in_line = np.array([[0.0, 1.0, 0.0], [0.5, 1.0, 0.0], [-0.5, 1.0, 0.0]])
    with pytest.raises(CalibrationError, match="in a line"):
        taught(in_line, PLACES).corners()
    other = CornerLearning()
    for place, plane in zip(PLACES, (PLANE, PLANE + np.array([0.0, 0.8, 0.0])), strict=True):
        for k, corner in enumerate(plane):
            for frame in range(60):
                other.update(place, corner - place, 10 * k + 40 * (place[0] > 0) + frame / 30)
    with pytest.raises(CalibrationError, match="top left corner: its two rays miss each other by"):
        other.corners()
    behind = CornerLearning()
    for k, (place, corner) in enumerate((p, c) for p in PLACES for c in PLANE):
        for frame in range(60):
            behind.update(place, place - corner, 10 * k + frame / 30)
    with pytest.raises(CalibrationError, match="meet behind a hand"):
        behind.corners()


def arm(states: int = 2, sd: float = 0.005, cameras: tuple[str, ...] = ("depth",)) -> TrackedArm:
    points, count = np.arange(3.0 * len(ARM_POINTS)).reshape(-1, 3), len(ARM_POINTS)
    return TrackedArm(
        1, False, points, np.full(count, states, np.uint8), np.full(count, sd, np.float32), np.zeros(21), None,
        "", 0.0, False, cameras=cameras,
    )  # fmt: skip


def test_an_arm_points_out_of_its_tip_and_an_uncertain_one_does_not() -> None:
    for by, begin, tip in (("index", 5, 8), ("forearm", ELBOW, 0)):
        ray = ray_of(arm(), by)
        assert ray is not None
        np.testing.assert_array_equal(ray, (arm().points[tip], arm().points[tip] - arm().points[begin]))
    for unsure in (None, arm(states=1), arm(sd=0.04), arm(sd=np.nan), arm(cameras=())):
        assert ray_of(unsure, "index") is None


def test_corners_in_a_line_are_no_plane() -> None:
    assert plane_corners(PLANE.ravel()).tolist() == PLANE.tolist()
    for numbers in ([0.0] * 9, [0, 0, 0, 1, 1, 1, 2, 2, 2], [np.nan] * 9):
        with pytest.raises(SettingsError, match=r"--corners is .* not in a line"):
            plane_corners(numbers, "--corners")


@pytest.mark.parametrize("name", list(CornerSettings.__dataclass_fields__))
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        CornerSettings(**{name: 0.0})
