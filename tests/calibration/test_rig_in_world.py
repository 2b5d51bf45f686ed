"""Where a camera rig lies in the world of body sensors, from people whom both see: laws, and what is not concluded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.calibration.rig_in_world import REMEMBERED, RigAlignment, RigInWorldSettings
from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.geometry.twists import exp_twist
from mocapella.model.memory import pack, unpack

Float64 = NDArray[np.float64]

HZ = 10
SHAPE = np.random.default_rng(5).normal(0.0, 0.4, (12, 3))
"""Somebody's joints about their middle."""


def walker(
    seconds: float, *, way: tuple[float, float] = (1.0, 0.3), speed: float = 0.8, seed: int = 0
) -> list[Float64]:
    """Somebody who goes along, and swings the limbs a little."""
    rng, places = np.random.default_rng(seed), []
    swing = rng.normal(0.0, 0.08, SHAPE.shape)
    for k in range(round(seconds * HZ)):
        t = k / HZ
        at = np.array([way[0] * speed * t, 0.9, way[1] * speed * t])
        places.append(SHAPE + at + swing * np.sin(3.0 * t))
    return places


def learn(
    alignment: RigAlignment, bodies: dict[str, list[Float64]], people: dict[int, list[Float64]], T_world_rig: Float64,
    *, noise_m: float = 0.02, seed: int = 1,
) -> None:  # fmt: skip
    """Show it people as they are, and bodies in the rig's space, both with noise."""
    rng = np.random.default_rng(seed)
    for k in range(min(len(places) for places in [*bodies.values(), *people.values()])):
        shown = {
            name: apply(inverse(T_world_rig), places[k] + rng.normal(0, noise_m, SHAPE.shape))
            for name, places in bodies.items()
        }
        alignment.update(shown, {i: one[k] + rng.normal(0, noise_m, SHAPE.shape) for i, one in people.items()}, k / HZ)


@pytest.mark.slow
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
@settings(max_examples=15, deadline=None)
def test_the_motion_between_rig_and_world_is_found_wherever_the_rig_lies(twist: list[float]) -> None:
    T = exp_twist(np.array(twist))
    alignment, somebody = RigAlignment(), walker(6.0)
    learn(alignment, {"anna": somebody}, {7: somebody}, T)
    assert alignment.found is not None
    assert alignment.found.pairs == {"anna": 7}
    np.testing.assert_allclose(alignment.found.T_world_rig[:3, :3], T[:3, :3], atol=0.02)
    middle = np.mean(somebody, axis=(0, 1))[None]
    away = apply(alignment.found.T_world_rig, apply(inverse(T), middle)) - middle
    assert np.linalg.norm(away) < 0.03
    assert alignment.found.residual_m < 0.08


def test_of_two_people_each_body_is_the_one_that_goes_as_it_does() -> None:
    T, alignment = rigid(exp_twist(np.array([0, 0, 0, 0, 1.0, 0]))[:3, :3], (1.0, 0.0, 2.0)), RigAlignment()
    one, other = walker(6.0), walker(6.0, way=(-0.4, 1.0), seed=3)
    learn(alignment, {"a": one, "b": other}, {3: other, 8: one}, T)
    assert alignment.found is not None
    assert alignment.found.pairs == {"a": 8, "b": 3}
    np.testing.assert_allclose(alignment.found.T_world_rig, T, atol=0.05)


def test_who_stands_still_shows_nothing() -> None:
    """Two people who stand are alike: the body of one would be laid on the other."""
    alignment, still = RigAlignment(), walker(6.0, speed=0.0)
    learn(alignment, {"a": still}, {1: still}, np.eye(4))
    assert alignment.found is None


def test_a_body_that_is_nobody_who_is_seen_shows_nothing() -> None:
    alignment = RigAlignment()
    learn(alignment, {"a": walker(6.0)}, {1: walker(6.0, way=(-0.2, 1.0), speed=1.4, seed=4)}, np.eye(4))
    assert alignment.found is None


def test_two_bodies_that_would_be_one_person_show_nothing() -> None:
    alignment, somebody = RigAlignment(), walker(6.0)
    learn(alignment, {"a": somebody, "b": somebody}, {1: somebody}, np.eye(4))
    assert alignment.found is None


@pytest.mark.slow
def test_a_rig_that_was_moved_is_found_anew() -> None:
    alignment, somebody = RigAlignment(), walker(40.0)
    T = rigid(np.eye(3), (2.0, 0.0, 0.0))
    learn(alignment, {"a": somebody[:80]}, {1: somebody[:80]}, np.eye(4))
    assert alignment.found is not None
    rng = np.random.default_rng(2)
    for k in range(80, 260):
        shown = apply(inverse(T), somebody[k] + rng.normal(0, 0.02, SHAPE.shape))
        alignment.update({"a": shown}, {1: somebody[k]}, k / HZ)
    np.testing.assert_allclose(alignment.found.T_world_rig, T, atol=0.05)


def test_it_goes_on_to_the_bit_from_its_memory() -> None:
    somebody, T = walker(8.0), rigid(np.eye(3), (1.0, 0.0, 0.5))
    one, other = RigAlignment(), RigAlignment()
    learn(one, {"a": somebody[:30]}, {1: somebody[:30]}, T)
    other.recall(unpack(pack(one.memory(), REMEMBERED), REMEMBERED))
    for k in range(30, 80):
        for alignment in (one, other):
            alignment.update({"a": apply(inverse(T), somebody[k])}, {1: somebody[k]}, k / HZ)
    assert one.found is not None
    assert other.found is not None
    assert one.found.T_world_rig.tobytes() == other.found.T_world_rig.tobytes()


@pytest.mark.parametrize("changes", [{"within_m": 0}, {"fewest": 1}, {"fewest": 90}, {"beyond": 1.5}])
def test_settings_out_of_range_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(changes))):
        RigInWorldSettings(**changes)  # type: ignore[arg-type]
