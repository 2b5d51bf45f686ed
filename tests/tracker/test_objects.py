"""Objects of each kind beside a hand: found, carried while hidden, let go, and refused with a reason."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any

import msgspec
import numpy as np
import pytest
from support.hand_frames import CUBE, HZ, IN_PALM, NOISE_PX, hands_settings, palm_at, scene, seen_by

from mocapella.errors import SettingsError
from mocapella.fusion.object_poses import ObjectPoseSettings
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x, rotation_about_y
from mocapella.geometry.twists import log_motion
from mocapella.kinematics.grasp import GraspSettings
from mocapella.model.markers import MarkerFrame, joined, marker_frame
from mocapella.model.observations import Arrival, JointState
from mocapella.model.poses import pose_frame, quaternion_of
from mocapella.model.scene import Scene
from mocapella.model.space import SpaceAlignment, as_settings, rows_of
from mocapella.model.tags import corner_names
from mocapella.schema import decode_frame, encode_frame, encode_scene
from mocapella.tracker.hands import HandsSettings, HandsTracker
from mocapella.tracker.objects import ObjectSettings, RigidObjects, TagPlace

SIZE = (0.16, 0.16, 0.16)
TAGGED = ObjectSettings("box", size_m=SIZE, tags=(TagPlace(7, 0.05, (0.0, -0.02, 0.0), up=(0.0, 0.0, 1.0)),))
T_WORLD_VR = rigid(rotation_about_y(1.1), [0.3, -0.2, 0.5])
DELAY_S = 0.03
VR = SpaceAlignment("vr", rows_of(T_WORLD_VR), DELAY_S)
FOLLOWED = ObjectSettings("cup", size_m=SIZE, space="vr", body="LHR-1", origin_m=(0.0, 0.0, 0.03))
APART = rigid(rotation_about_x(0.4), [0.2, 0.05, -0.25])
KINDS = {"colours": CUBE, "tag": TAGGED, "other tracker": FOLLOWED}


def tracker(thing: ObjectSettings, **changed: Any) -> HandsTracker:
    changed = {"spaces": (VR,) if thing.space else (), "tag_sd_px": 0.0, **changed}
    return HandsTracker(scene().rig, hands_settings(thing, **changed), shape=scene().shape)


def watched(
    thing: ObjectSettings, start: int, stop: int, *, T: np.ndarray | None = None, hidden: bool = False,
    no_hand: bool = False,
) -> Iterator[Arrival]:  # fmt: skip
    """Frames of both cameras and, where it follows the thing, of the other tracker: in the palm, or at ``T``."""
    gone = scene().names if no_hand else ()
    for k in range(start, stop):
        for camera, at_s in (("left", k / HZ), ("right", (k + 0.5) / HZ)):
            place = palm_at(at_s) @ IN_PALM if T is None else T
            if thing is CUBE:
                yield seen_by(camera, at_s, hidden=(*gone, *(CUBE.markers if hidden else ())), T_world_cube=place)
                continue
            made = seen_by(camera, at_s, hidden=gone)
            if thing.points and not hidden:
                eye = scene().cameras[camera]
                px = project(apply(eye.T_camera_world @ place, thing.points_m), eye.lens)
                px += np.random.default_rng([k, 5, len(camera)]).normal(0, NOISE_PX, px.shape)
                tags = marker_frame(
                    camera, thing.points, time_ns=made.frame.time_ns, size_px=eye.size_px, positions_px=px,
                    sd_px=NOISE_PX,
                )  # fmt: skip
                made = Arrival(joined(made.frame, tags), made.at_ns)  # type: ignore[arg-type]
            yield made
        if thing.space and not hidden:
            at_s = (k + 0.7) / HZ
            place = palm_at(at_s) @ IN_PALM if T is None else T
            body = inverse(T_WORLD_VR) @ place @ rigid(np.eye(3), [0.0, 0.0, -0.03])
            yield told("vr", "LHR-1", body, at_s + DELAY_S)


def told(space: str, body: str, T: np.ndarray, at_s: float) -> Arrival:
    at_ns = round(at_s * 1e9) + 1
    frame = pose_frame(
        "vive", space, [body], time_ns=at_ns, positions=[T[:3, 3]], orientations=[quaternion_of(T[:3, :3])]
    )
    return Arrival(decode_frame(encode_frame(frame)), at_ns)


def run(made: HandsTracker, arrivals: Iterable[Arrival]) -> list[Scene]:
    return [made.update(arrival) for arrival in arrivals]


def off(one: Scene, T: np.ndarray) -> tuple[float, float]:
    found = one.objects[0].T_world_object
    assert found is not None
    d = inverse(T) @ found
    return float(np.linalg.norm(d[:3, 3])), float(np.linalg.norm(log_motion(d)[3:]))


@pytest.mark.parametrize("kind", KINDS)
def test_a_thing_apart_is_tracked_and_not_held(kind: str) -> None:
    thing = KINDS[kind]
    for one in run(tracker(thing), watched(thing, 0, 30, T=APART))[60:]:
        (found,) = one.objects
        assert (found.name, found.state) == (thing.name, JointState.TRACKED)
        away, turned = off(one, APART)
        assert away < 0.003
        assert turned < 0.03
        assert one.hands[0].holds == ""


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_thing_is_grabbed_carried_while_hidden_and_let_go(kind: str) -> None:
    thing = KINDS[kind]
    made = tracker(thing)
    held = run(made, watched(thing, 0, 30))
    assert held[-1].hands[0].holds == thing.name
    away, turned = off(held[-1], palm_at((held[-1].at_ns - 1) / 1e9 - (DELAY_S if thing.space else 0)) @ IN_PALM)
    assert away < 0.006
    assert turned < 0.06
    hidden = run(made, watched(thing, 30, 90, hidden=True))
    assert {one.hands[0].holds for one in hidden} == {thing.name}
    assert hidden[-1].objects[0].state == JointState.INFERRED
    away, _ = off(hidden[-1], palm_at((hidden[-1].at_ns - 1) / 1e9) @ IN_PALM)
    assert away < 0.04  # as the palm is inferred of one marker
    apart = run(made, watched(thing, 90, 130, T=APART))
    assert apart[-1].hands[0].holds == ""
    assert off(apart[-1], APART)[0] < 0.004


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_another_hand_does_not_hold_what_the_first_one_held(kind: str) -> None:
    thing = KINDS[kind]
    made = tracker(thing)
    assert run(made, watched(thing, 0, 30))[-1].hands[0].holds == thing.name
    left = palm_at(30 / HZ) @ IN_PALM @ rigid(np.eye(3), [0.3, 0.2, 0.1])
    gone = run(made, watched(thing, 30, 90, T=left, no_hand=True))
    assert gone[-1].hands == ()
    back = run(made, watched(thing, 90, 120, T=left))
    assert back[-1].hands[0].id == 1
    assert back[-1].hands[0].holds == ""
    assert off(back[-1], left)[0] < 0.004


@pytest.mark.parametrize("kind", KINDS)
def test_a_snapshot_goes_on_as_if_nothing_had_been(kind: str) -> None:
    thing = KINDS[kind]
    one, other = tracker(thing), tracker(thing)
    run(one, watched(thing, 0, 20))
    other.restore(one.snapshot())
    for here, there in zip(run(one, watched(thing, 20, 30)), run(other, watched(thing, 20, 30)), strict=True):
        assert encode_scene(here) == encode_scene(there)


def test_one_camera_is_enough_for_a_tag() -> None:
    made = tracker(TAGGED)
    arrivals = [one for one in watched(TAGGED, 0, 40, T=APART) if one.frame.sensor == "left"]
    last = run(made, arrivals)[-1]
    assert last.objects[0].state == JointState.TRACKED
    assert off(last, APART)[0] < 0.01


@pytest.mark.parametrize(
    ("thing", "own", "other"), [(CUBE, "marker_sd_px", "tag_sd_px"), (TAGGED, "tag_sd_px", "marker_sd_px")]
)
def test_how_unsure_tags_are_moves_no_thing_of_colours_and_the_other_way_round(
    thing: ObjectSettings, own: str, other: str
) -> None:
    def pose(**sd_px: float) -> np.ndarray:
        made = RigidObjects(scene().rig, [thing], ObjectPoseSettings(), GraspSettings())
        for arrival in watched(thing, 0, 3, T=APART):
            assert isinstance(arrival.frame, MarkerFrame)
            at_s = arrival.frame.time_ns * 1e-9
            made.add_markers(arrival.frame, at_s, **sd_px)
        (found,) = made.track(None, at_s)
        assert found.T_world_object is not None
        return found.T_world_object

    usual = pose(**{own: 0.1, other: 0.1})
    np.testing.assert_array_equal(pose(**{own: 0.1, other: 5.0}), usual)
    assert (pose(**{own: 5.0, other: 0.1}) != usual).any()


def test_another_trackers_poses_are_predicted_for_a_moment() -> None:
    made, errors = tracker(FOLLOWED), []
    for arrival in watched(FOLLOWED, 0, 60):
        one = made.update(arrival)
        if arrival.frame.sensor != "vive" and one.step > 30:
            errors.append(off(one, palm_at((arrival.at_ns - 1) / 1e9) @ IN_PALM)[0])
    assert np.median(errors) < 0.003
    assert np.max(errors) < 0.01


@pytest.mark.parametrize(
    ("arrival", "said"),
    [
        (
            told("stage", "LHR-1", np.eye(4), 1.0),
            "its space 'stage' is not aligned with the cameras: mocapella calibrate space",
        ),
        (told("vr", "LHR-9", np.eye(4), 1.0), "none of its bodies is a configured object: --set 'objects=.*LHR-9"),
    ],
)
def test_poses_that_cannot_be_used_are_counted(arrival: Arrival, said: str) -> None:
    made = tracker(FOLLOWED)
    one = made.update(arrival)
    assert one.objects == ()
    (reason,) = made.report.rejected
    assert re.search(said, reason)


def test_poses_that_go_back_in_time_are_counted() -> None:
    made = tracker(FOLLOWED)
    made.update(told("vr", "LHR-1", np.eye(4), 1.0))
    made.update(told("vr", "LHR-1", np.eye(4), 0.9))
    assert made.report.rejected == {"time goes backwards": 1}


def test_settings_of_files_are_read() -> None:
    values = {
        "objects": [{"name": "box", "tag": 7, "tag_side_m": 0.05}, {"name": "cup", "space": "vr", "body": "LHR-1"}],
        "spaces": [as_settings(VR)],
    }
    made = msgspec.convert(values, HandsSettings)
    assert made.spaces == (VR,)
    assert made.objects[0].points == corner_names(7)
    np.testing.assert_allclose(made.objects[0].points_m[:, 2], 0.03)
    assert made.objects[0].planes == ((0, 1, 2, 3),)
    assert set(corner_names(7)) < set(made.markers)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"space": "vr"}, "1 to 80 characters each"),
        ({"space": "vr", "body": "b", "tag": 1}, "without markers and tags"),
        ({"tag": -1}, "tag is -1"),
        ({"tag": 1, "tag_side_m": 0.0}, "side_m"),
        ({"tag": 1, "tags": (TagPlace(1, 0.05),)}, "each number once"),
        ({"tag": 1, "origin_m": (0.0, 0.0, np.nan)}, "origin_m"),
        ({}, "three or more, each once; or give it a tag"),
    ],
)
def test_things_that_cannot_be_are_refused(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        ObjectSettings("x", **changed)


def test_tags_and_settings_that_cannot_be_are_refused() -> None:
    with pytest.raises(SettingsError, match="at right angles"):
        TagPlace(1, 0.05, right=(1.0, 0.0, 0.0), up=(1.0, 0.0, 0.0))
    with pytest.raises(SettingsError, match="middle_m"):
        TagPlace(1, 0.05, middle_m=(np.inf, 0.0, 0.0))
    with pytest.raises(SettingsError, match="spaces"):
        HandsSettings(spaces=(VR, VR))
    with pytest.raises(SettingsError, match="its own name"):
        HandsSettings(objects=(ObjectSettings("x", tag=1), ObjectSettings("x", tag=2)))
    with pytest.raises(SettingsError, match="tag_sd_px"):
        HandsSettings(tag_sd_px=-1.0)
