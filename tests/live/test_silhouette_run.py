"""A body followed through images, and every way in which cameras and people fail."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from silhouette_pictures import Room, pose_at, ring, somebody

from mocapella.live.silhouette_run import LOST_AFTER_S, SAID_AFTER, SilhouetteRun
from mocapella.model.camera import CameraRig
from mocapella.recording.followed_bodies import ALONE
from mocapella.sources.frame_set import FrameSet, time_of_frame

HZ = 30.0
MESH = somebody()
RIG = ring(3)


def start(rig=RIG, aside_m=0.0):
    run = SilhouetteRun({ALONE: MESH}, rig)
    run.start({ALONE: pose_at(MESH, aside_m)}, time_of_frame(-1, HZ))
    return run


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
    assert said[-1] == "the body is there again"


def wrong_way_round(images):
    return {**images, "c1": images["c3"], "c3": images["c1"]}


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
        run.empty.learn(wrong_way_round(empty) if mixed else empty)
        run.step(FrameSet.at_rate(0, HZ, wrong_way_round(images) if mixed else images))
        assert [note.partition(":")[0] for note in run.notes] == (["c1", "c3"] if mixed else [])


def test_a_camera_that_stands_elsewhere_is_said_where_the_empty_room_is_known():
    placed = RIG.cameras["c2"]
    T = placed.T_camera_world.copy()
    T[1, 3] += 0.7
    run = start(CameraRig({**RIG.cameras, "c2": msgspec.structs.replace(placed, T_camera_world=T)}))
    room = Room(RIG)
    run.empty.learn(room.images())
    run.step(FrameSet.at_rate(0, HZ, room.images(MESH, pose_at(MESH))))
    assert "c2 stands elsewhere" in run.notes[0]
    assert "c2: the body covers other parts" in run.notes[1]
