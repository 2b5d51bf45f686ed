"""Scenes and truths to bytes and back, with everything that is not ours refused at the door."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError, one_of
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene, SensorPlace, TrackerState
from mocapella.model.topology import Topology
from mocapella.model.truth import Truth
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.arms import decode_arm, encode_arm
from mocapella.schema.checks import (
    F4,
    F8,
    FLAGS,
    I8,
    MAX_SCENE_BYTES,
    SCHEMA_VERSION,
    STATES,
    array,
    choices,
    deviations,
    known_topology,
    parse,
    points,
    sensor_name,
    sensor_pose,
    transform,
)
from mocapella.schema.hands import (
    decode_hand,
    decode_object,
    decode_points,
    encode_hand,
    encode_object,
    encode_points,
)

_PHASES: Final = {phase.value: phase for phase in Phase}


def encode_scene(scene: Scene) -> bytes:
    """Write a scene; the same numbers give the same bytes."""
    state = scene.state
    message = pb.Scene(
        schema_version=SCHEMA_VERSION,
        step=scene.step,
        at_ns=scene.at_ns,
        sensor=scene.sensor,
        node_id=scene.node_id,
        sequence=scene.sequence,
        topology=scene.topology.name,
        phase=state.phase.value,
        sensors_missing=state.sensors_missing,
        frames_remaining=state.frames_remaining,
        frames_wanted=state.frames_wanted,
        reason=state.reason,
        people=[
            pb.Person(
                id=person.id,
                positions_m=person.positions.astype(F8, copy=False).tobytes(),
                joint_states=person.states.tobytes(),
                views=[_encode_view(view) for view in person.views],
                joint_sd_m=b"" if person.sd is None else person.sd.astype(F4, copy=False).tobytes(),
                name=person.name,
            )
            for person in scene.people
        ],
        sensors=[_encode_place(place) for place in scene.sensors],
        hands=[encode_hand(hand) for hand in scene.hands],
        points=None if scene.points is None else encode_points(scene.points),
        objects=[encode_object(thing) for thing in scene.objects],
        arms=[encode_arm(arm) for arm in scene.arms],
    )
    return message.SerializeToString()


def decode_scene(data: bytes) -> Scene:
    """Read a scene and check it.

    Raises:
        SchemaVersionError, WireError: as `decode_frame`.
    """
    m = parse(pb.Scene, data, MAX_SCENE_BYTES)
    kind = known_topology(m.topology)
    if m.phase not in _PHASES:
        phase = m.phase[:80]
        raise WireError(f"Scene.phase is {phase!r}; known: {one_of(phase, _PHASES)}")
    people = tuple(
        Person(
            person.id,
            points(person.positions_m, (len(kind), 3), "Person.positions_m"),
            choices(person.joint_states, STATES, len(kind), "Person.joint_states"),
            tuple(_decode_view(view, kind) for view in person.views),
            _decode_sd(person.joint_sd_m, kind),
            person.name,
        )
        for person in m.people
    )
    state = TrackerState(_PHASES[m.phase], m.sensors_missing, m.frames_remaining, m.frames_wanted, m.reason)
    places = tuple(map(_decode_place, m.sensors))
    return Scene(
        m.step,
        m.at_ns,
        sensor_name(m.sensor),
        m.node_id,
        m.sequence,
        kind,
        state,
        people,
        places,
        tuple(map(decode_hand, m.hands)),
        decode_points(m.points) if m.HasField("points") else None,
        tuple(map(decode_object, m.objects)),
        tuple(map(decode_arm, m.arms)),
    )


def encode_truth(truth: Truth) -> bytes:
    """Write what a simulated room knows."""
    message = pb.Truth(
        schema_version=SCHEMA_VERSION,
        sensor=truth.sensor,
        sequence=truth.sequence,
        room_ns=truth.room_ns,
        topology=truth.topology.name,
        people=truth.people.astype(I8, copy=False).tobytes(),
        positions_m=truth.positions.astype(F8, copy=False).tobytes(),
        T_world_sensor=truth.T_world_sensor[:3].astype(F8, copy=False).tobytes(),
        body_people=truth.body_people.astype(I8, copy=False).tobytes(),
        mirrored=truth.mirrored.tobytes(),
    )
    return message.SerializeToString()


def decode_truth(data: bytes) -> Truth:
    """Read what a simulated room knows, and check it.

    Raises:
        SchemaVersionError, WireError: as `decode_frame`.
    """
    m = parse(pb.Truth, data, MAX_SCENE_BYTES)
    kind = known_topology(m.topology)
    people, bodies = len(m.people) // 8, len(m.mirrored)
    return Truth(
        sensor_name(m.sensor),
        m.sequence,
        m.room_ns,
        kind,
        array(m.people, I8, (people,), "Truth.people"),
        points(m.positions_m, (people, len(kind), 3), "Truth.positions_m"),
        transform(m.T_world_sensor, "Truth.T_world_sensor"),
        array(m.body_people, I8, (bodies,), "Truth.body_people"),
        choices(m.mirrored, FLAGS, bodies, "Truth.mirrored").view(np.bool_),
    )


def _decode_sd(data: bytes, kind: Topology) -> NDArray[np.float32] | None:
    return deviations(data, len(kind), "Person.joint_sd_m") if data else None


def _encode_place(place: SensorPlace) -> Any:
    T = place.T_world_sensor
    return pb.SensorPlace(
        sensor=place.sensor,
        T_world_sensor=b"" if T is None else T[:3].astype(F8, copy=False).tobytes(),
        position_sd_m=place.position_sd,
        rotation_sd_rad=place.rotation_sd,
        quality=place.quality,
        problem=place.problem,
    )


def _decode_place(place: Any) -> SensorPlace:
    for name in ("position_sd_m", "rotation_sd_rad"):
        if getattr(place, name) < 0 or math.isinf(getattr(place, name)):
            raise WireError(f"SensorPlace.{name} is {getattr(place, name):g}; 0 or more is wanted, or NaN")
    data = place.T_world_sensor
    return SensorPlace(
        sensor_name(place.sensor),
        transform(data, "SensorPlace.T_world_sensor") if data else None,
        place.position_sd_m,
        place.rotation_sd_rad,
        place.quality,
        place.problem,
    )


def _encode_view(view: PotentialSkeleton) -> Any:
    return pb.PotentialSkeleton(
        sensor=view.sensor,
        tracking_id=view.tracking_id,
        time_ns=view.time_ns,
        tilt_rad=view.tilt,
        height_m=view.height,
        T_world_sensor=view.T_world_sensor[:3].astype(F8, copy=False).tobytes(),
        positions_m=view.positions.astype(F8, copy=False).tobytes(),
        joint_states=view.states.tobytes(),
        mirrored=view.mirrored,
    )


def _decode_view(view: Any, kind: Topology) -> PotentialSkeleton:
    sensor_pose(view.tilt_rad, view.height_m, "PotentialSkeleton")
    return PotentialSkeleton(
        sensor_name(view.sensor),
        view.tracking_id,
        view.time_ns,
        view.tilt_rad,
        view.height_m,
        transform(view.T_world_sensor, "PotentialSkeleton.T_world_sensor"),
        points(view.positions_m, (len(kind), 3), "PotentialSkeleton.positions_m"),
        choices(view.joint_states, STATES, len(kind), "PotentialSkeleton.joint_states"),
        view.mirrored,
    )
