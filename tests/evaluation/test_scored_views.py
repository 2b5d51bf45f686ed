"""Both views of a pair are brought to one instant, between frames of the later one's own sensor."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.evaluation_sessions import body
from support.evaluation_sessions import session_of as session_of_study
from support.reference_methods import Method

from mocapella.evaluation.kinectmultitrack import AsRun
from mocapella.evaluation.scored_views import LONGEST_GAP, SeenViews, _at_one_instant, _changes, asked_about
from mocapella.evaluation.study_pairs import Pairs
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y

EVERY_S = 1 / 32
VELOCITIES = np.array([[0.4, 0.0, -0.3], [-1.0, 0.2, 0.5]])
"""Of two people [m/s]."""


def shown(sensor: Any, person: Any, at_s: Any) -> np.ndarray:
    """(…, joints, 3) where a sensor sees a person, who goes straight on."""
    start = 10.0 * np.asarray(person)[..., None] + 3.0 * np.asarray(sensor)[..., None]
    place = start + VELOCITIES[person] * np.asarray(at_s)[..., None]
    return np.asarray(place[..., None, :] + np.arange(25.0)[:, None])


def session_of(steps: int, late_s: float, every_s: float = EVERY_S) -> tuple[Any, Pairs]:
    """Two people before two sensors, the second of which takes its frames so much later."""
    step, sensor, person = (grid.ravel() for grid in np.meshgrid(np.arange(steps), [0, 1], [0, 1], indexing="ij"))
    at_s = step * every_s + sensor * late_s
    session = SimpleNamespace(
        at_s=at_s, sensor=sensor, log=SimpleNamespace(person_id=person), raw=shown(sensor, person, at_s),
        replay=SimpleNamespace(sensors=("one", "other")),
    )  # fmt: skip
    rows = np.arange(4 * steps).reshape(steps, 2, 2).swapaxes(1, 2).reshape(-1, 2)
    return session, Pairs(rows, person[rows[:, 0]], np.full(len(rows), 3))


@pytest.mark.parametrize("late_s", [0.01, 0.0, -0.01])
@pytest.mark.parametrize("offsets_s", [(0.0, 0.004), (0.02, 0.0), (0.1, 0.09), (-0.05, -0.04)])
def test_who_goes_straight_on_is_shown_where_he_was_then(late_s: float, offsets_s: tuple[float, float]) -> None:
    session, pairs = session_of(8, late_s)
    offset_s = np.tile(offsets_s, (len(pairs), 1))
    found = _at_one_instant(session, pairs, offset_s)
    right_s = session.at_s[pairs.rows] + offset_s
    then_s = right_s.min(axis=1, keepdims=True) - offset_s  # by each sensor's own clock
    begun = pairs.rows[:, 0] >= 4  # before a person's first frame there is none to interpolate from
    wanted = shown(session.sensor[pairs.rows], pairs.person[:, None], then_s)
    np.testing.assert_allclose(found[begun], wanted[begun], atol=1e-9)
    np.testing.assert_array_equal(found[~begun], session.raw[pairs.rows[~begun]])


def test_a_frame_of_exactly_then_is_taken_as_it_is() -> None:
    session, pairs = session_of(8, 0.0)
    found = _at_one_instant(session, pairs, np.tile([0.0, EVERY_S], (len(pairs), 1)))
    later = pairs.rows[:, 0] >= 8
    np.testing.assert_allclose(found[later, 1], session.raw[pairs.rows[later, 1] - 4])
    np.testing.assert_array_equal(found[:, 0], session.raw[pairs.rows[:, 0]])


@pytest.mark.parametrize(("every_s", "moved"), [(LONGEST_GAP, True), (np.nextafter(LONGEST_GAP, 1), False)])
def test_frames_far_apart_are_not_interpolated(every_s: float, moved: bool) -> None:
    session, pairs = session_of(2, 0.0, every_s)
    found = _at_one_instant(session, pairs, np.tile([0.0, 0.01], (len(pairs), 1)))
    assert (found[-1, 1] != session.raw[pairs.rows[-1, 1]]).all() == moved


def test_clocks_that_are_not_known_and_joints_that_are_missing_change_nothing() -> None:
    session, pairs = session_of(4, 0.01)
    own = session.raw[pairs.rows]
    np.testing.assert_array_equal(_at_one_instant(session, pairs, np.full((len(pairs), 2), np.nan)), own)
    before, last = pairs.rows[-3, 1], pairs.rows[-1, 1]
    session.raw[before, 3] = session.raw[last, 5] = np.nan
    found = _at_one_instant(session, pairs, np.zeros((len(pairs), 2)))[-1, 1]
    np.testing.assert_array_equal(found[3], session.raw[last, 3])
    np.testing.assert_array_equal(np.isnan(found[:, 0]), np.arange(25) == 5)


def test_changes_of_labels_are_counted_over_both_sensors_for_each_person_alone() -> None:
    swapped = np.array([[0, 0], [1, 1], [0, 1], [1, 1], [1, 0], [1, 1]], dtype=bool)
    person = np.array([0, 1, 0, 1, 0, 1])
    assert _changes(swapped, person) == 3  # of the first one at the first sensor once, at the second twice
    assert _changes(swapped[:0], person[:0]) == 0


@pytest.mark.parametrize("turned", [-2.0, 0.0, 1.0])
@pytest.mark.parametrize("direction", [-1.0, 0.0, 0.7])
def test_a_facing_is_that_against_the_sensor_wherever_the_person_is(direction: float, turned: float) -> None:
    """Of the mean of both views, seen by each sensor."""
    place = 2.0 * np.array([np.sin(direction), 0.0, np.cos(direction)])
    T = np.stack([np.eye(4), rigid(rotation_about_y(0.9), [1.0, 0.5, 0.0])])
    true = body(direction + np.pi + turned) + place
    joints = np.stack([apply(inverse(T[k]), true) for k in (0, 1)])[None]
    seen = SeenViews(joints, T[None], np.zeros((1, 2), dtype=bool))
    session: Any = SimpleNamespace(at_s=np.zeros(2))
    asked = asked_about(session, Pairs(np.array([[0, 1]]), np.zeros(1, np.int64), np.full(1, 3)), seen)
    assert wrap(asked.facing[0, 0] - turned) == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(asked.position[0], joints[0, :, 0], atol=1e-9)
    sights = [T[k][:3, 3] - place for k in (0, 1)]
    towards = np.arctan2(*np.transpose([sight[[0, 2]] for sight in sights]))
    assert wrap(np.diff(asked.facing[0]) + np.diff(towards)) == pytest.approx(0, abs=1e-9)


class Raised(Method):
    """Declares that the side sensor sees all joints a decimetre too low, and swaps its labels for a while."""

    @staticmethod
    def joint_bias(sensor: str, facing: float, position: Any, velocity: Any) -> Any:
        return np.full((25, 3), [0.0, 0.1 * (sensor == "side"), 0.0])

    def conclude(self, arrival: Any) -> None:
        self.swapped = frozenset({("side", 0)} if 30 < self.step < 50 else ())


def test_a_bias_is_added_and_swaps_are_counted_per_minute() -> None:
    session = session_of_study(frames=60, noise=0.0)
    biased, plain = (AsRun(session, make).views("walk", session.pairs) for make in (Raised, Method))
    added = biased.raw_labels - plain.raw_labels
    np.testing.assert_allclose(added, np.broadcast_to([[[0.0, 0.0, 0.0]], [[0.0, 0.1, 0.0]]], added.shape), atol=1e-9)
    minutes = np.ptp(session.at_s) / 60
    assert biased.swaps_per_min == pytest.approx(2 / minutes)
    assert plain.swaps_per_min == 0
