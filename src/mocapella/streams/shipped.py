"""The streams that ship with Mocapella."""

from __future__ import annotations

from typing import Final

from mocapella.model.trajectories import PARTS
from mocapella.streams.stream import Stream

OSC: Final = Stream(
    interface=1,
    name="osc",
    summary="OSC: a message for each keypoint, with its position, state and uncertainty.",
    parts=tuple(PARTS),
    port=9000,
    make="mocapella.streams.keypoint_osc:KeypointOsc",
)
VMC: Final = Stream(
    interface=1,
    name="vmc",
    summary="VMC: the bone rotations of one person, for avatars in Unity, VSeeFace, Warudo and others.",
    parts=("people",),
    port=39539,
    make="mocapella.streams.vmc:VmcPerformer",
)
