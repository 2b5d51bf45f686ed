"""By how much one camera is later than others, told by what moves: right, or not at all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.sources.motion_lags import APART_S, LEAST_S, LONGEST_S, STEP_S, MotionLags, _late, _shift
from mocapella.sources.simulate.silhouette_scene import silhouette_scene


def course(seed, late_s, fps=30.0, seconds=12.0, noise=0.0):
    """How much moves, (n, 2): as nobody foresees, in about three bursts a second."""
    rng = np.random.default_rng(seed)
    knots = rng.uniform(0, 1, 100) ** 2
    at_s = np.arange(0, seconds, 1 / fps)
    moved = np.interp(at_s - late_s + 2.0, 0.3 * np.arange(100), knots)
    return np.stack([at_s, moved + noise * np.random.default_rng(seed + 1).uniform(0, 1, len(at_s))], axis=-1)


@settings(max_examples=30)
@given(st.integers(0, 1000), st.floats(-0.5, 0.5), st.sampled_from([10.0, 25.0, 30.0, 60.0]), st.floats(0.2, 5.0))
def test_a_shift_is_found_whatever_the_rates_and_how_much_each_camera_sees_of_it(seed, late_s, fps, gain):
    other = course(seed, late_s, fps=fps, noise=0.1) * [1.0, gain]
    assert _shift(course(seed, 0.0, noise=0.1), other) == pytest.approx(late_s, abs=0.02)


@settings(max_examples=30)
@given(st.integers(0, 1000), st.floats(0.1, 0.5))
def test_it_is_the_same_backwards(seed, late_s):
    a, b = course(seed, 0.0), course(seed, late_s)
    assert _shift(a, b) == pytest.approx(-_shift(b, a), abs=1e-3)


def test_what_says_nothing_is_left_open():
    a = course(0, 0.0)
    at_s = a[:, 0]
    for other in (
        course(77, 0.0),  # somebody else moves there
        np.stack([at_s, np.full(len(at_s), 0.4)], axis=-1),  # nothing moves
        course(0, LONGEST_S + 0.4),
        course(0, 0.0, seconds=4.0),
        a[:1],
    ):
        assert _shift(a, other) is None
    steps = np.stack([at_s, 1 + np.sin(2 * np.pi * at_s / 0.4)], axis=-1)  # again and again: it may be any of them
    assert _shift(steps, steps - [0.1, 0.0]) is None
    assert APART_S < 0.2


def test_who_is_late_is_told_from_pairs_and_nothing_where_they_contradict_each_other():
    assert _late({}) == {}
    assert _late({("a", "b"): 0.1}) == pytest.approx({"a": 0.0, "b": 0.1})
    assert _late({("a", "b"): -0.1}) == pytest.approx({"a": 0.1, "b": 0.0})
    chain = {("a", "b"): 0.12, ("b", "c"): -0.12, ("d", "e"): 0.3}
    assert _late(chain) == pytest.approx({"a": 0.0, "b": 0.12, "c": 0.0}, abs=1e-9)
    assert _late({("a", "b"): 0.12, ("b", "c"): 0.0, ("a", "c"): 0.0}) == {}


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["runner", "cartwheel"])
def test_of_people_before_cameras_that_see_them_from_all_sides_it_is_measured(motion):
    made = silhouette_scene(motion, seed=3, cameras=3, size_px=(160, 120), fps=30.0)
    names, rng, late_s = list(made.rig.cameras), np.random.default_rng(0), (0.0, 0.12, 0.01)
    lags = MotionLags(names)
    shown = [made.images(k) for k in range(len(made))]
    there = [*range(len(shown)), *reversed(range(len(shown)))] * 2
    for step, k in enumerate(there):
        for c, name in enumerate(names):
            image = np.clip(shown[k][c] + rng.normal(0, 3, shown[k][c].shape), 0, 255).astype(np.uint8)
            lags.add(name, round(1e9 * (100 + step / 30 + late_s[c])), image)
    found = lags.measure()
    assert {names[0], names[1]} <= set(found)
    assert found == pytest.approx({name: late_s[c] for c, name in enumerate(names) if name in found}, abs=0.015)


@settings(max_examples=20)
@given(st.lists(st.integers(1, 30), min_size=2, max_size=20), st.integers(1, 4))
def test_steady_motion_is_a_constant_signal_whatever_the_intervals_between_images(intervals, speed):
    """After a longer interval more has changed, at the same speed."""
    lags = MotionLags(["a"])
    for at in np.cumsum([0, *intervals]):
        image = np.zeros((60, 60, 3), np.uint8)
        image.reshape(-1, 3)[: speed * at] = 200
        lags.add("a", round(1e9 * (100 + at / 100)), image)
    values = [value for _, value in lags._courses["a"]]
    assert len(values) == len(intervals)
    np.testing.assert_allclose(values, values[0], rtol=1e-6)
    assert values[0] > 0


def test_a_camera_that_was_away_begins_anew():
    lags = MotionLags(["a", "b"])
    rng = np.random.default_rng(1)
    for k in range(300):
        image = rng.integers(0, 255, (12, 16, 3)).astype(np.uint8) // (1 + (k // 10) % 3)
        lags.add("a", round(1e9 * k / 30), image)
        if not 250 <= k < 270:
            lags.add("b", round(1e9 * k / 30), image)
    assert lags.measure() == {}
    assert len(lags._courses["b"]) < 35


def test_shifts_are_told_more_finely_than_the_steps_of_the_search():
    """Rounded to whole steps, these would be wrong by a quarter of a step or more."""
    wrong = [
        abs(_shift(course(seed, 0.0, fps=100.0), course(seed, late_s, fps=100.0)) - late_s)
        for seed in range(10)
        for late_s in (-0.1275, 0.2025, 0.2033, 0.2067, 0.2075)
    ]
    assert np.mean(wrong) < 0.2 * STEP_S


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sign", [-1, 1])
def test_shifts_are_found_to_one_step_before_the_longest(seed, sign):
    """At the longest itself, the correlation could still rise beyond."""
    a = course(seed, 0.0, fps=100.0)
    for late_s in (LONGEST_S - 2 * STEP_S, LONGEST_S - STEP_S):
        assert _shift(a, course(seed, sign * late_s, fps=100.0)) == pytest.approx(sign * late_s, abs=0.006)
    assert _shift(a, course(seed, sign * LONGEST_S, fps=100.0)) is None


def test_signals_that_overlap_for_the_least_time_are_enough():
    a, b = course(0, 0.0, fps=32.0, seconds=12.0), course(0, 0.1, fps=32.0, seconds=12.0)
    for one, other in ((a, b), (b, a)):
        enough = one[: round(LEAST_S * 32) + 1]
        assert enough[-1, 0] - enough[0, 0] == LEAST_S
        assert _shift(enough, other) is not None
        assert _shift(enough[1:], other) is None
        assert _shift(other, enough[:-1]) is None


@pytest.mark.parametrize(
    ("apart_s", "share", "shift_s"), [(0.4, 0.0, 0.0), (0.4, 0.2, 0.0), (0.4, 0.5, None), (0.06, 0.5, 0.03)]
)
def test_a_second_maximum_makes_a_shift_ambiguous_only_if_it_is_apart_and_nearly_as_high(apart_s, share, shift_s):
    """A camera sees a share of the motion once more, later."""
    a, again = course(3, 0.0, fps=100.0), course(3, apart_s, fps=100.0)
    both = np.stack([a[:, 0], (1 - share) * a[:, 1] ** 2 + share * again[:, 1] ** 2], axis=-1)
    found = _shift(a, both)
    assert found is None if shift_s is None else found == pytest.approx(shift_s, abs=0.02)


@pytest.mark.parametrize("sign", [-1, 1])
def test_slow_motion_has_one_broad_maximum_which_is_no_rival_of_itself(sign):
    at_s, rng = np.arange(0, 12, 0.01), np.random.default_rng(2)
    middles, strengths = np.arange(-1, 14) + rng.uniform(-0.3, 0.3, 15), rng.uniform(0.1, 1, 15)

    def seen(late_s):
        moved = (strengths * np.exp(-0.5 * ((at_s[:, None] - late_s - middles) / 0.3) ** 2)).sum(axis=1)
        return np.stack([at_s, moved], axis=-1)

    assert _shift(seen(0.0), seen(0.13 * sign)) == pytest.approx(0.13 * sign, abs=0.02)


def test_quick_motion_that_is_seen_twice_is_ambiguous_unless_the_times_are_near_each_other():
    at_s, bursts = np.arange(0, 12, 0.01), np.random.default_rng(2).uniform(0, 1, 1300) ** 2
    one, limit = np.stack([at_s, bursts[50:1250]], axis=-1), round(APART_S / STEP_S)
    for apart, ambiguous in ((6, False), (limit, False), (limit + 1, True), (25, True)):
        both = 0.5 * (bursts[50:1250] + bursts[50 - apart : 1250 - apart])
        found = _shift(one, np.stack([at_s, both], axis=-1))
        assert (found is None) == ambiguous
        assert ambiguous or found in (pytest.approx(0, abs=0.01), pytest.approx(apart * STEP_S, abs=0.01))
