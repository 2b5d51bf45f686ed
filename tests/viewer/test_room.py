"""Parts in the room are drawn as their type says; a plug-in's drawing needs nothing else, and may fail."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from support.drawings import Strict
from support.walkers import Room

from mocapella.geometry.rigid import apply, rigid, rotation_about_y
from mocapella.model.observations import JointState
from mocapella.model.part_types import PART_TYPES, PartType
from mocapella.model.scene import TrackedObject, UnknownPart
from mocapella.viewer.boards import image_lines
from mocapella.viewer.bones import joint_strokes
from mocapella.viewer.drawing import Tag
from mocapella.viewer.perspective import FREE
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.room import DrawPart, ImageLines, PartDrawing, drawing_of
from mocapella.viewer.stage import StageView, TrackingDrawing
from mocapella.viewer.stages import ROOM
from mocapella.viewer.view_state import ViewMemory

ROOM_OF_TWO = Room()
FRAMES = ROOM_OF_TWO.frames(0.0)
SCENE = ROOM_OF_TWO.scene(0.0, FRAMES)
AT = np.array([0.3, -0.2, 2.0])


class Balloon(msgspec.Struct, frozen=True, eq=False):
    """Of somebody's method."""

    position: np.ndarray


def float_up(parts: tuple[Balloon, ...], scene: Any, room: Any) -> PartDrawing:
    at = apply(room.T_stage_world, np.array([part.position for part in parts]))
    states = np.full((len(at), 1), JointState.TRACKED)
    x, y, z = at[0].tolist()
    return PartDrawing(
        joints=joint_strokes(at[:, None], states, [(255, 0, 0)] * len(at), [0.1]), tags=(Tag("a balloon", (x, y, z)),)
    )


def burst(parts: tuple[Balloon, ...], scene: Any, room: Any) -> PartDrawing:
    raise ZeroDivisionError("burst")


def blow(parts: tuple[Balloon, ...], scene: Any, room: Any) -> str:
    return "not a drawing"


def smear(parts: tuple[Balloon, ...]) -> dict[str, ImageLines]:
    raise KeyError("smear")


SMEARED = DrawPart(float_up, images=smear)


@pytest.fixture
def balloons(monkeypatch):
    def register(drawing: str) -> None:
        kind = PartType(1, "balloons", Balloon, lambda part: b"", lambda data, tree: None, drawing=drawing)
        monkeypatch.setitem(PART_TYPES, "balloons", kind)

    return register


def draw(scene: Any, troubles: PluginErrors, perspective: str = FREE) -> TrackingDrawing:
    known = ViewMemory(troubles=troubles)
    known.learn(scene, FRAMES, None)
    return ROOM.draw(scene, scene, StageView(perspective, known.seen, known.floors, troubles))


WITH = SCENE.with_parts(balloons=(Balloon(AT),))


@pytest.mark.parametrize("name", PART_TYPES)
def test_every_drawing_that_is_named_can_be_imported(name):
    drawing_of(name, Strict())


def test_a_plug_ins_part_stands_in_the_room_with_the_people(balloons):
    balloons(f"{__name__}:float_up")
    drawing, without = draw(WITH, Strict()), draw(SCENE, Strict())
    assert len(drawing.joints) == len(without.joints) + 1
    np.testing.assert_allclose(drawing.joints.positions[-1, [0, 2]], AT[[0, 2]], atol=1e-5)
    assert [tag.text for tag in drawing.tags][-1] == "a balloon"
    alone = msgspec.structs.replace(WITH, parts={"balloons": WITH.of("balloons")})
    assert draw(alone, Strict()).there


@pytest.mark.parametrize(
    ("drawing", "said"),
    [
        (f"{__name__}:burst", "ZeroDivisionError: burst"),
        (f"{__name__}:blow", "it makes str; a PartDrawing is wanted"),
        ("nowhere:AT_ALL", "cannot be imported"),
    ],
)
def test_a_drawing_that_raises_is_skipped_the_others_are_drawn_and_it_is_told_once(balloons, drawing, said):
    balloons(drawing)
    troubles = PluginErrors()
    for _ in range(3):
        assert len(draw(WITH, troubles).joints) == len(draw(SCENE, troubles).joints)
    (line,) = troubles.lines
    assert line.startswith("scene part balloons cannot be drawn: ")
    assert said in line


def test_lines_in_images_that_raise_are_skipped_too(balloons):
    balloons(f"{__name__}:SMEARED")
    troubles = PluginErrors()
    assert image_lines(WITH, troubles) == {}
    assert "KeyError" in troubles.lines[0]
    assert draw(WITH, troubles).there


def test_parts_without_a_drawing_and_of_no_known_type_are_left_out():
    unknown = SCENE.with_parts(gongs=(UnknownPart("gongs", b""),), points=())
    assert len(draw(unknown, Strict()).joints) == len(draw(SCENE, Strict()).joints)


def test_where_the_perspective_has_no_place_in_the_world_only_people_are_placed_who_were_seen(balloons):
    balloons(f"{__name__}:float_up")
    drawing = draw(WITH, Strict(), "front")  # the scene gives sensors no places
    assert len(drawing.joints) == len(draw(SCENE, Strict(), "front").joints) > 0


def test_a_thing_is_its_outline_where_it_is_and_thin_where_it_was_last_seen():
    square = 0.1 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    T = rigid(rotation_about_y(0.4), AT)
    thing = TrackedObject("cup", T, square, JointState.TRACKED)
    drawing = draw(SCENE.with_parts(objects=(thing,)), Strict())
    people = len(draw(SCENE, Strict()).bones)
    assert len(drawing.bones) == people + 4
    here = drawing.bones.positions[people:]
    np.testing.assert_allclose(np.linalg.norm(np.roll(here, -1, 0) - here, axis=1), 0.2, rtol=1e-4)
    np.testing.assert_allclose(here.mean(axis=0)[[0, 2]], AT[[0, 2]], atol=1e-5)
    seen_last = draw(SCENE.with_parts(objects=(msgspec.structs.replace(thing, state=JointState.INFERRED),)), Strict())
    assert seen_last.bones.scales[people, 0] < drawing.bones.scales[people, 0]
    gone = TrackedObject("cup", None, square, JointState.NOT_TRACKED)
    assert len(draw(SCENE.with_parts(objects=(gone,)), Strict()).bones) == people


def test_so_many_troubles_are_kept_and_no_more():
    troubles = PluginErrors()
    for k in range(100):
        troubles.tell(f"lane {k}", ValueError("x" * 1000))
    assert len(troubles.lines) == 20
    assert max(map(len, troubles.lines)) <= 300
