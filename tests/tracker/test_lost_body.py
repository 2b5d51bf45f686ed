"""A body that is lost while the person stays in the images is found where the person is, without an empty room."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import silhouette_pictures as pictures
from support.silhouette_room import FRAME_NS, Room, bent

from mocapella.geometry.rigid import rigid, rotation_about_x, rotation_about_z
from mocapella.kinematics.silhouette_fit import eye, see
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.silhouettes import Silhouette, overlap
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.bodies_fitter import BodiesFitter
from mocapella.tracker.body_fitter import FittedBody
from mocapella.tracker.body_presence import (
    APART_RAD,
    DOUBTED,
    EARLIER,
    KEYPOINTS,
    LAST,
    POSTURES,
    SilhouettePresence,
    remembered,
)
from mocapella.tracker.body_reacquisition import reacquire
from mocapella.tracker.frame_sync import FrameSyncSettings
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.initial_body import InitialBody, LaterJoints
from mocapella.tracker.silhouette_body import SilhouetteBody
from mocapella.tracker.silhouette_camera import SeenIn, SilhouetteCamera
from mocapella.tracker.silhouette_settings import SilhouetteSettings
from mocapella.tracker.silhouettes import SilhouettesTracker

ROOM = Room()
EVERY, COVERED, UNCOVERED, END = 2, 20, 60, 70
MESH, RIG = pictures.somebody(), pictures.ring(3)
HERE = pictures.pose_at(MESH)


def walks(k: int) -> TreePose:
    """Sidewards, 1.2 m in a second; the arms come up."""
    arms = 60 * float(np.clip((k - 30) / 20, 0, 1))
    angles = {f"{side} shoulder swing forwards": arms for side in ("left", "right")}
    return bent(ROOM.mesh, angles, (-0.6 + 1.2 * min(k / 60, 1.0), 0.0, 0.0))


def followed(later: Sequence[LaterJoints] = ()) -> tuple[float, list[str], list[bool]]:
    """Median error of the landmarks at the end [m], the notes, and whether it was lost; cameras are covered midway."""
    start = InitialBody(ROOM.mesh, walks(0), later=later)
    tracker = SilhouettesTracker({"": start}, ROOM.rig, sync=FrameSyncSettings(period_s=EVERY / 60))
    lost = []
    for k in range(0, END, EVERY):
        images = ROOM.images(walks(k), k)
        if COVERED <= k < UNCOVERED:
            images = {name: np.zeros_like(image) for name, image in images.items()}
        for arrival in arrivals_of(images, k * FRAME_NS, cameras=ROOM.rig.cameras, number=k):
            tracker.update(arrival)
        assert tracker.seen is not None
        body = tracker.seen.bodies[""]
        lost.append(body.lost)
    off = np.linalg.norm(body.fit.landmarks - landmarks_at(ROOM.mesh, walks(k)), axis=1)
    return float(np.median(off)), [note.text for note in tracker.drain_notes()], lost


@pytest.mark.slow
def test_who_walked_on_while_the_cameras_were_covered_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    off_m, notes, lost = followed()
    assert off_m < 0.01
    assert any(lost)
    assert not lost[-1]
    assert f"frame {UNCOVERED + EVERY}: the body is there again, {LAST}" in notes
    monkeypatch.setattr(SilhouetteCamera, "foreground", lambda *_: None)
    monkeypatch.setattr(SilhouetteCamera, "stands_out", lambda *_: float("nan"))
    off_m, _, lost = followed()
    assert off_m > 0.5, "the body stayed where it was seen last"
    assert not lost[-1], "and nobody was told"


@pytest.mark.slow
def test_who_walked_on_before_an_unknown_room_is_found_by_keypoints(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SilhouetteCamera, "foreground", lambda *_: None)
    later = [
        LaterJoints(k / 60, dict(zip(ROOM.mesh.landmarks, landmarks_at(ROOM.mesh, walks(k)), strict=True)))
        for k in range(EVERY, END, EVERY)
    ]
    off_m, notes, lost = followed(later)
    assert off_m < 0.01
    assert any(lost)
    assert not lost[-1]
    assert f"frame {UNCOVERED}: the body is there again, {KEYPOINTS}" in notes


def camera_of(name: str, pose: TreePose) -> SilhouetteCamera:
    """A camera that has learnt the room of `pictures.Room` with a body in it."""
    camera = SilhouetteCamera(eye(RIG.cameras[name]), 1, SilhouetteSettings())
    assert camera.background is not None
    assert camera.look(pictures.figure(MESH), pictures.posed(MESH, pose), SilhouetteSettings())
    room = pictures.Room(RIG)
    for _ in range(3):
        camera.background.update(room.images(MESH, pose)[name], camera._expected())
    camera.forget_frame()
    return camera


@pytest.mark.parametrize("aside_m", [-0.6, 0.6])
def test_foreground_is_the_person_and_not_the_room(aside_m: float) -> None:
    camera, there = camera_of("c1", HERE), pictures.pose_at(MESH, aside_m)
    room = pictures.Room(RIG)
    found = camera.foreground(room.images(MESH, there)["c1"], None)
    assert found is not None
    size_px = RIG.cameras["c1"].camera.size_px
    true = pictures.silhouettes_of(MESH, RIG, there)["c1"].mask(size_px)
    here = pictures.silhouettes_of(MESH, RIG, HERE)["c1"].mask(size_px)
    mask = found.mask(size_px)
    assert (mask & true).sum() > 0.6 * mask.sum()
    assert (mask & true).sum() > 0.6 * (true & ~here).sum()
    assert camera.foreground(room.images()["c1"], None) is None


def test_there_is_no_foreground_of_what_is_no_person() -> None:
    """A black image, one of another room, other people, and cameras that know nothing."""
    camera, there = camera_of("c1", HERE), pictures.pose_at(MESH, 0.6)
    images = pictures.Room(RIG).images(MESH, there)
    assert camera.foreground(np.zeros_like(images["c1"]), None) is None
    assert camera.foreground(255 - images["c1"], None) is None
    others = np.ones(images["c1"].shape[:2], np.bool_)
    assert camera.foreground(images["c1"], others) is None
    new = SilhouetteCamera(eye(RIG.cameras["c1"]), 1, SilhouetteSettings())
    assert new.foreground(images["c1"], None) is None
    moving = SilhouetteCamera(eye(RIG.cameras["c1"]), 1, SilhouetteSettings(background=None))
    assert moving.foreground(images["c1"], None) is None


def turned(angle: float, tilt: float) -> TreePose:
    angles = HERE.angles.copy()
    angles[0] = angle
    return TreePose(rigid(rotation_about_x(tilt), np.zeros(3)), angles)


@given(st.lists(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), max_size=40))
def test_remembered_postures_are_few_and_unlike_each_other(wanted: list[tuple[float, float]]) -> None:
    kept: tuple[TreePose, ...] = ()
    for angle, tilt in wanted:
        before, kept = kept, remembered(kept, turned(angle, tilt))
        assert kept == before or kept[-1].angles[0] == angle
    assert len(kept) <= POSTURES
    assert bool(kept) == bool(wanted)
    for k, one in enumerate(kept):
        for other in kept[:k]:
            tilts = [np.arctan2(pose.T_world_model[2, 1], pose.T_world_model[1, 1]) for pose in (one, other)]
            assert max(abs(one.angles[0] - other.angles[0]), abs(tilts[0] - tilts[1])) >= APART_RAD - 1e-6
        assert remembered(kept, one) is kept


def test_a_body_that_was_lost_in_a_wrong_posture_is_found_in_an_earlier_one() -> None:
    room, fitters = pictures.Room(RIG), BodiesFitter({"": MESH}, RIG)
    empty, person = room.images(), room.images(MESH, HERE)
    bent = np.array([high for _, high in MESH.tree.limits])  # as nobody ever was
    fallen = TreePose(HERE.T_world_model @ rigid(rotation_about_x(np.pi / 2), np.zeros(3)), bent)
    fitters.start("", fallen, 0)
    fitters.others[""] = {}
    presence = SilhouettePresence(fitters, RIG)
    presence.empty.learn(empty)
    for postures in ((), (HERE,)):
        presence.start("", fallen, 0)
        presence._bodies[""].postures = postures
        nowhere = FittedBody(600_000_000, fallen, landmarks_at(MESH, fallen), {}, {})
        presence.update(1, {"": nowhere}, person)
        assert presence._bodies[""].found == (EARLIER if postures else "")
        assert presence._bodies[""].placed == bool(postures)
    near = fitters.fitters[""].expected(10**9)
    assert np.linalg.norm(landmarks_at(MESH, near) - landmarks_at(MESH, HERE), axis=1).mean() < 0.15


def test_a_region_stands_out_that_is_not_the_room() -> None:
    """Before what is known half or less, nothing is said."""
    there = pictures.pose_at(MESH, 0.6)
    room, s = pictures.Room(RIG), SilhouetteSettings()
    for images, share in ((room.images(MESH, there), 1.0), (room.images(), 0.0)):
        camera = camera_of("c1", HERE)
        body = pictures.figure(MESH)
        assert camera.look(body, pictures.posed(MESH, there), s)
        prior = camera._expected()
        camera._found, camera._image = (prior, np.ones(prior.phi.shape, np.float32)), images["c1"]
        assert camera.stands_out(None) == pytest.approx(share, abs=0.25)
    unknown = SilhouetteCamera(eye(RIG.cameras["c1"]), 1, s)
    unknown._found, unknown._image = camera._found, images["c1"]
    assert np.isnan(unknown.stands_out(None))
    assert isinstance(prior, Silhouette)


@pytest.mark.parametrize("here", [True, False])
def test_other_people_do_not_make_a_body_stand_out(here: bool) -> None:
    """Somebody else covers the upper half of a body; of one who is all behind others nothing is known."""
    there = pictures.pose_at(MESH, 0.6)
    images = pictures.Room(RIG).images(MESH, there)["c1"]
    camera = camera_of("c1", HERE)
    assert camera.look(pictures.figure(MESH), pictures.posed(MESH, there), SilhouetteSettings())
    prior = camera._expected()
    mask = prior.mask((images.shape[1], images.shape[0]))
    others = np.zeros_like(mask)
    rows = np.flatnonzero(mask.any(axis=1))
    others[: rows[len(rows) // 2]] = True
    room = pictures.Room(RIG).images()["c1"]
    shown = np.where((others | here)[..., None], images, room)
    camera._found, camera._image = (prior, np.ones(prior.phi.shape, np.float32)), shown
    assert camera.stands_out(others) == pytest.approx(1.0 if here else 0.0, abs=0.25)
    if not here:
        assert camera.stands_out(None) > 0.3, "the fault that the test must show"
    assert np.isnan(camera.stands_out(np.ones_like(mask)))
    others[: rows[3 * len(rows) // 4]] = True
    assert np.isnan(camera.stands_out(others)), "less than a third of the body is its own"


def present(
    stands_out: float, fitted: TreePose, until_ms: int = 300, joints: Mapping[str, Any] | None = None
) -> tuple[list[str], TreePose]:
    """Notes about a body that is fitted in all cameras while the person is `HERE`, and where it is expected next."""
    room, fitters = pictures.Room(RIG), BodiesFitter({"": MESH}, RIG)
    fitters.start("", fitted, 0)
    fitters.others[""] = {}
    presence = SilhouettePresence(fitters, RIG)
    presence.empty.learn(room.images())
    presence.start("", HERE, 0)
    person, body, notes = room.images(MESH, HERE), fitters.fitters[""].body, list[str]()
    seen = {}
    for name, placed in RIG.cameras.items():
        outline = see(body.figure, body.standing(fitted).vertices, eye(placed), step_px=1, margin_px=2)
        assert outline is not None
        seen[name] = SeenIn(outline.silhouette, outline, 1.0, stands_out=stands_out)
    for at_ms in range(100, until_ms + 1, 100):
        fit = FittedBody(at_ms * 1_000_000, fitted, landmarks_at(MESH, fitted), seen, {})
        notes += presence.update(at_ms // 100, {"": fit}, person, {"": joints or {}})[1]
    return notes, fitters.fitters[""].expected(10**9)


def off_m(pose: TreePose) -> float:
    return float(np.linalg.norm(landmarks_at(MESH, pose) - landmarks_at(MESH, HERE), axis=1).mean())


def test_a_body_that_looks_like_the_room_is_searched_and_one_that_stands_out_is_not() -> None:
    beside = pictures.pose_at(MESH, 0.3)
    notes, pose = present(0.9 * DOUBTED, beside)
    assert any(f"did not stand out from the room: {LAST}" in note for note in notes)
    assert off_m(pose) < 0.1
    for stands_out in (1.1 * DOUBTED, float("nan")):
        notes, pose = present(stands_out, beside)
        assert not notes
        assert off_m(pose) == pytest.approx(0.3)


@pytest.mark.parametrize(("aside_m", "moves"), [(0.0, False), (0.1, False), (0.3, True)])
def test_a_doubted_body_goes_to_its_keypoints_only_where_they_are_elsewhere(aside_m: float, moves: bool) -> None:
    joints = dict(zip(MESH.landmarks, landmarks_at(MESH, HERE), strict=True))
    notes, pose = present(0.9 * DOUBTED, pictures.pose_at(MESH, aside_m), joints=joints)
    assert any(f"did not stand out from the room: {KEYPOINTS}" in note for note in notes) == moves
    assert off_m(pose) == pytest.approx(0.0 if moves else aside_m, abs=0.02)


@pytest.mark.parametrize("joints", [{"neck": np.zeros(3)}, {name: np.zeros(3) for name in MESH.landmarks}])
def test_joints_of_nobody_are_no_place(joints: dict[str, Any]) -> None:
    notes, _ = present(0.9 * DOUBTED, pictures.pose_at(MESH, 0.3), joints=joints)
    assert any(LAST in note for note in notes)


def test_a_body_that_stands_out_stays_whatever_its_keypoints_say() -> None:
    joints = dict(zip(MESH.landmarks, landmarks_at(MESH, pictures.pose_at(MESH, 0.6)), strict=True))
    notes, pose = present(1.1 * DOUBTED, HERE, joints=joints)
    assert not notes
    assert off_m(pose) == 0.0


def test_a_body_that_looks_like_the_room_stays_where_it_covers_the_person() -> None:
    """Somebody in the colours of the room."""
    notes, pose = present(0.0, HERE)
    assert not notes
    assert off_m(pose) == 0.0


@pytest.mark.parametrize("aside_m", [0.0, 0.01, 0.6])
def test_a_doubted_body_moves_only_to_where_it_covers_much_more(aside_m: float) -> None:
    seen, body = pictures.silhouettes_of(MESH, RIG, HERE), SilhouetteBody(MESH)
    eyes = {name: eye(placed) for name, placed in RIG.cameras.items()}
    found = reacquire(seen, body, [HERE], eyes, pictures.pose_at(MESH, aside_m))
    assert (found is not None) == (aside_m > 0.5)
    assert reacquire(seen, body, [HERE], eyes) is not None


@pytest.mark.parametrize("tilt", [np.pi, np.pi / 2, -3 * np.pi / 4])
@pytest.mark.parametrize("about", [rotation_about_x, rotation_about_z])
def test_a_body_is_found_any_way_up(tilt: float, about: Callable[[float], Any]) -> None:
    """It fell, or does a cartwheel: where it was seen last, it stood."""
    middle, R = MESH.vertices.mean(axis=0), about(tilt)
    T = HERE.T_world_model @ rigid(R, middle - R @ middle)
    T[0, 3] += 0.3
    true = TreePose(T, HERE.angles)
    seen, body = pictures.silhouettes_of(MESH, RIG, true), SilhouetteBody(MESH)
    eyes = {name: eye(placed) for name, placed in RIG.cameras.items()}

    def shares(pose: TreePose) -> float:
        covered = pictures.silhouettes_of(MESH, RIG, pose)
        sizes = {name: placed.camera.size_px for name, placed in RIG.cameras.items()}
        return float(np.mean([overlap(one.mask(sizes[k]), seen[k].mask(sizes[k])) for k, one in covered.items()]))

    found = reacquire(seen, body, [HERE], eyes, any_way_up=True)
    standing = reacquire(seen, body, [HERE], eyes)
    assert found is not None
    assert shares(found) > 0.6
    if abs(tilt) < np.pi:  # upside down the outline is much like a standing one
        assert standing is None or shares(standing) < shares(found)


def test_who_does_a_cartwheel_still_faces_the_same_way() -> None:
    middle, R = MESH.vertices.mean(axis=0), rotation_about_z(np.pi)
    true = TreePose(HERE.T_world_model @ rigid(R, middle - R @ middle), HERE.angles)
    eyes = {name: eye(placed) for name, placed in RIG.cameras.items()}
    body = SilhouetteBody(MESH)
    found = reacquire(pictures.silhouettes_of(MESH, RIG, true), body, [HERE], eyes, any_way_up=True)
    assert found is not None
    assert found.T_world_model[:3, 2] @ HERE.T_world_model[:3, 2] > 0
