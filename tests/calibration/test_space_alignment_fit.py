"""The parts of the alignment of another tracker's space: poses between poses, weights, derivatives and errors."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from mocapella.calibration.space_alignment import (
    SpaceAlignmentSettings,
    _expected,
    _linear,
    _refined,
    _spread,
    _start,
    _stepped,
    _Track,
    _turning,
    _upright,
    _weights,
    align_space,
    try_to_align,
)
from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.geometry.twists import exp_twist, log_motion

LEVERS = np.array([[0.02, -0.03, 0.08], [0.07, -0.05, 0.08], [0.02, 0.04, 0.06]])
EVERY_AXIS, UPRIGHT = np.eye(3), np.array([[0.0, 1.0, 0.0]])
SIGNS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
FAR = rigid(exp_twist([0, 0, 0, 0.3, -1.2, 0.5])[:3, :3], [2.0, -1.0, 3.0])
FAR_UPRIGHT = rigid(exp_twist([0, 0, 0, 0, 2.0, 0])[:3, :3], [2.0, -1.0, 3.0])
PERIOD_S = 4.0


def turned(phi: Any) -> np.ndarray:
    return exp_twist(np.concatenate([np.zeros(np.shape(phi)), phi], axis=-1))[..., :3, :3]


def body(t: Any) -> np.ndarray:
    """``T_space_body`` (n, 4, 4) of a thing that is moved about, and the same again after each period."""
    t = np.asarray(t, dtype=np.float64)[:, None] * 2 * np.pi / PERIOD_S
    turn = 0.6 * np.sin(t * [1, 2, 1] + [0, 1, 2])
    return np.asarray(rigid(turned(turn), 0.15 * np.sin(t * [2, 1, 3] + [2, 0, 1])))


def seen(
    T: np.ndarray, t: np.ndarray, *, delay_s: float = 0.0, points: int = 1, rate_hz: float = 200.0
) -> tuple[np.ndarray, _Track]:
    """Exact points at times t, and the track."""
    told_s = np.arange(-1.0, t[-1] + 1.0, 1 / rate_hz)
    there = body(t + delay_s)
    return apply(T @ there, LEVERS[:points]), _Track(told_s, body(told_s), 0.1)


def steady(t: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``T_space_body`` (n, 4, 4) of a thing that moves and turns steadily, its velocity, and how fast it turns."""
    v, w = np.array([0.3, -0.2, 0.5]), np.array([0.4, 1.0, -0.7])
    t = np.asarray(t, dtype=np.float64)[:, None]
    return np.asarray(rigid(turned(t * w) @ turned([0.3, 0.2, 0.1]), [1.0, 2.0, 3.0] + t * v)), v, w, t


@pytest.mark.parametrize("count", [2, 3, 9])
def test_what_moves_steadily_is_known_exactly_between_poses_and_how_fast_it_moves_and_turns(count: int) -> None:
    told_s = 5.0 + np.arange(count) * 0.0625
    track = _Track(told_s, steady(told_s)[0], 0.0625)
    t = np.linspace(told_s[0], told_s[-1], 33)
    T, velocity, turning, _ = steady(t)
    R, b, v, known, w = track.at(t)
    assert known.all()
    np.testing.assert_allclose(R, T[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(b, T[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(v, np.broadcast_to(velocity, v.shape), atol=1e-9)
    np.testing.assert_allclose(w, np.broadcast_to(turning, w.shape), atol=1e-9)


def test_a_pose_is_known_from_the_first_to_the_last_and_across_gaps_up_to_the_longest() -> None:
    told_s = np.array([1.0, 1.125, 1.25, 1.5, 1.625])
    track = _Track(told_s, body(told_s), 0.125)
    t = np.array([0.0, np.nextafter(1.0, 0), 1.0, 1.1, 1.25, 1.3, 1.5, 1.55, 1.625, np.nextafter(1.625, 2), 9.0])
    known = [False, False, True, True, False, False, True, True, True, False, False]
    np.testing.assert_array_equal(track.at(t)[3], known)


@pytest.mark.parametrize("count", [0, 1])
def test_without_two_poses_nothing_is_known_at_any_time(count: int) -> None:
    track = _Track(np.zeros(count), np.broadcast_to(np.eye(4), (count, 4, 4)), 1.0)
    assert not track.at(np.array([-1.0, 0.0, 1.0]))[3].any()


@pytest.mark.parametrize("axes", [EVERY_AXIS, UPRIGHT])
def test_the_derivative_is_the_change_of_the_expected_points_with_a_step(axes: np.ndarray) -> None:
    t, centre = np.array([0.31, 0.62, 0.87]), np.array([0.5, -0.2, 1.0])
    told_s = np.arange(0.0, 2.0, 0.25)
    track = _Track(told_s, body(told_s), 1.0)
    found = FAR, LEVERS, 0.02
    _, J, known = _expected(t, track, found, centre, axes)
    assert known.all()
    assert J.shape == (3, 3, 3, len(axes) + 4 + 9)
    for unknown, step in enumerate(1e-6 * np.eye(J.shape[-1])):
        more, less = (
            _expected(t, track, _stepped(found, by, centre, axes, 0.3), centre, axes)[0] for by in (step, -step)
        )
        np.testing.assert_allclose(J[..., unknown], (more - less) / 2e-6, atol=1e-7)


def test_a_step_of_one_kind_changes_no_other() -> None:
    centre, found = np.array([0.5, -0.2, 1.0]), (FAR, LEVERS, 0.02)
    turn, shift, levers = np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6]), np.arange(9.0)
    T, lever, delay = _stepped(found, np.r_[turn, np.zeros(13)], centre, EVERY_AXIS, 1.0)
    np.testing.assert_allclose(T[:3, :3], turned(turn) @ FAR[:3, :3], atol=1e-12)
    np.testing.assert_allclose(apply(T @ inverse(FAR), [centre]), [centre], atol=1e-12)  # about the centre
    np.testing.assert_array_equal(lever, LEVERS)
    assert delay == 0.02
    T, lever, delay = _stepped(found, np.r_[0, 0, 0, shift, 0.07, levers], centre, EVERY_AXIS, 1.0)
    np.testing.assert_allclose(T[:3, 3], FAR[:3, 3] + shift, atol=1e-12)
    np.testing.assert_allclose(lever, LEVERS + levers.reshape(3, 3), atol=1e-12)
    assert delay == pytest.approx(0.09)


@pytest.mark.parametrize(("within_s", "farthest_s"), [(0.0, 0.1), (0.3, 0.7), (5.0, 10.1)])
def test_the_delay_goes_no_farther_than_a_tenth_of_a_second_beyond_twice_what_is_looked_at(
    within_s: float, farthest_s: float
) -> None:
    for sign in (-1, 1):
        step = np.zeros(10)
        step[6] = 100.0 * sign
        delay = _stepped((FAR, LEVERS[:1], 0.0), step, np.zeros(3), EVERY_AXIS, within_s)[2]
        assert delay == pytest.approx(farthest_s * sign)


def test_the_weights_are_hubers_and_what_is_very_far_off_or_unknown_has_none() -> None:
    off = np.r_[np.full(60, 0.015382), 0.0, 0.0249, 0.05, 0.1, 0.1199, 0.1201, 5.0][:, None]
    known = np.ones(len(off), np.bool_)
    weight, scale = _weights(off, known)
    assert scale == pytest.approx(0.01)  # of three coordinates, the median length is 1.5382 times that of one
    np.testing.assert_allclose(weight[:62], 1.0)
    np.testing.assert_allclose((weight * off)[62:65], 0.025)
    np.testing.assert_array_equal(weight[65:], 0.0)
    known[:5] = False
    some, same = _weights(np.where(known[:, None], off, 9.0), known)
    assert same == pytest.approx(scale)
    np.testing.assert_array_equal(some[:5], 0.0)
    np.testing.assert_allclose(some[5:], weight[5:])
    doubled, twice = _weights(2 * off, np.ones(len(off), np.bool_))
    assert twice == pytest.approx(2 * scale)
    np.testing.assert_allclose(doubled, weight)


def test_the_scale_of_the_weights_is_the_noise_of_a_coordinate() -> None:
    noise = np.random.default_rng(0).normal(0, 0.003, (4000, 2, 3))
    assert _weights(np.linalg.norm(noise, axis=-1), np.ones(4000, np.bool_))[1] == pytest.approx(0.003, rel=0.03)
    assert _weights(np.zeros((9, 1)), np.ones(9, np.bool_))[1] == 1e-7  # where nothing is off, weights are known too


def test_a_motion_is_made_upright_by_the_nearest_turn_about_the_point_that_comes_to_the_centre() -> None:
    centre = np.array([0.5, 1.5, -2.0])
    np.testing.assert_allclose(_upright(FAR_UPRIGHT, centre), FAR_UPRIGHT, atol=1e-12)
    for seed in range(5):
        T = exp_twist(np.random.default_rng(seed).uniform(-1, 1, 6))
        upright = _upright(T, centre)
        np.testing.assert_allclose(upright[:3, 1], [0, 1, 0], atol=1e-12)
        np.testing.assert_allclose(apply(upright @ inverse(T), [centre]), [centre], atol=1e-12)
        near = np.trace(upright[:3, :3].T @ T[:3, :3])
        for angle in np.linspace(0, 2 * np.pi, 12):
            assert np.trace(turned([0, angle, 0]).T @ T[:3, :3]) <= near + 1e-12


@pytest.mark.parametrize("points", [1, 2, 3])
def test_a_start_without_noise_is_right_for_one_marker_or_several(points: int) -> None:
    t = np.arange(0, 4, 0.05)
    p, track = seen(FAR, t, points=points)
    R, b, *_ = track.at(t)
    error, T, lever = _linear(p, R, b)
    assert error < 1e-9
    np.testing.assert_allclose(T, FAR, atol=1e-8)
    np.testing.assert_allclose(lever, LEVERS[:points], atol=1e-8)


@pytest.mark.parametrize("delay_s", [-0.06, -0.02, 0.0, 0.04, 0.06])
def test_the_start_has_the_delay_of_the_least_error_up_to_the_largest_in_either_direction(delay_s: float) -> None:
    t = np.arange(0, 4, 0.05)
    s = SpaceAlignmentSettings(delay_within_s=0.06, least_instants=40)
    for true, found in ((delay_s, delay_s), (np.sign(delay_s) * 0.12, np.sign(delay_s) * 0.06)):
        start = _start(t, *seen(FAR, t, delay_s=true, rate_hz=100.0), s)
        assert start is not None
        assert start[2] == pytest.approx(found, abs=1e-9)


@pytest.mark.parametrize(("axes", "T"), [(3, FAR), (1, FAR_UPRIGHT)])
@pytest.mark.parametrize(("delay_s", "points"), [(0.05, 1), (-0.13, 3)])
def test_without_noise_space_lever_arms_and_delay_come_back(
    axes: int, T: np.ndarray, delay_s: float, points: int
) -> None:
    t = np.arange(0, 6, 0.05)
    p, track = seen(T, t, delay_s=delay_s, points=points)
    s = SpaceAlignmentSettings(vertical=axes == 1, delay_within_s=0.2)
    fit = align_space(t, p, track.times, track.T, s)
    # What is left is from poses between which is interpolated.
    np.testing.assert_allclose(fit.T_world_space, T, atol=2e-4)
    np.testing.assert_allclose(fit.lever_m, LEVERS[:points], atol=1e-4)
    assert fit.delay_s == pytest.approx(delay_s, abs=1e-4)
    assert (fit.instants, fit.left_out) == (len(t), 0)
    assert fit.residual_m < 1e-4


def refined(t: np.ndarray, p: np.ndarray, track: _Track, T: np.ndarray, *, vertical: bool = False, **start: Any) -> Any:
    begin = T, start.get("lever", LEVERS[: p.shape[1]]), start.get("delay", 0.0)
    return _refined(t, p, track, begin, SpaceAlignmentSettings(vertical=vertical), moved=(0.0, 0.0))


@pytest.mark.parametrize("vertical", [False, True])
def test_errors_of_a_fit_are_as_large_as_it_says(vertical: bool) -> None:
    t, T = np.arange(0, 8, 0.1), FAR_UPRIGHT if vertical else FAR
    p, track = seen(T, t, rate_hz=50.0)
    squares, rng = [], np.random.default_rng(1)
    for _ in range(12):
        fit = refined(t, p + rng.normal(0, 0.003, p.shape), track, T, vertical=vertical)
        middle = p.mean(axis=(0, 1))
        off = apply(fit.T_world_space @ inverse(T), [middle])[0] - middle
        turn = log_motion(fit.T_world_space @ inverse(T))[3:]
        turn = turn[1:2] if vertical else turn
        worst = np.abs(fit.lever_m - LEVERS[:1]).max()
        squares.append(
            [(off**2).mean() / fit.position_sd_m**2, (turn**2).mean() / fit.rotation_sd_rad**2,
             (fit.delay_s / fit.delay_sd_s) ** 2, (worst / fit.lever_sd_m) ** 2]
        )  # fmt: skip
        assert fit.residual_m == pytest.approx(0.003, rel=0.35)
    assert (np.sqrt(np.mean(squares, axis=0)) > 0.6).all()
    assert (np.sqrt(np.mean(squares, axis=0)) < 1.7).all()


def test_twice_the_noise_is_twice_the_uncertainty() -> None:
    t = np.arange(0, 8, 0.1)
    p, track = seen(FAR, t, rate_hz=50.0)
    noise = np.random.default_rng(2).normal(0, 1e-4, p.shape)
    one, two = (refined(t, p + times * noise, track, FAR) for times in (1, 2))
    for name in ("position_sd_m", "rotation_sd_rad", "lever_sd_m", "delay_sd_s", "residual_m"):
        assert getattr(two, name) == pytest.approx(2 * getattr(one, name), rel=0.02)


def test_three_times_as_large_leaves_angles_and_times_as_they_are() -> None:
    t = np.arange(0, 8, 0.1)
    p, track = seen(FAR, t, points=2, rate_hz=50.0)
    p += np.random.default_rng(2).normal(0, 0.001, p.shape)
    large = track.T.copy()
    large[:, :3, 3] *= 3
    far = FAR.copy()
    far[:3, 3] *= 3
    one, three = (
        refined(t, p, track, FAR),
        refined(t, 3 * p, _Track(track.times, large, 0.1), far, lever=3 * LEVERS[:2]),
    )
    for name in ("position_sd_m", "lever_sd_m", "residual_m", "lever_m"):
        np.testing.assert_allclose(getattr(three, name), 3 * getattr(one, name), rtol=1e-4)
    for name in ("rotation_sd_rad", "delay_sd_s", "delay_s"):
        assert getattr(three, name) == pytest.approx(getattr(one, name), rel=1e-4)


def test_if_everything_happens_twice_the_variance_is_half_that_of_once() -> None:
    """Apart from what is corrected because the blocks of half a second are a sample, from which the mean is taken."""
    once = np.arange(0, PERIOD_S, 0.05) + 0.01
    noise = np.random.default_rng(3).normal(0, 0.001, (len(once), 1, 3))
    variances = []
    for times in (1, 2):
        t = np.concatenate([once + k * PERIOD_S for k in range(times)])
        p, track = seen(FAR, t, rate_hz=50.0)
        fit, blocks = refined(t, p + np.tile(noise, (times, 1, 1)), track, FAR), times * PERIOD_S / 0.5
        sd = np.array([fit.position_sd_m, fit.rotation_sd_rad, fit.lever_sd_m, fit.delay_sd_s])
        variances.append(sd**2 * (1 - 1 / blocks))
    np.testing.assert_allclose(variances[1], variances[0] / 2, rtol=0.01)


def test_outliers_among_the_known_instants_are_counted_once_each_and_do_not_mislead() -> None:
    t = np.arange(0, 8, 0.1)
    p, track = seen(FAR, t, points=2)
    p += np.random.default_rng(4).normal(0, 1e-3, p.shape)
    told = (track.times < 3.02) | (track.times > 3.98)
    track = _Track(track.times[told], track.T[told], 0.1)
    known = int(track.at(t)[3].sum())  # none from 3.1 to 3.9 s
    for k in (5, 11, 60):
        p[k, 0] += [1.0, -2.0, 0.5]  # one of two markers
    p[60, 1] += 1.0
    p[35] += 3.0  # in the gap
    fit = refined(t, p, track, FAR)
    assert known == len(t) - 9
    assert (fit.instants, fit.left_out) == (known, 3)
    np.testing.assert_allclose(fit.T_world_space, FAR, atol=0.005)


def test_the_space_is_the_second_largest_spread_or_with_one_vertical_the_largest_that_is_level() -> None:
    spread = SIGNS * [0.3, 0.1, 0.02]
    assert _spread(spread @ turned([0.5, -0.7, 0.2]) + [5.0, -3.0, 8.0], False) == pytest.approx(0.1)
    assert _spread(np.tile(spread, (4, 1)), False) == pytest.approx(0.1)
    level = SIGNS * [0.2, 0.9, 0.1]
    assert _spread(level @ turned([0, 0.6, 0]) + [5.0, -3.0, 8.0], True) == pytest.approx(0.2)


@pytest.mark.parametrize("axis", [[0.0, 1.0, 0.0], [-0.6, 0.0, -0.8], [0.48, -0.6, 0.64], [0.0, 0.6, -0.8]])
def test_what_turns_about_one_axis_does_not_move_that_axis_and_all_others_by_the_sine(axis: list[float]) -> None:
    phi = np.array(axis) * np.array([-0.4, 0.4, -0.4, 0.4])[:, None]
    least, other, found = _turning(turned([0.3, 1.0, 0.2]) @ turned(phi))
    assert least == pytest.approx(0.0, abs=1e-7)
    assert other == pytest.approx(np.sin(0.4))
    sign = np.sign(axis[int(np.argmax(np.abs(axis)))])  # its largest component is positive
    np.testing.assert_allclose(found, sign * np.array(axis), atol=1e-7)


def recorded(seconds: float = 5.0, step_s: float = 0.05) -> tuple[Any, Any, Any, Any]:
    t = np.arange(0, seconds, step_s)
    p, track = seen(FAR, t)
    return t, p, track.times, track.T


def problems(given: tuple[Any, Any, Any, Any], s: SpaceAlignmentSettings) -> list[str]:
    return [one.problem for one in try_to_align(*given, s)[1]]


@pytest.mark.parametrize(("seconds", "told"), [(4.0, None), (3.5, "at 70, in 3.5 s")])
def test_eight_blocks_of_half_a_second_suffice_and_seven_do_not(seconds: float, told: str | None) -> None:
    s = SpaceAlignmentSettings(least_instants=60, delay_within_s=0.02)
    _, missing = try_to_align(*recorded(seconds), s)
    assert [one.measured for one in missing] == (
        [] if told is None else [f"{told}, both trackers know where it is; 60 in 4 s are wanted"]
    )


@pytest.mark.parametrize(("count", "more"), [(1, False), (2, True)])
def test_motion_is_told_of_from_two_shared_instants_on(count: int, more: bool) -> None:
    t, p, poses_s, T = recorded()
    fit, missing = try_to_align(t[:count], p[:count], poses_s, T)
    assert fit is None
    assert missing[0].problem == "too few shared instants"
    assert (len(missing) > 1) == more


@pytest.mark.parametrize(
    ("measure", "limit", "problem"),
    [
        ("space_m", "least_space_m", "too small a space"),
        ("turn_rad", "least_turn_rad", "too little rotation to know the lever arm"),
    ],
)
def test_motion_of_just_the_least_suffices(measure: str, limit: str, problem: str) -> None:
    given, s = recorded(), SpaceAlignmentSettings(delay_within_s=0.02)
    has = getattr(align_space(*given, s), measure)
    assert problems(given, dataclasses.replace(s, **{limit: has})) == []
    assert problems(given, dataclasses.replace(s, **{limit: float(np.nextafter(has, 1))})) == [problem]


def test_the_space_is_told_in_centimetres_and_the_turn_in_degrees() -> None:
    t = np.arange(0, 5, 0.05)
    poses_s = np.arange(-1, 6, 0.05)
    sign = np.array([1.0, -1.0])[np.arange(len(poses_s)) % 2]
    T = np.asarray(rigid(turned(sign[:, None] * [-0.005, 0.25, 0.0]), np.zeros(3)))
    other = np.where(np.arange(len(t)) // 2 % 2, 1.0, -1.0)
    p = np.stack([0.3 * np.tile([1.0, -1.0], len(t) // 2), 0.023 * other, np.zeros(len(t))], axis=1)[:, None]
    at = np.searchsorted(poses_s, t - 1e-9)
    space, turn = try_to_align(poses_s[at], p, poses_s, T)[1]
    assert "by 2.3 cm across its main direction, 4 cm are" in space.measured
    assert turn.measured == (
        "it was turned by 0.0° about its second axis, mostly about the body's axis [0.0, 1.0, 0.0], 9° are wanted "
        "(as standard deviations)"
    )
    _, other_rad, _ = _turning(T[at, :3, :3])
    for least, mostly in ((other_rad, True), (float(np.nextafter(other_rad, 1)), False)):
        _, turn = try_to_align(poses_s[at], p, poses_s, T, SpaceAlignmentSettings(least_turn_rad=least))[1]
        assert ("mostly about" in turn.measured) == mostly


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("delay_within_s", (0, 5), (-1e-9, 5.001)),
        ("least_instants", (10, 1000), (9,)),
        *(
            (name, (1e-9, 999.9), (0.0, 1000.0))
            for name in ("longest_gap_s", "least_space_m", "least_turn_rad", "largest_residual_m", "largest_sd_m",
                         "largest_sd_rad", "largest_delay_sd_s")
        ),
    ],
)  # fmt: skip
def test_settings_are_taken_up_to_their_limits(name: str, good: tuple[float, ...], bad: tuple[float, ...]) -> None:
    for value in good:
        assert getattr(SpaceAlignmentSettings(**{name: value}), name) == value
    for value in bad:
        with pytest.raises(SettingsError, match=name):
            SpaceAlignmentSettings(**{name: value})
