"""Followed bodies in the 3D scene: each mesh as it stands, the cameras around, and their pictures above."""

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
from mocapella.viewer.drawing import FloorNode, SensorNode, Tag, TagNodes
from mocapella.viewer.layout import Look, frame
from mocapella.viewer.palette import AMBER, GREY, Rgb, SensorColours
from mocapella.viewer.picture_plane import Encoded, PictureNode, Plane

Float64 = NDArray[np.float64]

SKIN: Final = Rgb(222, 228, 238)
LOST: Final = Rgb(96, 104, 120)
FLOOR_M: Final = 6.0
_HALF_M: Final = 0.45
"""Of a body that stands: so far it reaches to either side."""
_ROW_HIGH_M, _ROW_WIDE_M, _GAP_M = 1.9, 6.4, 0.06
"""A row of pictures is as high as this, and no wider than that."""
_OVER_M, _BEHIND_M = 0.35, 1.2
"""Where it begins: over the body's head at the start, and behind it."""
_TAG_M: Final = 0.08
"""So far over a head its name stands."""
_CAMERA_SIZE, _LINE = 0.012, 0.09
"""Of a camera's frustum, over its distance from the viewer; of its lines, over its size."""
_ASPECT: Final = 1.4
"""Of a usual window beside the panel."""
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
    """Draws it; all browsers see the same.

    Args:
        scene: of the page.
        meshes: of the bodies, by name; one alone has the colour of skin, several have their outlines'.
        rig: the cameras.
        space: how the world lies.
    """

    def __init__(
        self, scene: viser.SceneApi, meshes: Mapping[str, RiggedMesh], rig: CameraRig, space: StageSpace
    ) -> None:
        self._space = space
        self._bodies = {
            name: _BodyNode(scene, f"/bodies/{k}", mesh, SKIN if len(meshes) == 1 else _softer(body_colour(k)))
            for k, (name, mesh) in enumerate(meshes.items())
        }
        self._heads = TagNodes(scene, "/bodies/names", size=1.0)
        FloorNode(scene, "/floor", width=FLOOR_M, depth=FLOOR_M).place(np.zeros(3))
        colours = SensorColours()
        colours.learn(set(rig.cameras))
        self.planes = picture_row({name: p.camera.size_px for name, p in rig.cameras.items()}, space.tall_m)
        eye, tags = np.array(self.look(_ASPECT).position), []
        for name, placed in rig.cameras.items():
            T = space.T_stage_world @ inverse(placed.T_camera_world) @ _FROM_PICTURE
            # As large on the screen wherever it stands: one before the body is not to hide it.
            size = _CAMERA_SIZE * float(np.linalg.norm(T[:3, 3] - eye))
            node = SensorNode(scene, f"/cameras/{name}", scale=size, thickness=_LINE * size)
            node.place(T, colours.of(name), field_deg(placed))
            x, y, z = T[:3, 3] + [0.0, 1.3 * size, 0.0]
            tags.append(Tag(name, (float(x), float(y), float(z))))
        TagNodes(scene, "/names", size=0.8).draw(tags)
        self._pictures = {name: PictureNode(scene, f"/pictures/{name}") for name in self.planes}
        self._words = TagNodes(scene, "/pictures/words", size=0.9, anchor="bottom-left")

    def look(self, aspect: float, camera: str = "") -> Look:
        """A camera that has the body and all pictures in its picture, or that camera's picture alone."""
        if camera in self.planes:
            return frame(self.planes[camera].corners, fov=_FOV, aspect=aspect, elevation=0.0, margin=1.02)
        wide, tall = self._space.half_wide_m, self._space.tall_m
        body = np.array([[x, y, z] for x in (-wide, wide) for y in (0.0, tall) for z in (-_HALF_M, _HALF_M)])
        corners = np.concatenate([body, *(plane.corners for plane in self.planes.values())])
        return frame(corners, fov=_FOV, aspect=aspect, elevation=_ELEVATION, margin=1.06)

    def draw(self, bodies: Mapping[str, ShownBody], pictures: Mapping[str, Encoded], words: Mapping[str, str]) -> None:
        """Show it.

        Args:
            bodies: by name, in the world; those of whom nobody is there are dark.
            pictures: of cameras, with the outlines.
            words: over each picture.
        """
        tags = []
        for name, shown in bodies.items():
            x, y, z = self._bodies[name].draw(self._space.T_stage_world, shown)
            tags += [Tag(f"{name} · not there" if shown.lost else name, (x, y + _TAG_M, z))] if name else []
        self._heads.draw(tags)
        for name, picture in pictures.items():
            self._pictures[name].draw(self.planes[name], picture)
        over = [(name, plane.corners[0] + [0.0, 0.03, 0.0]) for name, plane in self.planes.items()]
        self._words.draw([Tag(words.get(name, name), (float(x), float(y), float(z))) for name, (x, y, z) in over])


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

    def draw(self, T_stage_world: Float64, shown: ShownBody) -> tuple[float, float, float]:
        """Show it; where its highest point is on the stage."""
        T = T_stage_world @ part_motions(self._mesh.tree, shown.pose)
        wxyz = viser.transforms.SO3.from_matrix(T[:, :3, :3]).wxyz
        for bone, q, at in zip(self._handle.bones, wxyz, T[:, :3, 3], strict=True):
            bone.wxyz, bone.position = q, at
        if (colour := LOST if shown.lost else self._usual) != self._colour:
            self._colour = colour
            self._handle.color = colour.paint
        vertices = apply(T_stage_world, posed(self._mesh, shown.pose))
        x, y, z = vertices[np.argmax(vertices[:, 1])]
        return float(x), float(y), float(z)


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
