"""A body followed through images, and every way in which cameras and people fail."""

from __future__ import annotations

import gc

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.silhouette_pictures import Room, pose_at, ring, silhouettes_of, somebody
from support.silhouette_rows import RunWithRows

from mocapella.kinematics.silhouette_fit import eye, within
from mocapella.live.silhouette_run import SilhouetteRun
from mocapella.live.silhouette_statistics import BinnedValues
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.recording.bodies_file import ALONE, FollowedFrame
from mocapella.sources.frame_set import FrameSet
from mocapella.tracker.body_presence import LOST_AFTER_S
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouette_conditions import SAID_AFTER
from mocapella.tracker.silhouette_views import NO_PICTURE
from mocapella.tracker.silhouettes import SilhouettesTracker

HZ = 30.0
MESH = somebody()
RIG = ring(3)
HERE = 16


def start(rig=RIG, aside_m=0.0, **how):
    return RunWithRows({ALONE: MESH}, rig, {ALONE: pose_at(MESH, aside_m)}, HZ, **how)


@pytest.fixture(scope="module")
def followed():
    """Somebody who goes aside, slowly, and bends the elbows; where they were."""
    run, room, poses = start(), Room(RIG), []
    for k in range(8):
        poses.append(pose_at(MESH, 0.01 * k, 0.4 + 0.05 * k))
        run.step(FrameSet.at_rate(k, HZ, room.images(MESH, poses[-1])))
    return run, poses


def test_a_body_is_followed(followed):
    run, poses = followed
    last = run.rows[ALONE][-1].pose(MESH.joint_names)
    assert np.linalg.norm(last.T_world_model[:3, 3] - poses[-1].T_world_model[:3, 3]) < 0.03
    assert min(min(row.overlap.values()) for row in run.rows[ALONE]) > 0.85
    assert run.notes == []
    assert [row.time_s for row in run.rows[ALONE]] == pytest.approx([k / HZ for k in range(8)])


def test_the_summary_counts(followed):
    run, _ = followed
    summary = run.summary_of(ALONE)
    assert (summary["frames"], summary["lost"], summary["left_out"]) == (8, 0, {})
    assert 0.85 < summary["median_overlap"] <= 1.0


@pytest.mark.parametrize(("fault", "said"), [("black", "its image is black"), ("frozen", "frozen")])
def test_a_camera_that_shows_nothing_is_left_out_and_said(fault, said):
    run, room = start(), Room(RIG)
    frozen = None
    for k in range(2 + SAID_AFTER + 3):
        images = room.images(MESH, pose_at(MESH, 0.01 * k))
        if k >= 2 and fault == "black":
            images["c2"] = np.zeros_like(images["c2"])
        elif k >= 2:
            frozen = images["c2"] if frozen is None else frozen
            images["c2"] = frozen
        run.step(FrameSet.at_rate(k, HZ, images))
    assert said in run.rows[ALONE][-1].left_out["c2"]
    assert "c2" not in run.rows[ALONE][-1].overlap
    assert [note for note in run.notes if "c2 does not count" in note and said in note]
    assert min(run.rows[ALONE][-1].overlap.values()) > 0.85
    assert set(run.summary_of(ALONE)["left_out"]) == {"c2"}


@pytest.mark.slow
def test_a_person_who_leaves_is_said_and_followed_again():
    run, room = start(), Room(RIG)
    # As in a lift: that way all cameras lose sight. Nobody stops at once.
    there = (3.6 * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 90)))).tolist()
    away = [3.6] * (round(LOST_AFTER_S * HZ) + 4)
    places = [*there, *away, *reversed(there), *[0.0] * 5]
    for k, up_m in enumerate(places):
        run.step(FrameSet.at_rate(k, HZ, room.images(MESH, pose_at(MESH, up_m=up_m))))
    lost = [row.lost for row in run.rows[ALONE]]
    assert any(lost[len(there) : len(there) + len(away)])
    assert not lost[0]
    assert not lost[-1]
    assert np.linalg.norm(run.rows[ALONE][-1].pose(MESH.joint_names).T_world_model[:3, 3]) < 0.2
    said = [note.partition(": ")[2] for note in run.notes if note.startswith("frame")]
    assert said[0] == "the body is in no camera's image any more; the last place is watched"
    assert said[-1] == "the body is there again, found in its last posture"


def wrong_way_round(images):
    return {**images, "c1": images["c3"], "c3": images["c1"]}


@pytest.mark.slow
def test_the_videos_of_two_cameras_the_wrong_way_round_are_said_once_somebody_moves():
    for mixed in (False, True):
        run, room = start(aside_m=0.5), Room(RIG)
        for k in range(12):
            images = room.images(MESH, pose_at(MESH, 0.5 + 0.05 * k))
            run.step(FrameSet.at_rate(k, HZ, wrong_way_round(images) if mixed else images))
        said = [note for note in run.notes if "of what moves in its images is where the body is" in note]
        assert bool(said) == mixed
        assert all(note.startswith(("c1", "c3")) for note in said)


def test_the_videos_of_two_cameras_the_wrong_way_round_are_said_at_once_where_the_empty_room_is_known():
    for mixed in (False, True):
        run, room = start(aside_m=0.3), Room(RIG)
        empty, images = room.images(), room.images(MESH, pose_at(MESH, 0.3))
        run.learn_empty(wrong_way_round(empty) if mixed else empty)
        run.step(FrameSet.at_rate(0, HZ, wrong_way_round(images) if mixed else images))
        assert [note.partition(":")[0] for note in run.notes] == (["c1", "c3"] if mixed else [])


def test_a_camera_that_stands_elsewhere_is_said_where_the_empty_room_is_known():
    placed = RIG.cameras["c2"]
    T = placed.T_camera_world.copy()
    T[1, 3] += 0.7
    run = start(CameraRig({**RIG.cameras, "c2": msgspec.structs.replace(placed, T_camera_world=T)}))
    room = Room(RIG)
    run.learn_empty(room.images())
    run.step(FrameSet.at_rate(0, HZ, room.images(MESH, pose_at(MESH))))
    assert "c2 stands elsewhere" in run.notes[0]
    assert "c2: the body covers other parts" in run.notes[1]


def test_a_camera_without_a_picture_is_left_out_said_and_counts_again():
    run, room = start(), Room(RIG)
    gone = range(2, 2 + SAID_AFTER + 2)
    for k in range(gone.stop + 2):
        images = room.images(MESH, pose_at(MESH, 0.01 * k))
        run.step(
            FrameSet.at_rate(k, HZ, {name: image for name, image in images.items() if name != "c2" or k not in gone})
        )
    for row in run.rows[ALONE]:
        assert row.left_out == ({"c2": NO_PICTURE} if row.frame in gone else {})
        assert ("c2" in row.overlap) == (row.frame not in gone)
    assert run.notes == [
        f"c2 does not count from frame 2 on: {NO_PICTURE}", f"c2 counts again from frame {gone.stop} on"
    ]  # fmt: skip
    assert run.summary_of(ALONE)["left_out"] == {"c2": len(gone)}


def test_a_frame_without_any_picture_is_lived_through():
    run, room = start(), Room(RIG)
    for k in range(6):
        run.step(FrameSet.at_rate(k, HZ, {} if k == 3 else room.images(MESH, pose_at(MESH, 0.01 * k))))
    assert run.rows[ALONE][3].left_out == dict.fromkeys(RIG.cameras, NO_PICTURE)
    assert not any(row.lost for row in run.rows[ALONE])
    assert min(run.rows[ALONE][-1].overlap.values()) > 0.85


def test_times_are_those_of_capture():
    run, room, times = start(), Room(RIG), [0.0, 0.03, 0.13, 0.15, 0.24]
    for k, at_s in enumerate(times):
        run.step(FrameSet(k, round(1e9 * at_s), room.images(MESH, pose_at(MESH, 0.3 * at_s))))
    assert [row.time_s for row in run.rows[ALONE]] == times
    place = run.rows[ALONE][-1].pose(MESH.joint_names).T_world_model[:3, 3]
    assert np.linalg.norm(place - [0.3 * times[-1], 0, 0]) < 0.05  # a pixel is 2 cm


@pytest.fixture(scope="module")
def waited():
    """The empty room is known; something moves before one camera, then there is nothing, and then somebody is there."""
    run, room, steps = start(waiting=True), Room(RIG), []
    for _ in range(3):
        run.learn_empty(room.images())
    for k in range(HERE + 6):
        images = room.images() if k < HERE else room.images(MESH, pose_at(MESH, 0.03))
        if k < HERE / 2:
            images["c1"][20:60, 2 + 3 * k : 32 + 3 * k] = 10
        steps.append(run.step(FrameSet.at_rate(k, HZ, images)))
    return run, steps


@pytest.mark.slow
def test_somebody_who_is_not_there_yet_is_waited_for(waited):
    run, _ = waited
    lost = [row.lost for row in run.rows[ALONE]]
    assert all(lost[:HERE])
    assert not any(lost[HERE + 2 :])
    for row in run.rows[ALONE][:HERE]:
        np.testing.assert_allclose(row.pose(MESH.joint_names).T_world_model, pose_at(MESH).T_world_model, atol=1e-9)
    assert np.linalg.norm(run.rows[ALONE][-1].pose(MESH.joint_names).T_world_model[:3, 3] - [0.03, 0, 0]) < 0.06


@pytest.mark.slow
def test_it_is_said_that_somebody_came_and_nobody_is_suspected_meanwhile(waited):
    run, _ = waited
    (note,) = run.notes  # no camera is doubted because nobody is where the body waits
    assert note.endswith("the body is there")


@pytest.mark.slow
def test_where_it_waits_is_drawn_in_every_picture(waited):
    _, steps = waited
    outlines = silhouettes_of(MESH, RIG, pose_at(MESH))
    for name, picture in steps[5].pictures().items():
        drawn = cv2.absdiff(picture, steps[5].images[name]).max(axis=-1) > 30
        mask = outlines[name].mask(RIG.cameras[name].camera.size_px).astype(np.uint8)
        rim = cv2.dilate(mask, np.ones((5, 5))) > cv2.erode(mask, np.ones((5, 5)))
        assert np.count_nonzero(drawn) > 100
        assert np.count_nonzero(drawn & rim) > 0.95 * np.count_nonzero(drawn)


def test_who_is_behind_a_camera_is_not_in_its_image():
    """Lines of sight go both ways, and what a camera sees does not."""
    body = landmarks_at(MESH, pose_at(MESH))
    for placed in RIG.cameras.values():
        away = msgspec.structs.replace(placed, T_camera_world=np.diag([-1.0, 1.0, -1.0, 1.0]) @ placed.T_camera_world)
        assert within(body, eye(placed))
        assert not within(body, eye(away))


def test_a_run_keeps_none_of_its_rows_and_knows_what_they_came_to():
    gc.collect()
    before = count_of(FollowedFrame)
    run, room, rows = SilhouetteRun(SilhouettesTracker({ALONE: InitialBody(MESH, pose_at(MESH))}, RIG)), Room(RIG), []
    for k in range(6):
        rows.append(run.step(FrameSet.at_rate(k, HZ, room.images(MESH, pose_at(MESH, 0.01 * k)))).people[ALONE].row)
    overlaps = [value for row in rows for value in row.overlap.values()]
    assert run.summary_of(ALONE)["median_overlap"] == pytest.approx(np.median(overlaps), abs=5e-5)
    shown = [value for row in rows for value in row.shown.values()]
    assert len(shown) == len(overlaps)
    assert 0 < min(shown) <= max(shown) <= 1
    assert run.summary_of(ALONE)["median_shown"] == pytest.approx(np.median(shown), abs=5e-5)
    assert (run.frames, run.summary()["frames"]) == (6, 6)
    del rows
    gc.collect()
    assert count_of(FollowedFrame) <= before


def count_of(kind):
    return sum(type(one) is kind for one in gc.get_objects())  # what is weakly referenced may be gone


@given(st.lists(st.integers(0, 10_000), min_size=1, max_size=60), st.lists(st.integers(0, 10_000), max_size=9))
def test_the_median_of_what_is_counted_is_the_median(values, others):
    counted, more = BinnedValues(1e-4), BinnedValues(1e-4)
    for value in values:
        counted.add(value * 1e-4)
    for value in others:
        more.add(value * 1e-4)
    assert counted.median == pytest.approx(np.median(values) * 1e-4)
    assert counted.least == pytest.approx(min(values) * 1e-4)
    counted += more
    assert len(counted) == len(values) + len(others)
    assert counted.median == pytest.approx(np.median(values + others) * 1e-4)
    assert BinnedValues(1.0).median is None
