"""Why two logged views lie apart: laws of the best motion, and the shares of its causes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError
from mocapella.evaluation.apart_causes import causes_by_task, causes_of
from mocapella.geometry import rigid
from mocapella.model.topology import topology

ANGLES = st.floats(-150.0, 150.0)


def person(seed: int, pairs: int = 30) -> np.ndarray:
    """Joints (pairs, 25, 3) of a person who goes about [m]."""
    rng = np.random.default_rng(seed)
    body = rng.normal(size=(25, 3)) * (0.3, 0.5, 0.1)
    return np.asarray(body + rng.normal(size=(pairs, 1, 3)) * (0.6, 0.0, 0.6) + (0.0, 0.0, 2.5))


@given(st.integers(0, 99), ANGLES, st.floats(-1.0, 1.0))
def test_a_wrong_motion_alone_leaves_nothing_and_its_angle_is_found(seed: int, degrees: float, x: float) -> None:
    first = person(seed)
    second = rigid.apply(rigid.rigid(rigid.rotation_about_y(np.radians(degrees)), (x, 0.0, 0.0)), first)
    found = causes_of(np.stack([first, second], axis=1))[0]
    assert found.left_cm < 1e-6
    assert found.turned_deg == pytest.approx(abs(degrees), abs=1e-4)
    assert found.apart_cm == pytest.approx(100 * np.linalg.norm(first - second, axis=-1).mean())
    assert found.swapped_percent == 0


@given(st.integers(0, 99), st.floats(0.0, 0.1))
def test_the_best_motion_is_never_worse_in_mean_squares_and_noise_is_left(seed: int, noise_m: float) -> None:
    first = person(seed)
    second = first + noise_m * np.random.default_rng(seed).normal(size=first.shape)
    found = causes_of(np.stack([first, second], axis=1))[0]
    assert found.left_cm <= found.apart_cm * 1.05 + 1e-6
    assert found.left_cm >= found.apart_cm * 0.9 - 1e-6


def test_swapped_labels_are_counted() -> None:
    first = person(0, pairs=50)
    second = first.copy()
    second[:10] = second[:10, list(topology("kinect_v2").mirror)]
    assert causes_of(np.stack([first, second], axis=1))[0].swapped_percent == pytest.approx(20)


def test_missing_joints_and_pairs_without_a_common_joint_are_left_out() -> None:
    first = person(0)
    second = first + 0.01
    views = np.stack([first, second], axis=1)
    whole = causes_of(views)[0]
    views[3, 0, :12] = np.nan
    views[4, 1] = np.nan
    found = causes_of(views)[0]
    assert found.apart_cm == pytest.approx(whole.apart_cm)
    assert found.left_cm == pytest.approx(0, abs=1e-6)


def test_a_constant_difference_is_told_from_noise() -> None:
    first, rng = person(0, pairs=400), np.random.default_rng(1)
    constant = 0.03 * rng.normal(size=(25, 3))
    second = first + constant + 0.01 * rng.normal(size=first.shape)
    found, steady = causes_of(np.stack([first, second], axis=1))
    assert steady.shape == (25, 3)
    assert found.steady_cm == pytest.approx(100 * np.linalg.norm(constant, axis=-1).mean(), rel=0.15)
    assert found.steady_cm < found.left_cm


def test_a_folder_without_logs_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Study_"):
        causes_by_task(tmp_path)


@pytest.mark.slow
def test_a_real_walk_is_apart_by_a_wrong_motion(study_logs: Path) -> None:
    found = causes_by_task(study_logs, [7, 20])
    assert set(found) >= {"stationary", "steps", "walk"}
    assert "around-first" not in found  # two people have two motions
    walk = found["walk"]["90"]
    assert walk.left_cm < 0.7 * walk.apart_cm
    assert 5 < walk.turned_deg < 60
    for each in found.values():
        for one in each.values():
            assert one.shared_cm <= one.steady_cm * 1.001 <= one.left_cm * 1.002
