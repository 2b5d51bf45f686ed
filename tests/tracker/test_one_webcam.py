"""One webcam: a person with a known body comes back to its place, and nothing is said to be measured."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.fusion.one_camera import camera_of_view, stature_of
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x, rotation_about_y
from mocapella.model.keypoints import NO_ID, KeypointFrame, keypoint_frame
from mocapella.model.observations import Arrival, JointState
from mocapella.model.topology import topology
from mocapella.testing import check_tracker
from mocapella.tracker import make_tracker
from mocapella.tracker.one_webcam import CHAINS, HALPE, OneWebcamSettings, OneWebcamTracker
from mocapella.tracker.webcams_warmup import circle_of_cameras, standing_person

SIZE = (640, 480)
LENS = camera_of_view(SIZE, np.radians(65.0))
STATURE = stature_of(standing_person(), CHAINS)
SOLE = float(standing_person()[:, 1].min())


def camera_from_world(height: float, tilt_deg: float) -> Any:
    level = np.diag([1.0, -1.0, -1.0]) @ rotation_about_x(np.radians(tilt_deg))
    return inverse(rigid(level, (0.0, height, 0.0)))


def one_frame(
    joints: list[np.ndarray],
    k: int,
    *,
    height: float = 1.5,
    tilt_deg: float = -5.0,
    scale: float = 1.0,
    ids: Any = None,
) -> KeypointFrame:
    """What a camera sees of people, with their body of another scale as the detector's depth."""
    seen = [apply(camera_from_world(height, tilt_deg), one) for one in joints]
    relative = [scale * (one - one[HALPE.index("Hip")]) for one in seen]
    pixels = [project(one, LENS) for one in seen]
    return keypoint_frame(
        "cam0", HALPE, time_ns=1 + k * 33_000_000, size_px=SIZE, positions_px=np.reshape(pixels, (-1, 26, 2)),
        confidences=0.9, ids=ids, relative=np.reshape(relative, (-1, 26, 3)) if joints else None, sequence=k,
    )  # fmt: skip


def at(x: float, z: float, turn: float = 0.0) -> np.ndarray:
    return standing_person() @ rotation_about_y(turn).T + [x, -SOLE, -z]


def settings_of(**more: Any) -> OneWebcamSettings:
    return OneWebcamSettings(**({"height_m": STATURE, "tilt_deg": -5.0, "camera_height_m": 1.5} | more))


@settings(max_examples=25)
@given(st.floats(-0.8, 0.8), st.floats(2.5, 5), st.floats(-3, 3), st.floats(0.6, 1.6))
def test_a_person_of_known_stature_is_where_it_is(x: float, z: float, turn: float, scale: float) -> None:
    tracker = OneWebcamTracker(settings_of())
    scene = tracker.update(Arrival(one_frame([at(x, z, turn)], 0, scale=scale), 10**9))
    (person,) = scene.people
    np.testing.assert_allclose(person.positions, at(x, z, turn), atol=0.02)
    assert set(person.states.tolist()) == {JointState.INFERRED}
    assert person.sd is not None
    assert (person.sd > 0.1).all()
    assert "inferred" in person.condition


@pytest.mark.parametrize(("camera_height", "least", "most"), [(0.0, 0.15, 0.4), (1.5, 0.0, 0.12)])
def test_the_floor_corrects_a_wrong_stature(camera_height: float, least: float, most: float) -> None:
    tracker = OneWebcamTracker(settings_of(height_m=1.1 * STATURE, height_sd_m=0.3, camera_height_m=camera_height))
    (person,) = tracker.update(Arrival(one_frame([at(0.0, 3.0)], 0), 10**9)).people
    off = np.linalg.norm((person.positions - at(0.0, 3.0))[:, [0, 2]], axis=-1).max()
    assert least <= off < most


def walk(ids: bool, count: int = 12) -> list[Arrival]:
    people = [(at(-0.7 + 0.02 * k, 3.0), at(0.7 - 0.02 * k, 4.0)) for k in range(count)]
    return [
        Arrival(one_frame(list(pair), k, ids=[7, 9] if ids else [NO_ID, NO_ID]), 10**9 + k * 33_000_000)
        for k, pair in enumerate(people)
    ]


@pytest.mark.parametrize("ids", [True, False])
def test_it_is_a_tracker_and_people_keep_their_numbers(ids: bool) -> None:
    scenes = check_tracker(lambda: OneWebcamTracker(settings_of()), walk(ids))
    assert [[person.id for person in scene.people] for scene in scenes] == [[0, 1]] * 12
    assert scenes[-1].people[0].positions[0, 0] > scenes[0].people[0].positions[0, 0] + 0.15


def test_who_leaves_is_not_shown_and_comes_back_with_a_new_number() -> None:
    tracker = OneWebcamTracker(settings_of())
    for k, joints in ((0, [at(0, 3)]), (1, []), (40, [at(0, 3)])):
        scene = tracker.update(Arrival(one_frame(joints, k), 10**9 + k * 33_000_000))
        assert len(scene.people) == len(joints)
    assert scene.people[0].id == 1


def test_frames_that_cannot_be_used_are_counted_with_the_reason() -> None:
    tracker = OneWebcamTracker(settings_of())
    first = one_frame([at(0, 3)], 1)
    flat = msgspec.structs.replace(one_frame([at(0, 3)], 2), relative=None)
    other = msgspec.structs.replace(one_frame([at(0, 3)], 3), sensor="cam1")
    for frame in (first, flat, other, one_frame([at(0, 3)], 0)):
        tracker.update(Arrival(frame, frame.time_ns))
    reasons = " ".join(tracker.report.rejected)
    assert all(text in reasons for text in ("mediapipe", "alone", "backwards"))
    assert (tracker.report.frames, tracker.report.kept) == (4, 1)


def test_a_rig_of_one_camera_gives_the_lens_and_of_two_is_refused() -> None:
    from mocapella.model.camera import CameraRig
    from mocapella.model.camera_rig_file import encode_camera_rig

    rig = circle_of_cameras(2)
    with pytest.raises(SettingsError, match="method webcams"):
        make_tracker("one-webcam", settings={"rig": encode_camera_rig(rig)})
    alone = CameraRig(dict(list(rig.cameras.items())[:1]))
    tracker: Any = make_tracker("one-webcam", settings={"rig": encode_camera_rig(alone)})
    np.testing.assert_array_equal(tracker._lens, alone.cameras["cam-0"].camera.lens)


def test_a_body_that_the_detector_does_not_know_has_means_for_hip_and_neck() -> None:
    kind = topology("mediapipe_pose")
    rows = kind.mappings["halpe_26"]
    frame = one_frame([at(0, 3)], 0)
    positions, relative = np.full((1, 33, 2), np.nan), np.zeros((1, 33, 3))
    assert frame.relative is not None
    for joint, terms in rows.items():
        source = next(iter(terms))
        positions[0, source], relative[0, source] = frame.positions_px[0, joint], frame.relative[0, joint]
    own = keypoint_frame("cam0", kind, time_ns=1, size_px=SIZE, positions_px=positions, relative=relative)
    (person,) = OneWebcamTracker(settings_of()).update(Arrival(own, 10**9)).people
    hip, head = HALPE.index("Hip"), HALPE.index("Head")
    np.testing.assert_allclose(person.positions[hip], at(0, 3)[hip], atol=0.05)
    assert person.states[head] == JointState.NOT_TRACKED


@pytest.mark.parametrize("wrong", [{"height_m": 0.1}, {"height_sd_m": 0}, {"camera_height_m": -1}, {"tilt_deg": 90},
                                   {"field_of_view_deg": 5}, {"sd_px": 0}, {"size_s": -1}, {"unseen_s": 0},
                                   {"same_within_m": 0}])  # fmt: skip
def test_wrong_settings_of_one_webcam_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        OneWebcamSettings(**wrong)
