"""The method silhouettes as a tracker: what it says after each image, and that a memory goes on to the bit alike."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
import pytest
from support.silhouette_pictures import Room, pose_at, ring, silhouettes_of, somebody

from mocapella.errors import SettingsError, WireError
from mocapella.model.images import image_frame
from mocapella.model.observations import Arrival, JointState, body_frame
from mocapella.model.scene import Phase
from mocapella.model.topology import topology
from mocapella.sensing.images import encode_image
from mocapella.tracker.body_presence import LOST_AFTER_S
from mocapella.tracker.frame_sync import NOT_RISING
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.method import not_taken
from mocapella.tracker.silhouette_room import IMAGES, LEARNING
from mocapella.tracker.silhouette_views import DAMAGED, NO_PICTURE
from mocapella.tracker.silhouettes import TOO_LATE, SilhouettesTracker

HZ = 30.0
MESH = somebody()
RIG = ring(3, far_m=5.5)
NAMES = ("anna", "ben")


def at(frame):
    return round(1e9 * (frame + 1) / HZ)


def new(bodies=None, **how):
    poses = {"anna": pose_at(MESH, -0.6), "ben": pose_at(MESH, 0.6)} if bodies is None else bodies
    return SilhouettesTracker({name: InitialBody(MESH, pose) for name, pose in poses.items()}, RIG, **how)


def alone(**how):
    return new({"": pose_at(MESH)}, **how)


def pair(room, anna, ben):
    """Anna in red, and Ben in green, behind her where both are."""
    images, in_front = room.images(MESH, anna), silhouettes_of(MESH, RIG, anna)
    for name, covered in silhouettes_of(MESH, RIG, ben).items():
        mask = covered.mask(RIG.cameras[name].camera.size_px)
        if name in in_front:
            mask &= ~in_front[name].mask(RIG.cameras[name].camera.size_px)
        images[name][mask] = [40, 160, 30]
    return images


def feed(tracker, images, frame, **how):
    """The last scene of an instant."""
    for arrival in arrivals_of(images, at(frame), cameras=RIG.cameras, number=frame, **how):
        scene = tracker.update(arrival)
    return scene


def plain(value):
    """A value all of whose arrays are bytes, to be compared to the bit."""
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, msgspec.Struct):
        return type(value).__name__, [plain(getattr(value, name)) for name in value.__struct_fields__]
    if isinstance(value, dict):
        return [(key, plain(one)) for key, one in value.items()]
    if isinstance(value, float):
        return value.hex()  # NaN is as NaN
    return [plain(one) for one in value] if isinstance(value, list | tuple) else value


@pytest.fixture(scope="module")
def visits():
    """Arrivals: the room is filmed empty; Ben leaves upwards and comes back; a camera fails, one image is damaged."""
    room, arrivals = Room(RIG), []
    for _ in range(2):
        arrivals += arrivals_of(room.images(), 0, empty_room=True)
    up = 4.5 * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 30)))
    gone = [4.5] * (round(LOST_AFTER_S * HZ) + 4)
    for k, above in enumerate([*up, *gone, *up[::-1], *[0.0] * 20]):
        images = pair(room, pose_at(MESH, -0.6 + 0.004 * k), pose_at(MESH, 0.6, up_m=above))
        if 8 <= k < 14:
            images["c2"] = np.zeros_like(images["c2"])
        if k == 20:
            del images["c1"]
        some = arrivals_of(images, at(k), cameras=RIG.cameras, number=k)
        if k == 25:
            damaged = image_frame(
                "c3", b"\xff\xd8 no image", time_ns=at(k), format="jpeg", size_px=(240, 200), sequence=k
            )
            some[2] = Arrival(damaged, at(k))
        arrivals += some
    return arrivals


@pytest.fixture(scope="module")
def whole(visits):
    """One run through all of it: the scenes, the notes of each arrival, and snapshots after some arrivals."""
    tracker, scenes, notes, snapshots = new(), [], [], {}
    # While the room is filmed; within an instant; while a camera is black; once Ben is lost; just after he was found.
    wanted = {4, 6 + 3 * 5 + 1, 6 + 3 * 11, 6 + 3 * 47 + 2, len(visits) - 3 * 4}
    for k, arrival in enumerate(visits):
        scenes.append(tracker.update(arrival))
        notes.append(tracker.drain_notes())
        if k + 1 in wanted:
            snapshots[k + 1] = tracker.snapshot()
    return tracker, scenes, notes, snapshots


@pytest.mark.slow
def test_two_people_are_followed_and_who_leaves_is_lost_and_found(whole):
    tracker, scenes, notes, _ = whole
    lost = [scene.bodies[1].lost for scene in scenes[9:]]
    assert not lost[0]
    assert any(lost)
    assert not lost[-1]
    assert not any(scene.bodies[0].lost for scene in scenes[9:])
    assert [scene.step for scene in scenes] == list(range(len(scenes)))
    told = [note.text for some in notes for note in some]
    assert any("ben is in no camera's image any more" in text for text in told)
    assert any("ben is there again" in text for text in told)
    assert [text for text in told if "c2 does not count from" in text] == [
        "c2 does not count from frame 8 on: its image is black"
    ]
    said = {scene.state.reason for scene in scenes}
    assert any("ben is in no camera's image" in reason for reason in said)
    assert any("c2: its image is black" in reason for reason in said)
    # In such small pictures, hands and feet are narrower than two samples, and doubted.
    assert not any(joint in scenes[-1].state.reason for joint in ("knee", "elbow"))
    assert [body.name for body in scenes[-1].bodies] == list(NAMES)
    ben = scenes[-1].bodies[1]
    assert np.linalg.norm(ben.T_world_model[:3, 3] - [0.6, 0, 0]) < 0.25
    assert tracker.seen.number == len(scenes) // 3 - 3
    (reason,) = tracker.report.rejected
    assert "its image is damaged" in reason
    assert (tracker.report.frames, tracker.report.kept) == (len(scenes), len(scenes) - 1)


@pytest.mark.slow
def test_a_memory_goes_on_to_the_bit_alike(visits, whole):
    """Each goes on until the next was made and is the same as that one, so all go on alike until the end."""
    tracker, scenes, notes, snapshots = whole
    assert len(snapshots) == 5
    made = {**snapshots, len(visits): tracker.snapshot()}
    for after, until in pairwise(made):
        again = new()
        again.restore(made[after])
        assert again.snapshot() == made[after]
        for k in range(after, until):
            scene = again.update(visits[k])
            assert plain(scene) == plain(scenes[k]), f"restored after {after} arrivals, arrival {k}"
            assert again.drain_notes() == notes[k]
        assert again.snapshot() == made[until], f"restored after {after} arrivals, at {until}"
    assert again.report == tracker.report


@pytest.mark.slow
def test_what_is_no_memory_is_refused_and_the_tracker_is_as_new(whole):
    _, _, _, snapshots = whole
    tracker = alone()
    as_new = tracker.snapshot()
    for data in (b"", b"abc", snapshots[4][:-5], snapshots[4]):
        with pytest.raises(WireError):
            tracker.restore(data)
    assert tracker.snapshot() == as_new


@pytest.mark.slow
def test_every_attribute_of_what_remembers_is_in_the_memory_or_is_made_anew(whole):
    """A new attribute has to be told of here: what is forgotten shows only where it matters."""
    tracker, *_ = whole
    fitter = tracker._fitters.fitters["ben"]
    camera = fitter._cameras["c1"]
    for part, made_anew in (
        (tracker, {"bodies", "rig", "_waiting", "_sync", "_fitters", "_presence", "_conditions", "_rig_check", "_room",
                   "_scenes", "_places", "seen", "_support", "_sizes", "_keypoints"} | set(_own_memory())),
        (tracker._keypoints, {"_waiting"}),
        (tracker._sync, {"settings", "_names", "_cameras", "_first_ns", "_now_ns", "_last_ns", "used", "dropped"}),
        (tracker._fitters, {"fitters", "others", "_followed"}),
        (fitter, {"settings", "mesh", "body", "eyes", "_usual", "_past", "_missed", "_as_expected", "_dead", "_surface",
                  "_limb_recovery", "_cameras", "_support", "_there", "_hidden_parts", "_just_found",
                  "_stillness", "_keypoints"}),
        (fitter._keypoints, {"_body", "_settings", "_part", "_parents", "_of_limbs", "_trunk", "_seen", "_expected",
                             "_contradicted", "_lines", "_met"}),
        (fitter._support, {"_least_nats", "parts", "arms", "_part", "_counts", "_judged", "_of_arm", "_count"}),
        (fitter._stillness, {"_body", "_points", "_part", "_parts", "_skin_part", "_still", "_anchors", "_settling",
                             "_last", "_start", "_near_start", "_witnesses"}),
        (camera.changes, {"step_px", "_older", "_newer", "_older_ns", "_newer_ns"}),
        (camera.things, {"_things"}),
        (camera.room_edges, {"step_px", "_first", "_body"}),
        (tracker._support, {"_landmarks", "_parts", "_since", "_said", "_until"}),
        (fitter._limb_recovery, {"_body", "_settings", "_limbs", "_whole", "_hung", "_sizes_m2", "_points", "_limb_of",
                                 "_lower", "_rng", "_rng_of_lower",
                                 "_frame", "_asked", "_evidence"}),
        (fitter._surface, {"_body", "_steadiness", "_part", "_last", "_onward", "_weights", "_speed", "_acceleration",
                        "_since_s", "_per_s2", "_held"}),
        (fitter._dead, {"_last", "_same"}),
        (camera, {"_eye", "step_px", "_settings", "_region", "_closer", "_wide_region", "_wide_correspondences",
                  "_usual_reach", "background", "wide", "usually", "covers", "_window", "_looked", "_outline",
                  "_prior", "_found", "_image", "_scored", "changes", "things", "room_edges"}),
        (camera.usually, {"_mean", "_deviation", "_else_since_ns"}),
        (camera.background, {"settings", "step_px", "_mean", "_variance", "_count", "_next_row", "_learnt", "_shape",
                             "_first_sd"}),
        (tracker._presence, {"_fitters", "_rig", "_eyes", "_witnesses", "_bodies", "_waits", "empty"}),
        (tracker._presence.empty, {"_images", "_known"}),
        (tracker._conditions, {"_cameras", "_since"}),
        (tracker._rig_check, {"_rig", "said", "_moved", "_shares", "_compared"}),
        (tracker._room, {"_seconds", "_begin_ns", "_taken", "_moved", "seen", "done"}),
    ):  # fmt: skip
        assert set(vars(part)) == made_anew, type(part).__name__


def _own_memory():
    from mocapella.tracker.silhouettes import _OWN_MEMORY

    return _OWN_MEMORY


def test_the_order_in_which_cameras_come_and_the_encoding_do_not_matter():
    told = []
    for order, encoded in (((0, 1, 2), False), ((2, 0, 1), True)):
        room, tracker = Room(RIG), alone()
        for k in range(4):
            arrivals = arrivals_of(room.images(MESH, pose_at(MESH, 0.01 * k)), at(k), number=k)
            for i in order:
                frame = arrivals[i].frame
                if encoded:
                    frame = msgspec.structs.replace(frame, format="png", data=encode_image(frame.data, "png"))
                scene = tracker.update(Arrival(frame, at(k)))
        told.append(plain(scene.bodies))
    assert told[0] == told[1]


def test_between_two_complete_instants_the_bodies_stay_and_are_fitted_once():
    room, tracker = Room(RIG), alone()
    before = feed(tracker, room.images(MESH, pose_at(MESH)), 0).bodies
    first, second, third = arrivals_of(room.images(MESH, pose_at(MESH, 0.02)), at(1), number=1)
    for arrival in (first, second):
        assert tracker.update(arrival).bodies is before
    assert tracker.update(third).bodies is not before
    assert tracker.seen.images["c1"] is first.frame.data


def test_a_body_says_what_is_to_be_drawn_and_which_landmarks_are_seen():
    room, tracker = Room(RIG), alone()
    for k in range(3):
        scene = feed(tracker, room.images(MESH, pose_at(MESH)), k)
    (body,) = scene.bodies
    assert (body.id, body.name, body.person, body.lost) == (0, "", -1, False)
    assert body.joint_names == MESH.joint_names
    assert body.landmark_names == tuple(MESH.landmarks)
    assert body.landmarks.shape == (len(MESH.landmarks), 3)
    doubted = {
        name for name, state in zip(body.landmark_names, body.states, strict=True) if state != JointState.TRACKED
    }
    ends = ("wrist", "hand", "fingertip", "ankle", "heel", "toe")
    assert all(name.endswith(ends) for name in doubted), "in pictures this small, these are two samples wide"
    assert [view.camera for view in body.views] == list(RIG.cameras)
    true = silhouettes_of(MESH, RIG, pose_at(MESH))
    for view in body.views:
        assert view.overlap > 0.85
        assert view.left_out == ""
        for line in (view.outline_px, view.contour_px):
            assert line.dtype == np.float32
            assert 50 < len(line) <= 330
            x, y = line[np.isfinite(line).all(axis=1)].astype(int).T
            mask = true[view.camera].mask(RIG.cameras[view.camera].camera.size_px)
            assert mask[y, x].mean() > 0.5  # its border, but for the samples that are a pixel outside
    none = feed(tracker, {}, 3).bodies[0]
    assert (none.states == JointState.INFERRED).all()
    assert not none.lost
    assert all(np.isnan(view.overlap) and len(view.outline_px) == 0 for view in none.views)
    assert {view.left_out for view in none.views} == {NO_PICTURE}


@pytest.mark.slow
def test_the_empty_room_is_learnt_first_and_then_people_are_waited_for():
    room, tracker = Room(RIG), alone(empty_room_s=0.5)
    assert tracker.learning
    assert tracker.update(arrivals_of(room.images(), at(0), number=0)[0]).state.phase is Phase.CALIBRATING
    tracker.reset()
    for k in range(16):
        assert tracker.learning == (k < 16)
        scene = feed(tracker, room.images(), k)
        (body,) = scene.bodies
        assert body.lost
        assert (body.states == JointState.NOT_TRACKED).all()
        assert all(len(view.outline_px) > 50 for view in body.views)  # where somebody is to stand
        if k < 15:
            assert scene.state.reason == LEARNING
            assert scene.state.frames_wanted == IMAGES
            assert 0 < scene.state.frames_remaining < IMAGES
    assert not tracker.learning
    assert tracker.seen is None
    lost = []
    for k in range(16, 30):
        scene = feed(tracker, room.images(*([MESH, pose_at(MESH, 0.02)] if k >= 20 else [])), k)
        lost.append(scene.bodies[0].lost)
        assert scene.state.phase is Phase.TRACKING
    assert all(lost[:4])
    assert not lost[-1]
    assert [note.text.partition(": ")[2] for note in tracker.drain_notes()] == ["the body is there"]
    tracker.recalibrate("asked for")
    assert tracker.learning
    assert feed(tracker, room.images(), 30).state.reason == "asked for"
    assert tracker.report.restarts == 1


def test_somebody_in_the_empty_room_is_said():
    room, tracker = Room(RIG), alone(empty_room_s=0.3)
    for k in range(10):
        feed(tracker, room.images(MESH, pose_at(MESH, 0.1 * k)), k)
    (note,) = tracker.drain_notes()
    assert note.text.startswith("something moved in the images of c1, c2, c3 while the empty room was learnt")


def test_nobody_is_waited_for_where_nobody_is_known_to_be_absent_and_cameras_without_an_empty_room_are_said():
    room, tracker = Room(RIG), alone()
    assert tracker.update(arrivals_of({"c1": room.images()["c1"]}, 0, empty_room=True)[0]).state.sensors_missing == 3
    assert not feed(tracker, room.images(MESH, pose_at(MESH)), 0).bodies[0].lost
    (note,) = tracker.drain_notes()
    assert note.text.startswith("no empty room is known of c2, c3")
    assert note.time_ns == at(0)


def test_cameras_are_missing_until_each_has_sent_an_image():
    room, tracker = Room(RIG), alone()
    arrivals = arrivals_of(room.images(MESH, pose_at(MESH)), at(0), number=0)
    states = [tracker.update(arrival).state for arrival in arrivals]
    assert [state.sensors_missing for state in states] == [2, 1, 0]
    assert [state.phase for state in states] == [Phase.WAITING_FOR_SENSORS] * 2 + [Phase.TRACKING]


def test_what_cannot_be_used_is_counted_and_changes_nothing():
    room, tracker = Room(RIG), alone()
    feed(tracker, room.images(MESH, pose_at(MESH)), 0)
    before = tracker.snapshot()
    image = room.images()["c1"]
    bones = topology("kinect_v2")
    bodies = body_frame("c1", bones, time_ns=at(1), positions=np.zeros((1, len(bones), 3)))
    wrong = {
        not_taken(bodies, "silhouettes"): bodies,
        "the rig has no camera 'c9'; it has c1, c2, c3": image_frame("c9", image, time_ns=at(1)),
        "its images are 120 × 200, the rig's 240 × 200: calibrate with this size": image_frame(
            "c1", np.ascontiguousarray(image[:, :120]), time_ns=at(1)
        ),
        TOO_LATE: image_frame("c1", image, time_ns=at(1), empty_room=True),
        "time goes backwards": image_frame("c1", image, time_ns=at(-1)),
    }
    for reason, frame in wrong.items():
        scene = tracker.update(Arrival(frame, at(1)))
        assert [count for told, count in tracker.report.rejected.items() if told.startswith(reason)] == [1]
        assert scene.state.phase is Phase.TRACKING
    assert tracker.report.kept == 3
    other = alone()
    other.restore(before)
    images = room.images(MESH, pose_at(MESH, 0.01))
    assert plain(feed(tracker, images, 1).bodies) == plain(feed(other, images, 1).bodies)
    # Of another process of the camera, whose clock is another, but on the clock of all it is too late.
    tracker.update(Arrival(image_frame("c1", image, time_ns=5, node_id=7), at(1)))
    assert tracker.report.rejected[NOT_RISING] == 1


def test_a_damaged_image_is_one_that_is_not_there_and_says_why():
    room, tracker = Room(RIG), alone()
    for k in range(3):
        arrivals = arrivals_of(room.images(MESH, pose_at(MESH)), at(k), number=k)
        frame = msgspec.structs.replace(arrivals[1].frame, format="jpeg", data=b"\xff\xd8\xff\xd9")
        arrivals[1] = Arrival(frame, at(k))
        for arrival in arrivals:
            scene = tracker.update(arrival)
    views = {view.camera: view for view in scene.bodies[0].views}
    assert views["c2"].left_out == DAMAGED
    assert views["c1"].overlap > 0.85
    assert list(tracker.report.rejected.values()) == [3]
    assert [note.text for note in tracker.drain_notes()] == [f"c2 does not count from frame 0 on: {DAMAGED}"]


def test_reset_forgets_everything():
    room, tracker = Room(RIG), alone()
    as_new = tracker.snapshot()
    for k in range(3):
        feed(tracker, room.images(MESH, pose_at(MESH, 0.02 * k)), k)
    assert tracker.snapshot() != as_new
    tracker.reset()
    assert tracker.snapshot() == as_new
    assert tracker.seen is None


def test_bodies_and_times_of_no_sense_are_refused():
    with pytest.raises(SettingsError, match="bodies"):
        new({})
    with pytest.raises(SettingsError, match="empty_room_s"):
        alone(empty_room_s=-1.0)
    with pytest.raises(SettingsError, match="no camera of the rig sees"):
        new({"": pose_at(MESH, up_m=30.0)})
