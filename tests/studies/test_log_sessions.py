"""Logs of any number of sensors, several participants and placements of a study's own are tracked by other methods."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.evaluation_sessions import log_of
from support.reference_methods import BatchFit

from mocapella.errors import InputError
from mocapella.evaluation.study_pairs import StudySession
from mocapella.geometry import rigid
from mocapella.model.study_log import StudyLog
from mocapella.recording.study_log import joined_blocks
from mocapella.sources.study_replay import StudyReplay
from mocapella.studies import method_views
from mocapella.studies.cleaning import only
from mocapella.studies.log_sessions import sessions_of_log
from mocapella.studies.method_results import results_of_methods
from mocapella.studies.method_views import TrackedRecording
from mocapella.studies.naming import RecordingNames

THIRD_ANGLE = 0.7


def with_third(log: StudyLog) -> StudyLog:
    """A third sensor that sees what the second one sees, a millimetre away, from another side."""
    second = only(log, np.flatnonzero(log.skeleton_id == 1))
    third = msgspec.structs.replace(
        second,
        kinect_id=np.full(len(second), "third"),
        skeleton_id=np.full(len(second), 2),
        init_angle=log.init_angle[log.skeleton_id == 0][:1].repeat(len(second)) + THIRD_ANGLE,
        positions=second.positions + np.float32(0.001),
    )
    both = joined_blocks([log, third])
    order = np.lexsort([both.skeleton_id, both.person_id, both.tracker_time_ms])
    return only(both, order)


def changed(log: StudyLog, **fields: int) -> StudyLog:
    return msgspec.structs.replace(log, **{name: np.full(len(log), value) for name, value in fields.items()})


def the_only(log: StudyLog) -> StudySession:
    (part,) = sessions_of_log(log)
    return StudySession(part.log, by_angle=part.by_angle)


def test_each_sensor_is_placed_by_its_logged_angle() -> None:
    log = with_third(log_of(frames=40))
    replay = StudyReplay(log, by_angle=True)
    assert len(replay.sensors) == 3
    T = replay.T_reference_sensor[replay.sensors[2]]
    assert np.arctan2(T[0, 2], T[0, 0]) == pytest.approx(THIRD_ANGLE)
    np.testing.assert_allclose(replay.T_reference_sensor[replay.sensors[0]], np.eye(4))


@settings(max_examples=10, deadline=None)
@given(frames=st.integers(5, 40))
def test_the_replayed_frames_of_all_sensors_are_the_logged_rows(frames: int) -> None:
    session = the_only(with_third(log_of(frames=frames)))
    names = session.replay.sensors
    T = np.stack([session.replay.T_reference_sensor[names[s]] for s in session.sensor.tolist()])
    np.testing.assert_allclose(rigid.apply(T, session.raw), session.log.positions, atol=1e-5)


def test_all_pairs_of_sensors_are_pairs() -> None:
    log = log_of(frames=30)
    two, three = the_only(log), the_only(with_third(log))
    assert len(three.pairs) == 3 * len(two.pairs)
    sensors = three.sensor[three.pairs.rows]
    assert sorted({tuple(sorted(pair)) for pair in sensors.tolist()}) == [(0, 1), (0, 2), (1, 2)]
    assert not np.ptp(three.log.tracker_time_ms[three.pairs.rows], axis=1).any()


def test_a_method_aligns_all_pairs_of_three_sensors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(method_views, "scored_tracker", lambda name: BatchFit)
    views = TrackedRecording(the_only(with_third(log_of(frames=60))), "fit").pairs()
    assert {tuple(sorted(pair)) for pair in views.sensor.tolist()} == {(0, 1), (0, 2), (1, 2)}
    assert np.isfinite(views.views[-3:]).any(axis=(1, 2, 3)).all()


def test_each_participant_and_placement_is_a_session_of_its_own() -> None:
    log = log_of(frames=30)
    parts = [log, changed(log, study_id=8), changed(log, kinect_config=0), changed(log, kinect_config=17)]
    found = list(sessions_of_log(joined_blocks(parts)))
    assert [(one.participant, one.placement, one.by_angle) for one in found] == [
        (7, 2, False), (8, 2, False), (7, 0, False), (7, 17, True),
    ]  # fmt: skip
    assert all(len(one.log) == len(log) for one in found)


def test_measures_and_methods_take_all_participants_or_the_chosen_ones() -> None:
    log = log_of(frames=30)
    both = joined_blocks([log, changed(log, study_id=8, kinect_config=17)])
    names = RecordingNames({8: "P08"}, {17: "wide"}, {3: "throw"})
    found = results_of_methods(both, ["stand-still"], [], names=names)
    assert [(one.participant, one.placement) for one in found.views] == [("7", "90"), ("P08", "wide")]
    assert "throw" in found.views[1].task
    (chosen,) = results_of_methods(both, ["stand-still"], [], names=names, participants=["P08"]).views
    assert chosen.participant == "P08"


def test_results_with_another_reference_are_left_out_and_counted() -> None:
    log = log_of(frames=30)
    skeleton = log.skeleton_id.copy()
    alone = np.flatnonzero((log.skeleton_id == 1) & (np.arange(len(log)) < 10))
    skeleton[alone] = 0  # the other sensor is the first one here
    mixed = only(msgspec.structs.replace(log, skeleton_id=skeleton), np.setdiff1d(np.arange(len(log)), alone - 1))
    (part,) = sessions_of_log(mixed)
    assert part.left_out == len(alone)
    assert len(part.log) == len(mixed) - len(alone)
    found = results_of_methods(mixed, ["stand-still"], [])
    assert [(one.what, one.rows) for one in found.findings] == [
        ("participant 7, 90: results with another reference sensor", len(alone))
    ]


def test_a_log_of_three_sensors_without_angles_is_refused_and_others_go_on() -> None:
    log = with_third(log_of(frames=20))
    blind = msgspec.structs.replace(log, init_angle=np.full(len(log), np.nan))
    with pytest.raises(InputError, match="does not say how its sensors stood"):
        results_of_methods(blind, ["stand-still"], [])
    found = results_of_methods(joined_blocks([blind, changed(log, study_id=8)]), ["stand-still"], [])
    assert [one.participant for one in found.views] == ["8"]
    (finding,) = found.findings
    assert finding.what.startswith("participant 7, 90: methods and measures cannot use it: ")
