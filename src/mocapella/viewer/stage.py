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
    """A two-sided mesh in the view's space, with a colour and an opacity, 0 to 1."""

    mesh: Mesh
    colour: Rgb
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Skin:
    """A rigged mesh in a pose.

    Attributes:
        mesh: the mesh; an unchanged mesh must be the same object, so that it is not sent again.
        T_stage_parts: (parts, 4, 4) transform of each part of the mesh from the rest pose to the view's space [m].
        colour: colour of the surface.
        opacity: 0 to 1.
    """

    mesh: RiggedMesh
    T_stage_parts: Float64
    colour: Rgb
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class TrackingDrawing:
    """Content of the Scene stage in one perspective, in the view's space.

    Attributes:
        bones, joints: strokes of bones or lines, and of balls.
        halos: strokes of translucent balls, for uncertain or inferred joints.
        tags: text labels.
        sensors: marks of the sensors, by sensor.
        unseen: names of people that cannot be shown, because the perspective's sensor never saw them.
        remarks: what users must know of parts, such as that no joint of one is known; shown in the title.
        scale: enlargement of the content.
        there: whether the stage has content; if not, it shows the reason.
        surfaces, skins: meshes by name; the name of a part's mesh must not change.
        extent: smallest and largest corner (3,) of an upright box that the browser's camera follows [m]; None if the
            camera stands still.
    """

    bones: Strokes = NO_STROKES
    joints: Strokes = NO_STROKES
    halos: Strokes = NO_STROKES
    tags: list[Tag] = field(default_factory=list)
    sensors: dict[str, SensorMark] = field(default_factory=dict)
    unseen: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    scale: float = 1.0
    there: bool = True
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    skins: Mapping[str, Skin] = field(default_factory=dict)
    extent: tuple[Float64, Float64] | None = None


@dataclass(frozen=True, eq=False)
class StageView:
    """Viewpoint and context of a stage's drawing.

    Attributes:
        perspective: a sensor's name, or `mocapella.viewer.perspective.FREE`.
        seen: last known poses of the sensors and of each person's views, updated with the scene.
        floors: tilt and height above the floor of each perspective.
        troubles: receives the errors of drawings.
        scenery: obstacles of a simulated room; None without one.
    """

    perspective: str
    seen: Perspectives
    floors: Floors
    troubles: PluginErrors
    scenery: Scenery | None = None


class StageMemory(Protocol):
    """Interface of the state that a stage keeps from scene to scene, such as a smoothed centre."""

    def update(self, scene: Scene | None) -> Any:
        """Update the state with the newest scene.

        Args:
            scene: the newest scene; None before the first. The same object again changes nothing.

        Returns:
            The second argument of `Stage.draw`, of a type that the stage chooses; None if the stage has no content.
        """


class NoMemory:
    """`StageMemory` of a stage that keeps no state."""

    def update(self, scene: Scene | None) -> Any:
        """Return the scene unchanged."""
        return scene


def no_memory(props: Mapping[str, Callable[[], Any]]) -> StageMemory:
    """Create a `NoMemory`; ``props`` are not used."""
    return NoMemory()


@dataclass(frozen=True, eq=False)
class Stage:
    """Descriptor of a stage of the view.

    Attributes:
        name: name for the user.
        draw: function of a scene, the value of `StageMemory.update` for this scene (both None before the first), and
            the viewpoint.
        title: function of the drawing and the perspective that returns the title in front of the stage.
        box: extent of the stage's content in the view's space.
        elevation: downward angle of the browser's camera when it shows this stage only [rad].
        memory: function that creates the stage's memory. Its argument has functions by name that create props:
            objects to be shown beside a scene, such as a cloth.
        perspectives: whether the drawing depends on the perspective.
        box_with_sensors: whether the camera at first shows the sensors' gallery as well.
        pictures: whether camera images with lines drawn over them are shown above the stage.
        panel: function that creates the stage's folder in a browser's panel; None for no folder.
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
    """Return the title of a stage with enlarged content, which names the scale; the same for every perspective."""
    return f"Scene · {drawing.scale:.1f} times as large"
