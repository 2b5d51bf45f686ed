"""Frames and scenes of every kind, for the codec's tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mocapella.model.arms import ARM_POINTS, ArmFrame, SeenArm
from mocapella.model.depth import DepthFrame, depth_frame
from mocapella.model.hand import ANGLES
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.markers import MarkerFrame, marker_frame
from mocapella.model.observations import BodyFrame, body_frame
from mocapella.model.scene import (
    Person,
    Phase,
    PotentialSkeleton,
    Scene,
    SensorPlace,
    TrackedArm,
    TrackedHand,
    TrackedObject,
    TrackedPoints,
    TrackerState,
)
from mocapella.model.topology import Topology, topology, topology_names
from mocapella.schema import encode_frame
from mocapella.schema import mocapella_pb2 as pb

SENSOR_NAMES = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", fullmatch=True)
UINT64 = st.integers(0, 2**64 - 1)
INT64 = st.integers(-(2**63), 2**63 - 1)
TOPOLOGIES = st.sampled_from(topology_names()).map(topology)


def floats(shape: tuple[int, ...], limit: float, allow_nan: bool) -> st.SearchStrategy[np.ndarray]:
    """float32 arrays within ±limit, most of one value and a few of others, which is what makes many joints cheap."""
    plain = st.floats(-limit, limit, width=32)
    return arrays.arrays(np.float32, shape, elements=plain | st.just(np.nan) if allow_nan else plain)


@st.composite
def frames(draw: st.DrawFn) -> BodyFrame:
    """Any frame that a sensor may publish: 0 to 20 bodies, with and without what is optional."""
    kind = draw(TOPOLOGIES)
    bodies = draw(st.integers(0, 20))
    shape = (bodies, len(kind))
    optional = {"depth_px": 2, "orientations": 4} if bodies else {}  # of nobody, all and none are the same bytes
    return body_frame(
        draw(SENSOR_NAMES),
        kind,
        time_ns=draw(INT64),
        sent_ns=draw(INT64),
        positions=draw(floats((*shape, 3), 1000.0, allow_nan=False)),
        states=draw(arrays.arrays(np.uint8, shape, elements=st.integers(0, 2))),
        tracking_ids=draw(arrays.arrays(np.uint64, bodies)),
        tracked=draw(arrays.arrays(np.bool_, bodies)),
        clipped_edges=draw(arrays.arrays(np.uint8, bodies, elements=st.integers(0, 15))),
        node_id=draw(UINT64),
        sequence=draw(UINT64),
        depth_size_px=(draw(st.integers(0, 2**32 - 1)), draw(st.integers(0, 2**32 - 1))),
        tilt=draw(st.floats(-3.125, 3.125, width=32)),
        height=draw(st.floats(-1000, 1000, width=32)),
        **{
            name: draw(floats((*shape, width), 4096.0, allow_nan=True))
            for name, width in optional.items()
            if draw(st.booleans())
        },
    )


@st.composite
def marker_frames(draw: st.DrawFn) -> MarkerFrame:
    """Any frame that a camera may publish: 0 to 12 markers, some of which are not seen."""
    names = draw(st.lists(st.text(min_size=1, max_size=12), unique=True, max_size=12))
    width, height = draw(st.integers(1, 4096)), draw(st.integers(1, 4096))
    n = len(names)
    positions = draw(arrays.arrays(np.float32, (n, 2), elements=st.floats(0, 1, width=32))) * [width - 1, height - 1]
    positions[draw(arrays.arrays(np.bool_, n))] = np.nan
    one = arrays.arrays(np.float32, n, elements=st.floats(0, 1, width=32))
    return marker_frame(
        draw(SENSOR_NAMES),
        names,
        time_ns=draw(INT64),
        sent_ns=draw(INT64),
        size_px=(width, height),
        positions_px=positions,
        sd_px=draw(one),
        areas_px=draw(one),
        confidences=draw(one),
        node_id=draw(UINT64),
        sequence=draw(UINT64),
    )


@st.composite
def keypoint_frames(draw: st.DrawFn) -> KeypointFrame:
    """Any frame that a detector of keypoints may publish: 0 to 6 people, with and without depth."""
    kind, people = draw(TOPOLOGIES), draw(st.integers(0, 6))
    shape = (people, len(kind))
    positions = draw(floats((*shape, 2), 5000.0, allow_nan=False))
    positions[draw(arrays.arrays(np.bool_, shape))] = np.nan
    relative = draw(floats((*shape, 3), 1000.0, allow_nan=True)) if people and draw(st.booleans()) else None
    return keypoint_frame(
        draw(SENSOR_NAMES),
        kind,
        time_ns=draw(INT64),
        sent_ns=draw(INT64),
        size_px=(draw(st.integers(1, 4096)), draw(st.integers(1, 4096))),
        positions_px=positions,
        confidences=draw(arrays.arrays(np.float32, shape, elements=st.floats(0, 1, width=32))),
        ids=draw(arrays.arrays(np.int64, people)),
        relative=relative,
        node_id=draw(UINT64),
        sequence=draw(UINT64),
    )


@st.composite
def depth_frames(draw: st.DrawFn) -> DepthFrame:
    """Any image that a depth camera may publish: of one pixel and more, smooth, noisy and with holes."""
    height, width = draw(st.integers(1, 24)), draw(st.integers(1, 24))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows, columns = np.mgrid[:height, :width]
    smooth = 700 + draw(st.integers(0, 9)) * rows - draw(st.integers(0, 9)) * columns
    depth = (smooth + rng.integers(0, draw(st.sampled_from([1, 5, 65_536])), (height, width))).astype(np.uint16)
    depth[rng.random((height, width)) < draw(st.sampled_from([0.0, 0.3, 1.0]))] = 0
    return depth_frame(
        draw(SENSOR_NAMES),
        depth,
        unit_m=draw(st.floats(1e-6, 0.1)),
        lens=[*rng.uniform(1, 1e4, 4), *rng.normal(size=5)],
        time_ns=draw(INT64),
        node_id=draw(UINT64),
        sequence=draw(UINT64),
        sent_ns=draw(INT64),
    )


@st.composite
def arm_frames(draw: st.DrawFn) -> ArmFrame:
    """Any frame of 0 to 4 arms, some of whose points are not known."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    ids = draw(st.lists(UINT64, unique=True, max_size=4))
    return ArmFrame(
        draw(SENSOR_NAMES),
        draw(UINT64),
        draw(UINT64),
        draw(INT64),
        draw(INT64),
        (draw(st.integers(1, 1024)), draw(st.integers(1, 1024))),
        np.array([*rng.uniform(1, 1e4, 4), *rng.normal(size=5)]),
        draw(st.text(min_size=1, max_size=12)),
        tuple(some_arm(identity, rng, draw(st.text(max_size=8))) for identity in ids),
        draw(st.text(max_size=12)),
    )


def some_arm(identity: int, rng: np.random.Generator, gesture: str = "open") -> SeenArm:
    """An arm of random numbers, without a pose of the palm in half of all cases."""
    points = rng.uniform(-2, 2, (len(ARM_POINTS), 3))
    states = rng.integers(0, 3, len(ARM_POINTS)).astype(np.uint8)
    sd = np.where(states > 0, rng.random(len(states)), np.nan).astype(np.float32)
    points[states == 0] = np.nan
    T = np.eye(4)
    T[:3, 3] = rng.normal(size=3)
    sure = [float(np.float32(value)) for value in (rng.uniform(0.5, 1), rng.random())]
    return SeenArm(
        identity, bool(rng.random() < 0.5), sure[0], points, states, sd, rng.uniform(-1, 1, len(ANGLES)),
        T if rng.random() < 0.5 else None, gesture, sure[1], bool(rng.random() < 0.5),
    )  # fmt: skip


def plain_frame(bodies: int = 2, kind: Topology | None = None) -> BodyFrame:
    """A frame with everything, all tracked."""
    kind = kind or topology("kinect_v2")
    shape = (bodies, len(kind))
    return body_frame(
        "front",
        kind,
        time_ns=1,
        positions=np.ones((*shape, 3)),
        depth_px=np.full((*shape, 2), 100.0),
        orientations=np.full((*shape, 4), 0.5),
    )


def message(bodies: int = 2, **changed: Any) -> pb.BodyFrame:
    """The protobuf message of `plain_frame` with some fields changed."""
    made = pb.BodyFrame.FromString(encode_frame(plain_frame(bodies)))
    for name, value in changed.items():
        setattr(made, name, value)
    return made


def small_scene(people: int = 1) -> Scene:
    """People who are seen by two sensors each."""
    kind = topology("kinect_v2")
    rng = np.random.default_rng(3)

    def view(sensor: str, *, mirrored: bool = False) -> PotentialSkeleton:
        positions, states = rng.normal(size=(len(kind), 3)), np.full(len(kind), 2, np.uint8)
        return PotentialSkeleton(sensor, 7, 11, 0.25, 1.5, np.eye(4), positions, states, mirrored)

    def person(identity: int) -> Person:
        positions, states = rng.normal(size=(len(kind), 3)), np.full(len(kind), 2, np.uint8)
        sd = np.full(len(kind), 0.01, np.float32)
        positions[3], states[3], sd[3] = np.nan, 0, np.nan
        return Person(identity, positions, states, (view("front"), view("left", mirrored=True)), sd, "Zoë")

    state = TrackerState(Phase.CALIBRATING, 1, 2, 3, "somebody moved")
    places = (SensorPlace("front", np.eye(4), 0.01, 0.002, "good"), SensorPlace("left", None, problem="walk"))
    return Scene(5, 6, "front", 2**64 - 1, 8, kind, state, {"people": tuple(person(i) for i in range(people))}, places)


def hands_scene() -> Scene:
    """A hand that holds a cup, another that is lost, and the points they are made of."""
    rng = np.random.default_rng(4)
    states, sd = np.full(21, 2, np.uint8), np.full(21, 0.001, np.float32)
    states[3] = 1
    T = np.eye(4)
    T[:3, 3] = 0.25
    hand = TrackedHand(3, True, rng.normal(size=(21, 3)), states, sd, rng.uniform(-1, 1, 21), T, "cup")
    nan = np.full((21, 3), np.nan)
    lost = TrackedHand(4, False, nan, np.zeros(21, np.uint8), nan[:, 0].astype(np.float32), nan[:, 0].copy(), None)
    positions = np.array([[0.1, 0.2, 0.3], [np.nan] * 3])
    points = TrackedPoints(
        ("red", "blue"), positions, np.array([0.001, np.nan], np.float32), np.array([2, 0], np.uint8)
    )
    square = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]])
    objects = (TrackedObject("ball", None, np.empty((0, 3)), 0), TrackedObject("cup", T, square, 2))
    state = TrackerState(Phase.TRACKING)
    return Scene(
        7, 8, "left", 9, 10, topology("hand"), state, {"hands": (hand, lost), "points": (points,), "objects": objects}
    )


def arms_scene() -> Scene:
    """A person's arm that two cameras see, and another that is nobody's, predicted, and without a pose of its palm."""
    made = []
    for k, (person, cameras) in enumerate(((7, ("left", "right")), (-1, ()))):
        arm = some_arm(3 + k, np.random.default_rng(10 + k))
        T = np.eye(4) if person >= 0 else None
        made.append(
            TrackedArm(
                arm.id, arm.left, arm.points, arm.states, arm.sd, arm.angles, T,
                arm.gesture, arm.gesture_sure, arm.grabbing, person, cameras,
            )
        )  # fmt: skip
    return Scene(7, 8, "left", 9, 10, topology("hand"), TrackerState(Phase.TRACKING), {"arms": tuple(made)})
