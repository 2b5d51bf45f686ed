"""Views are drawn with the poses that a scene has for their sensors, also while these approach refined ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from support.walking_people import FRONT, SIDE, Walker

from mocapella.model.scene import Scene
from mocapella.schema.scenes import encode_scene
from mocapella.testing.walking import walking_arrivals
from mocapella.tracker.default import DefaultTracker

FARTHER = SIDE.copy()
FARTHER[:3, 3] += (0.08, 0.03, -0.05)


def _tracker(places: Mapping[str, np.ndarray]) -> DefaultTracker:
    tracker = DefaultTracker(sensors_expected=2)
    tracker.start_from(places)
    return tracker


def _check(scene: Scene) -> int:
    """Check that each view has the pose of its sensor, to the bit; return the number of views."""
    places = {place.sensor: place.T_world_sensor for place in scene.sensors}
    views = [view for person in scene.people for view in person.views]
    for view in views:
        place = places[view.sensor]
        assert place is not None
        np.testing.assert_array_equal(view.T_world_sensor, place)
    return len(views)


def test_each_view_has_the_pose_of_its_sensor_also_after_a_restart_of_another_session() -> None:
    arrivals = walking_arrivals({1: Walker()}, 4.0, {"front": FRONT, "side": SIDE}, noise=0.005)
    one = _tracker({"front": FRONT, "side": FARTHER})
    other = _tracker({"side": SIDE, "front": FRONT})  # the first one is the origin
    views = sum(_check(one.update(arrival)) for arrival in arrivals[:199])
    for arrival in arrivals[:150]:
        other.update(arrival)
    session = other.snapshot()
    for end in range(199, 205):  # between two steps of the approach, too
        other.restore(session)
        for arrival in arrivals[150:156]:
            views += _check(other.update(arrival))
        other.restore(one.snapshot())
        for arrival in arrivals[end : end + 3]:
            views += _check(other.update(arrival))
        _check(one.update(arrivals[end]))
    assert views > 300


def test_scenes_that_were_given_out_keep_their_views() -> None:
    """Views are replaced in place from frame to frame, which must not reach the scenes of earlier frames."""
    tracker = _tracker({"front": FRONT, "side": FARTHER})
    arrivals = walking_arrivals({1: Walker()}, 1.0, {"front": FRONT, "side": SIDE}, noise=0.005)
    scenes = [tracker.update(arrival) for arrival in arrivals[:40]]
    before = [encode_scene(scene) for scene in scenes]
    later = [tracker.update(arrival) for arrival in arrivals[40:]]
    assert [encode_scene(scene) for scene in scenes] == before
    newest = [one.time_ns for scene in (*scenes, *later) for person in scene.people for one in person.views]
    assert len(set(newest)) > 30  # the views did change
