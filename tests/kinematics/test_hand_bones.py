"""Bones from a gesture: found, with how sure; and a gesture that does not tell is refused with what to do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.kinematic_hands import RIGHT, THESIS, markers

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.rigid import rigid
from mocapella.kinematics.hand_bones import PHASES, BonesSettings, _DigitFit, measure_bones
from mocapella.kinematics.hand_tracker import base_layout
from mocapella.model.hand import DIGIT_ANGLES, HandShape

FRAMES = 40
LAYOUT = base_layout(RIGHT, 3)


def gesture(  # noqa: PLR0917 - of these tests
    shape: HandShape,
    rng: np.random.Generator,
    noise: float = 0.0,
    knuckles: float = 75,
    hook: float = 95,
    held: float = 0,
) -> tuple[np.ndarray, np.ndarray]:
    phases, k = np.repeat(PHASES, FRAMES), np.arange(3 * FRAMES)
    layout = base_layout(shape, 3)
    swing, angles = 0.5 - 0.5 * np.cos(4 * np.pi * k / FRAMES), np.zeros((len(k), 21))
    for row in DIGIT_ANGLES[1:]:
        angles[:, row[0]] = np.radians(np.where(phases == "knuckles", knuckles * swing, held))
        angles[:, row[2]] = np.radians(np.where(phases == "hook", hook * swing, held))
        angles[:, row[3]] = 2 / 3 * angles[:, row[2]]
    turns = 0.3 * np.sin(0.05 * k[:, None] + np.arange(3))
    T = rigid(Rotation.from_rotvec(turns).as_matrix(), 0.1 * np.cos(0.03 * k[:, None] + np.arange(3)))
    clean = markers(THESIS, shape, layout, angles, T)
    return clean + rng.normal(0, noise, clean.shape) if noise else clean, phases


def somebody(side: str, rng: np.random.Generator) -> HandShape:
    start = THESIS.shape(side)  # type: ignore[arg-type]
    lengths = start.lengths * rng.uniform(0.9, 1.1, (5, 1)) * rng.uniform(0.96, 1.04, (5, 3))
    return HandShape(start.handedness, lengths, start.bases, "Ada")


@pytest.mark.parametrize("side", ["right", "left"])
def test_bones_are_found_and_the_uncertainty_is_true(side: str) -> None:
    scores = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        truth, start = somebody(side, rng), THESIS.shape(side, person="Ada")  # type: ignore[arg-type]
        points, phases = gesture(truth, rng, noise=0.0005, held=2)
        bones = measure_bones(THESIS, start, LAYOUT, points, phases, sd_m=0.0005)
        error = bones.shape.lengths - truth.lengths
        assert np.abs(error[1:].sum(axis=1)).max() < 0.004
        assert bones.shape.lengths_sd is not None
        scores.append(error[1:] / bones.shape.lengths_sd[1:])
        assert (bones.shape.handedness, bones.shape.person) == (side, "Ada")
        assert bones.residual_m < 0.002
        assert (bones.knuckles_deg > 60).all()
        assert (bones.hook_deg > 70).all()
    assert np.sqrt(np.mean(np.square(scores))) < 2


def test_the_thumb_keeps_its_proportion_and_says_that_it_is_not_measured() -> None:
    rng = np.random.default_rng(0)
    bigger = THESIS.shape("right", hand_length_m=1.1 * THESIS.hand_length_m)
    points, phases = gesture(bigger, rng)
    bones = measure_bones(THESIS, RIGHT, LAYOUT, points, phases)
    np.testing.assert_allclose(bones.shape.lengths[0], bigger.lengths[0], rtol=0.03)
    assert bones.finger_sd_m[0] > 2 * bones.finger_sd_m[1:].max()


def test_more_noise_leaves_more_uncertainty() -> None:
    points, phases = gesture(RIGHT, np.random.default_rng(1))
    one, other = (measure_bones(THESIS, RIGHT, LAYOUT, points, phases, sd_m=sd).finger_sd_m for sd in (0.0005, 0.002))
    assert (other[1:] > 1.5 * one[1:]).all()


def test_the_bases_markers_are_found_where_they_are() -> None:
    points, phases = gesture(RIGHT, np.random.default_rng(2))
    bones = measure_bones(THESIS, RIGHT, LAYOUT + np.array([[0.002, 0, 0], [0, 0, 0], [0, 0, 0]]), points, phases)
    between = [np.linalg.norm(x[:, None] - x[None], axis=-1) for x in (bones.base_markers, LAYOUT)]
    np.testing.assert_allclose(between[0], between[1], atol=1e-6)


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ({"knuckles": 15}, "index.*moves by 1[0-9]° only in the part 'knuckles'; bend the straight finger"),
        ({"hook": 20}, "index.*only in the part 'hook'; keep the knuckle straight"),
    ],
)
def test_a_gesture_that_is_too_small_is_refused_and_says_what_to_do(motion: dict[str, float], message: str) -> None:
    points, phases = gesture(RIGHT, np.random.default_rng(3), **motion)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        measure_bones(THESIS, RIGHT, LAYOUT, points, phases)


def test_what_is_seen_too_rarely_is_named() -> None:
    points, phases = gesture(RIGHT, np.random.default_rng(4))
    hidden = points.copy()
    hidden[phases == "hook", 3] = np.nan
    with pytest.raises(InputError, match=r"ring.*too rarely in the part 'hook'"):
        measure_bones(THESIS, RIGHT, LAYOUT, hidden, phases)
    hidden[10:, 6] = np.nan
    with pytest.raises(InputError, match="base: 10: is seen too rarely"):
        measure_bones(THESIS, RIGHT, LAYOUT, hidden, phases)


def test_a_tip_is_seen_often_enough_from_the_least_number_of_instants_on() -> None:
    points, phases = gesture(RIGHT, np.random.default_rng(8))
    (hook,) = np.nonzero(phases == "hook")
    points[hook[20:], 3] = np.nan
    wanted = BonesSettings(least_frames=20)
    assert (measure_bones(THESIS, RIGHT, LAYOUT, points, phases, settings=wanted).hook_deg > 70).all()
    points[hook[19], 3] = np.nan
    with pytest.raises(InputError, match=r"ring: 19: is seen too rarely in the part 'hook'"):
        measure_bones(THESIS, RIGHT, LAYOUT, points, phases, settings=wanted)


def test_a_result_that_is_not_sure_is_refused() -> None:
    points, phases = gesture(RIGHT, np.random.default_rng(5))
    with pytest.raises(InputError, match=r"index: is known to .* mm only; repeat"):
        measure_bones(THESIS, RIGHT, LAYOUT, points, phases, sd_m=0.02)


def test_one_base_marker_or_three_in_a_line_do_not_tell_how_the_palm_lies() -> None:
    points, phases = gesture(RIGHT, np.random.default_rng(6))
    with pytest.raises(InputError, match="three or more markers on the back of the hand"):
        measure_bones(THESIS, RIGHT, LAYOUT[:1], points[:, :6], phases)
    line = points.copy()
    line[:, 7] = 0.5 * (line[:, 5] + line[:, 6])
    with pytest.raises(InputError, match="lie in a line"):
        measure_bones(THESIS, RIGHT, np.array([LAYOUT[0], LAYOUT[1], LAYOUT[:2].mean(axis=0)]), line, phases)


def test_wrong_arrays_and_names_are_refused() -> None:
    points, phases = gesture(RIGHT, np.random.default_rng(7))
    with pytest.raises(InputError, match="points"):
        measure_bones(THESIS, RIGHT, LAYOUT, points[:, :7], phases)
    with pytest.raises(InputError, match="'fist': is no part of the gesture; take one of flat, knuckles, hook"):
        measure_bones(THESIS, RIGHT, LAYOUT, points, np.where(phases == "hook", "fist", phases))
    with pytest.raises(SettingsError, match="sd_m"):
        measure_bones(THESIS, RIGHT, LAYOUT, points, phases, sd_m=0)


@pytest.mark.parametrize("name", list(BonesSettings.__dataclass_fields__))
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        BonesSettings(**{name: -1})


@pytest.mark.parametrize("digit", [1, 4])
def test_the_equations_of_a_fit_are_the_slope_of_its_cost(digit: int) -> None:
    """In each unknown: lengths, base, held angles, and each instant's angles."""
    rng = np.random.default_rng(digit)
    names = np.array([*PHASES, "hook", "knuckles", "flat"])
    tips = rng.normal([0.0, 0.0, 0.1], 0.05, (6, 3))
    whitening = np.linalg.inv(np.linalg.cholesky(0.001**2 * (np.eye(3) + 0.2 * np.ones((3, 3)))))
    fit = _DigitFit(THESIS, RIGHT, digit, tips, np.tile(whitening, (6, 1, 1)), names, BonesSettings())
    fit.shared += rng.normal(0, 1, 8) * fit.prior_sd
    fit.angles += rng.normal(0, 0.3, fit.angles.shape)
    A, _, C, of_shared, of_angles = fit._equations()
    for k in range(8):
        step = 1e-5 * fit.prior_sd[k] * np.eye(8)[k]
        slope = (fit._cost(fit.shared + step, fit.angles) - fit._cost(fit.shared - step, fit.angles)) / (2 * step[k])
        assert slope == pytest.approx(-2 * of_shared[k], rel=1e-5)
    for n in range(6):
        for k in range(4):
            step = np.zeros((6, 4))
            step[n, k] = 1e-7
            slope = (fit._cost(fit.shared, fit.angles + step) - fit._cost(fit.shared, fit.angles - step)) / 2e-7
            assert slope == pytest.approx(-2 * of_angles[n, k], rel=1e-4, abs=1e-6 * np.abs(of_angles).max())
    assert (np.linalg.eigvalsh(A) > 0).all()
    assert (np.linalg.eigvalsh(C) > 0).all()


def test_the_cost_of_a_fit_is_1_where_a_length_is_one_standard_deviation_off_and_all_else_fits() -> None:
    """The tips are those of the changed finger, so that only the deviation from what is expected is left."""
    names = np.array(["flat", "flat"])
    fit = _DigitFit(THESIS, RIGHT, 2, np.zeros((2, 3)), np.tile(1000 * np.eye(3), (2, 1, 1)), names, BonesSettings())
    for k in range(6):
        for deviations in (1.0, -2.0):
            shared = fit.prior + deviations * fit.prior_sd * np.eye(8)[k]
            fit.tips = fit._tips(shared, fit.angles)[0]
            assert fit._cost(shared, fit.angles) == pytest.approx(deviations**2)
            assert np.abs(fit.residuals()).max() == pytest.approx(
                np.abs(fit.tips - fit._tips(fit.prior, fit.angles)[0]).max()
            )
