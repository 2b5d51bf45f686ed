"""Pose frames: there and back, and what is refused."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError, WireError
from mocapella.geometry.twists import exp_twist
from mocapella.model.poses import PoseFrame, pose_frame, quaternion_of, rotation_of
from mocapella.schema import decode_frame, encode_frame, format_of
from mocapella.schema import mocapella_pb2 as pb

NAN = float("nan")


@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.text(min_size=1, max_size=12))
def test_a_pose_frame_comes_back_as_it_was(seed: int, bodies: int, space: str) -> None:
    rng = np.random.default_rng(seed)
    p, q = rng.uniform(-5, 5, (bodies, 3)), rng.normal(size=(bodies, 4))
    p[rng.random(bodies) < 0.3] = np.nan
    frame = pose_frame("vive", space, [f"b{k}" for k in range(bodies)], time_ns=int(seed), positions=p, orientations=q)
    data = encode_frame(frame)
    back = decode_frame(data)
    assert isinstance(back, PoseFrame)
    assert format_of(data).schema_name == "mocapella.PoseFrame"
    for name in frame.__struct_fields__:
        np.testing.assert_array_equal(getattr(back, name), getattr(frame, name))
    assert encode_frame(back) == data
    assert back.bodies == int(np.isfinite(p).all(axis=1).sum())


@given(st.binary(max_size=80))
def test_no_bytes_do_anything_but_give_a_frame_or_an_error_of_ours(data: bytes) -> None:
    head = pb.PoseFrame(schema_version=1, sensor="vive", space="vr").SerializeToString()
    with contextlib.suppress(WireError):
        decode_frame(head + data)


def message(**changed: Any) -> bytes:
    frame = pose_frame(
        "vive", "vr", ["cup", "box"], time_ns=1, positions=[[1, 2, 3], [NAN] * 3],
        orientations=[[1, 0, 0, 0], [NAN] * 4],
    )  # fmt: skip
    made = pb.PoseFrame.FromString(encode_frame(frame))
    for name, value in changed.items():
        if name == "names":
            del made.names[:]
            made.names.extend(value)
        else:
            setattr(made, name, value)
    return bytes(made.SerializeToString())


def floats(*values: float) -> bytes:
    return np.array(values, "<f4").tobytes()


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"names": ["cup"]}, "positions_m"),
        ({"names": ["cup", "cup"]}, "twice"),
        ({"space": "x" * 81}, "space"),
        ({"positions_m": floats(1, 2, 3, 4, 5, 6)}, "part of a pose"),
        ({"positions_m": floats(1, 2, 2000, NAN, NAN, NAN)}, "2000"),
        ({"positions_m": floats(1, 2, np.inf, NAN, NAN, NAN)}, "part of a pose"),
        ({"orientations": floats(1, 1, 0, 0, NAN, NAN, NAN, NAN)}, "length 1.41"),
        ({"orientations": b"123"}, "orientations"),
        ({"states": bytes([2, 3])}, "has a 3"),
        ({"states": bytes([2, 2])}, "tracked without a pose"),
        ({"states": bytes([0, 0])}, "with a pose that is not"),
        ({"states": bytes([2])}, "states"),
        ({"sensor": "-"}, "sensor name"),
        ({"schema_version": 2}, "version 2"),
    ],
)
def test_what_is_refused_is_named(changed: dict[str, Any], named: str) -> None:
    with pytest.raises(WireError, match=named):
        decode_frame(message(**changed))


def test_states_may_be_left_out() -> None:
    frame = decode_frame(message(states=b""))
    assert isinstance(frame, PoseFrame)
    assert frame.states.tolist() == [2, 0]
    np.testing.assert_array_equal(frame.T_space_body("cup"), [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    assert frame.T_space_body("box") is None
    assert frame.T_space_body("mug") is None


@given(st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3))
def test_quaternions_are_those_of_their_rotations(turn: list[float]) -> None:
    R = exp_twist([0, 0, 0, *turn])[:3, :3]
    q = quaternion_of(R)
    assert np.linalg.norm(q) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation_of(q), R, atol=1e-9)


def test_poses_of_a_wrong_shape_are_refused() -> None:
    good: dict[str, Any] = {"time_ns": 0, "positions": np.zeros((1, 3)), "orientations": [[1, 0, 0, 0]]}
    for names in (["a", "a"], [""]):
        with pytest.raises(SettingsError, match="a name of its own"):
            pose_frame("vive", "vr", names, **good)
    with pytest.raises(SettingsError, match="positions"):
        pose_frame("vive", "vr", ["a"], **{**good, "positions": np.zeros((2, 3))})
    with pytest.raises(SettingsError, match="states"):
        pose_frame("vive", "vr", ["a"], **good, states=[3])
    nothing = pose_frame("vive", "vr", ["a"], **{**good, "orientations": [[0, 0, 0, 0]]})
    assert nothing.states.tolist() == [0]


def test_the_quaternion_that_is_furthest_from_one_is_named() -> None:
    both = {"positions_m": floats(1, 2, 3, 4, 5, 6), "states": bytes([2, 2])}
    with pytest.raises(WireError, match=r"length 0\.5;"):
        decode_frame(message(**both, orientations=floats(0.5, 0, 0, 0, 1.25, 0, 0, 0)))
