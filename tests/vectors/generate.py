"""Test vectors: messages as bytes and as values, for whoever writes a publisher or reader in another language.

``python tests/vectors/generate.py`` writes ``<name>.bin`` (the message) and ``<name>.json`` (its values) for each. All
floats are exact in binary, so that every language that computes them gets the same bits. In the JSON, 64-bit integers
are strings, as protobuf's own JSON has them, and null is a missing number (NaN).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from mocapella.model.arms import ARM_POINTS, ArmFrame, SeenArm
from mocapella.model.depth import DepthFrame, depth_frame
from mocapella.model.hand import ANGLES
from mocapella.model.images import ImageFrame, image_frame
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.markers import MarkerFrame, marker_frame
from mocapella.model.observations import BodyFrame, JointState, body_frame
from mocapella.model.poses import PoseFrame, pose_frame
from mocapella.model.scene import (
    Person,
    Phase,
    PotentialSkeleton,
    Scene,
    SensorPlace,
    TrackedArm,
    TrackedBody,
    TrackedBodyView,
    TrackedHand,
    TrackedObject,
    TrackedPoints,
    TrackerState,
    UnknownPart,
)
from mocapella.model.sensor_frame import SensorFrame, UnknownFrame
from mocapella.model.topology import topology
from mocapella.model.truth import Truth
from mocapella.schema import encode_frame, encode_scene, encode_truth
from mocapella.schema.delimited import delimited

FOLDER = Path(__file__).resolve().parent
NODE_ID = 0x0123456789ABCDEF


def frame_skeleton() -> BodyFrame:
    """Two bodies of a Kinect v2; every joint whose number is 7 more than a multiple of 8 is not tracked.

    `examples/c_publisher` writes the same bytes from the same formulas.
    """
    body, joint = np.mgrid[0:2, 0:25]
    positions = np.stack([(joint - 12) / 16 + 2 * body - 1, (12 - joint) / 8, 2 + joint / 64], axis=-1)
    states = np.where(joint % 8 == 7, JointState.NOT_TRACKED, np.where(joint % 8 == 3, 1, 2))
    return body_frame(
        "front",
        topology("kinect_v2"),
        time_ns=66_666_667,
        sent_ns=5_000_000_123,
        positions=positions,
        states=states,
        tracking_ids=[72057594037927937, 72057594037927938],
        clipped_edges=[0, 9],
        node_id=NODE_ID,
        sequence=2,
        depth_size_px=(512, 424),
        tilt=-0.125,
        height=1.5,
    )


def frame_everything() -> BodyFrame:
    """One body of a Kinect v1 with depth points and orientations, some of which a joint does not have."""
    joint = np.arange(20)[None]
    depth_px = np.stack([100 + joint * 8.5, 200 - joint * 4.25], axis=-1)
    depth_px[0, 5] = np.nan
    orientations = np.stack([0 * joint + 0.5, 0 * joint + 0.5, 0.5 - joint % 2, joint % 2 - 0.5], axis=-1)
    orientations[0, 3] = np.nan
    return body_frame(
        "left.2",
        topology("kinect_v1"),
        time_ns=-1,
        positions=np.stack([joint / 32, -joint / 32, 1.25 + joint / 128], axis=-1),
        states=np.where(joint == 19, 0, 2),
        tracking_ids=[2**64 - 1],
        tracked=[True],
        clipped_edges=[15],
        depth_px=depth_px,
        orientations=orientations,
        node_id=1,
        sequence=2**40,
        depth_size_px=(320, 240),
    )


def frame_nobody() -> BodyFrame:
    """Nobody is there: the smallest frame that a sensor sends."""
    return body_frame("front", topology("kinect_v2"), time_ns=0, positions=[], node_id=NODE_ID)


def markers_two_of_three() -> MarkerFrame:
    """A camera that sees two of three markers."""
    return marker_frame(
        "left",
        ["thumb", "index", "base"],
        time_ns=33_333_333,
        sent_ns=5_000_000_123,
        size_px=(640, 480),
        positions_px=[[319.5, 239.25], [np.nan, np.nan], [0.0, 479.0]],
        sd_px=[0.125, np.nan, 0.5],
        areas_px=[210.0, 0.0, 64.5],
        confidences=[1.0, 0.0, 0.75],
        node_id=NODE_ID,
        sequence=3,
    )


def keypoints_two_people() -> KeypointFrame:
    """A camera that sees two people: all of the first, the upper half of the second, with depth."""
    detection, joint = np.mgrid[0:2, 0:17]
    positions = np.stack([100.5 + 200 * detection + joint, 50.25 + 8 * joint - detection], axis=-1)
    positions[1, 11:] = np.nan
    relative = np.stack([joint / 64 - 0.125, joint / 32 - 0.25, detection / 8 - joint / 256], axis=-1)
    relative[1, 11:] = np.nan
    return keypoint_frame(
        "left",
        topology("coco_17"),
        time_ns=33_333_333,
        sent_ns=5_000_000_123,
        size_px=(640, 480),
        positions_px=positions,
        confidences=1 - joint / 32,
        ids=[7, -1],
        relative=relative,
        node_id=NODE_ID,
        sequence=3,
    )


def poses_one_of_two() -> PoseFrame:
    """Another tracker that sees one of two bodies, a quarter turn about y."""
    half = np.float32(np.sqrt(0.5))
    return pose_frame(
        "vive",
        "vr",
        ["cup", "box"],
        time_ns=11_111_111,
        sent_ns=5_000_000_123,
        positions=[[0.25, 1.125, -0.5], [np.nan] * 3],
        orientations=[[half, 0.0, half, 0.0], [np.nan] * 4],
        states=[1, 0],
        node_id=NODE_ID,
        sequence=4,
    )


def depth_slope() -> DepthFrame:
    """A depth camera that sees a slope with a hole in it and a step beside it."""
    row, column = np.mgrid[0:6, 0:8]
    depth = (1000 + 3 * row - 2 * column).astype(np.uint16)
    depth[:, 6:] = 65_535
    depth[2:4, 2:4] = 0
    lens = [476.0, 476.0, 3.5, 2.5, 0.125, -0.0625, 0.0, 0.0, 0.03125]
    return depth_frame(
        "depth",
        depth,
        unit_m=2.0**-10,
        lens=lens,
        time_ns=33_333_333,
        sent_ns=5_000_000_123,
        node_id=NODE_ID,
        sequence=5,
    )


def arms_one() -> ArmFrame:
    """A left arm with a fist, of which the elbow is not seen and a part of the hand is inferred."""
    point = np.arange(len(ARM_POINTS))
    points = np.stack([point / 128 - 0.0625, point / 256, 0.5 + point / 64], axis=-1)
    states = np.where(point == len(ARM_POINTS) - 1, 0, np.where(point % 4 == 0, 2, 1)).astype(np.uint8)
    sd = (point / 1024).astype(np.float32)
    points[-1], sd[-1] = np.nan, np.nan
    angles = np.arange(len(ANGLES)) / 32
    angles[0] = np.nan
    quarter_turn = np.array([[0.0, 0, 1, 0.5], [0, 1, 0, 0.25], [-1, 0, 0, 2], [0, 0, 0, 1]])
    arm = SeenArm(2, True, 0.75, points, states, sd, angles, quarter_turn, "fist", 0.5, True)
    lens = np.array([476.0, 476.0, 319.5, 239.5, 0, 0, 0, 0, 0])
    reason = "the elbow is outside the picture"
    return ArmFrame("arm", NODE_ID, 6, 33_333_333, 5_000_000_123, (640, 480), lens, "line-skeleton", (arm,), reason)


def image_four_by_three() -> ImageFrame:
    """A camera's image of four by three pixels, as they are, of the empty room."""
    pixels = np.arange(36, dtype=np.uint8).reshape(3, 4, 3)
    return image_frame(
        "left", pixels, time_ns=33_333_333, node_id=NODE_ID, sequence=4, sent_ns=5_000_000_123, empty_room=True
    )


def other_plug_in() -> UnknownFrame:
    """A frame of a plug-in's type."""
    return UnknownFrame("spot", NODE_ID, 2, 33_333_333, 5_000_000_123, "heat", b"\x01\x02")


def scene_one_body() -> Scene:
    """A body fitted to the silhouettes of one camera, another one's image left out, and a part of a plug-in's type."""
    line = np.array([[1.5, 2.0], [4.0, 2.5], [3.0, 8.0]], np.float32)
    views = (
        TrackedBodyView("left", 0.875, "", line, line + 0.5),
        TrackedBodyView("right", float("nan"), "its image is black", line[:0], line[:0]),
    )
    landmarks = np.array([[0.125, 1.0, 2.0], [-0.125, 1.0, 2.0]])
    quarter_turn = np.array([[0.0, 0, 1, 0.5], [0, 1, 0, 0.25], [-1, 0, 0, 2], [0, 0, 0, 1]])
    body = TrackedBody(
        1, "anna", '{"model":"female"}', quarter_turn, np.array([0.25, -0.5]), ("left knee", "right knee"),
        ("left hip", "right hip"), landmarks, np.array([2, 1], np.uint8), lost=False, views=views, person=3,
    )  # fmt: skip
    parts = {"bodies": (body,), "spots": (UnknownPart("spots", b"\x03"),)}
    state = TrackerState(Phase.TRACKING)
    return Scene(6, 5_000_000_000, "left", NODE_ID, 4, topology("kinect_v2"), state, parts)


def scene_one_hand() -> Scene:
    """A left hand that holds a cup, made of two markers, of which one camera pair sees one."""
    landmark = np.arange(21)
    landmarks = np.stack([landmark / 128, landmark / 256, 0.5 + landmark / 64], axis=-1)
    states = np.where(landmark % 4 == 0, 2, 1).astype(np.uint8)
    sd, angles = (landmark / 1024).astype(np.float32), landmark / 32
    quarter_turn = np.array([[0.0, 0, 1, 0.5], [0, 1, 0, 0.25], [-1, 0, 0, 2], [0, 0, 0, 1]])
    hand = TrackedHand(2, True, landmarks, states, sd, angles, quarter_turn, "cup")
    places = np.array([[0.125, 0.25, 0.5], [np.nan] * 3])
    points = TrackedPoints(
        ("thumb", "index"), places, np.array([0.001953125, np.nan], np.float32), np.array([2, 0], np.uint8)
    )
    outline = np.array([[0.0, 0, 0], [0.0625, 0, 0], [0.0625, 0.0625, 0]])
    cup = TrackedObject("cup", quarter_turn, outline, 2)
    state = TrackerState(Phase.TRACKING)
    return Scene(
        4,
        5_000_000_000,
        "left",
        NODE_ID,
        3,
        topology("hand"),
        state,
        {"hands": (hand,), "points": (points,), "objects": (cup,)},
    )


def scene_two_arms() -> Scene:
    """A person's left arm, which two depth cameras see, and nobody's right one, which is only predicted."""
    seen = arms_one().arms[0]
    left = TrackedArm(
        2, True, seen.points, seen.states, seen.sd, seen.angles, seen.T_camera_palm, "fist", 0.5, True, 0, ("arm", "b")
    )
    nothing = np.full(len(ANGLES), np.nan)
    states = np.minimum(seen.states, 1)
    right = TrackedArm(5, False, seen.points + 0.25, states, seen.sd, nothing, None, "", 0.0, False)
    state = TrackerState(Phase.TRACKING)
    return Scene(5, 5_000_000_000, "arm", NODE_ID, 6, topology("hand"), state, {"arms": (left, right)})


def scene_one_person() -> Scene:
    """One person, seen by two sensors; the last joint by none."""
    kind = topology("kinect_v2")
    joint = np.arange(25)
    positions = np.stack([joint / 16, joint / 32, joint / 64], axis=-1)
    positions[24] = np.nan
    states = np.where(joint == 24, 0, 2).astype(np.uint8)
    quarter_turn = np.array([[0.0, 0, 1, 0.5], [0, 1, 0, 0.25], [-1, 0, 0, 2], [0, 0, 0, 1]])
    views = (
        PotentialSkeleton("front", 7, 66_666_667, -0.125, 1.5, np.eye(4), positions, states),
        PotentialSkeleton("left.2", 8, 70_000_000, 0.0, 0.0, quarter_turn, positions + 0.25, states, mirrored=True),
    )
    sd = np.where(joint == 24, np.nan, joint / 256).astype(np.float32)
    condition = "left knee: sensors and body model disagree by 50°"
    people = (Person(1, positions, states, views, sd, "Ada", condition),)
    places = (
        SensorPlace("front", np.eye(4), 0.0, 0.0, "the world's own"),
        SensorPlace("left.2", None, problem="walk a few steps"),
    )
    return Scene(9, 5_000_000_000, "front", NODE_ID, 2, kind, TrackerState(Phase.TRACKING), {"people": people}, places)


def truth_two_people() -> Truth:
    """A simulated room with two people, of whom the sensor sees the second, mirrored."""
    kind = topology("kinect_v1")
    positions = np.arange(2 * 20 * 3).reshape(2, 20, 3) / 64
    return Truth("front", 2, 10**9, kind, np.array([0, 5]), positions, np.eye(4), np.array([5]), np.array([True]))


def values(message: SensorFrame | Scene | Truth) -> dict[str, Any]:
    """The fields of a message by their names in the schema."""
    kinds = {
        BodyFrame: _frame_values,
        MarkerFrame: _marker_values,
        PoseFrame: _pose_values,
        DepthFrame: _depth_values,
        ArmFrame: _arm_values,
        ImageFrame: _image_values,
        KeypointFrame: _keypoint_values,
        UnknownFrame: _other_values,
        Scene: _scene_values,
        Truth: _truth_values,
    }
    read = kinds[type(message)]
    name = "OtherFrame" if isinstance(message, UnknownFrame) else type(message).__name__
    return {"message": name, **read(message)}


def vectors() -> dict[str, tuple[bytes, dict[str, Any]]]:
    """Every vector: its bytes and its values, by the name of its files."""
    kinds = (
        frame_skeleton, frame_everything, frame_nobody, markers_two_of_three, poses_one_of_two, depth_slope, arms_one,
        image_four_by_three, keypoints_two_people, other_plug_in,
    )  # fmt: skip
    frames = {make.__name__: make() for make in kinds}
    found = {name: (encode_frame(frame), values(frame)) for name, frame in frames.items()}
    scenes, truth = (
        {make.__name__: make() for make in (scene_one_person, scene_one_hand, scene_two_arms, scene_one_body)},
        truth_two_people(),
    )
    found |= {name: (encode_scene(scene), values(scene)) for name, scene in scenes.items()}
    found["truth_two_people"] = encode_truth(truth), values(truth)
    stream = b"".join(delimited(encode_frame(frames[name])) for name in ("frame_nobody", "frame_skeleton"))
    found["stream_two_frames"] = stream, {"stream": ["frame_nobody", "frame_skeleton"]}
    return found


def _frame_values(frame: BodyFrame) -> dict[str, Any]:
    return {
        **_identity(frame),
        "topology": frame.topology.name,
        "depth_width_px": frame.depth_size_px[0],
        "depth_height_px": frame.depth_size_px[1],
        "tilt_rad": frame.tilt,
        "height_m": frame.height,
        "tracking_ids": [str(identity) for identity in frame.tracking_ids.tolist()],
        "tracked": frame.tracked.astype(int).tolist(),
        "clipped_edges": frame.clipped_edges.tolist(),
        "joint_states": frame.states.tolist(),
        "positions_m": _lists(frame.positions),
        "depth_px": _lists(frame.depth_px),
        "orientations": _lists(frame.orientations),
    }


def _identity(frame: SensorFrame) -> dict[str, Any]:
    """The fields that all frames have."""
    return {
        "schema_version": 1,
        "sensor": frame.sensor,
        "node_id": str(frame.node_id),
        "sequence": str(frame.sequence),
        "time_ns": str(frame.time_ns),
        "sent_ns": str(frame.sent_ns),
    }


def _image_values(frame: ImageFrame) -> dict[str, Any]:
    return {
        **_identity(frame),
        "width_px": frame.size_px[0],
        "height_px": frame.size_px[1],
        "format": frame.format,
        "image": np.asarray(frame.data).tobytes().hex(),
        "empty_room": frame.empty_room,
    }


def _other_values(frame: UnknownFrame) -> dict[str, Any]:
    return {**_identity(frame), "kind": frame.kind, "content": frame.content.hex()}


def _body_values(body: TrackedBody) -> dict[str, Any]:
    return {
        "id": str(body.id),
        "name": body.name,
        "build": body.build,
        "T_world_model": body.T_world_model[:3].tolist(),
        "angles_rad": body.angles.tolist(),
        "joint_names": list(body.joint_names),
        "landmark_names": list(body.landmark_names),
        "landmarks_m": _lists(body.landmarks),
        "landmark_states": body.states.tolist(),
        "lost": body.lost,
        "views": [
            {
                "camera": view.camera,
                "overlap": None if np.isnan(view.overlap) else view.overlap,
                "left_out": view.left_out,
                "outline_px": _lists(view.outline_px),
                "contour_px": _lists(view.contour_px),
            }
            for view in body.views
        ],
        "person": None if body.person < 0 else str(body.person),
    }


def _marker_values(frame: MarkerFrame) -> dict[str, Any]:
    return {
        **_identity(frame),
        "width_px": frame.size_px[0],
        "height_px": frame.size_px[1],
        "names": list(frame.names),
        "positions_px": _lists(frame.positions_px),
        "sd_px": _lists(frame.sd_px),
        "areas_px": _lists(frame.areas_px),
        "confidences": _lists(frame.confidences),
    }


def _keypoint_values(frame: KeypointFrame) -> dict[str, Any]:
    return {
        **_identity(frame),
        "topology": frame.topology.name,
        "width_px": frame.size_px[0],
        "height_px": frame.size_px[1],
        "ids": [str(identity) for identity in frame.ids.tolist()],
        "positions_px": _lists(frame.positions_px),
        "confidences": _lists(frame.confidences),
        "relative_m": _lists(frame.relative),
    }


def _pose_values(frame: PoseFrame) -> dict[str, Any]:
    return {
        **_identity(frame),
        "space": frame.space,
        "names": list(frame.names),
        "positions_m": _lists(frame.positions),
        "orientations": _lists(frame.orientations),
        "states": frame.states.tolist(),
    }


def _depth_values(frame: DepthFrame) -> dict[str, Any]:
    return {
        **_identity(frame),
        "width_px": frame.size_px[0],
        "height_px": frame.size_px[1],
        "unit_m": frame.unit_m,
        "lens": frame.lens.tolist(),
        "depth": frame.depth.tolist(),
    }


def _arm_values(frame: ArmFrame) -> dict[str, Any]:
    return {
        **_identity(frame),
        "width_px": frame.size_px[0],
        "height_px": frame.size_px[1],
        "lens": frame.lens.tolist(),
        "method": frame.method,
        "arms": [
            {
                "id": str(arm.id),
                "left": arm.left,
                "left_sure": arm.left_sure,
                "points_m": _lists(arm.points),
                "point_states": arm.states.tolist(),
                "point_sd_m": _lists(arm.sd),
                "angles_rad": _lists(arm.angles),
                "T_camera_palm": None if arm.T_camera_palm is None else _lists(arm.T_camera_palm[:3]),
                "gesture": arm.gesture,
                "gesture_sure": arm.gesture_sure,
                "grabbing": arm.grabbing,
            }
            for arm in frame.arms
        ],
        "reason": frame.reason,
    }


def _scene_values(scene: Scene) -> dict[str, Any]:
    return {
        "schema_version": 1,
        "step": str(scene.step),
        "at_ns": str(scene.at_ns),
        "sensor": scene.sensor,
        "node_id": str(scene.node_id),
        "sequence": str(scene.sequence),
        "topology": scene.topology.name,
        "phase": scene.state.phase.value,
        "people": [
            {
                "id": str(person.id),
                "positions_m": _lists(person.positions),
                "joint_states": person.states.tolist(),
                "joint_sd_m": _lists(person.sd),
                "name": person.name,
                "views": [
                    {
                        "sensor": view.sensor,
                        "tracking_id": str(view.tracking_id),
                        "time_ns": str(view.time_ns),
                        "tilt_rad": view.tilt,
                        "height_m": view.height,
                        "T_world_sensor": _lists(view.T_world_sensor[:3]),
                        "positions_m": _lists(view.positions),
                        "joint_states": view.states.tolist(),
                        "mirrored": view.mirrored,
                    }
                    for view in person.views
                ],
            }
            for person in scene.people
        ],
        "sensors": [
            {
                "sensor": place.sensor,
                "T_world_sensor": None if place.T_world_sensor is None else _lists(place.T_world_sensor[:3]),
                "position_sd_m": None if np.isnan(place.position_sd) else place.position_sd,
                "rotation_sd_rad": None if np.isnan(place.rotation_sd) else place.rotation_sd,
                "quality": place.quality,
                "problem": place.problem,
            }
            for place in scene.sensors
        ],
        "hands": [
            {
                "id": str(hand.id),
                "left": hand.left,
                "landmarks_m": _lists(hand.landmarks),
                "landmark_states": hand.states.tolist(),
                "landmark_sd_m": _lists(hand.sd),
                "angles_rad": _lists(hand.angles),
                "T_world_palm": None if hand.T_world_palm is None else _lists(hand.T_world_palm[:3]),
                "holds": hand.holds,
            }
            for hand in scene.hands
        ],
        "points": None
        if scene.points is None
        else {
            "names": list(scene.points.names),
            "positions_m": _lists(scene.points.positions),
            "sd_m": _lists(scene.points.sd),
            "cameras": scene.points.cameras.tolist(),
        },
        "objects": [
            {
                "name": thing.name,
                "T_world_object": None if thing.T_world_object is None else _lists(thing.T_world_object[:3]),
                "outline_m": _lists(thing.outline),
                "state": thing.state,
            }
            for thing in scene.objects
        ],
        "arms": [
            {
                "id": str(arm.id),
                "left": arm.left,
                "points_m": _lists(arm.points),
                "point_states": arm.states.tolist(),
                "point_sd_m": _lists(arm.sd),
                "angles_rad": _lists(arm.angles),
                "T_world_palm": None if arm.T_world_palm is None else _lists(arm.T_world_palm[:3]),
                "gesture": arm.gesture,
                "gesture_sure": arm.gesture_sure,
                "grabbing": arm.grabbing,
                "person": None if arm.person < 0 else str(arm.person),
                "cameras": list(arm.cameras),
            }
            for arm in scene.arms
        ],
        "bodies": [_body_values(body) for body in scene.bodies],
        "parts": [
            {"kind": part.kind, "content": part.content.hex()}
            for some in scene.parts.values()
            for part in some
            if isinstance(part, UnknownPart)
        ],
    }


def _truth_values(truth: Truth) -> dict[str, Any]:
    return {
        "schema_version": 1,
        "sensor": truth.sensor,
        "sequence": str(truth.sequence),
        "room_ns": str(truth.room_ns),
        "topology": truth.topology.name,
        "people": [str(identity) for identity in truth.people.tolist()],
        "positions_m": _lists(truth.positions),
        "T_world_sensor": _lists(truth.T_world_sensor[:3]),
        "body_people": [str(identity) for identity in truth.body_people.tolist()],
        "mirrored": truth.mirrored.astype(int).tolist(),
    }


def _lists(array: np.ndarray | None) -> Any:
    """Nested lists, with null where a number is missing."""
    if array is None:
        return None
    return np.where(np.isnan(array), None, array.astype(object)).tolist()


def main() -> None:
    """Write every vector anew."""
    for name, (data, content) in vectors().items():
        (FOLDER / f"{name}.bin").write_bytes(data)
        text = json.dumps({"bytes": len(data), "hex": data.hex(), **content}, indent=1, ensure_ascii=False)
        (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")
        print(f"{name}: {len(data)} bytes")


if __name__ == "__main__":
    main()
