from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.standing_people import FRAME_NS, KINECT, see, sensor_at, somebody

from mocapella.model.bodies import tracked_bodies
from mocapella.model.observations import Arrival, body_frame
from mocapella.model.topology import topology
from mocapella.tracker.arrivals import Arrivals

ME, T = somebody(), sensor_at(0.0)
SECOND = round(1e9 / FRAME_NS)
V1 = topology("kinect_v1")


def test_a_sensor_speaks_until_it_was_silent_for_too_long_and_again_with_its_next_frame() -> None:
    arrivals = Arrivals(1.0)
    arrivals.update(see("b", T, [ME], 0))
    assert list(arrivals.update(see("a", T, [ME], SECOND)).newest) == ["a", "b"]
    assert list(arrivals.update(see("a", T, [ME], SECOND + 1)).newest) == ["a"]
    assert list(arrivals.update(see("b", T, [ME], SECOND + 2)).newest) == ["a", "b"]


def test_a_late_frame_does_not_turn_the_clock_back() -> None:
    arrivals = Arrivals(1.0)
    arrivals.update(see("a", T, [ME], 0))
    arrivals.update(see("b", T, [ME], 2 * SECOND))
    assert list(arrivals.update(see("c", T, [ME], 0)).newest) == ["b", "c"]


@pytest.mark.parametrize(
    ("then", "problem"),
    [
        (see("a", T, [ME], 4), "time goes backwards"),
        (see("a", T, [ME], 5), "repeats the time of the frame before"),
        (see("a", T, [ME, ME], 6, ids=[3, 3]), "two bodies have the same tracking id"),
        (
            Arrival(body_frame("b", topology("hand"), time_ns=1, positions=[]), 1),
            "topology hand has no mapping to kinect_v2; send one of kinect_v2, arkit, azure_kinect, body_25, body_25b, "
            "coco_17, coco_18, coco_wholebody_133, halpe_136, halpe_26, kinect_v1, mediapipe_pose, nite",
        ),
    ],
)
def test_what_cannot_follow_is_refused_and_changes_nothing(then: Arrival, problem: str) -> None:
    arrivals = Arrivals(1.0)
    arrivals.update(see("a", T, [ME], 5))
    assert arrivals.update(then).problem == problem
    assert arrivals.topology is KINECT
    after = arrivals.update(see("a", T, [ME], 6))
    assert (after.problem, list(after.newest)) == ("", ["a"])


def test_bodies_of_another_topology_get_the_joints_of_people_and_the_frame_stays_as_it_came() -> None:
    arrivals = Arrivals(1.0)
    kinect = see("b", T, [ME], 5)
    positions = np.random.default_rng(0).normal(size=(2, len(V1), 3)).astype(np.float32)
    frame = body_frame("a", V1, time_ns=1, positions=positions, tracking_ids=[7, 3], tracked=[True, True])
    first = arrivals.update(Arrival(frame, 1))
    assert arrivals.topology is KINECT
    after = arrivals.update(kinect)
    assert (first.problem, after.problem, list(after.newest)) == ("", "", ["a", "b"])
    assert after.newest["a"].frame is frame
    mapped, own = after.newest["a"].bodies, after.newest["b"].bodies
    assert (mapped.topology, mapped.ids, mapped.positions.shape) == (KINECT, (3, 7), (2, 25, 3))
    np.testing.assert_array_equal(mapped.positions[:, KINECT.index("Head")], positions[::-1, V1.index("Head")])
    np.testing.assert_array_equal(own.positions, tracked_bodies(kinect.frame).positions)  # type: ignore[arg-type]


def test_a_new_process_of_a_sensor_may_begin_at_any_time_of_its_own_clock() -> None:
    arrivals = Arrivals(1.0)
    assert not arrivals.update(see("a", T, [ME], 5, node_id=1)).node_changed
    assert not arrivals.update(see("a", T, [ME], 6, node_id=1)).node_changed
    restarted = see("a", T, [ME], 0, at=7, node_id=2)
    heard = arrivals.update(restarted)
    assert (heard.problem, heard.node_changed) == ("", True)
    assert not arrivals.update(see("a", T, [ME], 1, at=8, node_id=2)).node_changed
    assert msgspec.structs.asdict(heard.newest["a"])["frame"] is restarted.frame
