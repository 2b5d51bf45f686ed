"""Edges of the room at a body's outline."""

from __future__ import annotations

from copy import deepcopy

import pytest
from support.silhouette_room import Room, bent, ring

from mocapella.errors import SettingsError
from mocapella.kinematics.silhouette_fit import Outline, eye, figure, see
from mocapella.model.rigged_mesh import posed
from mocapella.model.twist_tree import TreePose
from mocapella.sensing.background_memory import BackgroundMemory
from mocapella.sensing.room_edges import RoomEdges

ROOM = Room(rig=ring(1), noise=1.0)
NAME, PLACED = next(iter(ROOM.rig.cameras.items()))
STEP_PX = 2
HERE = bent(ROOM.mesh, {})
THERE = bent(ROOM.mesh, {}, (0.7, 0.0, 0.3))


def outline(pose: TreePose) -> Outline:
    seen = see(figure(ROOM.mesh), posed(ROOM.mesh, pose), eye(PLACED), step_px=STEP_PX)
    assert seen is not None
    return seen


def background(*, known: bool) -> BackgroundMemory:
    memory = BackgroundMemory(STEP_PX)
    if known:
        memory.update(ROOM.walls()[NAME], None)
    return memory


def share(edges: RoomEdges, image_of: TreePose, model: TreePose, *, known: bool) -> float:
    """The share of a model's outline at which the image of a pose has edges of the room."""
    seen = outline(model)
    found = edges.of_room(ROOM.images(image_of)[NAME], seen.at, seen.normals, background(known=known))
    assert found.shape == (len(seen.at),)
    return float(found.mean())


def test_the_edges_of_a_body_are_its_own() -> None:
    assert share(RoomEdges(STEP_PX), HERE, HERE, known=True) < 0.05
    assert share(RoomEdges(STEP_PX), HERE, HERE, known=False) == 0.0


def test_edges_inside_which_the_image_shows_the_background_are_of_the_room() -> None:
    away = share(RoomEdges(STEP_PX), HERE, THERE, known=True)
    # The wall has no edge at most of its pixels, and what has none is no evidence anyway.
    assert away > 3 * share(RoomEdges(STEP_PX), HERE, HERE, known=True)
    assert away > 0.1


def test_edges_that_were_there_before_the_body_are_of_the_room() -> None:
    edges = RoomEdges(STEP_PX)
    edges.keep(ROOM.images(HERE)[NAME], outline(HERE).silhouette)
    assert share(edges, HERE, THERE, known=False) > 0.5
    assert share(edges, THERE, THERE, known=False) < 0.1, "the body came, and its edges with it"


def test_edges_at_which_the_body_was_in_the_first_image_are_its_own() -> None:
    edges = RoomEdges(STEP_PX)
    edges.keep(ROOM.images(HERE)[NAME], outline(HERE).silhouette)
    assert share(edges, HERE, HERE, known=False) == 0.0


def test_the_first_image_is_kept_until_a_reset_and_goes_with_the_memory() -> None:
    edges, other = RoomEdges(STEP_PX), RoomEdges(STEP_PX)
    edges.keep(ROOM.images(HERE)[NAME], outline(HERE).silhouette)
    before = share(edges, HERE, THERE, known=False)
    edges.keep(ROOM.images(THERE)[NAME], outline(THERE).silhouette)
    assert share(edges, HERE, THERE, known=False) == before
    other.recall(deepcopy(edges.memory()))
    assert share(other, HERE, THERE, known=False) == before
    edges.reset()
    assert share(edges, HERE, THERE, known=False) == 0.0


def test_gray_images_are_compared_as_well() -> None:
    edges = RoomEdges(STEP_PX)
    gray = ROOM.images(HERE)[NAME][..., 1].copy()
    edges.keep(gray, outline(HERE).silhouette)
    assert edges.of_room(gray, outline(THERE).at, outline(THERE).normals, BackgroundMemory(STEP_PX)).mean() > 0.5


def test_a_step_below_one_pixel_is_refused() -> None:
    with pytest.raises(SettingsError, match="step_px"):
        RoomEdges(0)
