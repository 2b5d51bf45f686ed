"""Where a camera rig lies in the world of body sensors, from people whom both see: laws, and what is not concluded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.calibration.rig_in_world import REMEMBERED, RigAlignment, RigInWorld, RigInWorldSettings
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


HALF = np.random.default_rng(8).normal(0.0, (0.02, 0.08, 0.1), (6, 3)) + np.array([0.2, 0.0, 0.0])
SYMMETRIC = np.stack([HALF, HALF * [-1, 1, 1]], axis=1).reshape(-1, 3)
"""Somebody's joints, in pairs of left and right, which are apart along x."""


def swapped_walk(
    seed: int, *, noise_m: float = 0.0, turned: float = 0.0, hidden: float = 0.0, labels: float = 0.5
) -> tuple[Float64, Float64]:
    """(samples, joints, 3) of somebody who goes along, as people and bodies see it, with left and right swapped.

    ``hidden`` is the share of joints that are not seen, and ``labels`` the share of samples with swapped labels.
    """
    rng = np.random.default_rng(seed)
    turn = rng.uniform(-turned, turned, 30)
    places = np.stack([rigid(exp_twist([0, 0, 0, 0, a, 0])[:3, :3], [0.3, 0.9, 0.05 * k]) for k, a in enumerate(turn)])
    views = [apply(places, SYMMETRIC) + rng.normal(0, noise_m, (30, 12, 3)) for _ in range(2)]
    swapped = rng.random(30) < labels
    views[1][swapped] = views[1][swapped].reshape(-1, 6, 2, 3)[:, :, ::-1].reshape(-1, 12, 3)
    views[0][(rng.random((30, 12)) < hidden) & (np.arange(12) >= 4)] = np.nan
    return views[0], views[1]


def found_from(people: Float64, bodies: Float64) -> RigInWorld:
    alignment = RigAlignment()
    for k, (person, body) in enumerate(zip(people, bodies, strict=True)):
        alignment.update({"a": body}, {1: person}, k / 8)
    assert alignment.found is not None
    return alignment.found


@given(st.integers(0, 1000), st.lists(st.floats(-3, 3), min_size=6, max_size=6))
@settings(max_examples=6)
def test_exact_joints_give_the_exact_motion_though_left_and_right_are_swapped(seed: int, twist: list[float]) -> None:
    people, bodies = swapped_walk(seed, turned=0.5)
    T = exp_twist(np.array(twist))
    found = found_from(people, apply(inverse(T), bodies))
    np.testing.assert_allclose(found.T_world_rig, T, atol=1e-9)
    assert found.residual_m < 1e-9


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("of_people", [True, False])
def test_labels_do_not_depend_on_where_the_origins_are(seed: int, of_people: bool) -> None:
    """Here one is far off, in the direction in which left and right are apart, and joints are hidden."""
    people, bodies = swapped_walk(seed, noise_m=0.03, hidden=0.4, labels=1.0)
    here, away = found_from(people, bodies), np.array([1000.0, 0.0, 0.0])
    if of_people:
        there, expected = found_from(people + away, bodies), apply(here.T_world_rig, bodies) + away
    else:
        there, expected = found_from(people, bodies + away), apply(here.T_world_rig, bodies)
        bodies = bodies + away
    np.testing.assert_allclose(apply(there.T_world_rig, bodies), expected, atol=1e-6)
    assert there.residual_m == pytest.approx(here.residual_m, abs=1e-6)


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


EVERY = RigInWorldSettings(every_s=0.0625, fewest=17, again_s=0.125)


def shown(alignment: RigAlignment, count: int, known: int = 12, hz: float = 16.0, person: int = 1) -> list[int]:
    """The numbers of samples after which there is a new estimate of somebody who goes along."""
    new, before = [], alignment.found
    for k, place in enumerate(walker(count / HZ, speed=2.0)):
        joints = np.where(np.arange(12)[:, None] < known, place, np.nan)
        alignment.update({"a": place}, {person: joints}, k / hz)
        if alignment.found is not before:
            new.append(k + 1)
            before = alignment.found
    return new


def test_samples_are_taken_and_estimates_made_at_their_intervals_from_the_fewest_samples_on() -> None:
    assert shown(RigAlignment(EVERY), 24) == [17, 19, 21, 23]  # at every second sample, from the first on
    assert shown(RigAlignment(EVERY), 40, hz=17.0) == shown(RigAlignment(EVERY), 40, hz=31.0) == [33, 37]


def test_a_sample_has_four_joints_that_are_known_in_both() -> None:
    assert shown(RigAlignment(EVERY), 24, known=4) != []
    assert shown(RigAlignment(EVERY), 24, known=3) == []


def test_a_second_call_of_one_time_does_nothing_and_an_earlier_one_begins_anew() -> None:
    alignment = RigAlignment(EVERY)
    shown(alignment, 24)
    found, samples, taken_s, _ = alignment.memory()
    assert found is not None
    alignment.update({"a": SHAPE}, {1: SHAPE}, taken_s)
    assert alignment.found is found
    assert len(alignment.memory()[1]["a", 1]) == len(samples["a", 1]) == 24
    alignment.update({"a": SHAPE}, {1: SHAPE}, float(np.nextafter(taken_s, 0)))
    assert alignment.found is None
    assert len(alignment.memory()[1]["a", 1]) == 1


def test_who_is_gone_in_either_view_is_forgotten_and_the_others_are_not() -> None:
    alignment = RigAlignment(EVERY)
    alignment.update({"a": SHAPE, "b": SHAPE}, {1: SHAPE, 2: SHAPE}, 0.0)
    assert set(alignment.memory()[1]) == {("a", 1), ("a", 2), ("b", 1), ("b", 2)}
    alignment.update({"a": SHAPE}, {2: SHAPE}, 0.0625)
    assert set(alignment.memory()[1]) == {("a", 2)}


def test_a_body_that_goes_as_two_people_do_is_neither() -> None:
    """Who walk side by side; without the second, it is the first."""
    somebody = walker(6.0)
    beside = [place + np.array([0.0, 0.0, 1.0]) for place in somebody]
    for people, found in (({1: somebody}, True), ({1: somebody, 2: beside}, False)):
        alignment = RigAlignment()
        learn(alignment, {"a": somebody}, people, np.eye(4))
        assert (alignment.found is not None) == found
