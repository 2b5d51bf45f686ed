"""Who is matched with whom, and the error of a layout, in the comparison with simulated truth."""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.evaluation.simulation import scene_room
from mocapella.evaluation.simulation_score import ALIKE, Score, _matches
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import exp_twist


@given(arrays(np.float64, st.tuples(*[st.integers(0, 4)] * 2), elements=st.floats(0, 1)))
def test_as_many_people_are_matched_as_can_be_and_then_the_most_similar(alike: np.ndarray) -> None:
    found = _matches(alike)
    assert len({row for row, _ in found}) == len({column for _, column in found}) == len(found)
    assert all(alike[at] >= ALIKE for at in found)
    wide = alike if alike.shape[0] <= alike.shape[1] else alike.T
    best = (0, 0.0)
    for columns in permutations(range(wide.shape[1]), wide.shape[0]):
        likenesses = [wide[k, column] for k, column in enumerate(columns) if wide[k, column] >= ALIKE]
        best = max(best, (len(likenesses), sum(likenesses)))
    assert (len(found), sum(alike[at] for at in found)) == (best[0], pytest.approx(best[1]))


@cache
def score() -> Score:
    return Score(scene_room("walk-45", 0))


turns = arrays(np.float64, 3, elements=st.floats(-1.8, 1.8))  # together less than half a turn


@given(turns, st.sampled_from([0, 1]))
def test_the_error_of_a_rotation_is_its_angle_about_whichever_axis(turn: np.ndarray, which: int) -> None:
    places = score()._T_world_sensor
    sensor = score().sensors[which]
    true = inverse(places[score().main]) @ places[sensor]
    _, deg = score()._layout_error(exp_twist(np.r_[0, 0, 0, turn]) @ true, sensor)
    assert deg == pytest.approx(np.degrees(np.linalg.norm(turn)), abs=1e-5)


@given(arrays(np.float64, 3, elements=st.floats(-10, 10)))
def test_the_error_of_a_translation_is_its_length(step: np.ndarray) -> None:
    places = score()._T_world_sensor
    sensor = score().sensors[1]
    true = inverse(places[score().main]) @ places[sensor]
    moved, deg = score()._layout_error(exp_twist(np.r_[step, 0, 0, 0]) @ true, sensor)
    assert moved == pytest.approx(np.linalg.norm(step), abs=1e-9)
    assert deg == pytest.approx(0, abs=1e-5)
