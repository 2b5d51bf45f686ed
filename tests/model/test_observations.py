"""A frame made of array-likes: what is left out is filled in, and what does not fit is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.model.observations import JointState, body_frame, check_sensor_name
from mocapella.model.topology import topology

V2 = topology("kinect_v2")


def test_what_is_not_given_is_filled_in() -> None:
    positions = np.ones((2, 25, 3))
    positions[1, 3, 0] = np.nan
    frame = body_frame("front", V2, time_ns=5, positions=positions)
    assert frame.bodies == 2
    assert frame.key == ("front", 0, 0)
    assert frame.states[1, 3] == JointState.NOT_TRACKED
    assert np.isnan(frame.positions[1, 3]).all()
    assert (np.delete(frame.states.ravel(), 28) == JointState.TRACKED).all()
    assert frame.tracked.all()
    assert frame.tracking_ids.tolist() == [0, 1]
    assert frame.depth_px is None
    assert frame.orientations is None
    dtypes = [frame.positions.dtype, frame.states.dtype, frame.tracking_ids.dtype, frame.clipped_edges.dtype]
    assert dtypes == [np.float32, np.uint8, np.uint64, np.uint8]


def test_what_is_not_tracked_is_missing_everywhere() -> None:
    states = np.full((1, 25), JointState.INFERRED)
    states[0, 7] = JointState.NOT_TRACKED
    frame = body_frame(
        "front",
        V2,
        time_ns=0,
        positions=np.ones((1, 25, 3)),
        states=states,
        depth_px=np.ones((1, 25, 2)),
        orientations=np.ones((1, 25, 4)),
    )
    for values in (frame.positions, frame.depth_px, frame.orientations):
        assert values is not None
        assert np.isnan(values[0, 7]).all()
        assert np.isfinite(np.delete(values[0], 7, axis=0)).all()


@pytest.mark.parametrize("nobody", [[], np.empty((0, 25, 3))])
def test_nobody_is_a_frame_too(nobody: Any) -> None:
    frame = body_frame("front", V2, time_ns=0, positions=nobody, states=[], tracking_ids=[])
    assert (frame.bodies, frame.positions.shape, frame.states.shape) == (0, (0, 25, 3), (0, 25))


def test_the_callers_arrays_stay_the_callers() -> None:
    positions = np.ones((1, 25, 3), np.float32)
    body_frame("front", V2, time_ns=0, positions=positions, states=np.zeros((1, 25), np.uint8))
    assert (positions == 1).all()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"positions": np.ones((2, 20, 3))}, r"positions has the shape \(2, 20, 3\); 2 bodies want \(2, 25, 3\)"),
        ({"positions": np.ones((25, 3))}, "positions has the shape"),
        ({"states": np.ones((1, 25))}, r"states has the shape \(1, 25\)"),
        ({"tracking_ids": [1]}, "tracking_ids has the shape"),
        ({"tracked": [True] * 3}, "tracked has the shape"),
        ({"clipped_edges": 0}, "clipped_edges has the shape"),
        ({"depth_px": np.ones((2, 25, 3))}, "depth_px has the shape"),
        ({"orientations": np.ones((2, 25, 3))}, r"orientations has the shape .* want \(2, 25, 4\)"),
    ],
)
def test_a_shape_that_does_not_fit_is_named(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        body_frame(**{"sensor": "front", "topology": V2, "time_ns": 0, "positions": np.ones((2, 25, 3)), **changed})


@pytest.mark.parametrize("name", ["a", "front", "Kinect_2.left-hand", "9", "x" * 64])
def test_names_that_can_be_used(name: str) -> None:
    assert check_sensor_name(name) == name


@pytest.mark.parametrize("name", ["", ".front", "-", "a b", "a/b", "a*", "größe", "front\n", "x" * 65])
def test_names_that_cannot_be_used(name: str) -> None:
    with pytest.raises(SettingsError, match="such as front"):
        check_sensor_name(name)
