"""Draw people in the room: the fused skeleton, and each sensor's view of it in the person's colour.

In a sensor's perspective the fused skeleton shows what the other sensors add: joints that this sensor measures are
white, joints that only another sensor measures are green, and joints that no sensor measures are grey.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply
from mocapella.model.observations import JointState
from mocapella.model.scene import Person, Scene
from mocapella.model.topology import Topology
from mocapella.viewer.bones import NO_STROKES, Float32, bone_strokes, doubt, halo_strokes, join, joint_strokes
from mocapella.viewer.drawing import Tag
from mocapella.viewer.faces import face_strokes, facings
from mocapella.viewer.palette import FILLED, FUSED, INFERRED, person_colour
from mocapella.viewer.people_panel import PeoplePanel
from mocapella.viewer.perspective import FREE
from mocapella.viewer.room import DrawPart, PartDrawing, RoomView

Float64 = NDArray[np.float64]

FUSED_RADIUS_M, POTENTIAL_RADIUS_M = 0.025, 0.014
JOINT_RADIUS_M, HEAD_RADIUS_M = 0.03, 0.095
_OVER_HEAD: Final = np.array([0.0, 0.22, 0.0])


def draw_people(people: tuple[Person, ...], scene: Scene, room: RoomView) -> PartDrawing:
    """Draw people in a perspective: fused skeletons, views, faces and labels. This is a `DrawPart.draw`.

    A person who cannot be placed in the perspective is not drawn, but named in the drawing's ``unseen``; one without a
    known joint is named in ``remarks``, as is a person's condition. Joints with a large standard deviation are smaller
    and get a halo.
    """
    states: list[NDArray[np.uint8]] = []
    positions, sds, radii = [], [], []
    colours: list[NDArray[np.uint8]] = []
    fused_colours: list[NDArray[np.uint8]] = []
    fused: list[int] = []
    tags: list[Tag] = []
    unseen, remarks = [], []
    views_from: dict[str, Float64] = {}
    T_stage = room.T_stage_perspective
    for person in people:
        T = room.T_perspective_world(person)
        if T is None:
            unseen.append(called(person))
            continue
        if not (np.isfinite(person.positions).all(axis=-1) & (person.states != JointState.NOT_TRACKED)).any():
            remarks.append(f"no joint is known of {called(person)}")
        if person.condition:
            remarks.append(f"{called(person)}: {person.condition}")
        views = person.views
        fused.append(len(states))
        positions.append(apply(T_stage @ T, np.stack([person.positions, *(view.positions for view in views)])))
        states += [person.states, *(view.states for view in views)]
        sds.append(person.sd)
        fused_colours.append(joint_colours(person, room.perspective, scene.topology))
        own = np.array(person_colour(person.id).paint, np.uint8)
        colours += [
            _bone_colours(fused_colours[-1], scene.topology),
            *[np.broadcast_to(own, (len(scene.topology.bones), 3))] * len(views),
        ]
        radii += [FUSED_RADIUS_M, *([POTENTIAL_RADIUS_M] * len(views))]
        tags += _person_tag(person, positions[-1][0], len(views))
        for view in views:
            if view.sensor not in views_from:
                views_from[view.sensor] = T_stage @ T @ view.T_world_sensor
    if not positions:
        return PartDrawing(unseen=tuple(unseen))
    # All skeletons at once: one by one they would cost several times as much.
    p, s, white = np.concatenate(positions), np.stack(states), [FUSED] * len(fused)
    doubts = of_fused = None
    halos = NO_STROKES
    if any(sd is not None for sd in sds):
        said = np.array([np.full(s.shape[1], np.nan) if sd is None else sd for sd in sds], np.float32)
        halos = halo_strokes(p[fused], s[fused], said, white)
        doubts, of_fused = np.zeros(s.shape, np.float32), doubt(said)
        doubts[fused] = of_fused
    each = np.stack(fused_colours)
    bones = bone_strokes(p, s, scene.topology, np.stack(colours), radii, doubts=doubts)
    joints = joint_strokes(p[fused], s[fused], each, _joint_radii(scene), doubts=of_fused)
    head = scene.topology.parts["head"]
    forward = facings(p[fused], scene.topology)
    forward[s[fused][:, head] == JointState.NOT_TRACKED] = np.nan
    joints = join([joints, face_strokes(p[fused][:, head], forward, HEAD_RADIUS_M, each[:, head])])
    return PartDrawing(
        bones, joints, halos, tuple(tags), unseen=tuple(unseen), remarks=tuple(remarks), sensors=views_from
    )


def called(person: Person) -> str:
    """Return a person's name, or ``person`` and the id if the person has no name."""
    return person.name or f"person {person.id}"


def joint_colours(person: Person, perspective: str, topology: Topology) -> NDArray[np.uint8]:
    """Return the colours (joints, 3) uint8 of a fused skeleton's joints, red, green and blue.

    White joints are measured by the perspective's sensor, green ones only by other sensors, grey ones by no sensor. In
    the `FREE` perspective, and of a person without views, every measured joint is white: who measured it is unknown.
    """
    colours = np.tile(np.array(FUSED, np.uint8), (len(topology), 1))
    measured = np.asarray(person.states) == JointState.TRACKED
    if perspective != FREE and person.views:
        colours[measured & ~_measured_by(person, perspective, topology)] = FILLED.paint
    colours[~measured] = INFERRED.paint
    return colours


def _measured_by(person: Person, sensor: str, topology: Topology) -> NDArray[np.bool_]:
    view = person.view_of(sensor)
    if view is None:
        return np.zeros(len(topology), np.bool_)
    states = np.asarray(view.states)
    return np.asarray((states[list(topology.mirror)] if view.mirrored else states) == JointState.TRACKED)


def _bone_colours(joints: NDArray[np.uint8], topology: Topology) -> NDArray[np.uint8]:
    """Return the bones' colours (bones, 3): grey with a grey joint, else green with a green one, else white."""
    bones = np.array(topology.bones)
    a, b = joints[bones[:, 0]], joints[bones[:, 1]]
    white, grey = np.array(FUSED, np.uint8), np.array(INFERRED.paint, np.uint8)
    of_b = (a == white).all(axis=-1) | ((b == grey).all(axis=-1) & ~(a == grey).all(axis=-1))
    colours: NDArray[np.uint8] = np.where(of_b[:, None], b, a)
    return colours


def _joint_radii(scene: Scene) -> Float32:
    radii = np.full(len(scene.topology), JOINT_RADIUS_M, np.float32)
    radii[scene.topology.parts["head"]] = HEAD_RADIUS_M
    return radii


def _person_tag(person: Person, fused: Float64, views: int) -> list[Tag]:
    there = np.isfinite(fused).all(axis=-1)
    if not there.any():
        return []
    top = fused[there][np.argmax(fused[there][:, 1])] + _OVER_HEAD
    who = called(person)
    seen = f" · {views} view{'' if views == 1 else 's'}" if views else ""
    return [Tag(f"{who[0].upper()}{who[1:]}{seen}", tuple(top.tolist()))]


PEOPLE: Final = DrawPart(draw_people, own_places=True, panel=PeoplePanel)
