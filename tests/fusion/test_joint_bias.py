"""What is known of joints by the facing: its laws, its file, and how it is learnt."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import InputError, SettingsError
from mocapella.fusion import joint_bias
from mocapella.fusion.joint_bias import (
    MIRRORED_AXES,
    TERMS,
    JointBiasModel,
    LeftOut,
    body_view,
    from_json,
    mirrored,
    read_model,
    shipped_model,
    symmetric,
    terms,
    to_json,
)
from mocapella.fusion.joint_bias_kernels import terms_of
from mocapella.fusion.joint_bias_training import BiasTrainingSettings, ViewPairs, second_to_first, train
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.model.topology import topology

KINECT = topology("kinect_v2")
MIRROR = list(KINECT.mirror)
few = settings(max_examples=25, deadline=None)
angles = st.floats(-np.pi, np.pi)
speeds = st.floats(-2.0, 2.0)
places = st.tuples(st.floats(-2, 2), st.floats(-1, 1), st.floats(0.8, 5)).map(np.array)
velocities = st.tuples(speeds, speeds, speeds).map(np.array)


def weights_of(seed: int, size: float = 0.02) -> np.ndarray:
    free = np.random.default_rng(seed).normal(size=(TERMS, len(KINECT), 3))
    return size * symmetric(free, KINECT.mirror)


def model_of(seed: int) -> JointBiasModel:
    folds = tuple(LeftOut(people, weights_of(seed + 1 + i)) for i, people in enumerate([(1, 3), (2,)]))
    return JointBiasModel(KINECT.name, weights_of(seed), {"participants": [1, 2, 3]}, folds)


# Laws


@given(st.integers(0, 99), angles, places, velocities)
@few
def test_the_mirror_image_of_a_view_has_the_mirror_image_of_the_bias(
    seed: int, facing: float, position: np.ndarray, velocity: np.ndarray
) -> None:
    model = model_of(seed)
    one = model("front", facing, position, velocity)
    other = model("front", -facing, MIRRORED_AXES * position, MIRRORED_AXES * velocity)
    np.testing.assert_allclose(other, (MIRRORED_AXES * one)[MIRROR], atol=1e-12)


@given(st.integers(0, 99), st.floats(0.5, 6), speeds, speeds)
@few
def test_over_all_facings_the_bias_is_nothing_in_the_body_s_axes(
    seed: int, distance_m: float, ahead: float, left: float
) -> None:
    alpha = np.linspace(-np.pi, np.pi, 48, endpoint=False)
    of_view = terms(alpha, np.full(48, distance_m), np.full(48, ahead), np.full(48, left))
    bias = np.tensordot(of_view, weights_of(seed), axes=1)
    np.testing.assert_allclose(bias.mean(axis=0), 0.0, atol=1e-12)
    assert np.abs(bias).max() > 1e-3


@given(st.integers(0, 99), angles, places, velocities, angles)
@few
def test_it_turns_with_the_person_about_the_sensor(
    seed: int, facing: float, position: np.ndarray, velocity: np.ndarray, turn: float
) -> None:
    model, R = model_of(seed), rotation_about_y(turn)
    one = model("front", facing, position, velocity)
    np.testing.assert_allclose(model("front", facing, R @ position, R @ velocity), one @ R.T, atol=1e-9)


@given(angles, st.floats(0, 6), speeds, speeds)
@few
def test_the_compiled_terms_are_the_same(alpha: float, distance_m: float, ahead: float, left: float) -> None:
    wanted = terms(*(np.float64(value) for value in (alpha, distance_m, ahead, left)))
    np.testing.assert_allclose(terms_of(alpha, distance_m, ahead, left), wanted, atol=1e-12)


@given(st.integers(0, 99))
@few
def test_weights_are_made_symmetric_once_and_for_all(seed: int) -> None:
    weights = weights_of(seed)
    np.testing.assert_allclose(mirrored(weights, KINECT.mirror), weights, atol=1e-15)
    np.testing.assert_allclose(symmetric(weights, KINECT.mirror), weights, atol=1e-15)


# Learning


def sessions(weights: np.ndarray, seed: int, count: int = 3, noise: float = 0.01, frames: int = 250) -> list[ViewPairs]:
    """Two sensors, somewhere else in each session, that see somebody who turns about and walks; biased by weights."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        t = np.linspace(0, 30, frames)
        place = np.stack([0.8 * np.sin(0.4 * t), np.zeros(frames), 2.6 + 0.8 * np.sin(0.3 * t + 1)], axis=-1)
        yaw = np.pi + 1.2 * np.sin(0.7 * t) + rng.normal()
        joints = rng.normal(size=(len(KINECT), 3)) * [0.2, 0.4, 0.15]
        joints = (joints + (MIRRORED_AXES * joints)[MIRROR]) / 2
        world = apply(rigid(rotation_about_y(yaw), place), joints)
        velocity = np.gradient(place, t, axis=0)
        second = rigid(rotation_about_y(rng.uniform(0.5, 1.5)), [-2.5, 0.1, 1.0] + 0.3 * rng.normal(size=3))
        views: dict[str, list[np.ndarray]] = {name: [] for name in ("positions", "facing", "position", "velocity")}
        for T_world_sensor in (np.eye(4), second):
            back = inverse(T_world_sensor)
            there, moving = apply(back, place), velocity @ back[:3, :3].T
            turned = yaw + np.arctan2(back[0, 2], back[0, 0])
            facing = turned - np.arctan2(-there[:, 0], -there[:, 2])
            of_view, R = body_view(facing, there, moving)
            bias = np.tensordot(of_view, weights, axes=1) @ np.swapaxes(R, -1, -2)
            views["positions"].append(apply(back, world) + bias + noise * rng.normal(size=world.shape))
            views["facing"].append(facing)
            views["position"].append(there)
            views["velocity"].append(moving)
        stacked = {name: np.stack(values, axis=1) for name, values in views.items()}
        out.append(ViewPairs(weight=np.full(frames, 1.0 / frames), **stacked))
    return out


def apart(found: list[ViewPairs], weights: np.ndarray) -> float:
    """Median distance of the two views, the bias taken off and the second sensor placed as well as can be [m]."""
    distances = []
    for session in found:
        of_view, R = body_view(session.facing, session.position, session.velocity)
        T = second_to_first(session, of_view, R, weights)
        corrected = session.positions - np.tensordot(of_view, weights, axes=1) @ np.swapaxes(R, -1, -2)
        distances.append(np.linalg.norm(corrected[:, 0] - apply(T, corrected[:, 1]), axis=-1))
    return float(np.nanmedian(np.concatenate(distances)))


QUICK = BiasTrainingSettings(ridge=1e-4, rounds=3, steps=3)


def test_a_bias_that_nobody_wrote_down_is_learnt_and_taken_off_in_sessions_not_learnt_from() -> None:
    true = weights_of(0, 0.05)
    learnt = train(sessions(true, 1, noise=0.002), KINECT, QUICK)
    np.testing.assert_allclose(mirrored(learnt, KINECT.mirror), learnt, atol=1e-12)
    others = sessions(true, 2, noise=0.002)
    nothing, perfect = np.zeros_like(true), apart(others, true)
    assert apart(others, nothing) > 10 * perfect
    assert apart(others, learnt) < 2 * perfect


def test_where_there_is_no_bias_none_is_learnt_and_lost_limbs_teach_nothing() -> None:
    found = sessions(np.zeros((TERMS, len(KINECT), 3)), 3, count=2)
    rng = np.random.default_rng(4)
    for session in found:
        lost = rng.random(session.positions.shape[:3]) < 0.03
        session.positions[lost] += rng.normal(size=(lost.sum(), 3))
        session.positions[rng.random(session.positions.shape[:3]) < 0.03] = np.nan
        session.facing[:20] = np.nan
    learnt = train(found, KINECT, BiasTrainingSettings(rounds=2, steps=3))
    assert np.abs(learnt).max() < 0.01
    assert np.isfinite(learnt).all()


def test_a_stronger_ridge_learns_less() -> None:
    found = sessions(weights_of(0, 0.05), 1, count=2)
    weak, strong = (
        np.abs(train(found, KINECT, BiasTrainingSettings(ridge=ridge, rounds=1, steps=2))).sum() for ridge in (1e-3, 10)
    )
    assert strong < 0.3 * weak


def test_learning_says_what_it_lacks() -> None:
    found = sessions(weights_of(0), 1, count=1, frames=20)
    found[0].facing[:] = np.nan
    with pytest.raises(InputError, match="no frame has two views of a person whose facing is known"):
        train(found, KINECT)
    for name, value in (("ridge", 0.0), ("rounds", 0), ("steps", 0), ("least_m", 2.0)):
        with pytest.raises(SettingsError, match=name):
            BiasTrainingSettings(**{name: value})


# The file


def test_the_shipped_model_is_small_and_says_what_it_was_trained_on() -> None:
    model = shipped_model()
    assert model is not None
    text = to_json(model)
    assert len(text) < 50_000
    assert model.trained_on["participants"] == [*range(10), 20, 21, 22]
    assert model.trained_on["sessions_of_two_people"] == 3
    assert "KinectMultiTrack" in model.trained_on["recordings"]
    assert "mocapella lab train bias" in model.trained_on["command"]
    assert np.abs(model.weights).max() < 0.3
    for participant in model.trained_on["participants"]:
        others = model.without(participant)
        assert participant not in others.trained_on["participants"]
        assert len(others.trained_on["participants"]) in (10, 11)
        assert (others.weights != model.weights).any()


def test_a_model_survives_its_file(tmp_path: Path) -> None:
    model = model_of(3)
    text = to_json(model)
    (tmp_path / "m.json").write_text(text, encoding="utf-8")
    read = read_model(tmp_path / "m.json")
    assert to_json(read) == text
    np.testing.assert_allclose(read.weights, model.weights, atol=5e-5)
    np.testing.assert_allclose(read.left_out[0].weights, model.left_out[0].weights, atol=5e-5)


def test_without_a_file_there_is_no_model(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(joint_bias, "files", lambda package: tmp_path)
    assert shipped_model.__wrapped__() is None


def test_who_taught_the_model_is_left_out_and_who_did_not_needs_not_be() -> None:
    model = model_of(0)
    assert model.without(9) is model
    np.testing.assert_array_equal(model.without(3).weights, model.left_out[0].weights)
    assert model.without(3).trained_on["participants"] == [2]
    assert model.without(3).without(1).trained_on["participants"] == [2]
    alone = JointBiasModel(KINECT.name, model.weights, model.trained_on)
    with pytest.raises(SettingsError, match=r"participant 2 and never without.*--folds 5"):
        alone.without(2)


ROW = [[0.0] * 3] * TERMS


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("terms", ["cos α"], "terms are not those of this version"),
        ("topology", "kinect_v9", "kinect_v9"),
        ("topology", "kinect_v1", "joints are not those of kinect_v1"),
        ("weights", {"Head": ROW}, "joints are not those of kinect_v2: AnkleLeft"),
        ("left_out", [{"participants": [1, 3], "weights": {}}], "joints are not those"),
        ("left_out", [], ""),
        ("trained_on", {"participants": [1, 2, 3, 4]}, r"left out were \[1, 2, 3\], where it was trained on"),
        ("weights", "small", "Expected `object`, got `str`"),
        ("extra", 1, "unknown field `extra`"),
    ],
)
def test_a_file_that_is_no_model_is_refused(field: str, value: Any, said: str) -> None:
    data = {**json.loads(to_json(model_of(0))), field: value}
    if not said:  # folds may be missing
        assert from_json(json.dumps(data), "a.json").left_out == ()
        return
    with pytest.raises(InputError, match=f"a.json: is no model of joint bias: .*{said}.*mocapella lab train bias"):
        from_json(json.dumps(data), "a.json")


def test_a_damaged_row_and_a_file_that_is_not_there_are_refused(tmp_path: Path) -> None:
    data = json.loads(to_json(model_of(0)))
    data["weights"]["KneeLeft"][2] = [0.0, 0.0]
    with pytest.raises(InputError, match=f"KneeLeft has not {TERMS} rows of 3 weights"):
        from_json(json.dumps(data), "a.json")
    with pytest.raises(InputError, match=r"none\.json: cannot be read"):
        read_model(tmp_path / "none.json")
    with pytest.raises(InputError, match=r"a\.json: is no model of joint bias"):
        from_json(to_json(model_of(0))[:-40], "a.json")
