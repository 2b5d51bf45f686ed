"""The types of scene parts that ship with Mocapella."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mocapella.model.part_types import PartType
from mocapella.model.scene import Person, TrackedArm, TrackedBody, TrackedHand, TrackedObject, TrackedPoints
from mocapella.schema.arms import decode_arm, encode_arm
from mocapella.schema.bodies import decode_body, encode_body
from mocapella.schema.hands import (
    decode_hand,
    decode_object,
    decode_points,
    encode_hand,
    encode_object,
    encode_points,
)
from mocapella.schema.people import decode_person, encode_person


def _hand_is_there(hand: Any) -> bool:
    return bool(np.isfinite(hand.landmarks).any())


PEOPLE: Final = PartType(
    interface=1,
    name="people",
    type=Person,
    encode=encode_person,
    decode=decode_person,
    field="people",
    counted=("person", "people"),
    none="Nobody is in view",
    drawing="mocapella.viewer.room_people:PEOPLE",
)
HANDS: Final = PartType(
    interface=1,
    name="hands",
    type=TrackedHand,
    encode=encode_hand,
    decode=lambda m, _: decode_hand(m),
    field="hands",
    counted=("hand", "hands"),
    none="No hand is in view",
    there=_hand_is_there,
)
ARMS: Final = PartType(
    interface=1,
    name="arms",
    type=TrackedArm,
    encode=encode_arm,
    decode=lambda m, _: decode_arm(m),
    field="arms",
    counted=("arm", "arms"),
    none="No arm is in view",
    meter="mocapella.kinematics.arm_quality:ArmQualityMeter",
    meter_name="arm_quality",
)
BODIES: Final = PartType(
    interface=1,
    name="bodies",
    type=TrackedBody,
    encode=encode_body,
    decode=lambda m, _: decode_body(m),
    field="bodies",
    counted=("body", "bodies"),
    none="Nobody is in view",
    there=lambda body: not body.lost,
    drawing="mocapella.viewer.room_bodies:BODIES",
)
OBJECTS: Final = PartType(
    interface=1,
    name="objects",
    type=TrackedObject,
    encode=encode_object,
    decode=lambda m, _: decode_object(m),
    field="objects",
    drawing="mocapella.viewer.room_objects:OBJECTS",
)
POINTS: Final = PartType(
    interface=1,
    name="points",
    type=TrackedPoints,
    encode=encode_points,
    decode=lambda m, _: decode_points(m),
    field="points",
)
