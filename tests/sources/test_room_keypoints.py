"""The simulated detector of a rendered room."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.model.topology import topology
from mocapella.sources.simulate.rendered_depth import rendered_scene
from mocapella.sources.simulate.room_depth import room_depth_scene
from mocapella.sources.simulate.room_keypoints import KeypointErrors, RoomKeypoints

NONE = KeypointErrors(0.0, 0.0, 0.0)


def test_without_errors_keypoints_are_where_joints_are_seen() -> None:
    scene = room_depth_scene("stand", seed=2, sensor="exact")
    seen = RoomKeypoints(scene, topology("coco_17"), NONE)
    shot = scene.at(8.0)
    truth, visible = seen.truth(shot)
    frame = seen.of(shot, "front", time_ns=5)
    assert np.allclose(frame.positions_px, project(truth, shot.lens), atol=1e-3)
    assert visible[0, 5:].all()
    assert (frame.confidences[visible] >= 0.6).all()
    assert frame.ids.tolist() == [0]


def test_the_same_instant_gives_the_same_keypoints_and_another_seed_others() -> None:
    scene = room_depth_scene("walk", seed=2, sensor="exact")
    seen = RoomKeypoints(scene, topology("halpe_26"))
    one, again = seen.at(9.0, "a", time_ns=1), seen.near(9_000_000_000)
    assert np.array_equal(one.positions_px, again.positions_px, equal_nan=True)
    other = RoomKeypoints(scene, topology("halpe_26"), seed=1).at(9.0, "a", time_ns=1)
    assert not np.array_equal(one.positions_px, other.positions_px, equal_nan=True)


def test_joints_behind_the_body_are_hidden_and_less_sure() -> None:
    scene = room_depth_scene("around", seed=2, sensor="exact")
    seen = RoomKeypoints(scene, topology("coco_17"))
    sure = {True: [], False: []}  # type: dict[bool, list[float]]
    for at_s in np.linspace(8.0, scene.period_s - 1, 6):
        shot = scene.at(float(at_s))
        frame, (_, visible) = seen.of(shot, "a", time_ns=1), seen.truth(shot)
        for row, person in enumerate(frame.ids.tolist()):
            for value, there in zip(frame.confidences[row], visible[person], strict=True):
                sure[bool(there)].append(float(value))
    assert len(sure[False]) > 5
    assert np.mean(sure[False]) < np.mean(sure[True]) - 0.2


def test_a_room_is_seen_from_the_place_of_each_of_its_sensors() -> None:
    front, right = (rendered_scene(f"room-stand/1/exact/{view}", "x") for view in ("front", "right"))
    assert not np.allclose(front.T_camera_world, right.T_camera_world)
    with pytest.raises(SettingsError, match="no sensor 'top'"):
        rendered_scene("room-stand/1/exact/top", "x")


def test_a_topology_without_known_joints_and_impossible_errors_are_refused() -> None:
    scene = room_depth_scene("stand", seed=2, sensor="exact")
    with pytest.raises(SettingsError, match="no mapping"):
        RoomKeypoints(scene, topology("hand"))
    with pytest.raises(SettingsError, match="missed"):
        KeypointErrors(missed=1.0)
