"""Encode and decode scenes and ground truths; invalid messages are refused."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Final

import numpy as np

from mocapella.conventions import SCHEMA_VERSION
from mocapella.errors import WireError, one_of
from mocapella.model.part_types import PART_TYPES, PartType
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackerState, UnknownPart
from mocapella.model.topology import Topology
from mocapella.model.truth import Truth
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import (
    F8,
    FLAGS,
    I8,
    MAX_NAME,
    MAX_SCENE_BYTES,
    array,
    choices,
    known_topology,
    parse,
    points,
    sensor_name,
    transform,
)
from mocapella.schema.people import Remember, encode_anew, encode_person

_PHASES: Final = {phase.value: phase for phase in Phase}
_SINGLE: Final = frozenset({"points"})
"""Fields of a message ``Scene`` with at most one part."""


class SceneEncoder:
    """Encodes a tracker's scenes as `encode_scene` does, and keeps the messages of what the next scene has again.

    A tracker's scene has the same objects as the one before, except for those of the newest frame. The arrays of a
    scene must not be changed once it is encoded.
    """

    def __init__(self) -> None:
        self._kept: dict[int, tuple[Any, Any]] = {}

    def encode(self, scene: Scene) -> bytes:
        """Encode the next scene as a protobuf message."""
        before, kept = self._kept, {}

        def remember(content: Any, encode: Callable[[Any], Any]) -> Any:
            known = before.get(id(content))
            if known is None or known[0] is not content:
                known = content, encode(content)
            kept[id(content)] = known
            return known[1]

        self._kept = kept
        return _encode(scene, remember)


def encode_scene(scene: Scene) -> bytes:
    """Encode a scene as a protobuf message; equal scenes give equal bytes. Parts of unknown types stay unchanged."""
    return _encode(scene, encode_anew)


def _encode(scene: Scene, remember: Remember) -> bytes:
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
        sensors=[remember(place, _encode_place) for place in scene.sensors],
        **_encode_parts(scene.parts, remember),
    )
    return message.SerializeToString()


def decode_scene(data: bytes) -> Scene:
    """Decode and check a scene from a protobuf message's bytes.

    A part whose type no installed package has becomes an `UnknownPart`. `Scene.parts` has only types with a part.

    Raises:
        SchemaVersionError: the message has another schema version; names both.
        WireError: the bytes are invalid, or a value is impossible; names the field.
    """
    m = parse(pb.Scene, data, MAX_SCENE_BYTES)
    kind = known_topology(m.topology)
    if m.phase not in _PHASES:
        phase = m.phase[:80]
        raise WireError(f"Scene.phase is {phase!r}; known: {one_of(phase, _PHASES)}")
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
        _decode_parts(m, kind),
        places,
    )


def _encode_parts(parts: Mapping[str, tuple[Any, ...]], remember: Remember) -> dict[str, Any]:
    """Return the fields of a message ``Scene`` for a scene's parts."""
    fields: dict[str, Any] = {}
    others: list[Any] = []
    for name, some in parts.items():
        kind = PART_TYPES.get(name)
        if kind is None:
            others += [pb.OtherPart(kind=part.kind, content=part.content) for part in some]
        elif not kind.field:
            others += [pb.OtherPart(kind=name, content=kind.encode(part)) for part in some]
        elif some:
            written = [
                encode_person(part, remember) if kind.encode is encode_person else kind.encode(part) for part in some
            ]
            fields[kind.field] = written[0] if kind.field in _SINGLE else written
    return {**fields, "parts": others} if others else fields


def _decode_parts(m: Any, topology: Topology) -> dict[str, tuple[Any, ...]]:
    """Return a scene's parts by type; an `UnknownPart` if no installed package has the type."""
    parts: dict[str, tuple[Any, ...]] = {}
    for kind in _with_fields():
        single = kind.field in _SINGLE
        some = ([getattr(m, kind.field)] if m.HasField(kind.field) else []) if single else getattr(m, kind.field)
        if some:
            parts[kind.name] = tuple(kind.decode(part, topology) for part in some)
    for other in m.parts:
        if not 0 < len(other.kind) <= MAX_NAME:
            raise WireError(f"OtherPart.kind is {other.kind[:MAX_NAME]!r}; 1 to {MAX_NAME} characters are wanted")
        known = PART_TYPES.get(other.kind)
        if known is not None and known.field:
            raise WireError(f"OtherPart.kind is {other.kind!r}, which travels in Scene.{known.field}")
        read = UnknownPart(other.kind, other.content) if known is None else known.decode(other.content, topology)
        parts[other.kind] = (*parts.get(other.kind, ()), read)
    return parts


def count_parts(message: pb.Scene, counts: Counter[str]) -> None:
    """Add the number of parts in a parsed scene message to ``counts``, by the name of their type; decode nothing.

    Types without a part are left out.
    """
    for name, field, single in _fields():
        count = message.HasField(field) if single else len(getattr(message, field))
        if count:
            counts[name] += count
    for other in message.parts:
        counts[other.kind] += 1


@cache
def part_fields() -> dict[str, int]:
    """Return the number of the field in a scene message of each type of parts that has one, by the type's name."""
    return {kind.name: pb.Scene.DESCRIPTOR.fields_by_name[kind.field].number for kind in _with_fields()}


@cache
def _fields() -> tuple[tuple[str, str, bool], ...]:
    return tuple((kind.name, kind.field, kind.field in _SINGLE) for kind in _with_fields())


@cache
def _with_fields() -> tuple[PartType, ...]:
    return tuple(kind for kind in PART_TYPES.values() if kind.field)


def encode_truth(truth: Truth) -> bytes:
    """Encode the ground truth of one simulated frame as a protobuf message."""
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
    """Decode and check the ground truth of one simulated frame from a protobuf message's bytes.

    Raises:
        SchemaVersionError: the message has another schema version; names both.
        WireError: the bytes are invalid, or a value is impossible; names the field.
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
