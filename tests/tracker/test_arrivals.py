from __future__ import annotations

import msgspec
import pytest
from support.standing_people import FRAME_NS, KINECT, see, sensor_at, somebody

from mocapella.model.observations import Arrival, body_frame
from mocapella.model.topology import topology, topology_from_toml
from mocapella.tracker.arrivals import Arrivals

ME, T = somebody(), sensor_at(0.0)
SECOND = round(1e9 / FRAME_NS)
HEADLESS = topology_from_toml(
    'joints = ["a", "b"]\nbones = [["a", "b"]]\nmirror = []\n[parts]\nroot = "a"\nhead = "b"\n', "two"
)


def test_a_sensor_speaks_until_it_was_silent_for_too_long_and_again_with_its_next_frame() -> None:
    arrivals = Arrivals(1.0, ())
    arrivals.update(see("b", T, [ME], 0))
    assert list(arrivals.update(see("a", T, [ME], SECOND)).newest) == ["a", "b"]
    assert list(arrivals.update(see("a", T, [ME], SECOND + 1)).newest) == ["a"]
    assert list(arrivals.update(see("b", T, [ME], SECOND + 2)).newest) == ["a", "b"]


def test_a_late_frame_does_not_turn_the_clock_back() -> None:
    arrivals = Arrivals(1.0, ())
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
            Arrival(body_frame("b", topology("kinect_v1"), time_ns=1, positions=[]), 1),
            "topology kinect_v1, where the first frame had kinect_v2",
        ),
    ],
)
def test_what_cannot_follow_is_refused_and_changes_nothing(then: Arrival, problem: str) -> None:
    arrivals = Arrivals(1.0, ())
    arrivals.update(see("a", T, [ME], 5))
    assert arrivals.update(then).problem == problem
    assert arrivals.topology is KINECT
    after = arrivals.update(see("a", T, [ME], 6))
    assert (after.problem, list(after.newest)) == ("", ["a"])


def test_a_topology_without_the_parts_that_the_method_needs_is_refused() -> None:
    arrivals = Arrivals(1.0, ("head", "hand_left", "hand_right"))
    heard = arrivals.update(Arrival(body_frame("a", HEADLESS, time_ns=1, positions=[]), 1))
    assert heard.problem == "topology two names no hand_left, hand_right"
    assert arrivals.update(see("a", T, [ME], 5)).problem == ""


def test_a_new_process_of_a_sensor_may_begin_at_any_time_of_its_own_clock() -> None:
    arrivals = Arrivals(1.0, ())
    assert not arrivals.update(see("a", T, [ME], 5, node_id=1)).node_changed
    assert not arrivals.update(see("a", T, [ME], 6, node_id=1)).node_changed
    restarted = see("a", T, [ME], 0, at=7, node_id=2)
    heard = arrivals.update(restarted)
    assert (heard.problem, heard.node_changed) == ("", True)
    assert not arrivals.update(see("a", T, [ME], 1, at=8, node_id=2)).node_changed
    assert msgspec.structs.asdict(heard.newest["a"])["frame"] is restarted.frame
