"""What a stage of the view is: a descriptor, found by the references that a tracking method lists.

    METHOD = Method(..., stages=("mocapella.viewer.stages:ARMS", "mocapella.viewer.stages:ROOM"))

The first stage that has something to show is shown, and the last one in any case.
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
    """A mesh in the view's own space, seen from both sides."""

    mesh: Mesh
    colour: Rgb
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Skin:
    """A rigged mesh in a pose.

    Attributes:
        mesh: an unchanged mesh is the same object.
        T_stage_parts: (parts, 4, 4) each part's motion, from the rest frame to the view's own space.
        colour: of its surface.
        opacity: from 0 to 1.
    """

    mesh: RiggedMesh
    T_stage_parts: Float64
    colour: Rgb
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class TrackingDrawing:
    """The Tracking stage of one perspective, ready to be drawn, in the view's own space.

    Attributes:
        bones, joints: strokes.
        halos: translucent balls about joints that are unsure or only inferred.
        tags: texts.
        sensors: by name.
        unseen: names of people whom the perspective's sensor never saw, who therefore cannot be placed in it.
        scale: how many times larger than they are things are drawn.
        there: whether anything is on the stage; else it says why it is empty.
        surfaces, skins: by names that stay.
        extent: (3,) and (3,) of an upright box that the camera goes along with; None where it stands still.
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
    """From where a stage is looked at.

    Attributes:
        perspective: a sensor's name, or `mocapella.viewer.perspective.FREE`.
        seen: from where each person was seen; has learnt the scene.
        floors: how high the perspective is over the floor.
        troubles: receives the drawing errors.
        scenery: the obstacles of a simulated room, if there is one.
    """

    perspective: str
    seen: Perspectives
    floors: Floors
    troubles: PluginErrors
    scenery: Scenery | None = None


class StageMemory(Protocol):
    """What a stage remembers from scene to scene, in one view."""

    def update(self, scene: Scene | None) -> Any:
        """What is to be shown with the newest scene; None where there is nothing to show.

        A scene that was taken in already changes nothing.
        """


class NoMemory:
    """Of a stage that shows each scene by itself."""

    def update(self, scene: Scene | None) -> Any:
        """The scene."""
        return scene


def no_memory(props: Mapping[str, Callable[[], Any]]) -> StageMemory:
    """See `NoMemory`."""
    return NoMemory()


@dataclass(frozen=True, eq=False)
class Stage:
    """A stage of the view.

    Attributes:
        name: in words.
        draw: a scene, what the memory made of it (both None before the first), and the view, as a drawing.
        title: what stands before it, of its drawing and the perspective.
        box: extent of its content.
        elevation: how far the camera looks down at it alone [rad].
        memory: makes its memory; is given, by name, what makes things that the view was asked to show beside the scene.
        perspectives: whether it matters from whose eyes it is seen.
        box_with_sensors: whether the camera also shows the sensors' gallery, until the user moves it.
        pictures: whether cameras' images with the drawings of its parts stand over it.
        panel: makes its readout, which is there while the stage is; None where it has none.
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
    """Of a stage on which things are larger than they are."""
    return f"Tracking · {drawing.scale:.1f} times as large"
