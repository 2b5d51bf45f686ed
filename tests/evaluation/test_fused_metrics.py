"""What a fused skeleton is measured by: laws, motions whose figures are known, and the figures of the real logs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.evaluation_sessions import KINECT, body, walker

from mocapella.evaluation import fused_metrics as metrics
from mocapella.geometry import rigid

T60 = np.arange(60) / 30
TIMES, WALKER = walker(120)


@given(yaw=st.floats(-3, 3), x=st.floats(-2, 2), z=st.floats(-2, 2))
def test_where_the_room_begins_and_which_way_it_faces_changes_nothing(yaw: float, x: float, z: float) -> None:
    moved = rigid.apply(rigid.rigid(rigid.rotation_about_y(yaw), [x, 0.3, z]), WALKER)
    for one, other in ((WALKER, moved),):
        assert metrics.bone_length_variation(other) == pytest.approx(metrics.bone_length_variation(one))
        assert metrics.jitter(other) == pytest.approx(metrics.jitter(one))
        assert metrics.foot_slide(other, TIMES) == pytest.approx(metrics.foot_slide(one, TIMES))
        assert metrics.shoulder_collapse(other) == metrics.shoulder_collapse(one)
        assert metrics.facing_against_motion(other, TIMES) == metrics.facing_against_motion(one, TIMES)
        assert metrics.yaw_reversals(other, TIMES) == metrics.yaw_reversals(one, TIMES)
        assert metrics.label_flips(other) == metrics.label_flips(one)


def test_jitter_is_of_the_noise_and_not_of_the_motion() -> None:
    gliding = body() + T60[:, None, None] * [0.7, 0, 0.2]
    assert metrics.jitter(gliding) == pytest.approx(0, abs=1e-12)
    noise = np.random.default_rng(0).normal(size=(4000, 25, 3)) * 0.01
    # The second difference of independent noise has the variance 1 + 4 + 1, in each of three coordinates.
    assert metrics.jitter(noise) == pytest.approx(0.01 * np.sqrt(18), rel=0.01)


def test_bone_lengths_of_a_rigid_body_do_not_vary_and_of_a_breathing_one_do() -> None:
    assert metrics.bone_length_variation(body() + T60[:, None, None]) == pytest.approx(0, abs=1e-12)
    scale = np.where(np.arange(60) % 2, 0.9, 1.1)
    assert metrics.bone_length_variation(body() * scale[:, None, None]) == pytest.approx(0.1)


def test_a_body_that_glides_slides_with_both_feet_and_one_that_stands_on_one_does_not() -> None:
    gliding = body() + T60[:, None, None] * [0.3, 0.5, 0.4]
    assert metrics.foot_slide(gliding, T60) == pytest.approx(0.5)
    one_foot = gliding.copy()
    one_foot[:, KINECT.index("AnkleLeft")] = body()[KINECT.index("AnkleLeft")]
    assert metrics.foot_slide(one_foot, T60) == pytest.approx(0, abs=1e-12)


def test_collapsed_shoulders_are_counted() -> None:
    frames = np.stack([body()] * 10)
    frames[:3, KINECT.index("ShoulderLeft"), 0] *= 0.1
    assert metrics.shoulder_collapse(frames) == pytest.approx(0.3)


@pytest.mark.parametrize("heading", np.linspace(-3, 3, 7))
def test_facing_is_against_the_motion_exactly_when_walking_backward(heading: float) -> None:
    step = np.array([np.sin(heading), 0, np.cos(heading)])
    path = T60[:, None, None] * step
    assert metrics.facing_yaw(body(heading)) == pytest.approx(heading)
    assert metrics.facing_against_motion(body(heading) + path, T60) == 0
    assert metrics.facing_against_motion(body(heading + np.pi) + path, T60) == 1
    assert np.isnan(metrics.facing_against_motion(body(heading) + 0.3 * path, T60))  # slower than somebody who moves


def test_a_half_turn_at_once_is_a_reversal_and_a_flip_and_a_slow_one_is_neither() -> None:
    yaw = np.where(np.arange(60) < 20, 0.0, np.pi) + np.where(np.arange(60) < 50, 0.0, np.pi)
    sudden = np.stack([body(angle) for angle in yaw])
    slow = np.stack([body(angle) for angle in np.linspace(0, np.pi, 60)])
    assert metrics.yaw_reversals(sudden, T60) == 2
    assert metrics.yaw_reversals(slow, T60) == 0
    mirrored = np.where((np.arange(60) < 20)[:, None, None], body(0.3), body(0.3)[list(KINECT.mirror)])
    assert metrics.label_flips(mirrored) == 1
    assert metrics.label_flips(slow) == 0


def test_facing_away_from_a_sensor() -> None:
    there = np.array([0.0, 0.0, 3.0])
    frames = np.stack([body(0.0), body(1.0), body(3.0), body(-2.0)])
    assert metrics.facing_away(frames, there) == 0.5


def test_limits_are_still_within() -> None:
    """Exactly at a right angle, nobody faces away; just as wide, fast or far, nothing has collapsed or turned."""
    there = np.array([2.0, 0.0, 0.0])
    assert metrics.facing_away(body()[None], there) == 0
    assert metrics.facing_against_motion(body() + T60[:, None, None] * [1.0, 0, 0], T60) == 0
    narrow = np.stack([body()] * 4)
    width = metrics.COLLAPSED * (0.2 - -0.2)
    narrow[0, KINECT.index("ShoulderLeft"), 0], narrow[0, KINECT.index("ShoulderRight"), 0] = width, 0.0
    assert metrics.shoulder_collapse(narrow) == 0
    narrow[0, KINECT.index("ShoulderLeft"), 0] -= 1e-9
    assert metrics.shoulder_collapse(narrow) == 0.25
    turned, within = metrics.REVERSED_BY, metrics.REVERSED_WITHIN
    for yaw, after_s, count in (
        (turned, within, 0), (turned + 1e-9, within, 1), (turned + 1e-9, np.nextafter(within, 1), 0)
    ):  # fmt: skip
        assert metrics.reversals(np.array([0.0, yaw]), np.array([0.0, after_s])) == count
    slides = np.stack([body(), body() + np.array([0.03, 0.0, 0.04])])
    assert metrics.foot_slide(slides, np.array([0.0, metrics.SLIDE_OVER])) == pytest.approx(0.5)


yaws = st.floats(-3, 3)
places = st.tuples(st.floats(-3, 3), st.floats(-1, 1), st.floats(-3, 3))


@given(yaws, yaws, places, st.floats(0.5, 5), st.floats(-1, 1))
def test_who_turns_by_more_than_a_right_angle_from_a_point_faces_away_wherever_both_are(
    yaw: float, direction: float, place: tuple[float, float, float], far: float, above: float
) -> None:
    turned = np.cos(yaw - direction)
    assume(abs(turned) > 1e-6)
    towards = np.array(place) + far * np.array([np.sin(direction), above, np.cos(direction)])
    frames = np.stack([body(yaw) + place, np.full((25, 3), np.nan)])  # the second one is not known to face away
    assert metrics.facing_away(frames, towards) == (0.5 if turned < 0 else 0.0)


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.05, 0.1])
def test_the_lag_is_how_late_a_skeleton_is(delay: float) -> None:
    at_s, path = walker(300)
    flat = path.reshape(300, -1)
    late = np.stack([np.interp(at_s - delay, at_s, column) for column in flat.T], axis=-1).reshape(path.shape)
    assert metrics.lag(late, path, at_s) == pytest.approx(delay, abs=0.006)
    assert metrics.lag(late + np.array([0.5, 1.0, -2.0]), path, at_s) == metrics.lag(late, path, at_s)


@pytest.mark.parametrize(("begin_s", "lasts_s", "known"), [(0.0, 0.49, False), (0.0, 0.51, True), (7.0, 0.49, False)])
def test_half_a_second_is_long_enough_for_a_lag_of_up_to_three_tenths(
    begin_s: float, lasts_s: float, known: bool
) -> None:
    at_s = begin_s + np.linspace(0, lasts_s, 17)
    path = np.sin(9 * at_s)[:, None, None] + body()
    assert np.isfinite(metrics.lag(path, path, at_s, most=0.3)) == known


def test_a_skeleton_without_width_is_not_flipped() -> None:
    """Left and right are in one place, so that swapping them changes nothing."""
    flat = np.stack([body() * [0, 1, 0]] * 5) + np.arange(5)[:, None, None]
    assert metrics.label_flips(flat) == 0


def test_rising_keeps_each_time_once() -> None:
    at_s, values = metrics.rising(np.array([2.0, 1.0, 2.0, 3.0]), np.array([0, 1, 2, 3]))
    assert (at_s.tolist(), values.tolist()) == ([1, 2, 3], [1, 0, 3])


# The data's README has the figures of 53 sessions with 20 people; here are 25 sessions with ten of them.
README: dict[str, tuple[float, float, float]] = {
    "bone_length_variation_percent": (13.8, 13.1, 0.2),
    "stationary_jitter_mm": (11.8, 11.4, 1.3),
    "foot_slide_cm_s": (14.5, 18.9, 1.5),
    "shoulder_collapse_percent": (5.8, 9.6, 0.8),
    "facing_against_motion_percent": (23.4, 32.5, 2.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", README)
def test_the_definitions_give_the_figures_that_are_known(name: str, as_logged: dict[str, Any]) -> None:
    front, thesis, within = README[name]
    assert as_logged["front_sensor_alone"]["fused"]["all"][name] == pytest.approx(front, abs=within)
    assert as_logged["methods"]["stand-still"]["fused"]["all"][name] == pytest.approx(thesis, abs=within)
    assert as_logged["methods"]["stand-still"]["fused"]["all"]["sessions"] == 25
