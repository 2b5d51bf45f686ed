"""Draw a scene's parts on the ROOM stage, life-size in one room.

A part type names its drawing by reference (`mocapella.model.part_types.PartType.drawing`): a `DrawPart`, or only a
function like `DrawPart.draw`:

    def draw(parts, scene, room):
        at = apply(room.T_stage_world, np.array([part.position for part in parts]))
        return PartDrawing(joints=joint_strokes(at[:, None], ...), tags=(Tag("a ball", ...),))

    BALLS = PartType(..., drawing="my_package.drawing:draw")
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import Person, Scene
from mocapella.registry import load
from mocapella.viewer.bones import NO_STROKES, Strokes, checked
from mocapella.viewer.drawing import Tag
from mocapella.viewer.palette import Rgb
from mocapella.viewer.part_panel import MakePanel
from mocapella.viewer.perspective import Floors, Perspectives, StageSpace
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.stage import Skin, Surface

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RoomView:
    """Viewpoint of a drawing of the room.

    Attributes:
        perspective: a sensor's name, or `mocapella.viewer.perspective.FREE`.
        seen: last known poses of the sensors and of each person's views.
        floors: tilt and height above the floor of each perspective.
    """

    perspective: str
    seen: Perspectives
    floors: Floors

    @property
    def T_stage_perspective(self) -> Float64:  # noqa: N802 - the field's notation
        """Transform (4, 4) from the perspective's camera space to the stage, whose floor is level and at y = 0 [m]."""
        return self.floors.level(self.perspective)

    @property
    def T_stage_world(self) -> Float64:  # noqa: N802 - the field's notation
        """Transform (4, 4) from the world to the stage [m]; NaN if the perspective's pose in the world is unknown."""
        T = self.seen.from_shared_world(self.perspective)
        return np.full((4, 4), np.nan) if T is None else self.T_stage_perspective @ T

    def T_perspective_world(self, person: Person) -> Float64 | None:  # noqa: N802 - the field's notation
        """Return the transform (4, 4) from a person's world to the perspective's camera space.

        For `FREE`, it is `Perspectives.T_free_world`, the same for every person. None if the perspective's sensor has
        no known pose and never saw the person. A method may use a separate world for each person (see
        `mocapella.viewer.perspective`).
        """
        return self.seen.from_world(person, self.perspective)


@dataclass(frozen=True, eq=False)
class PartDrawing:
    """Drawing of the parts of one type, in the view's space [m].

    Attributes:
        bones, joints: strokes of bones or lines, and of balls (`mocapella.viewer.bones`).
        halos: strokes of translucent balls.
        tags: text labels.
        surfaces, skins: meshes by name; the name of a part's mesh must not change.
        unseen: names of parts that cannot be shown, because their positions in the perspective are unknown.
        remarks: what users must know of parts, such as that no joint of one is known; shown in the stage's title.
        sensors: poses (4, 4), from camera space to the view's space, of the sensors that saw the parts, by name.
        extent: smallest and largest corner (3,) of an upright box that the browser's camera follows; None for none.
    """

    bones: Strokes = NO_STROKES
    joints: Strokes = NO_STROKES
    halos: Strokes = NO_STROKES
    tags: tuple[Tag, ...] = ()
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    skins: Mapping[str, Skin] = field(default_factory=dict)
    unseen: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    sensors: Mapping[str, Float64] = field(default_factory=dict)
    extent: tuple[Float64, Float64] | None = None

    @property
    def there(self) -> bool:
        """Whether the drawing has content: strokes, labels, meshes, or names of parts that cannot be shown."""
        strokes = len(self.bones) + len(self.joints) + len(self.halos)
        return bool(strokes or self.tags or self.surfaces or self.skins or self.unseen or self.remarks)


NOTHING: Final = PartDrawing()


@dataclass(frozen=True, eq=False)
class ImageLines:
    """Lines and text drawn over a camera's image.

    Attributes:
        words: text above the image, such as ``93%``; may be empty.
        ends_px: (n, 2, 2) float32 x, y of the end points of line segments [px].
        colours: colour of each of the n segments.
    """

    words: str
    ends_px: Float32
    colours: tuple[Rgb, ...]


def _no_space(parts: tuple[Any, ...]) -> StageSpace | None:
    return None


def _no_images(parts: tuple[Any, ...]) -> Mapping[str, ImageLines]:
    return {}


@dataclass(frozen=True, eq=False)
class DrawPart:
    """Descriptor of the drawing of one part type.

    Attributes:
        draw: function of the parts, their scene and the `RoomView`. If the perspective's pose in the world is unknown,
            it is called only if ``own_places``.
        own_places: whether ``draw`` places each part with `RoomView.T_perspective_world`, as for people.
        space: function of the parts that returns the pose of the world in the `FREE` perspective; None for the
            identity.
        images: function of the parts that returns lines over camera images, by camera; these images are shown above
            the stage.
        panel: function that creates the parts' folder in a browser's panel; None for no folder.
    """

    draw: Callable[[tuple[Any, ...], Scene, RoomView], PartDrawing]
    own_places: bool = False
    space: Callable[[tuple[Any, ...]], StageSpace | None] = _no_space
    images: Callable[[tuple[Any, ...]], Mapping[str, ImageLines]] = _no_images
    panel: MakePanel | None = None


def drawing_of(name: str, troubles: PluginErrors) -> DrawPart | None:
    """Return the drawing descriptor of a part type by the type's name; None if the type has none or is unknown.

    If the descriptor cannot be imported, the error is reported to ``troubles``, and None is returned.
    """
    kind = PART_TYPES.get(name)
    if kind is None or not kind.drawing:
        return None
    return troubles.attempt(called(name), lambda: _loaded(kind.drawing), None)


def draw_parts(name: str, parts: tuple[Any, ...], scene: Scene, room: RoomView, troubles: PluginErrors) -> PartDrawing:
    """Draw a scene's parts of one type; empty if the type has no drawing, or drawing fails (reported to ``troubles``).

    Args:
        name: name of the part type.
        parts: the parts.
        scene: the parts' scene.
        room: viewpoint of the drawing.
        troubles: receives errors.
    """
    how = drawing_of(name, troubles)
    if how is None or not parts:
        return NOTHING
    if not how.own_places and room.seen.from_shared_world(room.perspective) is None:
        return NOTHING
    return troubles.attempt(called(name), lambda: _drawn(how, parts, scene, room), NOTHING)


def called(name: str) -> str:
    """Return the noun for a part type's drawing in error messages: ``scene part people`` for the name ``people``."""
    return f"scene part {name}"


def _drawn(how: DrawPart, parts: tuple[Any, ...], scene: Scene, room: RoomView) -> PartDrawing:
    drawing = how.draw(parts, scene, room)
    if not isinstance(drawing, PartDrawing):
        raise TypeError(f"it makes {type(drawing).__name__}; a PartDrawing is wanted")
    for strokes in (drawing.bones, drawing.joints, drawing.halos):
        checked(strokes)
    return drawing


@cache
def _loaded(reference: str) -> DrawPart:
    found = load(reference)
    return found if isinstance(found, DrawPart) else DrawPart(found)
