"""Followed bodies in the 3D scene: each mesh as it stands, the cameras around, and boards for their pictures above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.outline_colours import Colour, body_colour
from mocapella.model.rigged_mesh import RiggedMesh, posed
from mocapella.model.twist_tree import TreePose, part_motions
from mocapella.viewer.body_sight import Sight
from mocapella.viewer.drawing import FloorNode, SensorNode, Tag, TagNodes
from mocapella.viewer.layout import Look, frame
from mocapella.viewer.palette import AMBER, GREY, Rgb, SensorColours
from mocapella.viewer.picture_plane import Plane

Float64 = NDArray[np.float64]

BOARD: Final = "/board"
"""Where pictures are; what is in it goes along with the bodies."""
SKIN: Final = Rgb(222, 228, 238)
LOST: Final = Rgb(96, 104, 120)
FLOOR_M: Final = 6.0
FLOOR_STEP_M: Final = 1.0
"""The floor goes along by whole squares, so that its lines stay where they are."""
EMPTY: Final = Rgb(106, 114, 129)
"""Of a board without a picture; seen from before, where little light is, it is a dark slate."""
_RIM_M: Final = 0.015
"""So much a board is wider than its picture, which is before it by as much."""
_HALF_M: Final = 0.45
"""Of a body that stands: so far it reaches to either side."""
_ROW_HIGH_M, _ROW_WIDE_M, _GAP_M = 1.9, 6.4, 0.06
"""A row of pictures is as high as this, and no wider than that."""
_OVER_M, _BEHIND_M = 0.35, 1.2
"""Where it begins: over the body's head at the start, and behind it."""
_TAG_M: Final = 0.08
"""So far over a head its name stands."""
_NEAR_M: Final = 1e-4
"""Boards that are so near to where they are to be stay."""
_CAMERA_SIZE, _LINE = 0.012, 0.09
"""Of a camera's frustum, over its distance from the viewer; of its lines, over its size."""
_ASPECT: Final = 1.4
"""Of a usual window beside the panel."""
_TALL: Final = 0.7
"""Of a telephone held upright: its panel is a sheet that covers three fifths from below."""
_OVER_SHEET: Final = 0.2
_FOV: Final = float(np.radians(36.0))
_ELEVATION: Final = float(np.radians(9.0))
_FROM_PICTURE: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""A camera's space, x right and y down, from a sensor's, x left and y up."""


class ShownBody(msgspec.Struct, frozen=True, eq=False):
    """A body in one frame.

    Attributes:
        pose: of it.
        overlap: of the outlines, by camera that saw it.
        left_out: why a camera did not count.
        lost: nobody is there.
    """

    pose: TreePose
    overlap: Mapping[str, float]
    left_out: Mapping[str, str]
    lost: bool


@dataclass(frozen=True, eq=False)
class StageSpace:
    """How the world lies on the stage: y up from the floor, the bodies at first about the origin, facing the viewer.

    Attributes:
        T_stage_world: (4, 4).
        tall_m: of the highest body over the floor at first.
        half_wide_m: how far from the origin bodies reach along x at first, and at least as far as one does.
    """

    T_stage_world: Float64
    tall_m: float
    half_wide_m: float = _HALF_M


def stage_space(bodies: Sequence[tuple[RiggedMesh, TreePose]], up: Float64) -> StageSpace:
    """Where a world stands on the stage.

    Args:
        bodies: their meshes and first poses; the first one looks at the viewer.
        up: (3,) unit vector of the world.
    """
    _, pose = bodies[0]
    y = np.asarray(up, np.float64)
    forward = pose.T_world_model[:3, 2]
    ahead = forward - (forward @ y) * y
    if np.linalg.norm(ahead) < 0.1:  # it lies: any way will do
        ahead = np.cross(y, np.eye(3)[np.argmin(np.abs(y))])
    z = -ahead / np.linalg.norm(ahead)
    R = np.stack([np.cross(y, z), y, z])
    vertices = np.concatenate([posed(mesh, at) for mesh, at in bodies]) @ R.T
    roots = [R @ (at.T_world_model[:3, :3] @ mesh.tree.root + at.T_world_model[:3, 3]) for mesh, at in bodies]
    middle = 0.5 * (np.min(roots, axis=0) + np.max(roots, axis=0))
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = -middle[0], -vertices[:, 1].min(), -middle[2]
    half = 0.5 * float(np.ptp([root[0] for root in roots])) + _HALF_M
    return StageSpace(T, float(np.ptp(vertices[:, 1])), half)


def picture_row(sizes_px: Mapping[str, tuple[int, int]], tall_m: float) -> dict[str, Plane]:
    """Where each camera's picture stands: beside each other, the first at the left of the screen, all of one height."""
    ratios = [width / height for width, height in sizes_px.values()]
    gaps = _GAP_M * (len(ratios) - 1)
    high = min(_ROW_HIGH_M, (_ROW_WIDE_M - gaps) / sum(ratios))
    left = 0.5 * (high * sum(ratios) + gaps)
    middle_y = tall_m + _OVER_M + 0.5 * high
    planes = {}
    for (name, size), ratio in zip(sizes_px.items(), ratios, strict=True):
        wide = high * ratio
        planes[name] = Plane(np.array([left - 0.5 * wide, middle_y, _BEHIND_M]), wide, size)
        left -= wide + _GAP_M
    return planes


class BodyStage:
    """Draws it; all browsers see the same, but for pictures (`BodyBrowser`).

    Args:
        scene: of the page.
        meshes: of the bodies, by name; one alone has the colour of skin, several have their outlines'.
        rig: the cameras.
        space: how the world lies.
        starts: the bodies' first poses.

    Attributes:
        sight: what is looked at.
        planes: of the pictures, by camera, where `sight` is at first.
    """

    def __init__(
        self, scene: viser.SceneApi, meshes: Mapping[str, RiggedMesh], rig: CameraRig, space: StageSpace,
        starts: Mapping[str, TreePose],
    ) -> None:  # fmt: skip
        self._space = space
        self.sight = Sight(np.array([space.half_wide_m, _HALF_M]), space.tall_m)
        self._bodies = {
            name: _BodyNode(scene, f"/bodies/{k}", mesh, SKIN if len(meshes) == 1 else _softer(body_colour(k)))
            for k, (name, mesh) in enumerate(meshes.items())
        }
        self._heads = TagNodes(scene, "/bodies/names", size=1.0)
        self._floor = FloorNode(scene, "/floor", width=FLOOR_M, depth=FLOOR_M)
        colours = SensorColours()
        colours.learn(set(rig.cameras))
        self.planes = picture_row({name: p.camera.size_px for name, p in rig.cameras.items()}, space.tall_m)
        self.home = self.look(_ASPECT)
        eye, tags = np.array(self.home.position), []
        for name, placed in rig.cameras.items():
            T = space.T_stage_world @ inverse(placed.T_camera_world) @ _FROM_PICTURE
            # As large on the screen wherever it stands: one before the body is not to hide it.
            size = _CAMERA_SIZE * float(np.linalg.norm(T[:3, 3] - eye))
            node = SensorNode(scene, f"/cameras/{name}", scale=size, thickness=_LINE * size)
            node.place(T, colours.of(name), field_deg(placed))
            x, y, z = T[:3, 3] + [0.0, 1.3 * size, 0.0]
            tags.append(Tag(name, (float(x), float(y), float(z))))
        self._names, self._tags = TagNodes(scene, "/names", size=0.8), tags
        self._names.draw(tags)
        self._boards = scene.add_frame(BOARD, show_axes=False)
        for name, plane in self.planes.items():
            scene.add_frame(f"{BOARD}/{name}", show_axes=False, position=plane.middle)
            _add_board(scene, f"{BOARD}/{name}/empty", plane.at_origin)
        self._words = TagNodes(scene, f"{BOARD}/words", size=0.9, anchor="bottom-left")
        self._box = self._draw_bodies({name: ShownBody(pose, {}, {}, lost=False) for name, pose in starts.items()})
        self._say({})
        self.settle(0.0)

    def look(self, aspect: float, camera: str = "") -> Look:
        """A camera that has the bodies and all pictures in its picture, or that camera's picture alone."""
        lowest = _OVER_SHEET if aspect < _TALL else -1.0
        if camera in self.planes:
            board = self.planes[camera].moved(self.sight.middle)
            return frame(board.corners, fov=_FOV, aspect=aspect, elevation=0.0, margin=1.02, lowest=lowest)
        (x, above, z), (wide, deep) = self.sight.middle, self.sight.half_m
        body = np.array(
            [[x + i, y, z + k] for i in (-wide, wide) for y in (0.0, self._space.tall_m + above) for k in (-deep, deep)]
        )
        corners = np.concatenate([body, *(plane.corners + self.sight.middle for plane in self.planes.values())])
        return frame(corners, fov=_FOV, aspect=aspect, elevation=_ELEVATION, margin=1.06, lowest=lowest)

    def draw(self, bodies: Mapping[str, ShownBody], words: Mapping[str, str]) -> None:
        """Show it.

        Args:
            bodies: by name, in the world; those of whom nobody is there are dark.
            words: over each picture.
        """
        self._box = self._draw_bodies(bodies)
        self._say(words)

    def name_cameras(self, *, named: bool) -> None:
        """Whether the cameras' names stand beside them; before a picture that is large they would be in the way."""
        self._names.draw([Tag(tag.text, tag.position, named) for tag in self._tags])

    def settle(self, now_s: float) -> None:
        """Go on to where those are who are there; call it steadily."""
        if self._box is None:
            self.sight.rest(now_s)
        else:
            self.sight.follow(*self._box, now_s)
        if np.abs(self.sight.middle - self._boards.position).max() > _NEAR_M:
            self._boards.position = self.sight.middle
        x, _, z = FLOOR_STEP_M * np.round(self.sight.middle / FLOOR_STEP_M)
        self._floor.place(np.array([x, 0.0, z]))

    def _draw_bodies(self, bodies: Mapping[str, ShownBody]) -> tuple[Float64, Float64] | None:
        """Show them; an upright box that all who are there are in, None where nobody is."""
        tags, boxes = [], []
        for name, shown in bodies.items():
            vertices = self._bodies[name].draw(self._space.T_stage_world, shown)
            x, y, z = vertices[np.argmax(vertices[:, 1])].tolist()
            tags += [Tag(f"{name} · not there" if shown.lost else name, (x, y + _TAG_M, z))] if name else []
            boxes += [] if shown.lost else [(vertices.min(axis=0), vertices.max(axis=0))]
        self._heads.draw(tags)
        if not boxes:
            return None
        return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)

    def _say(self, words: Mapping[str, str]) -> None:
        over = [(name, plane.corners[0] + [0.0, 0.03, 0.0]) for name, plane in self.planes.items()]
        self._words.draw([Tag(words.get(name, name), (float(x), float(y), float(z))) for name, (x, y, z) in over])


def _add_board(scene: viser.SceneApi, name: str, plane: Plane) -> None:
    """What is seen where there is no picture, and a rim around one."""
    px = _RIM_M / plane.px_m
    width, height = plane.size_px
    corners = plane.place(
        np.array([[-px, -px], [width + px, -px], [width + px, height + px], [-px, height + px]]) - 0.5
    )
    scene.add_mesh_simple(
        name, (corners + np.array([0.0, 0.0, _RIM_M])).astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
        color=EMPTY.paint, side="double", cast_shadow=False, receive_shadow=False,
    )  # fmt: skip


class _BodyNode:
    """One body's mesh."""

    def __init__(self, scene: viser.SceneApi, name: str, mesh: RiggedMesh, colour: Rgb) -> None:
        self._mesh, self._usual, self._colour = mesh, colour, colour
        parts = len(mesh.part_names)
        self._handle = scene.add_mesh_skinned(
            name, mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32), color=colour.paint,
            bone_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (parts, 1)), bone_positions=np.zeros((parts, 3)),
            skin_weights=_summed(mesh, parts), receive_shadow=False,
        )  # fmt: skip

    def draw(self, T_stage_world: Float64, shown: ShownBody) -> Float64:
        """Show it; (n, 3) where its vertices are on the stage."""
        T = T_stage_world @ part_motions(self._mesh.tree, shown.pose)
        wxyz = viser.transforms.SO3.from_matrix(T[:, :3, :3]).wxyz
        for bone, q, at in zip(self._handle.bones, wxyz, T[:, :3, 3], strict=True):
            bone.wxyz, bone.position = q, at
        if (colour := LOST if shown.lost else self._usual) != self._colour:
            self._colour = colour
            self._handle.color = colour.paint
        return apply(T_stage_world, posed(self._mesh, shown.pose))


def _softer(colour: Colour) -> Rgb:
    """Half way to the skin's: bright surfaces of a line's colour would hide their shape."""
    return Rgb(*((np.array(colour) + np.array(SKIN)) // 2).tolist())


def field_deg(placed: PlacedCamera) -> tuple[float, float]:
    """A camera's field of view, across and high [°], as if its lens did not distort."""
    (width, height), lens = placed.camera.size_px, placed.camera.lens
    return (
        float(np.degrees(2 * np.arctan(0.5 * width / lens[0]))),
        float(np.degrees(2 * np.arctan(0.5 * height / lens[1]))),
    )


def overlap_colour(overlap: float | None) -> Rgb:
    """Of how well outlines agree: plain where they do, amber where they do not, grey where nobody knows."""
    return GREY if overlap is None else SKIN if overlap >= 0.7 else AMBER


def _summed(mesh: RiggedMesh, parts: int) -> Float64:
    """(n, parts) how much each part moves each vertex; a part may be there more than once where its share is 0."""
    weights = np.zeros((len(mesh.vertices), parts))
    rows = np.arange(len(mesh.vertices))
    for column in range(mesh.bones.shape[1]):
        np.add.at(weights, (rows, mesh.bones[:, column]), mesh.shares[:, column])
    return weights
