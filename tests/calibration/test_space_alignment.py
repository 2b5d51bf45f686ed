"""Another tracker's space is found from one thing that both follow; where it cannot be, the reason is named."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.calibration.space_alignment import (
    SpaceAlignmentSettings,
    SpaceFit,
    _linear,
    _shortfalls,
    align_space,
    try_to_align,
)
from mocapella.errors import CalibrationError, InputError, SettingsError
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.model.space import SpaceAlignment, load_space, rows_of, save_space

LEVERS = np.array([[0.02, -0.03, 0.08], [0.07, -0.03, 0.08], [0.02, 0.02, 0.08]])


def body(t: float, turn: float = 0.6, far: float = 0.15, axes: int = 3) -> np.ndarray:
    """``T_world_body`` of a thing that is moved about."""
    rates = np.array([2.1, 2.9, 1.7])
    phi = turn * np.sin(rates * t + [0, 1, 2]) * (np.arange(3) < axes)
    return rigid(exp_twist([0, 0, 0, *phi])[:3, :3], far * np.sin(rates[::-1] * t + [2, 0, 1]))


def recorded(
    T_world_space: np.ndarray, *, delay_s: float = 0.04, noise_m: float = 0.0, seconds: float = 8.0, points: int = 1,
    seed: int = 0, **how: Any,
) -> tuple[Any, Any, Any, Any]:  # fmt: skip
    """What `align_space` takes: 60 Hz of points, 90 Hz of poses that are told late."""
    rng = np.random.default_rng(seed)
    at_s = np.arange(0, seconds, 1 / 60)
    p = np.array([apply(body(t, **how), LEVERS[:points]) for t in at_s])
    told_s = np.arange(-0.5, seconds + 0.5, 1 / 90)
    T = np.array([inverse(T_world_space) @ body(t - delay_s, **how) for t in told_s])
    T[:, :3, 3] += rng.normal(0, 0.5 * noise_m, (len(T), 3))
    return at_s, p + rng.normal(0, noise_m, p.shape), told_s, T


def somewhere(seed: int, vertical: bool = False) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turn = rng.uniform(-1, 1, 3)
    turn *= rng.uniform(0, 3.0) / np.linalg.norm(turn)
    return rigid(exp_twist([0, 0, 0, *(turn * [0, 1, 0] if vertical else turn)])[:3, :3], rng.uniform(-3, 3, 3))


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000), delay_s=st.floats(-0.2, 0.2), points=st.sampled_from([1, 3]))
def test_without_noise_it_is_found(seed: int, delay_s: float, points: int) -> None:
    vertical = seed % 2 == 0
    T = somewhere(seed, vertical)
    fit = align_space(*recorded(T, delay_s=delay_s, points=points), SpaceAlignmentSettings(vertical=vertical))
    # What is left is from poses between which is interpolated.
    off = fit.T_world_space @ inverse(T)
    assert np.linalg.norm(log_motion(off)[3:]) < 1e-3
    np.testing.assert_allclose(fit.T_world_space @ inverse(T) @ [0, 0, 0, 1], [0, 0, 0, 1], atol=1e-3)
    assert fit.delay_s == pytest.approx(delay_s, abs=5e-4)
    np.testing.assert_allclose(fit.lever_m, LEVERS[:points], atol=1e-3)


@pytest.mark.slow
def test_errors_are_as_large_as_is_said() -> None:
    squares = []
    for seed in range(8):
        T = somewhere(seed)
        fit = align_space(*recorded(T, noise_m=0.003, seed=seed))
        middle = (fit.T_world_space @ inverse(T))[:3, 3]
        turn = log_motion(fit.T_world_space @ inverse(T))[3:]
        delay = (fit.delay_s - 0.04) / fit.delay_sd_s
        squares.append([*(middle / fit.position_sd_m), *(turn / fit.rotation_sd_rad), delay])
        assert np.abs(fit.lever_m - LEVERS[:1]).max() < 5 * fit.lever_sd_m
        assert fit.residual_m == pytest.approx(0.0033, rel=0.2)
    rms = np.sqrt(np.mean(np.square(squares)))
    assert 0.5 < rms < 2.0


def test_outliers_and_holes_do_not_mislead() -> None:
    T = somewhere(3)
    at_s, p, told_s, poses = recorded(T, noise_m=0.001)
    rng = np.random.default_rng(1)
    p[rng.random(len(p)) < 0.15] += rng.uniform(-0.5, 0.5, 3)
    p[100:160] = np.nan
    keep = (told_s < 3.0) | (told_s > 4.0)
    fit = align_space(at_s, p, told_s[keep], poses[keep])
    assert np.linalg.norm(log_motion(fit.T_world_space @ inverse(T))[3:]) < 0.01
    assert np.linalg.norm((fit.T_world_space @ inverse(T))[:3, 3]) < 0.003
    assert fit.left_out > 30
    assert fit.instants < 0.8 * len(at_s)


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000))
def test_a_start_without_noise_is_right_though_every_twentieth_point_is_elsewhere(seed: int) -> None:
    T, rng = somewhere(seed), np.random.default_rng(seed)
    poses = exp_twist(rng.uniform(-0.5, 0.5, (400, 6)))
    p = apply(T @ poses, LEVERS[:1])
    p[::20] += rng.uniform(-0.2, 0.2, p[::20].shape)
    _, found, lever = _linear(p, poses[:, :3, :3], poses[:, :3, 3])
    # What is left is because it weighs the points anew only a few times.
    np.testing.assert_allclose(found, T, atol=0.001)
    np.testing.assert_allclose(lever, LEVERS[:1], atol=0.001)


@pytest.mark.parametrize(("lacking", "found"), [(0, True), (1, False)])
def test_as_many_shared_instants_as_are_wanted_suffice_and_one_less_does_not(lacking: int, found: bool) -> None:
    """The poses go on so long before and after the points that none is lost at any delay."""
    observed = recorded(somewhere(4), delay_s=0.0, seconds=5.0)
    wanted = SpaceAlignmentSettings(delay_within_s=0.02, least_instants=len(observed[0]) + lacking)
    fit, missing = try_to_align(*observed, wanted)
    assert (fit is not None, [one.problem for one in missing] == ["too few shared instants"]) == (found, not found)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"seconds": 0.5}, "too few shared instants"),
        ({"seconds": 3.0}, "too few shared instants: .* in 3 s"),
        ({"far": 0.01, "turn": 0.3}, "too small a space"),
        ({"turn": 0.05}, "too little rotation to know the lever arm"),
        ({"axes": 1}, "too little rotation to know the lever arm: it was turned by 0.0° about its second"),
        ({"delay_s": 0.9}, r"clocks differ|one rigid thing"),
    ],
)
def test_what_is_missing_is_named(how: dict[str, Any], said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        align_space(*recorded(somewhere(1), noise_m=0.001, **how))


def test_two_things_that_move_apart_are_no_one() -> None:
    at_s, p, told_s, poses = recorded(somewhere(1), noise_m=0.001)
    with pytest.raises(CalibrationError, match=r"do not follow one rigid thing|too|clocks"):
        align_space(at_s, p[::-1].copy(), told_s, poses)
    slanted = somewhere(5)
    with pytest.raises(CalibrationError, match="do without --vertical"):
        align_space(*recorded(slanted), SpaceAlignmentSettings(vertical=True))


def test_without_poses_or_points_it_says_so() -> None:
    at_s, p, told_s, poses = recorded(somewhere(1))
    for given_ in ((at_s, np.full_like(p, np.nan), told_s, poses), (at_s, p, told_s[:1], poses[:1])):
        with pytest.raises(CalibrationError, match="too few shared instants"):
            align_space(*given_)


WANTED = SpaceAlignmentSettings()
AT_ITS_LIMITS = SpaceFit(
    np.eye(4), LEVERS[:1], WANTED.delay_within_s, WANTED.largest_sd_m, WANTED.largest_sd_rad, WANTED.largest_sd_m,
    WANTED.largest_delay_sd_s, WANTED.largest_residual_m, instants=100, left_out=50, turn_rad=1.0, space_m=1.0,
)  # fmt: skip


def test_a_fit_at_all_its_limits_is_good_enough() -> None:
    assert list(_shortfalls(AT_ITS_LIMITS, WANTED)) == []
    assert list(_shortfalls(msgspec.structs.replace(AT_ITS_LIMITS, delay_s=-WANTED.delay_within_s), WANTED)) == []


@pytest.mark.parametrize(
    ("name", "value", "problem", "measured"),
    [
        ("residual_m", 0.031, "do not follow one rigid thing", "31 mm, at most 20 mm are"),
        ("left_out", 51, "do not follow one rigid thing", "20 mm, at most 20 mm are"),
        ("delay_s", 0.42, "clocks differ too much", "by 0.42 s, at most 0.3 s"),
        ("delay_s", -0.42, "clocks differ too much", "by -0.42 s, at most 0.3 s"),
        ("delay_sd_s", 0.024, "too slow to know the delay", "to 24 ms, 15 ms are"),
        ("lever_sd_m", 0.013, "too little rotation", "to 13 mm, 10 mm are"),
        ("position_sd_m", 0.012, "too uncertain", "to 12 mm and 1.7°, 10 mm and 1.7° are"),
        ("rotation_sd_rad", np.radians(4.6), "too uncertain", "to 10 mm and 4.6°, 10 mm and 1.7° are"),
    ],
)
def test_a_fit_beyond_one_limit_has_that_shortfall_alone_and_tells_both_figures(
    name: str, value: float, problem: str, measured: str
) -> None:
    (told,) = _shortfalls(msgspec.structs.replace(AT_ITS_LIMITS, **{name: value}), WANTED)
    assert problem in told.problem
    assert measured in told.measured
    if isinstance(value, float):
        just = np.nextafter(getattr(AT_ITS_LIMITS, name), np.inf) * np.sign(value)
        (again,) = _shortfalls(msgspec.structs.replace(AT_ITS_LIMITS, **{name: float(just)}), WANTED)
        assert again.problem == told.problem


def test_settings_that_cannot_be_are_refused() -> None:
    for changed in ({"delay_within_s": -1.0}, {"least_instants": 3}, {"largest_sd_m": 0.0}):
        with pytest.raises(SettingsError, match=next(iter(changed))):
            SpaceAlignmentSettings(**changed)


def test_an_alignment_is_kept_in_a_file(tmp_path: Any) -> None:
    path, told = tmp_path / "vr.toml", SpaceAlignment("vr", rows_of(somewhere(2)), 0.04, 0.002, 0.01, 0.003)
    save_space(path, told)
    assert load_space(path) == told
    np.testing.assert_array_equal(told.T_world_space, load_space(path).T_world_space)
    text = path.read_text()
    for wrong, said in (
        (text.replace("mocapella space", "another"), "is something else"),
        (text.replace("space = ", "spce = "), "spce"),
        (text + "\nx", "no TOML"),
        (text.replace("clock_s = 0.04", "clock_s = 99.0"), "clock_s"),
        (text.replace("rows = [", "rows = [[1.0, 1.0, 0.0, 0.0],"), "rows|length"),
    ):
        path.write_text(wrong)
        with pytest.raises(InputError, match=said):
            load_space(path)
    with pytest.raises(InputError):
        load_space(tmp_path / "none.toml")
    with pytest.raises(SettingsError, match="rigid motion"):
        SpaceAlignment("vr", ((1.0, 0, 0, 0), (0, 1.0, 0, 0), (0, 0, -1.0, 0)))
