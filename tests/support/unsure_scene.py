"""A scene of the method ``default``: sensors with places of their own, joints that are more or less sure, a name."""

from __future__ import annotations

import msgspec
import numpy as np
from support.walkers import HEIGHT_M, KINECT, Room, rigid

from mocapella.geometry.rigid import apply
from mocapella.model.observations import JointState
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackerState

MOVED = "it was moved (or the sensor beside it): walk a few steps where both see you"
WALK = "with front: walk a few steps"


def placed(room: Room, t: float = 1.0, **problems: str) -> Scene:
    """The room's scene on a world with a floor.

    Args:
        room: whose sensors are at known places.
        t: when [s].
        problems: by sensor; one that begins with ``it was moved`` or ``with`` takes the sensor's place away.
    """
    scene = room.scene(t, room.frames(t))
    T_up = rigid(0.3, (0.4, HEIGHT_M, 0.2))
    places = []
    for k, name in sorted(enumerate(room.names), key=lambda pair: pair[1]):
        problem = problems.get(name, "")
        T = None if problem.startswith(("it was moved", "with")) else T_up @ room.T_world[k]
        quality = "" if k == 0 else "12 mm, 0.4°"
        places.append(SensorPlace(name, T, 0.0 if k == 0 else 0.012, 0.007 * (k > 0), quality, problem))
    people = []
    for person in scene.people:
        sd, states = np.full(25, 0.015, np.float32), person.states.copy()
        for joint, value in (("ElbowRight", 0.05), ("WristRight", 0.09), ("HandRight", 0.13), ("KneeLeft", 0.1)):
            sd[KINECT.index(joint)] = value
        states[KINECT.index("HandRight")] = JointState.INFERRED
        gone = KINECT.index("ThumbLeft")
        sd[gone], states[gone] = np.nan, JointState.NOT_TRACKED
        views = tuple(
            msgspec.structs.replace(
                view, positions=apply(T_up, view.positions), T_world_sensor=T_up @ view.T_world_sensor
            )
            for view in person.views
        )
        people.append(
            msgspec.structs.replace(person, positions=apply(T_up, person.positions), states=states, sd=sd, views=views)
        )
    reason = "; ".join(f"{name}: {problem}" for name, problem in sorted(problems.items()))
    state = TrackerState(Phase.TRACKING, reason=reason)
    return msgspec.structs.replace(scene.with_parts(people=tuple(people)), sensors=tuple(places), state=state)
