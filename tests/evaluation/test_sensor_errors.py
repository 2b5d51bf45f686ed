"""Check that the measurement of sensor errors recovers simulated errors."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from support.evaluation_sessions import body as standing
from support.evaluation_sessions import log_of

from mocapella.association.proportions import SD_M
from mocapella.errors import InputError
from mocapella.evaluation import sensor_errors
from mocapella.evaluation.facing_sessions import AlignedViews
from mocapella.evaluation.labelled_views import LabelledViews, mirrored_better
from mocapella.evaluation.sensor_error_fit import (
    KNOTS_S,
    LAG_S,
    autocovariance,
    fit_bias,
    fit_correlation,
    fit_spread,
    fit_white_noise,
    knot_autocorrelation,
    unexplained,
)
from mocapella.evaluation.sensor_errors import _statement, as_simulated, measure, told_apart
from mocapella.model.session import SCENARIOS
from mocapella.recording.study_log import write_study_log
from mocapella.sources.simulate import SimulatedSensor, scene_settings
from mocapella.sources.simulate.body import BODY, JOINT
from mocapella.sources.simulate.measured import (
    BIAS_BINS,
    Errors,
    SensorErrors,
    bias_place,
    measured_errors,
    spline_weights,
    view_axes,
)
from mocapella.sources.simulate.room import PersonSettings

MIRROR = list(BODY.mirror)
RNG = np.random.default_rng(5)


def views(bias: np.ndarray, noise: float = 0.0, frames: int = 600) -> LabelledViews:
    """Two views 70° apart of somebody who turns around in Walk, with that bias."""
    alpha = np.linspace(-np.pi, np.pi, frames)
    both = np.stack([alpha, (alpha - np.radians(70) + np.pi) % (2 * np.pi) - np.pi], axis=1)
    toward = np.tile([0.3, 0.3 + np.radians(70)], (frames, 1))
    seen = RNG.normal(size=(frames, 1, 25, 3)) + np.zeros((1, 2, 1, 1))
    for k in range(2):
        first, second, part = bias_place(both[:, k])
        of_frame = (1 - part)[:, None] * bias[:, first] + part[:, None] * bias[:, second]
        seen[:, k] += np.einsum("nik,jnk->nji", view_axes(toward[:, k]), of_frame[..., :])
    seen += noise * RNG.normal(size=seen.shape)
    nothing = np.zeros((frames, 2), dtype=bool)
    raw = AlignedViews(np.zeros((frames, 2)), np.full(frames, 3), seen, seen, np.zeros((2, 3)), toward)
    return LabelledViews("x", 0, raw, both, both, nothing, seen, np.zeros((frames, 2, 25), dtype=bool))


def mirrored_bias() -> np.ndarray:
    """(25, bins, 3) that is its own mirror image."""
    bias = 0.05 * RNG.normal(size=(25, BIAS_BINS, 3))
    other = bias[MIRROR][:, (-np.arange(BIAS_BINS)) % BIAS_BINS] * [-1, 1, 1]
    return (bias + other) / 2


def test_the_bias_between_two_views_is_found_again() -> None:
    of = views(mirrored_bias())
    before = np.linalg.norm(of.positions[:, 0] - of.positions[:, 1], axis=-1).mean()
    rest = unexplained(of, fit_bias([of]))
    assert np.linalg.norm(rest, axis=-1).mean() < 0.2 * before


def test_noise_without_bias_is_as_wide_as_it_was_made() -> None:
    of = views(np.zeros((25, BIAS_BINS, 3)), noise=0.03, frames=3000)
    sd = fit_spread([of], [unexplained(of, np.zeros((25, BIAS_BINS, 3)))])
    assert sd[:, 0] == pytest.approx(0.03, rel=0.15)
    correlation = fit_correlation([of], [of.positions[:, 0] - of.positions[:, 1]], sd)
    assert np.abs(correlation - np.eye(25) - np.diag(np.diag(correlation) - 1)).max() < 0.1


def test_white_noise_has_no_memory_and_splines_have_that_of_their_knots() -> None:
    covariance = autocovariance([0.02 * RNG.normal(size=(20_000, 2, 3))])
    assert covariance[0] == pytest.approx(0.02**2, rel=0.03)
    assert np.abs(covariance[1:]).max() < 0.02 * covariance[0]
    known = knot_autocorrelation(0.4, np.array([0.0, 0.2, 0.4, 1.7]))
    assert known[0] == pytest.approx(1)
    assert (np.diff(known) < 0).all()
    assert known[-1] == pytest.approx(0, abs=1e-9)


def splines(step: float, frames: int, series: int, rng: np.random.Generator) -> np.ndarray:
    """(frames, series) random cubic splines of variance 1, with a frame every ``step`` knots."""
    places = step * np.arange(frames)
    first = np.floor(places).astype(int)
    knots = rng.normal(size=(first[-1] + 4, series))
    weights = np.stack([spline_weights(float(place - k)) for place, k in zip(places, first, strict=True)])
    return np.einsum("fw,fws->fs", weights, knots[first[:, None] + np.arange(4)])


def test_the_memory_of_a_spline_is_that_of_splines_with_knots_anywhere() -> None:
    """Of many splines, with eight frames between two knots."""
    made = splines(1 / 8, 1600, 300, np.random.default_rng(1))
    lags = np.array([0, 2, 4, 8, 16])
    measured = [(made[lag:] * made[: len(made) - lag]).mean() for lag in lags]
    np.testing.assert_allclose(knot_autocorrelation(0.4, lags * 0.05), measured, atol=0.015)
    np.testing.assert_allclose(knot_autocorrelation(2.0, lags * 0.25), knot_autocorrelation(0.4, lags * 0.05))


def standing_views(white_m: np.ndarray, spline_m: float) -> LabelledViews:
    """Somebody who stands and faces the first sensor, whose joints shake; in Walk, and to the second, they shake more.

    In Walk, the person faces the second sensor.
    """
    rng, stands, walks = np.random.default_rng(2), 1000, 100
    walking = np.arange(stands + walks) >= stands
    shape = (stands + walks, 2, 25, 3)
    seen = standing() + white_m[:, None] * rng.normal(size=shape)
    smooth = splines(LAG_S / KNOTS_S[0], shape[0], 25 * 3, rng).reshape(shape[0], 25, 3)
    seen[:, 0] += spline_m * smooth
    seen[:, 1] += 0.1 * rng.normal(size=seen[:, 1].shape)
    seen[walking] += 0.1 * rng.normal(size=seen[walking].shape)
    alpha = np.where(walking[:, None], [2.5, 0.1], [-0.4, 2.5])
    zeros, task = np.zeros(shape[:2]), np.where(walking, SCENARIOS["walk"], SCENARIOS["stationary"])
    raw = AlignedViews(zeros, task, seen, seen, np.zeros((2, 3)), zeros)
    return LabelledViews("x", 0, raw, alpha, alpha, zeros > 1, seen, np.zeros(shape[:3], dtype=bool))


@pytest.mark.parametrize("spline_m", [0.0, 0.004])
def test_white_noise_is_what_shakes_those_who_stand_and_face_a_sensor_and_what_splines_do_not(spline_m: float) -> None:
    white_m = np.linspace(0.002, 0.006, 25)
    sd = np.full((25, 2, 3), 0.02)
    share = np.array([(spline_m / 0.02) ** 2, 0.0, 0.0])
    found = fit_white_noise([standing_views(white_m, spline_m)], sd, share)
    assert found == pytest.approx(white_m, rel=0.12)


def test_there_is_no_white_noise_if_splines_shake_more_than_the_views() -> None:
    found = fit_white_noise([standing_views(np.full(25, 0.001), 0.0)], np.full((25, 2, 3), 0.02), np.ones(3))
    assert (found == 0).all()


def test_people_of_different_lengths_are_told_apart_and_twins_are_not() -> None:
    def session(person: int, size: float) -> tuple[int, np.ndarray]:
        return person, 0.3 * size + SD_M * RNG.normal(size=(120, 2, 6))

    apart = told_apart([session(0, 1.0), session(1, 2.0), session(0, 1.0)], near=2.0)
    assert apart["same_nearer_percent"] == apart["other_session_nearer_percent"] == 100
    assert apart["other_person_near_percent"] == 0
    twins = told_apart([session(0, 1.0), session(1, 1.0)], near=2.0)
    assert twins["other_person_near_percent"] == 100
    assert told_apart([session(0, 1.0), session(0, 1.0)], near=2.0) == {}


def test_views_with_swapped_labels_are_nearer_mirrored() -> None:
    body = np.zeros((4, 25, 3))
    body[:, JOINT["HandLeft"]], body[:, JOINT["HandRight"]] = [1, 0, 0], [-1, 0, 0]
    assert mirrored_better(body, body) == 0
    half = np.where(np.arange(4)[:, None, None] < 2, body, body[:, MIRROR])
    assert mirrored_better(body, half) == 0.5
    assert mirrored_better(body * [0, 1, 1], body * [0, 1, 1]) == 0  # without width, swapping changes nothing
    assert mirrored_better(body + np.array([0, 0, 5]), body) == 0


@pytest.mark.slow
def test_a_real_log_gives_a_table_that_a_sensor_can_use(study_logs: Path, tmp_path: Path) -> None:
    name = "Study_4_Kinect_0_Time_1_17_51_PM.csv.gz"
    (tmp_path / name).symlink_to(study_logs / name)
    errors = measure(tmp_path)
    used = Errors(errors)
    assert errors.measured_on["participants"] == [4]
    assert set(errors.measured_on["by_placement"]) == {"parallel"}
    assert 0.5 < errors.measured_on["by_placement"]["parallel"]["stationary_jitter_mm"] < 40
    assert max(errors.yaw_deg) < 110
    assert errors.mirrored[0] < 0.05
    assert errors.mirrored[-1] > 0.8
    assert 0.003 < np.median(used.sd_m[:, 0, 0]) < 0.06


def labels_swapped_from_behind(share: list[float], white_m: float) -> SensorErrors:
    """Sensors of white noise that swap left and right where they see a back, and the facings to compare with."""
    half, joints = [0.0, 89.999, 90.001, 180.0], len(BODY)
    return msgspec.structs.replace(
        measured_errors().data,
        measured_on={"by_placement": {"90": {"walk_alpha_share": share}}},
        alpha_deg=half, mirrored=[0.0, 0.0, 1.0, 1.0],
        yaw_deg=half, mirrored_yaw_deg=[yaw - 180 for yaw in half], yaw_sd_deg=[0.0] * 4, mirrored_yaw_sd_deg=[0.0] * 4,
        bias_m=np.zeros((joints, BIAS_BINS, 3)).tolist(), sd_m=np.full((joints, 2, 3), 1e-6).tolist(),
        white_m=[white_m] * joints, losses_per_min=0.0, joint_lost=0.0,
    )  # fmt: skip


def test_simulated_facings_count_as_often_as_recorded_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of sensors 90° apart, one alone sees the back at an α of 90° to 120° at the first, or of −60° to −90°.

    At 60° to 90°, towards the second sensor, neither sees it, and both at −90° to −120°.
    """
    turns = PersonSettings((0.8, 2.8), "route", route=("stand 0.4", "turn 320", "turn 190", "turn 70"))
    scene = dataclasses.replace(scene_settings("walk"), people=(turns,))
    monkeypatch.setattr(sensor_errors, "scene_settings", lambda name: scene)
    monkeypatch.setattr(sensor_errors, "STILL_S", 0.3)
    neither, first, second, both = 0.4, 0.3, 0.2, 0.1
    share = [0.0, 0.0, both, second, 0.0, 0.0, 0.0, 0.0, neither, first, 0.0, 0.0]
    white_m = 0.002
    found = as_simulated(labels_swapped_from_behind(share, white_m), seeds=(0,))
    assert found["90"]["mirrored_better_percent"] == pytest.approx(100 * (first + second), abs=2)
    # The variance of a second difference is 1 + 4 + 1 times that of a coordinate, of which there are three.
    assert found["90"]["stationary_jitter_mm"] == pytest.approx(1000 * white_m * np.sqrt(6 * 3), rel=0.15)


def test_simulated_views_without_errors_but_white_noise_are_as_near_as_that(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two sensors 90° apart that both see the front: what still frames shake by is no motion of those who turn.

    Frames in which one of them has nobody do not count.
    """

    class Blinks(SimulatedSensor):
        def frames(self, begin_s: float, end_s: float) -> Any:
            for k, item in enumerate(super().frames(begin_s, end_s)):
                seen: Any = SimpleNamespace(frame=SimpleNamespace(bodies=0), truth=item.truth)
                yield seen if k > 12 and k % 7 == 3 + (self.name == "second") else item

    monkeypatch.setattr(sensor_errors, "SimulatedSensor", Blinks)
    turns = PersonSettings((0.8, 2.8), "route", route=("stand 0.4", "turn 260"))
    scene = dataclasses.replace(scene_settings("walk"), people=(turns,))
    monkeypatch.setattr(sensor_errors, "scene_settings", lambda name: scene)
    monkeypatch.setattr(sensor_errors, "STILL_S", 0.3)
    neither, white_m = [0.0] * 8 + [1.0] + [0.0] * 3, 0.0002
    found = as_simulated(labels_swapped_from_behind(neither, white_m), seeds=(0,))["90"]
    # The mean length of a normal vector in space is √(8/π) times a coordinate's; of a difference, √2 times that.
    assert found["walk_dd_cm"] == pytest.approx(100 * white_m * np.sqrt(2 * 8 / np.pi), abs=0.011)
    assert found["mirrored_better_percent"] == 0
    assert found["bone_length_variation_percent"] < 1
    assert found["stationary_jitter_mm"] == pytest.approx(1000 * white_m * np.sqrt(6 * 3), rel=0.1)


def test_what_is_stated_of_a_session_is_what_its_views_were_made_with() -> None:
    """Somebody who stands while both views shake by 1 mm, then walks, 10 % larger and smaller by turns, 3 cm apart."""
    stands, walks = 40, 60
    frames = stands + walks
    walking, turns = np.arange(frames) >= stands, np.where(np.arange(frames) % 2, 1.0, -1.0)[:, None, None]
    seen = np.where(walking[:, None, None], (1 + 0.1 * turns) * standing(), standing() + turns * [0.001, 0.0, 0.0])
    both = np.stack([seen, seen + np.where(walking, 0.03, 0.0)[:, None, None] * [0.0, 1.0, 0.0]], axis=1)
    task = np.where(walking, SCENARIOS["walk"], SCENARIOS["stationary"])
    zeros, nothing = np.zeros((frames, 2)), np.zeros((frames, 2), dtype=bool)
    at_s = np.arange(frames)[:, None] / 30 + zeros
    raw = AlignedViews(at_s, task, both, both, np.zeros((2, 3)), zeros)
    view = LabelledViews("90", 0, raw, zeros, zeros, nothing, both, np.zeros((frames, 2, 25), dtype=bool))
    figures = _statement([view], [both[:, 0] - both[:, 1]], [], 1.0, [])["by_placement"]["90"]
    assert figures["walk_dd_cm"] == figures["walk_rest_cm"] == pytest.approx(3)
    assert figures["bone_length_variation_percent"] == pytest.approx(10)
    assert figures["mirrored_better_percent"] == 0
    assert figures["stationary_jitter_mm"] == pytest.approx(4)  # of −1, 1 and −1 mm: the second difference


def test_what_was_fitted_is_told_rounded_with_losses_per_minute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shares of the splines are of their sum."""
    known = measured_errors().data
    view = views(np.zeros((25, BIAS_BINS, 3)), frames=12)
    sessions = [SimpleNamespace(), SimpleNamespace()]
    fits = {"fit_bias": known.bias_m, "fit_spread": known.sd_m, "fit_white_noise": known.white_m}
    fits |= {
        "fit_correlation": known.correlation,
        "fit_shares": [3e-4, 1e-4, 0.0],
        "fit_still_shares": [0.5, 0.25, 0.1],
    }
    for name, values in fits.items():
        monkeypatch.setattr(sensor_errors, name, lambda *_, values=values: np.array(values))
    tables = ("alpha_deg", "mirrored", "yaw_deg", "yaw_sd_deg", "mirrored_yaw_deg", "mirrored_yaw_sd_deg")
    monkeypatch.setattr(sensor_errors, "study_sessions", lambda *_: iter(sessions))
    monkeypatch.setattr(sensor_errors, "labelled_views", lambda session: view if session is sessions[0] else None)
    monkeypatch.setattr(sensor_errors, "_yaw_tables", lambda views: {name: getattr(known, name) for name in tables})
    monkeypatch.setattr(sensor_errors, "_losses", lambda _: ([0.25] * 5, 4.0))
    monkeypatch.setattr(sensor_errors, "_joint_lost", lambda of: 0.01 * len(of))
    monkeypatch.setattr(sensor_errors, "_statement", lambda *told: {"views": len(told[0])})
    found = measure(tmp_path)
    assert (found.losses_per_min, found.joint_lost, found.measured_on) == (1.25, 0.02, {"views": 1})
    assert (found.share, found.still_share) == ([0.75, 0.25, 0.0], [0.5, 0.25, 0.1])
    assert found.loss_s == [0.25] * 20
    monkeypatch.setattr(sensor_errors, "_losses", lambda _: ([], 4.0))
    assert measure(tmp_path).loss_s == []


def test_a_folder_without_somebody_in_all_three_tasks_is_refused(tmp_path: Path) -> None:
    log = log_of(frames=60)
    log.scenario_id[:] = 3
    write_study_log(tmp_path / "Study_7_Kinect_2_Time_1.csv.gz", log.rows())
    with pytest.raises(InputError, match="Stationary, Steps and Walk"):
        measure(tmp_path)
