"""Descriptor of a stage of the view, which tracking methods list by reference.

    METHOD = Method(..., stages=("mocapella.viewer.stages:ARMS", "mocapella.viewer.stages:ROOM"))

The view shows the first stage that has content; the last one is shown even without content.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.scene import Scene
from mocapella.model.scenery import Scenery
from mocapella.viewer.bones import NO_STROKES, Strokes
from mocapella.viewer.drawing import Tag
from mocapella.viewer.layout import BoundingBox
from mocapella.viewer.meshes import Mesh
from mocapella.viewer.palette import Rgb
from mocapella.viewer.part_panel import MakePanel
from mocapella.viewer.perspective import Floors, Perspectives
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.sensor_marks import SensorMark

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface:
    """A two-sided mesh in the view's space."""

    mesh: Mesh
    colour: Rgb
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Skin:
    """A rigged mesh in a pose.

    Attributes:
        mesh: the mesh; an unchanged one must be the same object, so that it is not sent again.
        T_stage_parts: (parts, 4, 4) each part's transform from the rest pose to the view's space.
        colour: of its surface.
        opacity: from 0 to 1.
    """

    mesh: RiggedMesh
    T_stage_parts: Float64
    colour: Rgb
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class TrackingDrawing:
    """Content of the Tracking stage in one perspective, in the view's space.

    Attributes:
        bones, joints: strokes.
        halos: translucent balls around uncertain or inferred joints.
        tags: text labels.
        sensors: marks by name.
        unseen: names of people that the perspective's sensor never saw, so that they cannot be placed in it.
        scale: enlargement of the content.
        there: whether the stage has content; otherwise it shows why it is empty.
        surfaces, skins: meshes by name; a part's mesh keeps its name.
        extent: two opposite corners (3,) of an upright box that the camera follows; None if it stands still.
    """

    bones: Strokes = NO_STROKES
    joints: Strokes = NO_STROKES
    halos: Strokes = NO_STROKES
    tags: list[Tag] = field(default_factory=list)
    sensors: dict[str, SensorMark] = field(default_factory=dict)
    unseen: tuple[str, ...] = ()
    scale: float = 1.0
    there: bool = True
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    skins: Mapping[str, Skin] = field(default_factory=dict)
    extent: tuple[Float64, Float64] | None = None


@dataclass(frozen=True, eq=False)
class StageView:
    """Viewpoint of a stage.

    Attributes:
        perspective: a sensor's name, or `mocapella.viewer.perspective.FREE`.
        seen: last known poses of the sensors and of each person's views, updated with the scene.
        floors: height of each perspective above the floor.
        troubles: receives the drawing errors.
        scenery: the obstacles of a simulated room, if there is one.
    """

    perspective: str
    seen: Perspectives
    floors: Floors
    troubles: PluginErrors
    scenery: Scenery | None = None


class StageMemory(Protocol):
    """Interface of the state that a stage keeps from scene to scene."""

    def update(self, scene: Scene | None) -> Any:
        """Update with the newest scene; return the value that the stage draws with it, None if it has nothing to show.

        A repeated scene changes nothing.
        """


class NoMemory:
    """Memory of a stage that needs only the scene itself."""

    def update(self, scene: Scene | None) -> Any:
        """Return the scene."""
        return scene


def no_memory(props: Mapping[str, Callable[[], Any]]) -> StageMemory:
    """Return a `NoMemory`."""
    return NoMemory()


@dataclass(frozen=True, eq=False)
class Stage:
    """A stage of the view.

    Attributes:
        name: for the user.
        draw: function of a scene, the value of `StageMemory.update` for it (both None before the first), and the
            viewpoint.
        title: function of the drawing and the perspective that returns the title in front of the stage.
        box: extent of its content.
        elevation: angle by which the camera looks down at the stage alone [rad].
        memory: creates its memory, from functions by name that create props, such as a cloth.
        perspectives: whether the drawing depends on the perspective.
        box_with_sensors: whether the camera also shows the sensors' gallery, until the user moves it.
        pictures: whether camera images with lines of its parts are shown above it.
        panel: creates its folder in the panel, visible while the stage is; None for none.
    """

    name: str
    draw: Callable[[Scene | None, Any, StageView], TrackingDrawing]
    title: Callable[[TrackingDrawing, str], str]
    box: BoundingBox
    elevation: float
    memory: Callable[[Mapping[str, Callable[[], Any]]], StageMemory] = no_memory
    perspectives: bool = True
    box_with_sensors: bool = True
    pictures: bool = False
    panel: MakePanel | None = None


def enlarged_title(drawing: TrackingDrawing, perspective: str) -> str:
    """Return the title of a stage with enlarged content."""
    return f"Tracking · {drawing.scale:.1f} times as large"
