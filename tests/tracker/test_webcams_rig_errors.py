"""The method webcams follows the errors of a rig, keeps the distance of people, and takes late frames for late."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from support.webcam_people import circling, frames, last_of_each, run, walker

from mocapella.geometry.rigid import rigid, rotation_about_y
from mocapella.model.camera import CameraRig
from mocapella.model.observations import Arrival, JointState
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_memory import no_counts, no_people
from mocapella.tracker.webcams_people_kernels import learn_heights, refuting
from mocapella.tracker.webcams_rig_kernels import (
    MOST_LATE_S,
    MOST_TURNED_RAD,
    add_late,
    direction_error,
    time_error,
    variance_factor,
)
from mocapella.tracker.webcams_warmup import circle_of_cameras

Float64 = NDArray[np.float64]

FOUR = circle_of_cameras(4)
NAMES = sorted(FOUR.cameras)


def one_walker(at_s: float) -> Float64:
    return walker(at_s, circling(0.9, 5.0))


def other_walker(at_s: float) -> Float64:
    return walker(at_s, circling(0.9, 5.0, np.pi), height_m=1.62, phase=1.0)


def turned(name: str, angle: float) -> CameraRig:
    """The rig with one camera calibrated with a wrong direction [rad]."""
    placed = FOUR.cameras[name]
    T = rigid(rotation_about_y(angle), np.zeros(3)) @ placed.T_camera_world
    return CameraRig({**FOUR.cameras, name: msgspec.structs.replace(placed, T_camera_world=T)})


@pytest.mark.slow
@pytest.mark.parametrize("angle", [-0.008, 0.008])
def test_the_direction_error_of_a_camera_is_found_and_corrected(angle: float) -> None:
    tracker = WebcamsTracker(turned("cam-1", angle))
    scenes = last_of_each(run(tracker, frames(FOUR, [one_walker, other_walker], seconds=10.0)))
    right = [direction_error(tracker._counts, c, 0) for c in range(4)]
    found = right[1] - np.mean([right[0], right[2], right[3]])
    assert 0.4 < found / -angle < 1.1  # the camera's keypoints are on the other side
    true = one_walker(scenes[-1].at_ns / 1e9 - 1.0)
    apart = [float(np.nanmean(np.linalg.norm(one.positions - true, axis=1))) for one in scenes[-1].people]
    assert min(apart) < 0.03


@pytest.mark.slow
def test_the_time_error_of_a_camera_is_found() -> None:
    tracker, late_s = WebcamsTracker(FOUR), 0.05
    arrivals = frames(FOUR, [one_walker, other_walker], seconds=8.0, offsets_s={"cam-2": late_s})
    shifted = [
        Arrival(one.frame, one.at_ns - (round(1e9 * late_s) if one.frame.sensor == "cam-2" else 0)) for one in arrivals
    ]
    run(tracker, sorted(shifted, key=lambda one: one.at_ns))
    found = [time_error(tracker._counts, c) for c in range(4)]
    assert found[2] - np.mean([found[0], found[1], found[3]]) > 0.3 * late_s
    assert max(abs(value) for value in found) < late_s


def test_a_good_rig_is_not_corrected() -> None:
    tracker = WebcamsTracker(FOUR)
    run(tracker, frames(FOUR, [one_walker, other_walker], seconds=1.5))
    counts = tracker._counts
    assert max(abs(direction_error(counts, c, axis)) for c in range(4) for axis in (0, 1)) < 0.0015
    assert max(variance_factor(counts, c) for c in range(4)) < 2.0


def test_corrections_are_limited() -> None:
    counts = no_counts(2)
    counts.aside[0] = [1e3, -1e3, 10.0]
    counts.late[1, :7] = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1e9]
    assert direction_error(counts, 0, 0) == MOST_TURNED_RAD
    assert direction_error(counts, 0, 1) == -MOST_TURNED_RAD
    assert direction_error(counts, 1, 0) == 0.0
    assert time_error(counts, 1) == MOST_LATE_S
    assert time_error(counts, 0) == 0.0


def test_people_who_walk_one_way_past_a_turned_camera_are_not_seen_late() -> None:
    """A residual that does not change with the motion is of the direction; one that does is of the time."""
    turned_rad, late_s, speed = 0.02, 0.04, 0.3
    one_way, both_ways, standing = (no_counts(1) for _ in range(3))
    for counts, ways in ((one_way, (1.0, 1.0)), (both_ways, (1.0, -1.0)), (standing, (1.0, 0.0))):
        for way in ways:
            residual, motion = turned_rad + (0.0 if counts is one_way else late_s * speed * way), speed * way
            sums = np.array([0, 0, 1, residual, 0, motion, 0, motion**2, residual * motion]) * 1e6
            add_late(counts.late[0], 1.0, sums, 0.0, 0.0, 0.0)
    assert abs(time_error(one_way, 0)) < 0.1 * turned_rad / speed
    assert time_error(both_ways, 0) == pytest.approx(late_s, rel=0.05)
    assert time_error(standing, 0) == pytest.approx(late_s, rel=0.05)


def test_times_are_followed_as_far_as_they_are_uncertain() -> None:
    found = []
    for sd_s in (0.0, 0.005, 0.03, 1.0):
        counts = no_counts(1, sd_s)
        counts.late[0, :7] = [1e6, 0.0, 0.0, 2e4, 0.0, 0.0, 2e4 * 0.05]  # a time error of 50 ms
        found.append(time_error(counts, 0))
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    assert found == sorted(found)
    assert found[1] == pytest.approx(0.05 / 3)
    assert found[3] == pytest.approx(0.05, rel=0.01)


def test_corrected_rays_give_the_same_time_as_uncorrected_ones() -> None:
    plain, corrected = np.zeros(8), np.zeros(8)
    weight, m, e = 2.0, np.array([0.3, -0.1]), np.array([0.01, 0.004])
    right, down, late_s = 0.003, -0.002, 0.02
    off = e - [right, down] - late_s * m
    for late, own, turned_by in ((plain, e, (0.0, 0.0, 0.0)), (corrected, off, (right, down, late_s))):
        sums = weight * np.array([0, 0, 1, *own, *m, m @ m, own @ m])
        add_late(late, 1.0, sums, *turned_by)
    np.testing.assert_allclose(corrected, plain, rtol=1e-12)


def test_late_frames_begin_no_third_person() -> None:
    """Two cameras are 0.18 s late for a while, and then catch up: their people are not where they were."""
    arrivals = frames(FOUR, [one_walker, other_walker], seconds=2.5)

    due: dict[str, float] = {}
    rows = []
    for k, one in enumerate(arrivals):
        at_s, name = one.at_ns / 1e9 - 1.0, one.frame.sensor
        slow = name in ("cam-1", "cam-2") and 0.8 < at_s < 1.8
        due[name] = max(at_s + (0.18 if slow else 0.0), due.get(name, 0.0))  # of one camera in their order
        rows.append((due[name], k, one))
    scenes = run(WebcamsTracker(FOUR), [one for _, _, one in sorted(rows)])
    assert {len(scene.people) for scene in scenes[20:]} == {2}
    assert {one.id for scene in scenes for one in scene.people} == {0, 1}


def test_one_camera_keeps_the_distance_of_a_person_who_walks_away() -> None:
    def path(at_s: float) -> tuple[float, float, float]:
        return 0.0, -max(at_s - 0.8, 0.0) * 0.9, np.pi

    arrivals = frames(FOUR, [lambda t: walker(t, path)], seconds=2.2)
    kept = [one for one in arrivals if one.frame.sensor == "cam-0" or one.at_ns < 2e9]
    scene = run(WebcamsTracker(FOUR), kept)[-1]
    one, true = scene.people[0], walker(scene.at_ns / 1e9 - 1.0, path)
    assert JointState.TRACKED not in one.states.tolist()
    error = np.linalg.norm((one.positions - true).mean(axis=0))
    assert error < 0.25
    assert one.sd is not None
    assert error < 4.0 * float(np.mean(one.sd))


def test_heights_are_learnt_with_their_variance() -> None:
    people, random = no_people(10, 2), np.random.default_rng(1)
    for k in range(600):
        people.hits[0] = k + 1
        joints = np.full((26, 3), np.nan)
        joints[3], joints[4] = (7.0, 8.0, 1.0), (7.0, 8.0, random.normal(0.9, 0.05))
        learn_heights(people, 0, joints, np.array([0.0, 0.0, 1.0]))
    assert people.heights[0, 3] == pytest.approx(1.0)
    assert people.heights[0, 4] == pytest.approx(0.9, abs=0.04)
    assert np.sqrt(people.height_variances[0, 4]) == pytest.approx(0.05, rel=0.5)
    assert people.height_variances[0, 3] < 1e-6
    assert np.isnan(people.heights[0, 5])


def test_a_camera_that_often_misses_people_refutes_less() -> None:
    people = no_people(10, 3)
    people.refuted[0] = [1.0, 0.5, np.nan]
    assert refuting(people, 0, np.zeros(3)) == 1.5
    assert refuting(people, 0, np.array([0.2, 0.0, 0.0])) == pytest.approx(1.0)
    assert refuting(people, 0, np.ones(3)) == 0.0
