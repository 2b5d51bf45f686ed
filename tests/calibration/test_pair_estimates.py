"""What a pair's sums say: its pose's uncertainty, its problems, and what a given start is worth."""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec
import numpy as np
import pytest
from support.pair_judgement import covariance, offset_of, problem_of
from support.walking_people import FRONT, SIDE

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_calibration import (
    MIRRORED_STREAM,
    NOT_ONE_BODY,
    ON_A_LINE,
    TOLD_APART_M,
    TOLD_CENTRE,
    TOLD_JOINTS,
    TOLD_REACH,
    TOLD_RESIDUAL_M,
    WALK,
    WALK_ACROSS,
    PairCalibration,
    PairEstimate,
    PairSettings,
    estimates,
)
from mocapella.calibration.pair_estimate_kernels import (
    COMMON_PART,
    M_ESTIMATE,
    MIRRORED_M,
    MOST_SAMPLES,
    ON_A_LINE_M,
    PRIOR_SAMPLES,
    SAMPLE_JOINTS,
)
from mocapella.calibration.time_offset import OFFSET_PRIOR_SD, TimeOffset
from mocapella.errors import SettingsError
from mocapella.geometry.alignment import align, centred_products, moments, normal_equations
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import exp_twist

TRUTH = inverse(FRONT) @ SIDE
S = PairSettings()
SHIFTS = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
E6 = np.eye(7)[6]


def normal_matrix(seed: int) -> np.ndarray:
    x = np.random.default_rng(seed).normal(size=(7, 20)) * np.array([[1], [1], [1], [2.5], [2.5], [2.5], [0.5]])
    return 10.0 * x @ x.T


def expected_scatter(H: np.ndarray, samples: float, motion_s: float, residual: float, weight: float) -> np.ndarray:
    """Of so many samples, each worth the joints with independent errors, once the noise of a posture is averaged."""
    return (1 + 1 / motion_s) / samples * residual**2 * weight / (3 * SAMPLE_JOINTS) * H


@pytest.mark.parametrize("samples", [1.0, 4.0, 60.0])
@pytest.mark.parametrize("motion_s", [0.5, 2.0, 1000.0])
@pytest.mark.parametrize("offset_sd", [1e-4, 0.02, 1.0])
def test_a_scatter_as_expected_gives_the_errors_of_its_samples_and_those_that_repeat(
    samples: float, motion_s: float, offset_sd: float
) -> None:
    """Errors are those of the normal matrix. What is known of the clock beside the joints is information like theirs,
    and a shift that all joints share is not averaged out."""
    H, residual, weight = normal_matrix(0), 0.05, 500.0
    B = expected_scatter(H, samples, motion_s, residual, weight)
    found = covariance(H, B, samples=samples, motion_s=motion_s, offset_sd=offset_sd)
    of_unit = M_ESTIMATE * residual**2 * weight / (3 * SAMPLE_JOINTS)
    unit = of_unit * ((1 + 1 / motion_s) / samples + 1 / MOST_SAMPLES)
    own = np.linalg.inv(H / unit + np.outer(E6, E6) / offset_sd**2)[:6, :6]
    np.testing.assert_allclose(found, own + (COMMON_PART * residual) ** 2 / 3 * SHIFTS, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(found, found.T, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("samples", [1.0, 4.0, 60.0])
def test_a_scatter_other_than_expected_counts_by_its_samples(samples: float) -> None:
    H, weight = normal_matrix(1), 500.0
    B = expected_scatter(H, samples, 2.0, 0.05, weight)
    three, one, none = (covariance(H, k * B, samples=samples, offset_sd=1e3) for k in (3, 1, 0))
    np.testing.assert_allclose(three - one, 2 * (one - none), rtol=1e-4, atol=1e-15)
    whole = M_ESTIMATE * 0.05**2 * weight / (3 * SAMPLE_JOINTS) * 1.5 / samples * np.linalg.inv(H)[:6, :6]
    np.testing.assert_allclose(one - none, samples / (samples + PRIOR_SAMPLES) * whole, rtol=1e-4, atol=1e-12)


def test_less_than_a_sample_counts_as_one_and_a_residual_below_half_the_floor_as_that() -> None:
    H, B = normal_matrix(2), normal_matrix(3)
    np.testing.assert_array_equal(covariance(H, B, samples=0.0), covariance(H, B, samples=1.0))
    floor = 0.5 * S.residual_floor_m
    np.testing.assert_array_equal(covariance(H, B, residual=0.0), covariance(H, B, residual=floor))
    assert (np.diag(covariance(H, B, residual=2 * floor)) > np.diag(covariance(H, B, residual=floor))).all()


def body_moments(across_m: float, weight: float = 30.0) -> np.ndarray:
    """Of points that spread by 0.4 m along a line, and less across it."""
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    q = signs * [0.4, across_m, 0.5 * across_m] + [0.2, 0.1, 2.5]
    return np.asarray(moments(apply(TRUTH, q), q, np.full(8, weight / 8)))


def problem(across_m: float = 0.1, weight: float = 30.0, **changed: float) -> str:
    values = {
        "samples": float(S.samples_wanted), "position_sd": S.position_sd_wanted_m,
        "rotation_sd": S.rotation_sd_wanted, "residual": S.residual_allowed_m, **changed,
    }  # fmt: skip
    return problem_of(body_moments(across_m, weight), **values)


def above(value: float) -> float:
    return float(np.nextafter(value, np.inf))


def test_an_estimate_at_all_its_limits_has_no_problem_and_beyond_one_has_its_own() -> None:
    assert problem() == problem(samples=0.0) == ""
    assert problem(residual=above(S.residual_allowed_m)) == NOT_ONE_BODY
    for changed in ({"position_sd": above(S.position_sd_wanted_m)}, {"rotation_sd": above(S.rotation_sd_wanted)}):
        assert problem(**changed) == WALK_ACROSS
        assert problem(samples=S.samples_wanted - 0.01, **changed) == WALK


@pytest.mark.parametrize("weight", [1e-3, 30.0, 1e5])
def test_points_are_on_a_line_within_three_centimetres_whatever_their_weight(weight: float) -> None:
    assert problem(0.031, weight) == ""
    assert problem(0.029, weight) == ON_A_LINE


def seen_pair(seed: int = 0) -> PairCalibration:
    """A pair that has compared some frames of people who moved."""
    rng = np.random.default_rng(seed)
    q, v, gradients = rng.normal(size=(25, 3)) * [0.3, 0.5, 0.2] + [0.2, 0.1, 2.5], rng.normal(size=(25, 3)), None
    gradients = rng.normal(size=(9, 7))
    pair = PairCalibration(T_a_b=TRUTH.copy(), moments=np.asarray(moments(apply(TRUTH, q), q, np.full(25, 20.0), v)))
    pair.scatter[:] = gradients.T @ gradients
    pair.scalars[[at.MOTION, at.BLOCKS, at.BLOCKS_SQ, at.BLOCKS_CLOSED]] = 5.0, 6.0, 4.0, 6.0
    pair.scalars[[at.COST, at.COST_WEIGHT, at.APART_SQ]] = 0.2, 4.0, 0.4
    pair.scalars[at.CENTRE : at.CENTRE + 3] = 4.0 * apply(TRUTH, q).mean(axis=0)
    pair.clock[:] = np.array([1.0, 0.01, 1.0, 0.01, 0.01**2 + 1e-4]) * 10
    return pair


def test_position_is_as_uncertain_as_a_point_where_people_are_and_rotation_as_all_angles_together() -> None:
    pair = seen_pair()
    estimate = pair.estimate()
    centre = pair.scalars[at.CENTRE : at.CENTRE + 3] / pair.scalars[at.COST_WEIGHT]
    moved = np.array([(apply(exp_twist(d), [centre])[0] - centre) / 1e-6 for d in 1e-6 * np.eye(6)]).T
    assert estimate.position_sd == pytest.approx(np.sqrt(np.trace(moved @ estimate.covariance @ moved.T)), rel=1e-4)
    assert estimate.rotation_sd == pytest.approx(np.sqrt(np.trace(estimate.covariance[3:, 3:])))
    assert (estimate.samples, estimate.residual) == pytest.approx((9.0, 0.05))
    assert pair.residual == estimate.residual


def test_sums_that_are_all_larger_are_no_other_estimate() -> None:
    one, more = seen_pair(), seen_pair()
    more.scalars[[at.COST, at.COST_WEIGHT, at.APART_SQ, at.CENTRE, at.CENTRE + 1, at.CENTRE + 2]] *= 3
    assert more.estimate().position_sd == pytest.approx(one.estimate().position_sd)
    assert more.estimate().residual == pytest.approx(one.estimate().residual)
    assert np.isnan(PairCalibration().residual)


def test_an_offset_is_known_from_its_bound_and_its_number_of_samples_on() -> None:
    pair = seen_pair()
    estimate = pair.estimate()
    bound, samples = 2 * estimate.offset_now.sd, int(estimate.samples)
    for wanted_s, wanted, known in (
        (bound, samples, True), (np.nextafter(bound, 0), samples, False), (bound, samples + 1, False),
    ):  # fmt: skip
        pair.settings = dataclasses.replace(S, offset_bound_wanted_s=float(wanted_s), samples_wanted=wanted)
        found = pair.estimate()
        assert found.offset.known is found.offset_now.known is known
        assert found.offset.seconds == (found.offset_now.seconds if known else 0.0)


def test_compiled_figures_are_those_of_the_formulas_in_arrays() -> None:
    """Normal matrix, singular values and clock in other ways, of pairs with and without a clock offset."""
    pairs = [seen_pair(seed) for seed in range(6)]
    for k, pair in enumerate(pairs):
        pair.scalars[[at.OFFSET, at.REFERENCE_OFFSET]] = 0.004 * k, 0.02
        pair.clock *= k > 0
    for pair, found in zip(pairs, estimates(pairs), strict=True):
        H, _ = normal_equations(pair.moments, pair.T_a_b, pair.scalars[at.OFFSET])
        seconds, sd = offset_of(pair.clock)
        C = covariance(H, pair.scatter, samples=9.0, motion_s=5.0, offset_sd=float(sd), weight=float(pair.moments[0]))
        np.testing.assert_allclose(found.covariance, C, rtol=1e-9, atol=1e-15)
        assert found.offset_now.seconds == pytest.approx(float(seconds) + 0.02)
        shape = np.linalg.svd(centred_products(pair.moments) / pair.moments[0], compute_uv=False)
        assert (found.problem == ON_A_LINE) == (shape[1] < ON_A_LINE_M**2)
        assert found.T_a_b is not pair.T_a_b
        assert not np.shares_memory(found.T_a_b, pair.T_a_b)


def test_a_mirrored_stream_is_told_from_a_flat_body() -> None:
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    good = {"samples": 9.0, "position_sd": 0.01, "rotation_sd": 0.01, "residual": 0.05}
    for depth_m, expected in ((MIRRORED_M + 0.001, MIRRORED_STREAM), (MIRRORED_M - 0.001, "")):
        q = signs * [0.5, 0.4, depth_m]
        assert problem_of(moments(q * [-1, 1, 1], q, np.ones(8)), **good) == expected
        assert problem_of(moments(q, q, np.ones(8)), **good) == ""


def told(**values: Any) -> PairEstimate:
    offset = values.pop("offset_now", TimeOffset(0.0, 0.01, True))
    return PairEstimate(TRUTH, np.eye(6), 0.02, 0.03, 5.0, 9.0, 0.05, offset, offset, **{"problem": "", **values})


def test_a_trusted_estimate_leaves_out_what_is_farther_off_than_its_error_a_metre_from_people() -> None:
    pair = PairCalibration()
    pair.trust(told())
    assert pair.scalars[at.OWN_SD] == pytest.approx(0.05)
    pair.trust(told(problem=WALK))
    assert pair.scalars[at.OWN_SD] == 0.0


def test_people_have_walked_from_the_wanted_number_of_samples_on() -> None:
    pair = PairCalibration()
    for closed in range(2 * S.samples_wanted):
        pair.scalars[at.BLOCKS_CLOSED] = closed
        assert pair.walked == (closed >= S.samples_wanted)


@pytest.mark.parametrize("reference_s", [0.0, 0.3, -0.02])
@pytest.mark.parametrize("seconds", [0.008, 0.3, -0.2])
def test_a_clock_seen_as_well_as_it_was_expected_to_be_right_is_followed_half_way(
    reference_s: float, seconds: float
) -> None:
    pair = seen_pair()
    weight = pair.moments[0]
    pair.scalars[at.REFERENCE_OFFSET] = reference_s
    pair.follow_clock(told(offset_now=TimeOffset(seconds, S.offset_expected_s, False)))
    assert pair.scalars[at.REFERENCE_OFFSET] + pair.scalars[at.OFFSET] == pytest.approx(seconds / 2)
    large = abs(seconds / 2 - reference_s) > 0.01
    assert (pair.scalars[at.OFFSET] == 0.0) == (pair.moments[0] < weight) == large
    before = pair.scalars.copy()
    pair.follow_clock(told(offset_now=TimeOffset(9.0, 0.01, True)))  # no sample more
    np.testing.assert_array_equal(pair.scalars, before)


def test_a_clock_seen_no_better_than_without_frames_is_not_followed() -> None:
    pair = seen_pair()
    pair.follow_clock(told(offset_now=TimeOffset(0.2, OFFSET_PRIOR_SD, False)))
    assert pair.scalars[at.REFERENCE_OFFSET] == pair.scalars[at.OFFSET] == 0.0
    pair.scalars[at.FOLLOWED] = -1.0
    pair.follow_clock(told(offset_now=TimeOffset(0.2, float(np.nextafter(OFFSET_PRIOR_SD, 0)), False)))
    assert pair.scalars[at.REFERENCE_OFFSET] > 0.01


@pytest.mark.parametrize("told_s", [0.03, 0.3])
def test_a_given_start_is_worth_its_seconds_of_a_person_in_the_usual_area(told_s: float) -> None:
    pair = PairCalibration.begun_from(TRUTH, PairSettings(told_s=told_s), 0.7)
    np.testing.assert_array_equal(pair.T_a_b, TRUTH)
    np.testing.assert_allclose(align(pair.moments), TRUTH, atol=1e-9)
    assert pair.moments[0] == pytest.approx(TOLD_JOINTS * told_s / TOLD_RESIDUAL_M)
    spread = centred_products(pair.moments) / pair.moments[0]
    np.testing.assert_allclose(spread, TRUTH[:3, :3] * TOLD_REACH**2, atol=1e-9)
    assert pair.scalars[at.COST_WEIGHT] == told_s
    assert pair.estimate().residual == pair.residual == pytest.approx(TOLD_RESIDUAL_M)
    assert pair.scalars[at.APART_SQ] / told_s == pytest.approx(TOLD_APART_M**2)
    centre = pair.scalars[at.CENTRE : at.CENTRE + 3] / told_s
    np.testing.assert_allclose(centre, apply(TRUTH, [TOLD_CENTRE])[0], atol=1e-9)
    assert pair.scalars[at.REFERENCE_OFFSET] == 0.7


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("memory_growth", (0.0, 3.0), (-1e-9,)),
        ("velocity_window_s", (1e-3, 0.299), (0.0, 0.3)),
        ("samples_wanted", (1, 9), (0,)),
        ("moved_factor", (1.0, 9.0), (0.999,)),
        ("every_s", (0.0, 0.2), (-1e-9, 0.201)),
        ("label_hysteresis_m", (0.02, 1.0), (0.0199,)),
        ("turned_weight", (0.0, 1.0), (-1e-9, 1.001)),
        ("told_s", (1e-9, 9e5), (0.0, 1e6)),
    ],
)
def test_settings_are_taken_up_to_their_limits(name: str, good: tuple[float, ...], bad: tuple[float, ...]) -> None:
    for value in good:
        assert getattr(PairSettings(**{name: value}), name) == value  # type: ignore[arg-type]
    for value in bad:
        with pytest.raises(SettingsError, match=name):
            PairSettings(**{name: value})  # type: ignore[arg-type]


def test_an_estimate_is_trusted_without_a_problem() -> None:
    assert told().trusted
    assert not msgspec.structs.replace(told(), problem=WALK).trusted
