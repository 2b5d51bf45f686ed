"""Two people: the labels by hand, and that a switch, a loss and a stranger are noticed."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.evaluation import interactions
from mocapella.evaluation.interactions import (
    FRESH,
    Label,
    crossings,
    distance_figures,
    identity_figures,
    label_frame,
    labels_of,
    people_as_logged,
    people_of_run,
)
from mocapella.evaluation.kinectmultitrack import evaluate
from mocapella.evaluation.study_pairs import StudySession, study_sessions
from mocapella.evaluation.study_tables import differences


@pytest.fixture(scope="module")
def sessions(study_logs: Path) -> list[StudySession]:
    return list(study_sessions(study_logs, [20, 21, 22]))


def test_the_labels_are_in_order_and_apart() -> None:
    assert len(crossings()) == 3
    for labels in crossings().values():
        assert all(one.at_s < other.at_s for one, other in pairwise(labels))
        for label in labels:
            places = np.array(list(label.place.values()))
            assert len(places) == 1 or np.linalg.norm(places[0] - places[1]) > 0.45


def test_in_the_logs_nobody_is_switched_or_missed(sessions: list[StudySession]) -> None:
    for session in sessions:
        frames = [label_frame(label, people_as_logged(session, label.at_s)) for label in labels_of(session)]
        found = identity_figures(frames)
        assert (found["identity_switches"], found["missed"]) == (0, 0)
        assert found["labels"] > 35


def test_the_second_file_has_the_persons_who_are_labelled_by_head_height(sessions: list[StudySession]) -> None:
    # In 20 and 21 A is the shorter one: labels and logs agree on who is who by a third thing, the height of the head.
    for session in sessions[:2]:
        head = session.log.positions[:, 3, 1]
        a, b = (np.nanmedian(head[session.log.person_id == person]) for person in (0, 1))
        assert b - a > 0.08


@pytest.mark.parametrize("crossing_s", [9.0, 28.0])
def test_a_planted_switch_is_two(sessions: list[StudySession], crossing_s: float) -> None:
    session = sessions[0]
    frames = []
    for label in labels_of(session):
        people: dict[int, Any] = dict(people_as_logged(session, label.at_s))
        if label.at_s > crossing_s:
            people = {1 - person: place for person, place in people.items()}
        frames.append(label_frame(label, people))
    assert identity_figures(frames)["identity_switches"] == 2


@pytest.mark.slow
def test_the_default_method_keeps_both_people_through_the_crossings_of_a_real_log(study_logs: Path) -> None:
    figures = evaluate(study_logs, ["default"], [22])["methods"]["default"]["interactions"]
    assert figures["identity_switches"] == 0
    assert figures["missed"] == 2  # the first instant, at which nobody is told of yet


def test_a_new_id_is_a_switch_and_nobody_at_a_place_is_missed(sessions: list[StudySession]) -> None:
    session = sessions[1]
    renamed, gone = [], []
    for label in labels_of(session):
        people = people_as_logged(session, label.at_s)
        new = {person + (5 if person == 0 and label.at_s > 20 else 0): place for person, place in people.items()}
        renamed.append(label_frame(label, new))
        gone.append(label_frame(label, {person: place for person, place in people.items() if person == 1}))
    assert identity_figures(renamed)["identity_switches"] == 1
    lost = identity_figures(gone)
    assert lost["missed"] == sum(0 in label.place for label in labels_of(session))
    assert lost["identity_switches"] == 0


def test_where_somebody_was_long_ago_is_not_where_he_is(sessions: list[StudySession]) -> None:
    session = sessions[0]
    assert people_as_logged(session, 15.0) == {}  # a pause of the log
    last = session.at_s[session.at_s < 15.0].max()
    assert set(people_as_logged(session, last + FRESH / 2)) == {0, 1}


@pytest.mark.parametrize(("at_s", "there"), [(0.0, True), (FRESH, True), (FRESH + 1e-6, False), (-0.2, False)])
def test_a_row_tells_where_somebody_is_for_three_tenths_of_a_second(at_s: float, there: bool) -> None:
    """The newest row of each sensor, and of these the mean."""
    positions = np.zeros((3, 25, 3))
    positions[:, 0, 0] = [9.0, 1.0, 2.0]
    session: Any = SimpleNamespace(
        at_s=np.array([-0.1, 0.0, 0.0]), sensor=np.array([0, 0, 1]), replay=SimpleNamespace(sensors=("a", "b")),
        log=SimpleNamespace(person_id=np.full(3, 4), positions=positions),
    )  # fmt: skip
    found = people_as_logged(session, at_s)
    assert {person: place[0] for person, place in found.items()} == ({4: 1.5} if there else {})


def test_distances_are_of_the_pairs_mean() -> None:
    apart = np.array([[0.01, 0.03], [0.02, np.nan], [np.nan, np.nan], [0.08, 0.08]])
    assert distance_figures(apart) == pytest.approx({"median_cm": 2, "mean_cm": 4, "p95_cm": 7.4})


@pytest.mark.parametrize("near_m", [0.25, 0.5])
def test_somebody_is_found_up_to_a_distance_along_the_floor(monkeypatch: pytest.MonkeyPatch, near_m: float) -> None:
    """There the similarity is one half, and at twice the distance it is 0."""
    monkeypatch.setattr(interactions, "NEAR", near_m)
    label = Label(0.0, {0: (1.0, 2.0), 1: (9.0, 2.0)})
    places = np.array([[1.0, 7.0, 2.0 + off * near_m] for off in (0.0, 0.5, 1.0, 2.0, 3.0)])
    frame = label_frame(label, dict(enumerate(places)))
    assert frame.similarity[0] == pytest.approx([1.0, 0.75, 0.5, 0.0, 0.0])
    for found, missed in ((places[2], 1), (places[2] + [0.0, 0.0, 1e-9], 2)):
        assert identity_figures([label_frame(label, {5: found})])["missed"] == missed


def test_people_of_a_run_are_where_its_newest_scene_has_them() -> None:
    """The scene after a frame is the one of that frame's time, until the next one's."""
    places = np.zeros((3, 2, 25, 3))
    places[..., 0, 0] = [[1, 11], [2, np.nan], [3, 13]]
    people = [tuple(SimpleNamespace(id=n, positions=place[n]) for n in (0, 1)) for place in places]
    run: Any = SimpleNamespace(at_ns=np.array([10, 10.5, 11]) * 10**9, people=people)
    for at_s, wanted in ((0.0, {0: 1, 1: 11}), (0.49, {0: 1, 1: 11}), (0.5, {0: 2}), (1.0, {0: 3, 1: 13})):
        assert {n: place[0] for n, place in people_of_run(run, at_s).items()} == wanted


@pytest.mark.slow
def test_the_thesis_two_calibrations_are_those_that_are_known(as_logged: dict[str, Any]) -> None:
    interactions = as_logged["methods"]["stand-still"]["interactions"]
    people = [person for file in interactions["files"].values() for person in file["people"].values()]
    assert 3.3 < min(p["median_cm"] for p in people) < max(p["median_cm"] for p in people) < 4.3
    assert np.mean([p["mean_cm"] for p in people]) == pytest.approx(6.6, abs=0.1)


def test_both_people_are_replayed_in_one_camera_space(sessions: list[StudySession]) -> None:
    # One motion for both people: with each person's logged rows as they are, their best motions are 5–9° apart.
    from support.reference_methods import robust_fit

    for session in sessions:
        turns, logged_turns = [], []
        for person in (0, 1):
            rows = session.pairs.rows[session.pairs.person == person]
            for points, out in ((session.raw, turns), (session.log.positions.astype(float), logged_turns)):
                one, other = points[rows[:, 0]].reshape(-1, 3), points[rows[:, 1]].reshape(-1, 3)
                finite = np.isfinite(one).all(axis=-1) & np.isfinite(other).all(axis=-1)
                T = robust_fit(other[finite], one[finite])
                out.append(np.degrees(np.arctan2(T[0, 2], T[0, 0])))
        assert abs(np.diff(logged_turns)[0]) > 4
        assert abs(np.diff(turns)[0]) < 1.5


def test_a_single_person_keeps_the_nominal_motion(study_logs: Path) -> None:
    (session,) = (s for s in study_sessions(study_logs, [9]) if "3_50" in s.name)
    assert list(session.replay.T_reference_second_of) == [0]
    np.testing.assert_array_equal(session.replay.T_reference_second_of[0], session.replay.T_reference_second)
    assert differences(msgspec.structs.astuple(session.log)[-1][session.pairs.rows]).shape[1:] == (25, 4)
