"""Two people whom the thesis calibrated apart are replayed in the one camera space of the sensor that saw them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import study_examples as examples

from mocapella.geometry import rigid
from mocapella.model.study_log import StudyLog
from mocapella.sources.study_replay import StudyReplay
from mocapella.sources.study_sensors import TURNING_DISTANCE

FRAMES = 80
TURN = -np.pi / 4
AXIS = np.array([0.0, 0.0, TURNING_DISTANCE])
T_REFERENCE_SECOND = rigid.rigid(rigid.rotation_about_y(TURN), AXIS - rigid.rotation_about_y(TURN) @ AXIS)
PLACES = np.array([[-0.3, 0.0, 2.5], [0.5, -0.1, 2.6]])


def log_of(errors: tuple[float, float], angles: bool = True) -> tuple[StudyLog, np.ndarray]:
    """A log of two people, the second sensor's angle of each wrong by that much, and what that sensor really saw."""
    random = np.random.default_rng(3)
    path = np.zeros((FRAMES, 2, 25, 3)) + PLACES[:, None] + 0.2 * random.normal(size=(1, 2, 25, 3))
    path[FRAMES // 2 :] += np.linspace(0, 0.5, FRAMES // 2)[:, None, None, None] * [1.0, 0.0, -0.5]
    seen = rigid.apply(rigid.inverse(T_REFERENCE_SECOND), path)
    logged = np.empty_like(seen)
    theta = np.zeros((2, 2))
    for person, error in enumerate(errors):
        turn = rigid.rotation_about_y(TURN + error)
        own, other = path[0, person].mean(axis=0), seen[0, person].mean(axis=0)
        logged[:, person] = (seen[:, person] - other) @ turn.T + own  # its world is the person's own centre
        theta[person] = 0.1 * person, 0.1 * person + TURN + error
    rows = examples.Rows(frames=2 * FRAMES)
    frame, person, second = np.unravel_index(np.arange(4 * FRAMES), (FRAMES, 2, 2))
    rows["kinect_config"] = np.full(4 * FRAMES, 1)
    rows["person_id"], rows["skeleton_id"] = person, second
    rows["kinect_id"] = np.where(second, examples.SIDE, examples.FRONT)
    rows["tracker_time_ms"] = examples.NOON_MS + frame * 33
    rows["skeleton_time_ticks"] = frame * examples.FRAME_TICKS + 1000 * second
    rows["init_angle"] = theta[person, second] if angles else np.full(4 * FRAMES, np.nan)
    both = np.where(second[:, None, None], logged[frame, person], path[frame, person])
    rows["positions"] = both.astype(np.float32)
    return rows.log(), seen


def replayed(log: StudyLog) -> np.ndarray:
    """(frames, people, joints, 3) as the second sensor of the replay has it."""
    return np.stack([frame.positions for _, frame in StudyReplay(log).frames("side")])


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_both_people_come_from_one_camera_however_wrong_each_calibration_was(first: float, second: float) -> None:
    log, seen = log_of((first, second))
    raw = replayed(log)
    # The first person's calibration is what the camera space is known up to: one rigid motion brings both people back.
    wrong = rigid.rotation_about_y(first)
    T = rigid.rigid(wrong.T, np.zeros(3))
    back = rigid.apply(T, raw - raw[0, 0].mean(axis=0))
    np.testing.assert_allclose(back - back[0, 0, 0], seen - seen[0, 0, 0], atol=2e-5)


def test_people_of_one_calibration_are_as_they_were() -> None:
    log, seen = log_of((0.0, 0.0))
    np.testing.assert_allclose(replayed(log), seen, atol=2e-5)
    replay = StudyReplay(log)
    np.testing.assert_array_equal(replay.T_reference_second_of[0], replay.T_reference_second)


def test_without_the_angles_every_person_keeps_the_nominal_motion() -> None:
    replay = StudyReplay(log_of((0.0, 0.2), angles=False)[0])
    for motion in replay.T_reference_second_of.values():
        np.testing.assert_array_equal(motion, replay.T_reference_second)


def test_as_the_thesis_left_them_they_would_not_be_in_one_space() -> None:
    log, seen = log_of((0.0, 0.2))
    untouched = rigid.apply(rigid.inverse(T_REFERENCE_SECOND), log.positions[log.skeleton_id == 1])
    untouched = untouched.reshape(seen.shape)
    assert np.abs(untouched[:, 1] - seen[:, 1]).max() > 0.05
    np.testing.assert_allclose(replayed(log)[:, 1], seen[:, 1], atol=2e-5)
    assert replayed(log)[:, 0] == pytest.approx(seen[:, 0], abs=2e-5)
