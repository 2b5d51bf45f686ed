from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.calibration import graph_kernels
from mocapella.calibration.sensor_graph import (
    MOST_STEPS,
    PlacedSensor,
    SensorPair,
    by_certainty,
    components_of,
    place_sensors,
)
from mocapella.calibration.time_offset import TimeOffset
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import adjoint, exp_twist, log_motion

NAMES = ("a", "b", "c", "d")
UNKNOWN = TimeOffset(0.0, 0.1, False)


def truth(rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {name: exp_twist(rng.normal(size=6) * [2, 0.3, 2, 0.2, 1.5, 0.2]) for name in NAMES}


def pair(
    T: dict[str, np.ndarray], a: str, b: str, rng: np.random.Generator | None = None, sd: float = 0.01, **more: object
) -> SensorPair:
    exact = inverse(T[a]) @ T[b]
    error = np.zeros(6) if rng is None else sd * rng.normal(size=6)
    fields = {"offset": UNKNOWN, **more}
    return SensorPair(a, b, exp_twist(error) @ exact, sd**2 * np.eye(6), **fields)  # type: ignore[arg-type]


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_without_noise_every_sensor_is_where_it_is_tied_through_others(seed: int) -> None:
    T = truth(np.random.default_rng(seed))
    for ties in (
        ("ab", "bc", "cd"),
        ("ab", "bc", "cd", "ad"),
        ("bd", "cd", "ac"),
        ("ab", "ac", "ad", "bc", "bd", "cd"),
    ):
        placed = place_sensors(NAMES, [pair(T, *tie) for tie in ties])
        for name in NAMES:
            np.testing.assert_allclose(placed[name].T_root_sensor, inverse(T["a"]) @ T[name], atol=1e-9)
            assert placed[name].root == "a"
            assert placed[name].trusted


def test_cycles_make_it_better_than_the_tree_and_the_covariance_says_so() -> None:
    wrong: dict[str, list[float]] = {"tree": [], "graph": []}
    nees: dict[str, list[float]] = {"tree": [], "graph": []}
    for seed in range(60):
        rng = np.random.default_rng(seed)
        T = truth(rng)
        pairs = [pair(T, *tie, rng) for tie in ("ab", "bc", "cd", "da"[::-1], "ac", "bd")]
        for kind, used in (("tree", pairs[:3]), ("graph", pairs)):
            d = place_sensors(NAMES, used)["d"]
            error = log_motion(inverse(T["a"]) @ T["d"] @ inverse(d.T_root_sensor))
            wrong[kind].append(float(error @ error))
            nees[kind].append(error @ np.linalg.solve(d.covariance, error))
    assert np.mean(wrong["graph"]) < 0.5 * np.mean(wrong["tree"])
    for found in nees.values():
        assert 4.5 < np.mean(found) < 7.5


def test_the_order_of_the_pairs_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    T = truth(rng)
    pairs = [pair(T, *tie, rng) for tie in ("ab", "bc", "cd", "ad", "ac")]
    one, other = place_sensors(NAMES, pairs), place_sensors(NAMES, pairs[::-1])
    for name in NAMES:
        np.testing.assert_allclose(one[name].T_root_sensor, other[name].T_root_sensor, atol=1e-7)


def test_sensors_that_nothing_ties_together_are_components_each_in_its_own_frame() -> None:
    T = truth(np.random.default_rng(2))
    placed = place_sensors(NAMES, [pair(T, "a", "c"), pair(T, "b", "d")])
    assert {name: place.root for name, place in placed.items()} == {"a": "a", "b": "b", "c": "a", "d": "b"}
    np.testing.assert_allclose(placed["d"].T_root_sensor, inverse(T["b"]) @ T["d"], atol=1e-9)
    assert place_sensors((), []) == {}


def test_a_pair_that_is_not_trusted_ties_only_what_nothing_else_does() -> None:
    T = truth(np.random.default_rng(3))
    poor = pair(T, "a", "c", np.random.default_rng(4), sd=1e-4, trusted=False)
    wrong = SensorPair("a", "c", exp_twist(np.ones(6)), poor.covariance, UNKNOWN, False)
    placed = place_sensors(NAMES, [pair(T, "a", "b"), pair(T, "b", "c"), wrong])
    np.testing.assert_allclose(placed["c"].T_root_sensor, inverse(T["a"]) @ T["c"], atol=1e-9)
    placed = place_sensors(NAMES, [pair(T, "a", "b"), wrong])
    assert not placed["c"].trusted
    assert placed["c"].root == "a"


def test_clocks_are_chained_and_weighed_and_unknown_where_no_known_one_leads() -> None:
    T = truth(np.random.default_rng(5))

    def known(seconds: float, sd: float = 0.004) -> TimeOffset:
        return TimeOffset(seconds, sd, True)

    ties = [
        pair(T, "a", "b", offset=known(0.010)),
        pair(T, "b", "c", offset=known(0.020)),
        pair(T, "a", "c", offset=known(0.060, 1.0)),
        pair(T, "c", "d"),
    ]
    placed = place_sensors(NAMES, ties)
    assert placed["c"].offset is not None
    np.testing.assert_allclose(placed["c"].offset.seconds, 0.030, atol=1e-4)
    np.testing.assert_allclose(placed["c"].offset.sd, 0.004 * np.sqrt(2), rtol=0.01)
    assert placed["d"].offset is None
    assert placed["a"].offset == TimeOffset(0.0, 0.0, True)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-9, 1e-3, 1.0, 3.1]))
@settings(max_examples=40, deadline=None)
def test_the_compiled_twists_are_those_of_geometry(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    twist = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
    T = exp_twist(twist)
    np.testing.assert_allclose(graph_kernels._exp(twist), T, atol=1e-12)
    np.testing.assert_allclose(graph_kernels._log(T), log_motion(T), atol=1e-8)
    np.testing.assert_allclose(graph_kernels._adjoint(T), adjoint(T), atol=1e-12)
    J = rng.normal(size=(9, 6))
    np.testing.assert_allclose(graph_kernels.inverse_of_positive(J.T @ J) @ J.T @ J, np.eye(6), atol=1e-6)
    assert np.isnan(graph_kernels.inverse_of_positive(-np.eye(3))).all()


def test_the_most_certain_pair_is_that_of_the_least_variance_of_a_point_two_and_a_half_metres_away() -> None:
    T = truth(np.random.default_rng(0))

    def of(number: int, **variances: float) -> SensorPair:
        C = np.zeros((6, 6))
        for name, variance in variances.items():
            C["xyzrst".index(name), "xyzrst".index(name)] = variance
        return msgspec.structs.replace(pair(T, "a", "b"), b=f"b{number}", covariance=C)

    for way in "xyz":
        for turn in "rst":
            ranked = [of(0), of(1, **{turn: 0.99 / 2.5**2}), of(2, **{way: 1.0}), of(3, **{turn: 1.01 / 2.5**2})]
            last = of(4, **dict.fromkeys("xyzrst", 1.0))
            unsure = msgspec.structs.replace(of(5), trusted=False)
            assert by_certainty([unsure, last, *ranked[::-1]]) == [*ranked, last, unsure]
    assert by_certainty([]) == []


def test_a_component_takes_its_steps_one_by_one_and_only_the_last_tells_the_covariance() -> None:
    T, rng = truth(np.random.default_rng(1)), np.random.default_rng(2)
    pairs = by_certainty([pair(T, *tie, rng, 0.3) for tie in ("ab", "bc", "ac")])
    (component,) = components_of("abc", pairs)
    assert component.steps_left == MOST_STEPS
    component.refine()
    assert component.steps_left == MOST_STEPS - 1
    assert not component.covariance.any()
    component.steps_left = 1
    component.refine()
    assert component.steps_left == 0
    assert component.covariance[1:].any(axis=(1, 2)).all()
    (alone,) = components_of("a", [])
    assert alone.steps_left == 0


def test_sensors_start_where_they_were_if_all_were_of_the_same_root_and_several_chains_tie_them() -> None:
    T = truth(np.random.default_rng(3))
    tree = [pair(T, *tie) for tie in ("ab", "bc")]
    cycle = [*tree, pair(T, "a", "c")]
    before = {
        name: PlacedSensor(exp_twist(0.01 * np.arange(6) * k), np.zeros((6, 6)), None, "a", True)
        for k, name in enumerate("abc")
    }
    other = {**before, "c": msgspec.structs.replace(before["c"], root="c")}
    few = {name: before[name] for name in "ab"}
    for pairs, known, kept in (
        (cycle, before, True),
        (cycle, other, False),
        (cycle, few, False),
        (tree, before, False),
    ):
        (component,) = components_of("abc", pairs, known)
        for name, found in zip(component.names, component.T_root_sensor, strict=True):
            expected = before[name].T_root_sensor if kept else inverse(T["a"]) @ T[name]
            np.testing.assert_allclose(found, expected, atol=1e-9)
