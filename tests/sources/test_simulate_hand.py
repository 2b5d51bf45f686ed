"""A simulated hand: how it moves, what cameras see of it, and that what is said to be true of an image is in it."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.kinematics.hand_chain import hand_chain, landmarks
from mocapella.model.hand import TIPS, Handedness, HandPose, hand_model
from mocapella.sources.simulate.camera_image import CameraImageSettings
from mocapella.sources.simulate.hand_camera import SimulatedHandCamera, pointed_at
from mocapella.sources.simulate.hand_motion import UPRIGHT, HandMotion, HandMotionSettings, landmarks_of
from mocapella.sources.simulate.hand_scene import (
    BASE_MARKERS,
    HandScene,
    HandSceneSettings,
    HandShot,
    SimulatedCamera,
    base_places,
    hand_scene_names,
    hand_scene_settings,
    load_hand_scene,
)  # fmt: skip
from mocapella.sources.simulate.marker_scene import Paint

MODEL = hand_model()
CLEAN = CameraImageSettings(lens_blur_px=0.0, photons=1e6, read_noise=0.0, bayer=False, shared_chroma=False, exposure=1)
seeds = st.integers(0, 2**32 - 1)
sides = st.sampled_from(["left", "right"])
motions = st.builds(HandMotionSettings, bend=st.floats(0, 1), spread=st.floats(0, 1), posture_s=st.floats(0.1, 2.0))
times = st.floats(-100, 100)


@cache
def small(
    readout_s: float = 0.0,
    black: int = -1,
    handedness: str = "right",
    seed: int = 1,
    image: CameraImageSettings = CLEAN,
) -> HandScene:
    """The scene ``wide`` in small pictures, without shading, gloss and changing light; one marker painted black."""
    made = hand_scene_settings("wide")
    eyes = tuple(dataclasses.replace(c, size_px=(160, 120), readout_s=readout_s, image=image) for c in made.cameras)
    paints = [dataclasses.replace(paint, gloss=0.0) for paint in made.paints]
    if black >= 0:
        paints[black] = dataclasses.replace(paints[black], albedo=(0.0, 0.0, 0.0))
    flat = {"shading": 0.0, "brightness_change": 1.0, "colour_change": 0.0, "skin_gloss": 0.0}
    changed = dataclasses.replace(made, cameras=eyes, paints=tuple(paints), handedness=handedness, **flat)  # type: ignore[arg-type]
    return HandScene(changed, seed)


def weights(readout_s: float, marker: int, camera: str, at_s: float) -> np.ndarray:
    """(height, width) how much of a pixel a marker fills: the difference to the same picture with it in black."""
    a, b = (small(readout_s, black).at(camera, at_s).image for black in (-1, marker))
    c = np.arange(256) / 255
    light = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return np.abs(light[a] - light[b]).sum(axis=-1)


def centre_of(weight: np.ndarray) -> np.ndarray:
    y, x = np.indices(weight.shape)
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


# How it moves.


@given(sides, motions, seeds, times)
def test_landmarks_are_those_of_the_chain_of_twists(
    side: Handedness, how: HandMotionSettings, seed: int, at_s: float
) -> None:
    shape = MODEL.shape(side)
    pose = HandMotion(MODEL, shape, how, seed).at(at_s)
    np.testing.assert_allclose(landmarks_of(MODEL, shape, pose), landmarks(hand_chain(MODEL, shape), pose), atol=1e-12)


@given(sides, seeds)
def test_landmarks_of_any_angles_are_those_of_the_chain_of_twists(side: Handedness, seed: int) -> None:
    full, rng = hand_model("full"), np.random.default_rng(seed)
    shape, angles = full.shape(side), rng.uniform(-2, 2, 21)
    pose = HandPose(angles, np.eye(4))
    np.testing.assert_allclose(landmarks_of(full, shape, pose), landmarks(hand_chain(full, shape), pose), atol=1e-12)


@given(motions, seeds, times)
def test_a_hand_keeps_its_limits_at_any_time(how: HandMotionSettings, seed: int, at_s: float) -> None:
    pose = HandMotion(MODEL, MODEL.shape("right"), how, seed).at(at_s)
    assert MODEL.within(pose.angles)
    R = pose.T_world_palm[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


@given(motions, seeds, times)
def test_motion_is_continuous_also_from_posture_to_posture(how: HandMotionSettings, seed: int, at_s: float) -> None:
    motion = HandMotion(MODEL, MODEL.shape("right"), how, seed)
    border = how.posture_s * round(at_s / how.posture_s)
    for about in (at_s, border):
        before, after = motion.at(about - 1e-6), motion.at(about + 1e-6)
        np.testing.assert_allclose(after.angles, before.angles, atol=1e-4)
        np.testing.assert_allclose(after.T_world_palm, before.T_world_palm, atol=1e-4)
    # At a border the hand rests in its posture: the way of least jerk begins and ends without speed.
    np.testing.assert_allclose(motion.angles(border + 1e-4), motion.angles(border - 1e-4), atol=1e-6)


@given(motions, seeds, times)
def test_the_same_seed_is_the_same_motion_and_another_another(how: HandMotionSettings, seed: int, at_s: float) -> None:
    one, same, other = (HandMotion(MODEL, MODEL.shape("right"), how, s).at(at_s) for s in (seed, seed, seed + 1))
    np.testing.assert_array_equal(one.angles, same.angles)
    np.testing.assert_array_equal(one.T_world_palm, same.T_world_palm)
    assert np.abs(one.T_world_palm - other.T_world_palm).max() > 0


@given(seeds, times)
def test_the_hand_stays_where_its_settings_say(seed: int, at_s: float) -> None:
    still = HandMotionSettings(centre_m=(1, 2, 3), travel_m=(0, 0, 0), turn_deg=(0, 0, 0), bend=0.0, spread=0.0)
    shape = MODEL.shape("right")
    pose = HandMotion(MODEL, shape, still, seed).at(at_s)
    np.testing.assert_allclose(pose.angles, MODEL.limited(MODEL.natural), atol=1e-12)
    np.testing.assert_allclose(pose.T_world_palm[:3, :3], UPRIGHT, atol=1e-12)
    L = landmarks_of(MODEL, shape, pose)
    assert L[0, 1] < 2 < L[TIPS[2], 1]
    moving = dataclasses.replace(still, travel_m=(0.1, 0.2, 0.3))
    away = HandMotion(MODEL, shape, moving, seed).at(at_s).T_world_palm[:3, 3] - pose.T_world_palm[:3, 3]
    assert (np.abs(away) <= [0.1, 0.2, 0.3]).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("centre_m", (0.0, 11.0, 0.0)), ("travel_m", (0.0, -0.1, 0.0)), ("travel_hz", 11.0)),
        *(("turn_deg", (0.0, 181.0, 0.0)), ("posture_s", 0.0), ("bend", 1.1), ("spread", -0.1), ("bend", np.nan)),
    ],
)
def test_motions_that_cannot_be_are_refused(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=f"{name} is "):
        HandMotionSettings(**{name: value})


# What cameras see.


def assert_same(a: HandShot, b: HandShot) -> None:
    np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(a.centres_px, b.centres_px)
    np.testing.assert_array_equal(a.visible, b.visible)


def test_the_same_scene_seed_and_time_give_the_same_image() -> None:
    noisy = CameraImageSettings()
    one = small(image=noisy).at("left", 0.4)
    small(image=noisy).at("right", 0.1)  # what was photographed before makes no difference
    assert_same(one, HandScene(small(image=noisy).settings, 1).at("left", 0.4))
    assert_same(one, small(image=noisy).at("left", 0.4))
    assert (one.image != small(image=noisy, seed=2).at("left", 0.4).image).any()
    assert (one.image != small(image=noisy).at("left", 0.4001).image).any()


def test_the_truth_of_a_shot_is_that_of_the_motion() -> None:
    made = small()
    shot = made.at("left", 0.7)
    np.testing.assert_array_equal(shot.pose.angles, made.motion.at(0.7).angles)
    np.testing.assert_allclose(shot.landmarks, landmarks_of(made.model, made.shape, shot.pose), atol=1e-12)
    np.testing.assert_allclose(shot.markers_world[:5], shot.landmarks[list(TIPS)], atol=1e-9)
    np.testing.assert_allclose(shot.markers_world[5:], apply(shot.pose.T_world_palm, base_places(made)), atol=1e-9)
    eye = made.cameras["left"]
    np.testing.assert_allclose(
        shot.centres_px, project(apply(eye.T_camera_world, shot.markers_world), eye.lens), atol=1e-6
    )


@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_a_markers_centre_of_area_is_the_stated_one(readout_s: float) -> None:
    """Without shading, a marker's weight is its coverage, as far as it is not hidden."""
    checked, away = 0, []
    for camera, at_s in (("left", 1.9), ("right", 0.7)):
        shot = small(readout_s).at(camera, at_s)
        for k in np.flatnonzero(shot.visible > 0.985):
            away.append(centre_of(weights(readout_s, int(k), camera, at_s)) - shot.centres_px[k])
            checked += 1
    assert checked >= 5
    assert np.abs(away).max() < 0.15
    assert np.abs(np.mean(away, axis=0)).max() < 0.06


def test_a_rolling_shutter_shows_each_row_later() -> None:
    """What is on a row is where it is when that row is exposed."""
    made, readout_s = small(0.02), 0.02
    eye = made.cameras["right"]
    shot = made.at("right", 0.7)
    moved = 0.0
    for k, px in enumerate(shot.centres_px):
        then = made.at("right", 0.7 + px[1] * readout_s / eye.size_px[1])
        world = then.markers_world[k]
        expected = project(apply(eye.T_camera_world, world[None]), eye.lens)[0]
        np.testing.assert_allclose(px, expected, atol=0.05)
        moved = max(moved, float(np.linalg.norm(px - small().at("right", 0.7).centres_px[k])))
    assert moved > 0.3


def test_what_is_said_to_be_visible_of_a_marker_is_the_part_of_it_in_the_image() -> None:
    """A ball's area goes with one over its distance squared, whichever way the hand is turned."""
    made, whole, visible = small(), [], []
    for camera, at_s in (("right", 8.4), ("right", 4.4), ("right", 3.6), ("left", 10.0)):
        shot = made.at(camera, at_s)
        z = apply(made.cameras[camera].T_camera_world, shot.markers_world)[5, 2]
        visible.append(shot.visible[5])
        whole.append(weights(0.0, 5, camera, at_s).sum() * z * z / shot.visible[5])
    assert min(visible) < 0.72
    assert max(visible) > 0.9
    np.testing.assert_allclose(whole, np.mean(whole), rtol=0.06)


def test_from_behind_the_palms_marker_is_hidden_and_outside_the_picture_nothing_is_visible() -> None:
    made = small().settings
    calm = dataclasses.replace(made.motion, travel_m=(0.0, 0.0, 0.0), turn_deg=(0.0, 0.0, 0.0), bend=0.1)
    eye = dataclasses.replace(made.cameras[0], distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    eyes = {
        "front": ((0.0, 0.0, 0.5), (0.0, 0.0, 0.0)),
        "back": ((0.0, 0.0, -0.5), (0.0, 0.0, 0.0)),
        "away": ((0.0, 0.0, 0.5), (0.0, 0.0, 2.0)),
        "beside": ((0.0, 0.0, 0.5), (2.0, 0.0, 0.5)),
    }
    cameras = tuple(
        dataclasses.replace(eye, name=name, position_m=at, looks_at_m=to) for name, (at, to) in eyes.items()
    )
    scene = HandScene(dataclasses.replace(made, cameras=cameras, motion=calm), 3)
    assert scene.at("front", 0.2).visible[5] > 0.9
    assert scene.at("back", 0.2).visible[5] == 0.0
    away = scene.at("away", 0.2)
    assert np.isnan(away.centres_px).all()
    assert (away.visible == 0).all()
    assert (scene.at("beside", 0.2).visible == 0).all()


@pytest.mark.parametrize("handedness", ["left", "right"])
def test_base_places_are_of_a_right_hand_and_stay_on_the_palm(handedness: str) -> None:
    made = small(handedness=handedness)
    places = base_places(made)
    assert places[0, 1] < -0.01  # on the palm's side
    for at_s in (0.3, 1.2):
        shot = made.at("left", at_s)
        palm = apply(shot.pose.T_world_palm, made.shape.mirror * places)
        np.testing.assert_allclose(shot.markers_world[5:], palm, atol=1e-9)


def test_three_base_markers_may_be_painted_and_of_a_left_hand_they_are_mirrored() -> None:
    made = hand_scene_settings("demo")
    paints = (*made.paints[:5], *(Paint(name, (0.1 + 0.1 * k, 0.3, 0.4)) for k, name in enumerate(BASE_MARKERS)))
    of = {
        side: base_places(HandScene(dataclasses.replace(made, paints=paints, handedness=side), 0))
        for side in ("left", "right")
    }
    assert of["left"].shape == (3, 3)
    np.testing.assert_allclose(of["left"], of["right"], atol=1e-9)
    assert of["right"][1, 0] * of["right"][2, 0] < 0  # index and little finger are on two sides of the palm


def test_every_scenes_cameras_look_at_what_they_should_and_are_its_rig() -> None:
    demo = load_hand_scene("demo")
    for name in hand_scene_names():
        for eye in hand_scene_settings(name).cameras:
            placed = eye.placed
            R = placed.T_camera_world[:3, :3]
            assert np.linalg.det(R) == pytest.approx(1.0)
            assert R[1, 1] < 0  # the picture's y is down
            at = project(apply(placed.T_camera_world, np.array([eye.looks_at_m])), placed.camera.lens)[0]
            np.testing.assert_allclose(at, 0.5 * (np.array(eye.size_px) - 1), atol=1e-9)
            if name == "demo":
                np.testing.assert_array_equal(demo.rig.cameras[eye.name].T_camera_world, placed.T_camera_world)
                assert demo.rig.cameras[eye.name].camera.readout_s == eye.readout_s == 0.02
    assert list(demo.rig.cameras) == ["left", "right"]


# Finding the markers.


@pytest.mark.slow
def test_the_program_that_learnt_the_colours_finds_the_markers() -> None:
    camera = SimulatedHandCamera(load_hand_scene("demo", seed=2), "right")
    assert [colour.name for colour in camera.profile.colours] == list(camera.scene.names)
    visible, found = 0, 0
    away: list[float] = []
    dues: list[float] = []
    for due_s, frame, shot in camera.frames(5.0, 5.6):
        dues.append(due_s)
        assert frame.time_ns == round(due_s * 1e9) + 1
        assert (frame.sensor, frame.sequence) == ("right", len(dues) - 1)
        clear = shot.visible > 0.5
        visible += clear.sum()
        found += (frame.found & clear).sum()
        whole = frame.found & (shot.visible > 0.9)  # of a part, the middle is another
        away += np.linalg.norm(frame.positions_px - shot.centres_px, axis=-1)[whole].tolist()
    assert dues == pytest.approx(5.025 + np.arange(12) / 20)
    assert found >= 0.95 * visible > 40
    assert np.median(away) < 0.5
    assert np.quantile(away, 0.95) < 1.0


def test_a_camera_that_is_late_leaves_frames_out() -> None:
    camera = SimulatedHandCamera(load_hand_scene("demo", seed=2), "right")
    clock = iter([0.0, 0.0, 0.31, 0.31, 9.0])
    dues = [frame.due_s for frame in camera.frames(0.0, 1.0, lambda: next(clock))]
    np.testing.assert_allclose(dues, [0.025, 0.075, 0.325, 0.375])


def test_a_camera_that_sees_nothing_cannot_learn() -> None:
    made = hand_scene_settings("demo")
    eye = dataclasses.replace(made.cameras[0], looks_at_m=(0.0, 0.0, 5.0), size_px=(32, 32))
    scene = HandScene(dataclasses.replace(made, cameras=(eye,)), 0)
    with pytest.raises(SettingsError, match="left hardly ever sees all markers well enough"):
        pointed_at(scene, "left")


# What cannot be.


def test_scenes_and_cameras_that_are_not_there_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"unknown scene 'wid'; .*wide"):
        load_hand_scene("wid")
    with pytest.raises(SettingsError, match=r"unknown camera 'lft'; .*left"):
        small().at("lft", 0.0)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"name": "a b"}, "sensor name"),
        ({"size_px": (161, 120)}, "size_px"),
        ({"size_px": (160, 16)}, "size_px"),
        ({"looks_at_m": (0.0, 0.0, 0.5)}, "looks_at_m"),
        ({"view_deg": 4.0}, "view_deg"),
        ({"fps": 0.5}, "fps"),
        ({"phase_s": -0.1}, "phase_s"),
        ({"readout_s": 1.1}, "readout_s"),
        ({"exposure_s": -0.1}, "exposure_s"),
    ],
)
def test_cameras_that_cannot_be_are_refused(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        SimulatedCamera(**{"name": "left", "position_m": (0.0, 0.0, 0.5), **changed})


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"cameras": ()}, "cameras"),
        ({"cameras": hand_scene_settings("wide").cameras[:1] * 2}, "each with its own name"),
        ({"paints": hand_scene_settings("wide").paints[:5]}, "six to eight"),
        ({"paints": (*hand_scene_settings("wide").paints[:5], hand_scene_settings("wide").paints[0])}, "own name"),
        ({"handedness": "both"}, "left or right"),
        ({"clutter": 1.1}, "clutter"),
        ({"brightness_change": 0.9}, "brightness_change"),
        ({"colour_change": 0.9}, "colour_change"),
        ({"shading": -0.1}, "shading"),
        ({"light_hz": 11.0}, "light_hz"),
    ],
)
def test_scenes_that_cannot_be_are_refused(changed: dict[str, Any], said: str) -> None:
    made = hand_scene_settings("wide")
    with pytest.raises(SettingsError, match=said):
        HandSceneSettings(**{"cameras": made.cameras, "paints": made.paints, **changed})
