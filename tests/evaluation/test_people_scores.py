"""Scores of people against ground truth: perfect, missing, additional, exchanged and wrong people."""

from __future__ import annotations

import numpy as np

from mocapella.evaluation.people_scores import AFTER_NS, SAME_M, PeopleScore, match_people
from mocapella.model.observations import JointState
from mocapella.model.scene import Person

RNG = np.random.default_rng(2)
SHAPE = RNG.normal(0, 0.3, (26, 3))
TRUE = np.stack([SHAPE, SHAPE + np.array([2.0, 0.0, 0.0])])
ALL_SEEN = np.ones((3, 2, 26), dtype=np.int64)
NUMBERS = np.array([0, 1])


def person(number: int, positions: np.ndarray, sd: float = 0.02, state: int = JointState.TRACKED) -> Person:
    states = np.where(np.isfinite(positions[:, 0]), state, 0).astype(np.uint8)
    return Person(number, positions, states, (), np.full(26, sd, np.float32))


def scored(instants: list[list[Person]], seen: np.ndarray = ALL_SEEN) -> PeopleScore:
    score = PeopleScore()
    for k, people in enumerate(instants):
        score.update(AFTER_NS + k, NUMBERS, TRUE, seen, people)
    return score


def test_the_truth_scores_best() -> None:
    found = scored([[person(7, TRUE[0]), person(9, TRUE[1])]] * 4).figures()
    assert (found.hota, found.switches, found.found_percent, found.phantoms_percent) == (1.0, 0, 100.0, 0.0)
    assert found.visible_mm == found.all_mm == found.false_percent == 0.0
    assert found.pcp_percent == found.measured_percent == 100.0


def test_an_exchange_of_numbers_is_a_switch_of_each() -> None:
    one, other = [person(1, TRUE[0]), person(2, TRUE[1])], [person(2, TRUE[0]), person(1, TRUE[1])]
    found = scored([one, one, other]).figures()
    assert found.switches == 2
    assert found.hota < 1


def test_a_person_too_many_and_a_person_too_few() -> None:
    nobody = person(5, TRUE[0] + [0.0, 0.0, 3.0])
    found = scored([[person(1, TRUE[0]), nobody]] * 3).figures()
    assert found.found_percent == 50.0
    assert found.phantoms_percent == 50.0
    assert found.hota < 0.7
    twice = scored([[person(1, TRUE[0]), person(2, TRUE[1]), person(3, TRUE[0])]] * 3).figures()
    assert twice.phantoms_percent == 50.0
    assert twice.found_percent == 100.0


def test_who_is_not_seen_by_two_cameras_may_be_missing() -> None:
    seen = ALL_SEEN.copy()
    seen[1:, 1] = 0
    assert scored([[person(1, TRUE[0])]] * 2, seen).figures().found_percent == 100.0
    both = scored([[person(1, TRUE[0]), person(2, TRUE[1])]] * 2, seen).figures()
    assert both.phantoms_percent == 0.0
    assert both.hota == 1.0


def test_errors_that_are_called_measured_are_false() -> None:
    off = TRUE[0].copy()
    off[:13] += [0.06, 0.0, 0.0]
    found = scored([[person(1, off), person(2, TRUE[1])]]).figures()
    assert found.false_percent == 25.0
    inferred = scored([[person(1, off, state=JointState.INFERRED), person(2, TRUE[1])]]).figures()
    assert inferred.false_percent == 0.0
    assert inferred.measured_percent == 50.0
    np.testing.assert_allclose(found.visible_mm, 15.0)


def test_consistent_deviations_are_one() -> None:
    score = PeopleScore()
    for k in range(300):
        noisy = TRUE + RNG.normal(0, 0.02, TRUE.shape)
        score.update(AFTER_NS + k, NUMBERS, TRUE, ALL_SEEN, [person(1, noisy[0]), person(2, noisy[1])])
    found = score.figures()
    assert abs(found.normalised - 1) < 0.02
    assert abs(found.normalised_median - 1) < 0.02


def test_nobody_at_all_is_no_error() -> None:
    score = PeopleScore()
    nobody = np.zeros((0, 26, 3))
    score.update(AFTER_NS, np.zeros(0, int), nobody, np.zeros((2, 0, 26), int), [])
    assert score.figures().hota == 1.0
    assert np.isnan(score.figures().visible_mm)


def test_matches_are_one_to_one_and_as_many_as_possible() -> None:
    apart = np.array([[[0.1], [0.2]], [[0.1], [0.9]], [[np.nan], [0.6]]])
    assert match_people(apart) == {0: 1, 1: 0}  # the nearest pair alone, 0 and 0, would leave 1 without a match
    assert match_people(np.full((2, 2, 3), np.nan)) == {}
    assert match_people(np.zeros((2, 0, 26))) == {}
    assert match_people(np.full((1, 1, 1), SAME_M)) == {0: 0}
    assert match_people(np.full((1, 1, 1), SAME_M + 1e-9)) == {}
