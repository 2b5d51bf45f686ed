"""The folder of fitted bodies: there from the first body on; angles are of whoever is chosen, up to what is shown."""

from __future__ import annotations

import numpy as np
import pytest
from support.fitted_scenes import body, scene, view
from support.silhouette_pictures import pose_at, somebody

from mocapella.model.body_meshes import legs_mesh
from mocapella.model.twist_tree import TreePose
from mocapella.viewer.body_panel import CHARTS_EVERY_S, BodyPanel
from mocapella.viewer.page import open_page
from mocapella.viewer.part_panel import PanelPlace, PanelState

MESH, LEGS = somebody(), legs_mesh("female", 1.7)


def of_two(k):
    legs = TreePose(pose_at(MESH, 1.0).T_world_model, np.full(len(LEGS.joint_names), 0.01 * k))
    elbows = pose_at(MESH, -1.0, 0.4 + 0.01 * k)
    return scene(k, body(MESH, elbows, view("c1"), name="anna"), body(LEGS, legs, view("c1"), name="ben"))


@pytest.fixture
def panel():
    server = open_page("127.0.0.1", 0, 340)
    yield BodyPanel(PanelPlace(server.gui, 1.0))
    server.stop()


class Shows:
    """Shows scenes up to the k-th."""

    def __init__(self, panel):
        self.panel, self.now_s = panel, 0.0

    def __call__(self, scenes, visible=True):
        self.now_s += 2 * CHARTS_EVERY_S
        shown = scenes[-1] if scenes else None
        parts = shown.bodies if shown is not None else ()

        def lately(seconds):
            return [one.at_ns / 1e9 for one in scenes], list(scenes)

        self.panel.show(PanelState(shown, parts, None, visible, False, True, self.now_s, lately))


def test_it_is_there_from_the_first_body_on_while_the_method_makes_any(panel):
    show = Shows(panel)
    show([])
    assert not panel._folder.visible
    show([of_two(0)])
    assert panel._folder.visible
    assert "anna" in panel._outlines.content
    show([scene(1)])
    assert panel._folder.visible
    assert "No body is fitted" in panel._outlines.content
    show([scene(1)], visible=False)
    assert not panel._folder.visible


def test_angles_are_of_who_is_chosen_and_both_have_charts_of_their_joints(panel):
    show = Shows(panel)
    scenes = [of_two(k) for k in range(10)]
    show(scenes)
    assert panel.whose == "anna"
    assert panel._whose.visible
    assert [chart._choice.value for chart in panel._charts] == ["knee flexion", "hip flexion"]
    at_s, left, right = panel._charts[0]._handle.data
    assert len(at_s) == 10
    np.testing.assert_array_equal(left, right)
    panel._whose.value = "ben"
    show(scenes[:6])
    at_s, left, _ = panel._charts[0]._handle.data
    np.testing.assert_allclose(left, np.degrees(0.01 * np.arange(6)))
    assert all(chart._names == tuple(LEGS.joint_names) for chart in panel._charts)
    alone = [scene(0, body(MESH, pose_at(MESH), view("c1")))]
    show(alone)
    assert not panel._whose.visible
    assert panel.whose == "body 0"
