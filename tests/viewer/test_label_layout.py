"""Labels are kept apart on the screen, and legends and scenery show what they are given."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.sources.simulate.scenery import scenery_of
from mocapella.viewer.drawing import Tag
from mocapella.viewer.label_layout import LabelCamera, apart
from mocapella.viewer.legend import legend_html
from mocapella.viewer.perspective import FREE

UP = np.array([0.0, 1.0, 0.0])


def camera() -> LabelCamera:
    made = LabelCamera.looking(np.array([0.0, 1.0, -5.0]), np.array([0.0, 1.0, 0.0]), UP, np.radians(36), 800)
    assert made is not None
    return made


def test_a_label_that_covers_another_moves_up_and_the_first_one_stays() -> None:
    near, far = Tag("Person 0", (0.0, 1.0, 0.0)), Tag("Person 1", (0.02, 1.01, 0.0))
    ((first, second),) = apart([(1.0, [near, far])], camera())
    assert first == near
    assert second.position[1] > 1.05
    assert (second.position[0], second.position[2]) == pytest.approx((0.02, 0.0), abs=1e-3)


def test_labels_that_do_not_cover_each_other_and_hidden_ones_stay() -> None:
    tags = [Tag("a", (0.0, 1.0, 0.0)), Tag("b", (1.0, 1.0, 0.0)), Tag("c", (0.0, 1.0, 0.0), visible=False)]
    assert apart([(1.0, tags)], camera()) == [tags]
    behind = [Tag("a", (0.0, 1.0, -9.0)), Tag("b", (0.0, 1.0, -9.0))]
    assert apart([(1.0, behind)], camera()) == [behind]


def test_a_camera_that_looks_nowhere_is_none() -> None:
    assert LabelCamera.looking(UP, UP, UP, 0.6, 800) is None
    assert LabelCamera.looking(np.zeros(3), UP, UP, 0.6, 800) is None


def test_the_legend_names_the_sensor_and_escapes_it() -> None:
    assert "hidden from <b>a&lt;b</b>" in legend_html("a<b", obstacle=False)
    assert "obstacle" in legend_html(FREE, obstacle=True)
    assert "hidden" not in legend_html(FREE, obstacle=True)
    assert "hidden" not in legend_html("a<b", obstacle=False, views=False)
    assert "each sensor" not in legend_html(FREE, obstacle=False, views=False)


def test_the_obstacle_of_the_demo_is_a_closed_solid_without_a_bottom() -> None:
    scenery = scenery_of("obstacle")
    (solid,) = scenery.solids
    assert set(scenery.T_room_sensor) == {"front", "right", "left"}
    assert solid.vertices[:, 1].max() == pytest.approx(1.1)
    middle = np.array([0.0, 0.55, 3.0])
    a, b, c = (solid.vertices[solid.faces[:, k]] - middle for k in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3) > 0).all()  # all faces look outwards
