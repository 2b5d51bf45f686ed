"""Depth images of arms: exact depths, what is said to be seen, and each sensor's noise against its formulas."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.model.arms import ELBOW
from mocapella.model.hand import DIGIT_ANGLES, TIPS
from mocapella.sources.simulate import depth_scene
from mocapella.sources.simulate.arm_mesh import FIRST_TIP, PARTS, ArmMeshPose, arm_mesh, arm_shape
from mocapella.sources.simulate.arm_motion import HeldArm, Key, held_at
from mocapella.sources.simulate.depth_noise import StructuredLight, TimeOfFlight, measured
from mocapella.sources.simulate.depth_scene import (
    BODY,
    FIRST_ARM,
    SEEN_PX,
    VIEWS,
    DepthScene,
    DepthShot,
    depth_scene_names,
    depth_sensor_names,
    load_depth_scene,
    shot_frame,
)

PLANE = (160, 200)


def plane(z: float) -> tuple[np.ndarray, np.ndarray]:
    return np.full(PLANE, z, np.float32), np.ones(PLANE, np.float32)


class Holding:
    """A motion that always holds the arm the same way."""

    def __init__(self, pose: ArmMeshPose) -> None:
        self.pose = pose

    def at(self, at_s: float) -> HeldArm:
        return HeldArm(self.pose, "")


def shot_of(digits: dict[int, tuple[float, float, float, float]], side: str = "right", view: str = "palm") -> DepthShot:
    """An average arm alone whose hand is held 0.6 m from the exact camera, digits bent as given [deg]."""
    scene = load_depth_scene("rotation", seed=1, sensor="exact")
    mesh = arm_mesh(arm_shape("average"), side)  # type: ignore[arg-type]
    start = held_at(mesh, np.radians([100.0, 75.0, 0.0, 0.0]), VIEWS[view], np.array([0.0, 0.0, 0.6]))
    angles = start.angles.copy()
    angles[DIGIT_ANGLES[1:, 1]] = np.radians([8.0, 0.0, -8.0, -14.0])
    for digit, values in digits.items():
        angles[DIGIT_ANGLES[digit, :4]] = np.radians(values)
    pose = ArmMeshPose(mesh.model.limited(angles), start.joints, start.T_camera_shoulder)
    scene._actors = [replace(scene._actors[0], mesh=mesh, motion=Holding(pose))]  # type: ignore[arg-type]
    return scene.at(0.0)


@pytest.mark.parametrize("sensor", depth_sensor_names())
def test_seed_and_time_determine_the_image(sensor: str) -> None:
    one, other = (load_depth_scene("open-close", seed=7, sensor=sensor) for _ in range(2))
    other.at(0.3)
    a, b = one.at(1.1), other.at(1.1)
    assert np.array_equal(a.depth, b.depth)
    assert np.array_equal(a.arms[0].points, b.arms[0].points)
    assert not np.array_equal(a.depth, one.at(1.15).depth)
    assert not np.array_equal(a.depth, load_depth_scene("open-close", seed=8, sensor=sensor).at(1.1).depth)
    assert a.depth.shape == one.sensor.size_px[::-1]
    assert a.depth.dtype == np.uint16


def test_the_noise_of_a_still_hand_changes_and_the_truth_does_not() -> None:
    scene = load_depth_scene("still", seed=2, sensor="kinect")
    motion = scene._actors[0].motion
    start = (1.0 - motion._phase) * float(motion._ends[-1]) + 1.0  # in the first key's hold
    a, b = scene.at(start), scene.at(start + 1.0)
    assert np.array_equal(a.exact_m, b.exact_m)
    assert np.array_equal(a.arms[0].points, b.arms[0].points)
    assert not np.array_equal(a.depth, b.depth)


def test_exact_depth_is_that_of_the_mesh() -> None:
    scene = load_depth_scene("open-close", seed=3, sensor="exact")
    shot = scene.at(0.4)
    pose, mesh = scene.poses(0.4)[0], scene.meshes[0]
    vertices = mesh.at(pose)
    px = project(vertices, shot.lens)
    height, width = shot.depth.shape
    inside = (px > 1).all(axis=1) & (px[:, 0] < width - 2) & (px[:, 1] < height - 2)
    x, y = px[inside].T
    z = vertices[inside, 2]
    i, j = x.astype(int), y.astype(int)
    corners = np.stack([shot.exact_m[j + b, i + a] for a, b in ((0, 0), (1, 0), (0, 1), (1, 1))])
    flat = np.ptp(corners, axis=0) < 0.002
    u, v = x - i, y - j
    depth = (1 - v) * ((1 - u) * corners[0] + u * corners[1]) + v * ((1 - u) * corners[2] + u * corners[3])
    near = flat & (np.abs(depth - z) < 0.004)  # what is behind is farther than that
    assert near.sum() > 1000
    assert np.median(np.abs(depth - z)[near]) < 0.0002
    assert np.percentile(np.abs(depth - z)[near], 99) < 0.001
    front = flat & (z < depth - 0.002)
    assert front.mean() < 0.001  # nothing visible is left out
    of_arm = shot.parts >= FIRST_ARM
    assert np.abs(shot.depth[of_arm] * shot.unit_m - shot.exact_m[of_arm]).max() < 0.6 * shot.unit_m


def test_an_open_hand_shows_all_its_tips_and_nothing_of_them_is_before_the_palm() -> None:
    for side in ("left", "right"):
        for view in ("palm", "back"):
            arm = shot_of({}, side, view).arms[0]
            assert arm.left == (side == "left")
            assert arm.seen[list(TIPS)].all()
            assert not arm.self_occluded.any()


def test_a_finger_bent_before_the_palm_is_seen_and_self_occluded_from_there_only() -> None:
    for digit in (1, 2, 3):
        bent = {digit: (65.0, 0.0, 80.0, 50.0)}
        arm = shot_of(bent).arms[0]
        assert arm.seen[TIPS[digit]]
        assert arm.self_occluded.tolist() == [k == digit for k in range(5)]
        behind = shot_of(bent, view="back").arms[0]
        assert not behind.seen[TIPS[digit]]
        assert not behind.self_occluded.any()
        assert behind.tip_px[digit, 0] < SEEN_PX < behind.tip_px[digit, 1]


def test_tips_have_the_pixels_that_are_drawn_and_those_they_would_have_alone() -> None:
    shot = shot_of({})
    for digit in range(5):
        drawn = int((shot.parts == FIRST_ARM + FIRST_TIP + digit).sum())
        there, alone = shot.arms[0].tip_px[digit]
        assert there == drawn
        assert there <= alone <= 1.6 * there


def test_joints_that_are_hidden_or_outside_are_not_seen() -> None:
    scene = load_depth_scene("leaves", seed=4, sensor="exact")
    shots = [scene.at(float(t)) for t in np.linspace(0.0, scene.period_s, 25)]
    width, height = scene.sensor.size_px
    away = 0
    for shot in shots:
        px = project(shot.arms[0].points, shot.lens)
        outside = ((px < -0.5) | (px > [width - 0.5, height - 0.5])).any(axis=1)
        outside[list(TIPS)] = False  # of a tip the patch counts
        assert not shot.arms[0].seen[outside].any()
        away += bool(outside.sum() > 15)
    assert 3 <= away <= 20
    there = max(shots, key=lambda shot: shot.arms[0].seen.sum()).arms[0]
    assert there.seen[[0, ELBOW]].all()


def test_the_torso_is_close_behind_the_arm() -> None:
    scene = load_depth_scene("torso", seed=100, sensor="exact")
    shot = scene.at(0.0)
    z = shot.exact_m
    wrist = shot.arms[0].points[0]
    x, y = np.rint(project(wrist, shot.lens)).astype(int)
    body = z[max(y - 90, 0) : y + 90, max(x - 90, 0) : x + 90][
        shot.parts[max(y - 90, 0) : y + 90, max(x - 90, 0) : x + 90] == BODY
    ]
    assert len(body) > 1000
    assert 0.02 < np.percentile(body, 5) - wrist[2] < 0.25


def test_two_hands_are_a_left_and_a_right_one() -> None:
    shot = load_depth_scene("two-hands", seed=101, sensor="exact").at(0.5)
    assert sorted(arm.left for arm in shot.arms) == [False, True]
    left, right = sorted(shot.arms, key=lambda arm: not arm.left)
    assert left.points[0, 0] > right.points[0, 0]  # they face the camera
    for n in range(2):
        first = FIRST_ARM + n * len(PARTS)
        assert ((shot.parts >= first) & (shot.parts < first + len(PARTS))).sum() > 3000


def test_scenes_of_one_period() -> None:
    scene = load_depth_scene("fast", seed=1, sensor="exact")
    shots = list(scene.frames(5.0, 1.0, 2.0))
    assert [shot.at_s for shot in shots] == [1.0, 1.2, 1.4, 1.6, 1.8]
    assert len(list(scene.frames(4.0))) == math.ceil(scene.period_s * 4.0)


@pytest.mark.slow
def test_gestures_are_those_of_the_images() -> None:
    scene = load_depth_scene("two-hands", seed=0, sensor="exact")
    for at_s in np.linspace(0.0, scene.period_s, 4):
        assert scene.gestures(float(at_s)) == tuple(arm.gesture for arm in scene.at(float(at_s)).arms)


def test_seeds_change_people_and_sides() -> None:
    arms = [load_depth_scene("rotation", seed=seed, sensor="exact")._actors[0] for seed in range(12)]
    assert len({arm.shape for arm in arms}) >= 4
    assert {arm.mesh.handedness for arm in arms} == {"left", "right"}


def test_a_shot_is_a_depth_frame() -> None:
    shot = load_depth_scene("still", seed=1, sensor="sr305").at(0.25)
    frame = shot_frame(shot, "front", sequence=3)
    assert frame.sensor == "front"
    assert frame.time_ns == 250_000_000
    assert frame.sequence == 3
    assert np.array_equal(frame.metres, shot.depth * np.float32(0.000125))


def test_what_there_is_not_is_refused_with_what_there_is() -> None:
    assert {"open-close", "touching", "torso", "two-hands"} <= set(depth_scene_names())
    with pytest.raises(SettingsError, match="open-close"):
        load_depth_scene("open-closed")
    with pytest.raises(SettingsError, match="kinect"):
        load_depth_scene("fist", sensor="kinec")
    with pytest.raises(SettingsError, match="seed"):
        load_depth_scene("fist", seed=-1)
    sensor = load_depth_scene("fist", sensor="exact").sensor
    keys = (Key(),)
    for field, value in (("view", "below"), ("arms", 3), ("behind", "sea")):
        wrong = depth_scene.DepthSceneSettings(keys, **{field: value})
        with pytest.raises(SettingsError, match=field):
            DepthScene("wrong", wrong, sensor, 0)
    with pytest.raises(SettingsError, match="fist"):
        DepthScene("wrong", depth_scene.DepthSceneSettings((Key(posture="fits"),)), sensor, 0)
    with pytest.raises(SettingsError, match="move_s"):
        Key(move_s=0.0)


@pytest.mark.parametrize("z", [0.5, 0.7, 1.2, 2.5])
def test_structured_light_is_as_noisy_as_published_and_in_steps(z: float) -> None:
    noise = StructuredLight()
    exact, slope = plane(z + 0.0003)
    images = [measured(exact, slope, noise, focal_px=580.0, unit_m=1e-4, key=k) * 1e-4 for k in range(6)]
    values = np.concatenate([image[image > 0] for image in images])
    assert values.std() == pytest.approx(0.0012 + 0.0019 * (z - 0.4) ** 2, rel=0.08)  # Nguyen et al., equation 4
    assert values.mean() == pytest.approx(z, abs=0.0006)
    steps = 1.0 / (0.0030711016 * values)
    assert np.abs(steps - np.rint(steps)).max() < 0.08
    lost = 1.0 - len(values) / (6 * exact.size)
    assert 0.0005 < lost < 0.003
    assert noise.sd_at(z) == pytest.approx(0.0012 + 0.0019 * (z - 0.4) ** 2)


def test_structured_light_is_noisier_at_a_slant_and_sees_nothing_at_grazing_angles() -> None:
    noise, sd = StructuredLight(dropout=0.0, step_per_m=0.0), []
    for degrees in (0.0, 50.0, 65.0):
        exact, slope = plane(1.0)
        slope *= math.cos(math.radians(degrees))
        image = measured(exact, slope, noise, focal_px=580.0, unit_m=1e-4, key=1) * 1e-4
        sd.append(image[image > 0].std())
        assert sd[-1] == pytest.approx(noise.sd_at(1.0, math.radians(degrees)), rel=0.08)
    assert sd[0] < sd[1] < sd[2]
    for degrees, lost in ((69.0, 0.0), (79.0, 0.5), (89.0, 1.0)):
        exact, slope = plane(1.0)
        slope *= math.cos(math.radians(degrees))
        image = measured(exact, slope, noise, focal_px=580.0, unit_m=1e-3, key=1)
        assert (image == 0).mean() == pytest.approx(lost, abs=0.03)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.5, 1.0), st.floats(0.15, 1.5), st.sampled_from([-0.075, -0.04, 0.05, 0.075]))
def test_the_shadow_is_as_wide_as_the_disparities_differ(near: float, gap: float, baseline: float) -> None:
    """Beside the edge of what is near, f·b·(1/near − 1/far) px of what is behind are not lit, on one side."""
    noise = StructuredLight(edge_px=0.0, edge_holes=0.0, dropout=0.0, baseline_m=baseline)
    exact, slope = plane(near + gap)
    front, back = (slice(100, None), slice(0, 100)) if baseline > 0 else (slice(0, 100), slice(100, None))
    exact[:, front] = near
    image = measured(exact, slope, noise, focal_px=580.0, unit_m=1e-3, key=1)
    width = 580.0 * abs(baseline) * (1.0 / near - 1.0 / (near + gap))
    assert (image[80, front] > 0).all()
    assert np.count_nonzero(image[80, back] == 0) == pytest.approx(min(width, 100), abs=1.6)
    exact[:, front], exact[:, back] = near + gap, near  # the other side of what is near is not in the dark
    assert (measured(exact, slope, noise, focal_px=580.0, unit_m=1e-3, key=1)[80] > 0).all()


def test_edges_of_structured_light_are_ragged_and_have_holes() -> None:
    exact, slope = plane(1.5)
    exact[:, :100] = 0.8
    image = measured(exact, slope, StructuredLight(baseline_m=-0.075), focal_px=580.0, unit_m=1e-3, key=3) * 1e-3
    edge = np.array([np.flatnonzero((row > 0.7) & (row < 0.9)).max() for row in image])
    assert 0.4 < edge.std() < 1.5
    assert abs(edge.mean() - 99.0) < 1.0
    assert (image[:, 97:99] == 0).mean() > 0.1
    assert (image[:, :90] == 0).mean() < 0.01
    strays = image[(image > 0.85) & (image < 1.4)]
    assert len(strays) == 0  # triangulation gives the one or the other


@pytest.mark.parametrize(("z", "degrees"), [(0.6, 0.0), (1.0, 0.0), (1.0, 60.0), (2.0, 0.0)])
def test_time_of_flight_is_noisier_the_less_light_comes_back(z: float, degrees: float) -> None:
    noise = TimeOfFlight(wiggle_m=0.0)
    exact, slope = plane(z)
    slope *= math.cos(math.radians(degrees))
    image = measured(exact, slope, noise, focal_px=365.0, unit_m=1e-4, key=5) * 1e-4
    values = image[image > 0]
    assert values.std() == pytest.approx(noise.sd_at_1m * z * z / math.cos(math.radians(degrees)), rel=0.05)
    assert values.mean() == pytest.approx(z, abs=2e-4)


def test_time_of_flight_has_flying_pixels_between_what_is_at_an_edge() -> None:
    exact, slope = plane(1.6)
    exact[:, :100] = 0.8
    noise = TimeOfFlight(sd_at_1m=0.0, wiggle_m=0.0, dropout=0.0)
    image = measured(exact, slope, noise, focal_px=365.0, unit_m=1e-4, key=5) * 1e-4
    assert np.allclose(image[:, :98], 0.8, atol=1e-4)
    assert np.allclose(image[:, 102:], 1.6, atol=1e-4)
    between = image[1:-1, 99:101]
    assert (between > 0.801).all()
    assert (between < 1.599).all()
    exact[:, 100:] = np.inf  # before nothing there is nothing to mix with
    image = measured(exact, slope, noise, focal_px=365.0, unit_m=1e-4, key=5) * 1e-4
    assert np.allclose(image[:, :100], 0.8, atol=1e-4)


def test_time_of_flight_wiggles_four_times_a_period_and_loses_what_is_too_dark() -> None:
    noise = TimeOfFlight(sd_at_1m=0.0, dropout=0.0, most_m=5.0)
    z = np.linspace(0.5, 3.5, 200, dtype=np.float32)[None].repeat(4, axis=0)
    image = measured(z, np.ones_like(z), noise, focal_px=365.0, unit_m=1e-4, key=5) * 1e-4
    error = (image - z)[0]
    assert np.abs(error).max() == pytest.approx(noise.wiggle_m, abs=2e-4)
    turns = np.abs(np.diff(np.sign(error[np.abs(error) > 2e-4]))).sum() / 4
    assert turns == pytest.approx(3.0 / (299792458.0 / (8 * noise.wiggle_hz)), abs=1.0)
    far, slope = plane(4.6)
    assert (measured(far, slope, noise, focal_px=365.0, unit_m=1e-3, key=5) == 0).all()  # 1/4.6² < 0.05


def test_a_perfect_camera_gives_what_is_there() -> None:
    exact, slope = plane(0.75)
    exact[0], exact[1] = np.inf, 100.0
    image = measured(exact, slope, None, focal_px=580.0, unit_m=1e-3, key=0)
    assert (image[2:] == 750).all()
    assert (image[:2] == 0).all()  # nothing there, and what 16 bits cannot say


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        (StructuredLight, "least_m", 5.0), (StructuredLight, "sd_m", -1.0), (StructuredLight, "shared", 1.5),
        (StructuredLight, "shared_px", 0), (StructuredLight, "steep_deg", (80.0, 70.0)),
        (StructuredLight, "baseline_m", 0.0), (TimeOfFlight, "least_m", 5.0), (TimeOfFlight, "spread", 2.0),
        (TimeOfFlight, "sd_at_1m", -1.0), (TimeOfFlight, "low_hz", 80e6), (TimeOfFlight, "wiggle_hz", -1.0),
    ],
)  # fmt: skip
def test_noise_that_cannot_be_is_refused(kind: type, field: str, value: object) -> None:
    with pytest.raises(SettingsError, match=field):
        kind(**{field: value})
