"""Scene nodes of one browser's 3D scene: created once, enlarged if necessary, and otherwise only updated.

Unchanged values are not assigned, because the library sends each assignment to the browser. Nodes that vanish are
hidden, because a browser removes and creates nodes slowly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.viewer.bones import Strokes, padded
from mocapella.viewer.meshes import Mesh
from mocapella.viewer.palette import FLOOR, Rgb

Anchor = Literal["bottom-center", "bottom-left"]

_FIRST_CAPACITY = 64
_MORE_STROKES = 64
"""A node's number of instances is a multiple of this: small, because unused instances also cost a browser time."""
_NEGLIGIBLE = 5e-4
"""A frustum that has moved by less [m], or turned by less [rad], stays where it is drawn."""
_FROM_PICTURE = np.diag([-1.0, -1.0, 1.0])
"""Rotation from an image's axes (x right, y down), the axes of a frustum, to a sensor's (x left, y up)."""


@dataclass(frozen=True)
class Tag:
    """A text label at a position (3,) in the view's space [m]; an invisible label keeps its place in a list."""

    text: str
    position: tuple[float, float, float]
    visible: bool = True


class StrokeNode:
    """Scene node with any number of instances of one mesh; it is created at the first drawing.

    Args:
        scene: viser's 3D scene of the browser.
        name: path of the node, such as ``/tracking/bones``.
        mesh: the mesh of all instances.
        shadow: whether the instances cast shadows.
        translucent: whether the strokes' opacities apply.
    """

    def __init__(
        self, scene: viser.SceneApi, name: str, mesh: Mesh, *, shadow: bool = True, translucent: bool = False
    ) -> None:
        self._scene, self._name, self._mesh = scene, name, mesh
        self._shadow, self._translucent = shadow, translucent
        self._shows = True
        self._capacity = 0
        self._handle: viser.BatchedMeshHandle | None = None

    def draw(self, strokes: Strokes) -> None:
        """Show exactly these strokes, in place of the earlier ones; an empty set hides all."""
        if not len(strokes) and not self._shows:
            return
        self._shows = len(strokes) > 0
        if self._handle is None or len(strokes) > self._capacity:
            self._grow(len(strokes))
        assert self._handle is not None
        s = padded(strokes, self._capacity)
        self._handle.batched_positions = s.positions
        self._handle.batched_wxyzs = s.wxyzs
        self._handle.batched_scales = s.scales
        self._handle.batched_colors = s.colours
        if self._translucent:
            self._handle.batched_opacities = s.opacities

    def _grow(self, count: int) -> None:
        if self._handle is not None:
            self._handle.remove()
        self._capacity = _MORE_STROKES * max(1, -(-count // _MORE_STROKES))
        blank = np.zeros((self._capacity, 3), np.float32)
        self._handle = self._scene.add_batched_meshes_simple(
            self._name,
            self._mesh.vertices,
            self._mesh.faces,
            batched_wxyzs=np.tile(np.array([1, 0, 0, 0], np.float32), (self._capacity, 1)),
            batched_positions=blank,
            batched_scales=blank,
            batched_colors=np.zeros((self._capacity, 3), np.uint8),
            batched_opacities=np.zeros(self._capacity, np.float32) if self._translucent else None,
            lod="off",
            cast_shadow=self._shadow,
            receive_shadow=False,
        )


class SurfaceNode:
    """Scene node of a two-sided surface with moving vertices.

    Args:
        scene: viser's 3D scene of the browser.
        name: path of the node.
    """

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        self._scene, self._name = scene, name
        self._made_of: tuple[object, ...] = ()
        self._vertices: NDArray[np.float32] | None = None
        self._handle: viser.MeshHandle | None = None

    def draw(self, mesh: Mesh, colour: Rgb, opacity: float) -> None:
        """Show a mesh in place of the earlier one.

        Args:
            mesh: vertices in the view's space [m]. If its ``faces`` are the same array as before, and colour and
                opacity are equal, only the vertices are sent to the browser. The same array of vertices is not sent
                again, even if it was changed in place.
            colour: colour of the surface.
            opacity: 0 to 1.
        """
        made_of = (id(mesh.faces), colour, opacity)
        if self._handle is None or self._made_of != made_of:
            if self._handle is not None:
                self._handle.remove()
            self._faces, self._made_of = mesh.faces, made_of  # held, so that no other array gets its id
            self._handle = self._scene.add_mesh_simple(
                self._name,
                mesh.vertices,
                mesh.faces,
                color=colour.paint,
                side="double",
                opacity=opacity if opacity < 1 else None,
                cast_shadow=False,
                receive_shadow=False,
            )
        if mesh.vertices is not self._vertices:
            self._vertices = self._handle.vertices = mesh.vertices
        if not self._handle.visible:
            self._handle.visible = True

    def hide(self) -> None:
        """Hide the node."""
        if self._handle is not None and self._handle.visible:
            self._handle.visible = False


class SkinNode:
    """Scene node of a rigged mesh. After the first drawing, only the parts' motions are sent to the browser.

    Args:
        scene: viser's 3D scene of the browser.
        name: path of the node.
    """

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        self._scene, self._name = scene, name
        self._mesh: RiggedMesh | None = None
        self._look: tuple[Rgb, float] | None = None
        self._handle: viser.MeshSkinnedHandle | None = None

    def draw(self, mesh: RiggedMesh, T: NDArray[np.float64], colour: Rgb, opacity: float) -> None:
        """Show a mesh in a pose.

        Args:
            mesh: the mesh; the same object as before is not sent again.
            T: (parts, 4, 4) transform of each part from its rest pose to the view's space [m].
            colour: colour of the surface.
            opacity: 0 to 1.
        """
        if self._handle is None or mesh is not self._mesh:
            self._add(mesh)
        assert self._handle is not None
        wxyz = viser.transforms.SO3.from_matrix(T[:, :3, :3]).wxyz
        for bone, q, at in zip(self._handle.bones, wxyz, T[:, :3, 3], strict=True):
            bone.wxyz, bone.position = q, at
        if (colour, opacity) != self._look:
            self._look = colour, opacity
            self._handle.color, self._handle.opacity = colour.paint, opacity if opacity < 1 else None
        if not self._handle.visible:
            self._handle.visible = True

    def hide(self) -> None:
        """Hide the node."""
        if self._handle is not None and self._handle.visible:
            self._handle.visible = False

    def _add(self, mesh: RiggedMesh) -> None:
        if self._handle is not None:
            self._handle.remove()
        self._mesh, self._look, parts = mesh, None, len(mesh.part_names)
        self._handle = self._scene.add_mesh_skinned(
            self._name, mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32),
            bone_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (parts, 1)), bone_positions=np.zeros((parts, 3)),
            skin_weights=_summed(mesh, parts), receive_shadow=False,
        )  # fmt: skip


def _summed(mesh: RiggedMesh, parts: int) -> NDArray[np.float64]:
    """Return the skinning weights (vertices, parts); a vertex may list a part again with a share of 0."""
    weights = np.zeros((len(mesh.vertices), parts))
    rows = np.arange(len(mesh.vertices))
    for column in range(mesh.bones.shape[1]):
        np.add.at(weights, (rows, mesh.bones[:, column]), mesh.shares[:, column])
    return weights


class LineNode:
    """Scene node of straight line segments, with a colour for each end point.

    Args:
        scene: viser's 3D scene of the browser.
        name: path of the node.
        thickness: thickness of the lines [m].
    """

    def __init__(self, scene: viser.SceneApi, name: str, *, thickness: float) -> None:
        self._scene, self._name, self._thickness = scene, name, thickness
        self._capacity = 0
        self._handle: viser.LineSegmentsHandle | None = None

    def draw(self, points: NDArray[np.float32], colours: NDArray[np.uint8]) -> None:
        """Show exactly these segments, in place of the earlier ones.

        Args:
            points: (n, 2, 3) end points in the view's space [m].
            colours: (n, 2, 3) red, green and blue of the end points, 0 to 255.
        """
        if not len(points):
            if self._handle is not None:
                self._handle.visible = False
            return
        if self._handle is None or len(points) > self._capacity:
            self._grow(len(points))
        assert self._handle is not None
        missing = self._capacity - len(points)  # the unused capacity lies as points at the end of the last line
        self._handle.points = np.concatenate([points, np.broadcast_to(points[-1, 1], (missing, 2, 3))])
        self._handle.colors = np.concatenate([colours, np.broadcast_to(colours[-1, 1], (missing, 2, 3))])
        self._handle.visible = True

    def _grow(self, count: int) -> None:
        if self._handle is not None:
            self._handle.remove()
        self._capacity = max(_FIRST_CAPACITY, 1 << (count - 1).bit_length())
        self._handle = self._scene.add_line_segments(
            self._name,
            np.zeros((self._capacity, 2, 3), np.float32),
            np.zeros((self._capacity, 2, 3), np.uint8),
            thickness=self._thickness,
        )


class TagNodes:
    """Scene nodes of text labels.

    Args:
        scene: viser's 3D scene of the browser.
        name: path of the nodes' parent.
        size: font scale; 1 is the library's usual size.
        anchor: point of the label that is at its position.
    """

    def __init__(self, scene: viser.SceneApi, name: str, *, size: float, anchor: Anchor = "bottom-center") -> None:
        self._scene, self._name, self._size, self._anchor = scene, name, size, anchor
        self._handles: list[viser.LabelHandle] = []
        self._shown: list[Tag] = []

    def draw(self, tags: list[Tag]) -> None:
        """Show exactly these labels, in place of the earlier ones; an equal list is not sent again."""
        if tags == self._shown:
            return
        self._shown = tags
        while len(self._handles) < len(tags):
            self._handles.append(
                self._scene.add_label(
                    f"{self._name}/{len(self._handles)}",
                    "",
                    font_screen_scale=self._size,
                    anchor=self._anchor,
                    visible=False,
                )
            )
        for i, handle in enumerate(self._handles):
            if i < len(tags):
                handle.text, handle.position = tags[i].text, tags[i].position
            handle.visible = i < len(tags) and tags[i].visible


class SensorNode:
    """Scene node of a sensor, drawn as the frustum of its field of view; hidden until `place`.

    Args:
        scene: viser's 3D scene of the browser.
        name: path of the node.
        scale: size of the frustum [m].
        thickness: thickness of its lines [m].
    """

    def __init__(self, scene: viser.SceneApi, name: str, *, scale: float, thickness: float = 0.012) -> None:
        self._placed: NDArray[np.float64] | None = None
        self._colour: Rgb | None = None
        self._field_deg: tuple[float, float] | None = None
        self._visible, self._size = False, (scale, thickness)
        self._handle = scene.add_camera_frustum(
            name,
            fov=1.0,
            aspect=1.0,
            scale=scale,
            thickness=thickness,
            visible=False,
            cast_shadow=False,
            receive_shadow=False,
            variant="filled",
        )

    def place(self, T: NDArray[np.float64], colour: Rgb, field_deg: tuple[float, float]) -> None:
        """Show the sensor in a pose.

        Args:
            T: (4, 4) transform from the sensor's camera space to the view's space [m].
            colour: colour of the frustum.
            field_deg: horizontal and vertical field of view [°].
        """
        if field_deg != self._field_deg:
            self._field_deg = field_deg
            across, high = np.tan(np.radians(field_deg) / 2)
            self._handle.fov, self._handle.aspect = float(np.radians(field_deg[1])), float(across / high)
        if colour != self._colour:
            self._colour, self._handle.color = colour, colour.paint
        if self._placed is None or np.abs(T - self._placed).max() > _NEGLIGIBLE:
            self._placed = T.copy()
            self._handle.wxyz = viser.transforms.SO3.from_matrix(T[:3, :3] @ _FROM_PICTURE).wxyz
            self._handle.position = T[:3, 3]
        self._show(True)

    def resize(self, scale: float, thickness: float) -> None:
        """Set the size of the frustum and the thickness of its lines [m]."""
        size = (round(scale, 3), round(thickness, 4))
        if size != self._size:
            self._size = size
            self._handle.scale, self._handle.thickness = size

    def hide(self) -> None:
        """Hide the node."""
        self._show(False)

    def _show(self, visible: bool) -> None:
        if visible != self._visible:
            self._visible = self._handle.visible = visible


class FloorNode:
    """Scene node of a level floor with lines every 0.5 m, stronger every metre; hidden until `place`.

    Args:
        scene: viser's 3D scene of the browser.
        name: path of the node.
        width, depth: size of the floor before scaling [m].
        scale: factor of the size, including that of the grid.
    """

    def __init__(self, scene: viser.SceneApi, name: str, *, width: float, depth: float, scale: float = 1.0) -> None:
        self._placed: NDArray[np.float64] | None = None
        self._handle = scene.add_grid(
            name,
            width=width,
            height=depth,
            plane="xz",
            scale=scale,
            cell_size=0.5,
            section_size=1.0,
            cell_color=(44, 56, 76),
            section_color=(70, 88, 118),
            cell_thickness=0.8,
            section_thickness=1.2,
            plane_color=FLOOR,
            plane_opacity=0.85,
            shadow_opacity=0.4,
            fade_distance=60.0,
            visible=False,
        )

    def place(self, centre: NDArray[np.float64]) -> None:
        """Show the floor with its centre at a position (3,) in the view's space [m]."""
        if self._placed is None or not np.array_equal(centre, self._placed):
            self._placed = centre.copy()
            self._handle.position = centre
            self._handle.visible = True

    def hide(self) -> None:
        """Hide the node."""
        if self._placed is not None:
            self._placed, self._handle.visible = None, False
