from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.standing_people import KINECT

from mocapella.model.bodies import body_name, id_array, tracked_bodies
from mocapella.model.observations import JointState, body_frame


@given(st.lists(st.integers(0, 2**64 - 1), max_size=6))
def test_ids_become_an_array_that_equal_ids_share(ids: list[int]) -> None:
    array = id_array(ids)
    assert (str(array.dtype), array.tolist()) == ("uint64", ids)
    assert id_array(tuple(ids)) is array


def test_only_tracked_bodies_count_and_their_order_is_that_of_their_ids() -> None:
    positions = np.arange(3 * 25 * 3).reshape(3, 25, 3)
    frame = body_frame(
        "front", KINECT, time_ns=1, positions=positions, tracking_ids=[9, 4, 7], tracked=[True, False, True]
    )
    seen = tracked_bodies(frame)
    assert seen.keys == (("front", 7), ("front", 9))
    np.testing.assert_array_equal(seen.positions, positions[[2, 0]])
    assert seen.states.shape == (2, 25)


def test_some_of_the_bodies_keep_their_order() -> None:
    positions = np.arange(3 * 25 * 3, dtype=np.float64).reshape(3, 25, 3)
    seen = tracked_bodies(body_frame("front", KINECT, time_ns=1, positions=positions, tracking_ids=[4, 7, 9]))
    some = seen.only(np.array([True, False, True]))
    assert some.keys == (("front", 4), ("front", 9))
    np.testing.assert_array_equal(some.positions, positions[[0, 2]])
    assert some.states.shape == (2, 25)


def test_a_joint_where_the_camera_is_counts_as_not_tracked() -> None:
    positions = np.ones((2, 25, 3))
    positions[1, 4] = 0.0
    positions[1, 5, :2] = 0.0  # before the camera, on its axis
    frame = body_frame("front", KINECT, time_ns=1, positions=positions)
    assert frame.states[1, 4] == JointState.TRACKED
    seen = tracked_bodies(frame)
    assert np.argwhere(np.isnan(seen.positions[..., 0])).tolist() == [[1, 4]]
    assert np.argwhere(seen.states == JointState.NOT_TRACKED).tolist() == [[1, 4]]
    assert not frame.positions[1, 4].any()  # the frame stays as it came


def test_a_body_is_named_in_few_digits() -> None:
    assert body_name(3) == "body 3"
    assert body_name(72057594037944007) == "body …007"


def test_a_frame_without_bodies_has_none() -> None:
    seen = tracked_bodies(body_frame("front", KINECT, time_ns=1, positions=[]))
    assert seen.ids == ()
    assert seen.positions.shape == (0, 25, 3)
