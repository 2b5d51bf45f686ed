"""OSC: poses of three kinds of senders, in right-handed axes; garbage is counted, and never raised."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.model.poses import PoseFrame
from mocapella.schema import decode_frame, encode_frame
from mocapella.sources.osc import BadOscError, OscPoses, as_json, bundle, encode, messages

S = np.sqrt(0.5)
FLIP = np.diag([1.0, 1.0, -1.0])


def told(*data: bytes) -> tuple[PoseFrame | None, OscPoses]:
    source = OscPoses("osc", "vr")
    frame = None
    for k, one in enumerate(data):
        frame = source.update(one, 1_000_000 * (k + 1))
    return frame, source


def test_our_own_pose_is_taken_as_it_is() -> None:
    frame, source = told(encode("/mocapella/pose", "cup", 0.5, 1.25, -2.0, 0.0, S, 0.0, S))
    assert frame is not None
    assert (frame.sensor, frame.space, frame.names, frame.time_ns) == ("osc", "vr", ("cup",), 1_000_000)
    np.testing.assert_allclose(frame.positions, [[0.5, 1.25, -2.0]])
    np.testing.assert_allclose(frame.orientations, [[S, 0, S, 0]], atol=1e-6)
    assert source.report.poses == 1
    decode_frame(encode_frame(frame))


def test_vmc_is_left_handed_and_its_local_pose_wins() -> None:
    """A turn by 90° about Unity's y brings its z axis (forward) to its x (right)."""
    frame, _ = told(encode("/VMC/Ext/Tra/Pos", "LHR-1", 0.5, 1.0, 2.0, 0.0, S, 0.0, S))
    assert frame is not None
    np.testing.assert_allclose(frame.positions, [[0.5, 1.0, -2.0]])
    T = frame.T_space_body("LHR-1")
    assert T is not None
    np.testing.assert_allclose(T[:3, :3] @ [0, 0, -1], [1, 0, 0], atol=1e-6)  # forward is −z now
    np.testing.assert_allclose(T[:3, :3] @ [0, 1, 0], [0, 1, 0], atol=1e-6)
    both = bundle(
        encode("/VMC/Ext/Tra/Pos/Local", "LHR-1", 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0),
        encode("/VMC/Ext/Tra/Pos", "LHR-1", 9.0, 9.0, 9.0, 0.0, 0.0, 0.0, 1.0),
        encode("/VMC/Ext/Hmd/Pos", "HMD", 4.0, 5.0, 6.0, 0.0, 0.0, 0.0, 1.0),
    )
    frame, source = told(both)
    assert frame is not None
    assert frame.names == ("LHR-1", "HMD")
    np.testing.assert_allclose(frame.positions, [[1, 2, -3], [4, 5, -6]])
    assert source.report.poses == 2


@given(st.lists(st.floats(-170, 170), min_size=3, max_size=3))
def test_vrchats_angles_turn_about_z_then_x_then_y(degrees: list[float]) -> None:
    rotation = encode("/tracking/trackers/3/rotation", *degrees)
    frame, _ = told(rotation, encode("/tracking/trackers/3/position", 0.1, 0.2, 0.3))
    assert frame is not None
    T = frame.T_space_body("3")
    assert T is not None

    def about(axis: int, angle: float) -> np.ndarray:
        """As Unity's left-handed axes have it: the formula is the same, the sense is the other."""
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        i, j = (axis + 1) % 3, (axis + 2) % 3
        R = np.eye(3)
        R[i, i] = R[j, j] = c
        R[i, j], R[j, i] = -s, s
        return R

    unity = about(1, degrees[1]) @ about(0, degrees[0]) @ about(2, degrees[2])
    np.testing.assert_allclose(T[:3, :3], FLIP @ unity @ FLIP, atol=1e-5)
    np.testing.assert_allclose(T[:3, 3], [0.1, 0.2, -0.3], atol=1e-6)


def test_a_rotation_alone_tells_no_pose_and_a_position_alone_tells_one_that_is_not_turned() -> None:
    frame, _ = told(encode("/tracking/trackers/head/rotation", 0.0, 90.0, 0.0))
    assert frame is None
    frame, _ = told(encode("/tracking/trackers/head/position", 0.0, 1.0, 0.0))
    assert frame is not None
    np.testing.assert_allclose(frame.orientations, [[1, 0, 0, 0]])
    frame, _ = told(
        bundle(
            encode("/tracking/trackers/1/position", 0.0, 1.0, 0.0), encode("/tracking/trackers/1/rotation", 0, 90, 0)
        )
    )
    assert frame is not None
    np.testing.assert_allclose(np.abs(frame.orientations), [[S, 0, S, 0]], atol=1e-6)


@given(st.binary(max_size=120))
def test_garbage_is_counted_and_never_raised(data: bytes) -> None:
    head = encode("/mocapella/pose", "cup", 0.5, 1.25, -2.0, 0.0, S, 0.0, S)
    source = OscPoses("osc", "vr")
    for k, datagram in enumerate((data, head[:-4] + data, b"#bundle\0" + data, head[: len(data)])):
        frame = source.update(datagram, k + 1)
        if frame is not None:
            decode_frame(encode_frame(frame))
    assert source.report.datagrams == 4
    as_json(source.report)


@pytest.mark.parametrize(
    ("datagram", "counted"),
    [
        (b"", "bad"),
        (b"mocapella/pose\0\0", "bad"),
        (b"/x\0\0,z\0\0", "bad"),
        (b"/x\0\0,f\0\0\0", "bad"),
        (b"/x\0\0,b\0\0\0\0\0\x63", "bad"),
        (b"/x\0\0iii\0", "bad"),
        (b"/\xff\0\0", "bad"),
        (b"#bundle\0" + b"\0" * 8 + struct.pack(">i", 99), "bad"),
        (bundle(bundle(bundle(bundle(bundle(encode("/x")))))), "bad"),
        (b"/x\0\0", "unknown"),
        (encode("/tracking/trackers/9/position", 0.0, 0.0, 0.0), "unknown"),
        (encode("/VMC/Ext/Bone/Pos", "Hips", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "unknown"),
        (encode("/mocapella/pose", "cup", 1.0), "refused"),
        (encode("/mocapella/pose", 3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "refused"),
        (encode("/mocapella/pose", "cup", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0), "refused"),
        (encode("/mocapella/pose", "cup", float("nan"), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "refused"),
        (encode("/mocapella/pose", "cup", 1e6, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "refused"),
        (encode("/mocapella/pose", "cup", "0", 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "refused"),
        (encode("/tracking/trackers/1/position", 0.0), "refused"),
    ],
)
def test_what_cannot_be_used_is_counted(datagram: bytes, counted: str) -> None:
    frame, source = told(datagram)
    assert frame is None
    counts = {"bad": source.report.bad, "unknown": source.report.unknown, "refused": source.report.refused.total()}
    assert counts == {**dict.fromkeys(counts, 0), counted: 1}


def test_a_thousand_times_the_rate_is_not_read() -> None:
    source = OscPoses("osc", "vr", most_hz=100.0)
    data = encode("/mocapella/pose", "cup", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    frames = [source.update(data, 10_000 * k) for k in range(1, 100_000)]  # 100 kHz for a second
    assert 150 <= sum(frame is not None for frame in frames) <= 250
    assert source.report.too_soon + source.report.poses == source.report.datagrams


def test_every_type_of_the_specification_is_read() -> None:
    data = b"/a\0\0,ifsbhdTFNI\0" + struct.pack(">if", 5, 0.5) + b"hi\0\0" + struct.pack(">i", 3) + b"abc\0"
    data += struct.pack(">qd", -7, 2.5)
    (message,) = messages(data)
    assert message.arguments == (5, 0.5, "hi", b"abc", -7, 2.5, True, False, None, float("inf"))
    with pytest.raises(BadOscError, match="cut off"):
        list(messages(data[:-1]))


@pytest.mark.parametrize("rest", [0, 4, 8])
def test_a_blob_or_a_part_of_a_bundle_may_be_as_long_as_the_rest_of_the_datagram_and_no_longer(rest: int) -> None:
    head, data = b"/x\0\0,b\0\0", bytes(range(rest))
    for size in range(-2, rest + 13):
        blob = head + struct.pack(">i", size) + data
        if 0 <= size <= rest:
            assert list(messages(blob)) == [("/x", (data[:size],))]
        else:
            with pytest.raises(BadOscError, match="a blob that is longer"):
                list(messages(blob))
    part = encode("/x", "a" * rest)
    for size in (-1, 0, len(part) + 1, len(part) + 4, len(part) + 20):
        with pytest.raises(BadOscError, match="a bundle whose part is longer"):
            list(messages(b"#bundle\0" + bytes(8) + struct.pack(">i", size) + part))
    assert [one.arguments for one in messages(bundle(part, part))] == [("a" * rest,)] * 2


@pytest.mark.parametrize("address", ["/mocapella/pose", "/VMC/Ext/Tra/Pos"])
@pytest.mark.parametrize("length", [0.89, 0.92, 1.0, 1.08, 1.11])
def test_a_quaternion_of_about_length_1_tells_the_same_rotation_at_length_1(address: str, length: float) -> None:
    exact = np.array([0.1, -0.5, 0.7, 0.5]) / np.linalg.norm([0.1, -0.5, 0.7, 0.5])
    (frame, source), (wanted, _) = (told(encode(address, "cup", 0, 1, 2, *(by * exact))) for by in (length, 1.0))
    assert wanted is not None
    if 0.9 < length < 1.1:
        assert frame is not None
        np.testing.assert_allclose(frame.orientations, wanted.orientations, atol=1e-6)
        assert np.linalg.norm(frame.orientations) == pytest.approx(1.0, abs=1e-12)
    else:
        assert frame is None
        assert source.report.refused == {"its quaternion is not of length 1": 1}
