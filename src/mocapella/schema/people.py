"""Encode and decode people of a scene; invalid messages are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.model.scene import Person, PotentialSkeleton
from mocapella.model.topology import Topology
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import F4, F8, STATES, choices, deviations, points, sensor_name, sensor_pose, transform

Remember = Callable[[Any, Callable[[Any], Any]], Any]
"""Returns the message of an object, given the function that encodes it."""


def encode_anew(content: Any, encode: Callable[[Any], Any]) -> Any:
    """Return the object's message, encoded now: the `Remember` that remembers nothing."""
    return encode(content)


def encode_person(person: Person, remember: Remember = encode_anew) -> Any:
    """Encode a person as a protobuf message, with the fused skeleton and the views, as a part of a scene's message.

    Args:
        person: the person.
        remember: returns the message of each view.
    """
    return pb.Person(
        id=person.id,
        positions_m=person.positions.astype(F8, copy=False).tobytes(),
        joint_states=person.states.tobytes(),
        views=[remember(view, encode_view) for view in person.views],
        joint_sd_m=b"" if person.sd is None else person.sd.astype(F4, copy=False).tobytes(),
        name=person.name,
        condition=person.condition,
    )


def decode_person(m: Any, kind: Topology) -> Person:
    """Decode a person from a parsed protobuf message, whose skeletons have the topology ``kind``; check its values.

    Raises:
        WireError: a field has the wrong length or an impossible value; names the field.
    """
    return Person(
        m.id,
        points(m.positions_m, (len(kind), 3), "Person.positions_m"),
        choices(m.joint_states, STATES, len(kind), "Person.joint_states"),
        tuple(_decode_view(view, kind) for view in m.views),
        _decode_sd(m.joint_sd_m, kind),
        m.name,
        m.condition,
    )


def _decode_sd(data: bytes, kind: Topology) -> NDArray[np.float32] | None:
    return deviations(data, len(kind), "Person.joint_sd_m") if data else None


def encode_view(view: PotentialSkeleton) -> Any:
    """Encode a sensor's view as a protobuf message, as a part of a person's."""
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
