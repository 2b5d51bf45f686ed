"""Draw fitted bodies: as skinned meshes in the room, and as outlines over camera images."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply
from mocapella.model.observations import JointState
from mocapella.model.outline_colours import INSIDE, OUTSIDE, Colour, body_colour
from mocapella.model.rigged_mesh import RiggedMesh, posed
from mocapella.model.scene import Scene, TrackedBody, TrackedBodyView
from mocapella.model.twist_tree import TreePose, part_motions
from mocapella.viewer import layout
from mocapella.viewer.body_mesh_cache import SHELF
from mocapella.viewer.body_panel import BodyPanel
from mocapella.viewer.bones import Strokes, join, joint_strokes, line_strokes
from mocapella.viewer.drawing import Tag
from mocapella.viewer.image_lines import deviations, pieces
from mocapella.viewer.palette import Rgb
from mocapella.viewer.perspective import StageSpace
from mocapella.viewer.room import DrawPart, ImageLines, PartDrawing, RoomView
from mocapella.viewer.room_people import called
from mocapella.viewer.stage import Skin

Float64 = NDArray[np.float64]

SKIN: Final = Rgb(222, 228, 238)
LOST_OPACITY: Final = 0.3
"""Opacity of a lost body's mesh, 0 to 1."""
HALF_M: Final = 0.45
"""Half the width of a standing body [m]."""
_TAG_M: Final = 0.08
"""Height of a body's label above its highest point [m]."""
_OVER_PERSON_M: Final = 0.38
"""Height of a body's label above its highest point if its person's own label is between the two [m]."""
_SOLE_M: Final = 0.02
"""Height of the toes' landmarks above the ground [m]."""
_LINE_M, _BALL_M = 0.022, 0.03
_SIDES: Final = ("left", "right")
_LIMBS: Final = (
    ("pelvis", "waist"), ("waist", "neck"), ("neck", "head"),
    *((f"{side} {a}", f"{side} {b}") for side in _SIDES for a, b in (
        ("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "fingertip"), ("hip", "knee"), ("knee", "ankle"),
        ("ankle", "toe"), ("ankle", "heel"), ("heel", "toe"),
    )),
    ("left shoulder", "right shoulder"), ("left hip", "right hip"), ("pelvis", "left hip"), ("pelvis", "right hip"),
)  # fmt: skip
"""Pairs of landmarks that lines connect while a body has no mesh."""


def mesh_of(body: TrackedBody) -> RiggedMesh | None:
    """Return a body's mesh from the cache of this process, without waiting.

    None while it is being built (the first call starts it), if that failed, or if its joints are not the body's.
    """
    mesh = SHELF.mesh(body.build)
    return mesh if mesh is not None and mesh.joint_names == body.joint_names else None


def draw_bodies(bodies: tuple[TrackedBody, ...], scene: Scene, room: RoomView) -> PartDrawing:
    """Draw fitted bodies in a perspective, as meshes, or as stick figures while their meshes are not available.

    A single body has a skin colour; several have the colours of their outlines. A lost body is translucent, and the
    browser's camera does not follow it. This is a `DrawPart.draw`.
    """
    T = room.T_stage_world
    bones: list[Strokes] = []
    joints: list[Strokes] = []
    tags, skins, extents = [], {}, []
    for k, body in enumerate(bodies):
        colour = SKIN if len(bodies) == 1 else _softer(body_colour(k))
        mesh = mesh_of(body)
        if mesh is None:
            points = apply(T, body.landmarks)
            lines, balls = _stick_figure(body, points, colour)
            bones += lines
            joints.append(balls)
        else:
            pose = TreePose(body.T_world_model, body.angles)
            opacity = LOST_OPACITY if body.lost else 1.0
            skins[str(body.id)] = Skin(mesh, T @ part_motions(mesh.tree, pose), colour, opacity)
            points = apply(T, posed(mesh, pose))
        points = points[np.isfinite(points).all(axis=-1)]
        if not len(points):
            continue
        x, y, z = points[np.argmax(points[:, 1])].tolist()
        text = body_tag(body, scene)
        over = _OVER_PERSON_M if any(one.id == body.person for one in scene.people) else _TAG_M
        tags += [Tag(text, (x, y + over, z))] if text else []
        extents += [] if body.lost else [(points.min(axis=0), points.max(axis=0))]
    return PartDrawing(join(bones), join(joints), tags=tuple(tags), skins=skins, extent=_around(extents))


def body_tag(body: TrackedBody, scene: Scene) -> str:
    """Return a body's label: its name, the person whose body it is, and whether it is lost; may be empty."""
    person = next((one for one in scene.people if one.id == body.person), None)
    of = called(person) if person is not None else f"person {body.person}" if body.person >= 0 else ""
    said = [body.name] if body.name else []
    if of and of != body.name:
        said.append(f"body of {of}")
    if body.lost and said:
        said.append("not there")
    text = " · ".join(said)
    return text[:1].upper() + text[1:] if not body.name else text


def body_space(bodies: tuple[TrackedBody, ...]) -> StageSpace | None:
    """Return a pose of the world on the stage such that the first body faces the viewer, and all stand in the centre.

    The vertical is the signed world axis nearest to the first body's upward axis, and the lowest point is on the floor.
    None if no point of the bodies is known. This is a `DrawPart.space`.

    Args:
        bodies: the scene's fitted bodies, at least one.
    """
    first = bodies[0]
    up = first.T_world_model[:3, 1]
    axis = int(np.argmax(np.abs(up)))
    y = np.zeros(3)
    y[axis] = np.sign(up[axis])
    forward = first.T_world_model[:3, 2]
    ahead = forward - (forward @ y) * y
    if np.linalg.norm(ahead) < 0.1:  # the body lies: any horizontal direction will do
        ahead = np.cross(y, np.eye(3)[np.argmin(np.abs(y))])
    z = -ahead / np.linalg.norm(ahead)
    R = np.stack([np.cross(y, z), y, z])
    made = [(body, mesh_of(body)) for body in bodies]
    points = [_body_points(body, mesh, y) for body, mesh in made]
    every = np.concatenate(points) @ R.T
    every = every[np.isfinite(every).all(axis=-1)]
    if not len(every):
        return None
    roots = np.array([R @ _root(body, mesh) for body, mesh in made])
    middle = 0.5 * (roots.min(axis=0) + roots.max(axis=0))
    centre_x, _, centre_z = layout.stage_centre()
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = centre_x - middle[0], -every[:, 1].min(), centre_z - middle[2]
    return StageSpace(T, float(np.ptp(every[:, 1])), 0.5 * float(np.ptp(roots[:, 0])) + HALF_M)


def _body_points(body: TrackedBody, mesh: RiggedMesh | None, up: Float64) -> Float64:
    """Return points (n, 3) of a body's surface, or without a mesh its landmarks and points below them, world [m]."""
    if mesh is not None:
        return posed(mesh, TreePose(body.T_world_model, body.angles))
    return np.concatenate([body.landmarks, body.landmarks - _SOLE_M * up])


def _root(body: TrackedBody, mesh: RiggedMesh | None) -> Float64:
    if mesh is not None:
        return np.asarray(body.T_world_model[:3, :3] @ mesh.tree.root + body.T_world_model[:3, 3])
    there = body.landmarks[np.isfinite(body.landmarks).all(axis=-1)]
    return there.mean(axis=0) if len(there) else body.T_world_model[:3, 3]


def _around(extents: list[tuple[Float64, Float64]]) -> tuple[Float64, Float64] | None:
    if not extents:
        return None
    return np.min([low for low, _ in extents], axis=0), np.max([high for _, high in extents], axis=0)


def _stick_figure(body: TrackedBody, points: Float64, colour: Rgb) -> tuple[list[Strokes], Strokes]:
    """Return lines between a body's landmarks, which are at ``points`` (n, 3) on the stage, and balls at them."""
    place = {name: k for k, name in enumerate(body.landmark_names)}
    faint = 0.45 if body.lost else 1.0
    paint = Rgb(*(round(faint * channel) for channel in colour.paint))
    pairs = [(place[a], place[b]) for a, b in _LIMBS if a in place and b in place]
    lines = [line_strokes(points[[a, b]], paint, faint * _LINE_M) for a, b in pairs]
    there = np.isfinite(points).all(axis=-1)
    states = np.where(there, JointState.TRACKED, JointState.NOT_TRACKED)
    return lines, joint_strokes(points[None], states[None], [paint], np.full(len(points), faint * _BALL_M))


def _softer(colour: Colour) -> Rgb:
    """Return the mean of a line's colour and `SKIN`: on surfaces as bright as lines, one would not see their shape."""
    return Rgb(*((np.array(colour) + np.array(SKIN)) // 2).tolist())


def body_images(bodies: tuple[TrackedBody, ...]) -> Mapping[str, ImageLines]:
    """Return lines over each camera's image, by camera: the models' outlines, and deviating silhouette contours.

    An outline has the body's colour; a contour is red outside the model and blue inside it. A lost body has no
    contour. This is a `DrawPart.images`.
    """
    views: dict[str, list[tuple[int, TrackedBody, TrackedBodyView]]] = {}
    for k, body in enumerate(bodies):
        for view in body.views:
            views.setdefault(view.camera, []).append((k, body, view))
    return {camera: _image(told) for camera, told in views.items()}


def _image(told: list[tuple[int, TrackedBody, TrackedBodyView]]) -> ImageLines:
    words, ends, colours = [], [np.zeros((0, 2, 2), np.float32)], list[Rgb]()
    for _, body, view in told:
        outside, inside = (
            (np.zeros((0, 2, 2), np.float32),) * 2 if body.lost else deviations(view.outline_px, view.contour_px)
        )
        ends += [outside, inside]
        colours += [Rgb(*OUTSIDE)] * len(outside) + [Rgb(*INSIDE)] * len(inside)
        words.append(f"{body.name} {view_words(view)}".strip())
    for k, _, view in told:  # on top, so that they hide deviations of less than a line's width
        model = pieces(view.outline_px)
        ends.append(model)
        colours += [Rgb(*body_colour(k))] * len(model)
    return ImageLines(" · ".join(dict.fromkeys(words)), np.concatenate(ends), tuple(colours))


def view_words(view: TrackedBodyView) -> str:
    """Return the overlap of model and silhouette in percent, or that the image is not used or lacks the body."""
    if view.left_out:
        return "left out"
    return "not in the image" if np.isnan(view.overlap) else f"{view.overlap:.0%}"


BODIES: Final = DrawPart(draw_bodies, space=body_space, images=body_images, panel=BodyPanel)
