"""People in rooms before cameras: what is said of them is true of the pictures, and they move as people may."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation, binary_erosion

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.model.body_meshes import body_mesh
from mocapella.model.bvh import read_bvh
from mocapella.model.rigged_mesh import landmarks_at, posed
from mocapella.model.twist_tree import TreePose
from mocapella.sources.simulate import body_paint_kernels
from mocapella.sources.simulate.body_motion import body_motion, motion_names, turned
from mocapella.sources.simulate.body_paint import cell_m, make_cast, painted, stand
from mocapella.sources.simulate.bvh_body import body_angles, body_motion_of
from mocapella.sources.simulate.corruption import Corruption
from mocapella.sources.simulate.outfits import OUTFITS, Garment, Outfit, dressed, make_outfit, outfit_names
from mocapella.sources.simulate.retarget import joint_columns
from mocapella.sources.simulate.silhouette_scene import CameraLook, SilhouetteScene, silhouette_scene

SMALL = {"size_px": (96, 72), "cameras": 2}
MOTIONS = motion_names()


@cache
def scene(name: str = "runner", **settings: Any) -> SilhouetteScene:
    return silhouette_scene(name, **{"seed": 3, **SMALL, **settings})


# ------------------------------------------------------------------ what is said of pictures


@pytest.mark.parametrize("name", MOTIONS)
def test_points_of_the_body_are_in_the_mask(name: str) -> None:
    s = scene(name)
    k = len(s) // 2
    vertices = posed(s.mesh, s.pose(k))
    for placed, mask, covered in zip(s.rig.cameras.values(), s.masks(k), s.covered(k), strict=True):
        shown = covered.people >= 0  # or things that are before the body
        x, y = np.rint(project(apply(placed.T_camera_world, vertices), placed.camera.lens)).astype(int).T
        # A vertex on the outline is half a pixel beside the middle that says so, at most; thin limbs have none.
        assert binary_dilation(shown, np.ones((3, 3)))[y, x].mean() > 0.99
        assert mask.any()
        reached = np.zeros_like(mask)
        reached[y, x] = True
        assert not (mask & ~binary_dilation(reached, np.ones((7, 7)))).any()


@pytest.mark.parametrize("name", MOTIONS)
def test_everybody_is_in_all_pictures_all_the_time(name: str) -> None:
    s = scene(name)
    for k in range(0, len(s), max(len(s) // 12, 1)):
        vertices = posed(s.mesh, s.pose(k))
        for placed in s.rig.cameras.values():
            px = project(apply(placed.T_camera_world, vertices), placed.camera.lens)
            assert (px >= -0.5).all()
            assert (px <= np.array(placed.camera.size_px) - 0.5).all()


def test_the_layer_covers_what_the_mask_covers() -> None:
    s = scene()
    stage = s._stage(7)
    for placed, mask in zip(s.rig.cameras.values(), s.masks(7), strict=True):
        layer = painted([stage], placed)
        x, y = layer.origin_px
        h, w = layer.alpha.shape
        inside = mask[y : y + h, x : x + w]
        assert inside[layer.alpha > 0.99].mean() > 0.995  # a pixel's middle and its four samples hardly ever disagree
        assert not (mask.sum() - inside.sum())
        assert layer.alpha.sum() == pytest.approx(mask.sum(), rel=0.05)
        assert (layer.alpha <= 1 + 1e-5).all()
        assert (layer.colour[layer.alpha == 0] == 0).all()


def test_pictures_differ_from_the_empty_room_where_somebody_is_and_nowhere_else_but_in_shadow() -> None:
    s = silhouette_scene("t-pose", seed=2, look=CameraLook(photons=1e9, read_noise=0.0), outfit="stripes", **SMALL)
    for image, empty, mask, view in zip(s.images(0), s.background(0), s.masks(0), s._views, strict=True):
        other = np.abs(image.astype(int) - empty).max(axis=-1) > 2
        assert other[binary_erosion(mask)].mean() > 0.9
        beside = other & ~binary_dilation(mask, np.ones((3, 3)))
        assert np.isfinite(view.floor_m[beside]).all()  # what else has changed is floor
        assert beside.any()
        darker = empty[beside].astype(int) - image[beside]
        assert (darker.sum(axis=-1) > 0).all()
        assert (darker.mean(axis=0) > 2).all()  # in blue, green and red


def test_the_parts_are_where_their_landmarks_are() -> None:
    s = silhouette_scene("t-pose", seed=4, cameras=3, size_px=(320, 240))
    names = list(s.mesh.landmarks)
    hit = 0
    for placed, truth in zip(s.rig.cameras.values(), s.covered(0), strict=True):
        for name, part in (("left hand", "left forearm"), ("right hand", "right forearm"), ("head", "torso")):
            at = apply(placed.T_camera_world, s.landmarks(0)[[names.index(name)]] - [0, 0.03 * (name == "head"), 0])
            x, y = np.rint(project(at, placed.camera.lens)[0]).astype(int)
            if abs(truth.depth_m[y, x] - at[0, 2]) < 0.15:  # nothing hides it
                assert s.mesh.part_names[truth.parts[y, x]] == part
                hit += 1
    assert hit >= 5
    assert set(np.unique(truth.people)) == {-1, 0}
    np.testing.assert_array_equal(np.isfinite(truth.depth_m), truth.people >= 0)


@pytest.mark.slow
def test_heights_that_are_not_given_are_random_and_within_their_range() -> None:
    """Of the third person with this seed, 1.45 m is drawn."""
    people = scene("t-pose", seed=308, people=3, height_m=2.0).meshes
    assert people[0] is body_mesh("female", 2.0)
    assert people[2] is body_mesh("female", 1.5)
    drawn = [scene("t-pose", seed=seed).mesh for seed in range(6)]
    men = [scene("t-pose", seed=seed, sex="male").mesh for seed in range(6)]
    tall_m = [float(np.ptp(mesh.vertices[:, 1])) for mesh in men]
    assert len(set(tall_m)) == 5  # twice 1.82 m
    assert 0 < sum(man is one for man, one in zip(men, drawn, strict=True)) < 6


def test_several_people_are_told_apart() -> None:
    s = scene("t-pose", people=2)
    found = np.unique(np.concatenate([truth.people.ravel() for truth in s.covered(0)]))
    assert found.tolist() == [-1, 0, 1]
    assert np.linalg.norm(s.landmarks(0, 0)[0] - s.landmarks(0, 1)[0]) > 0.8


@pytest.mark.slow
@given(st.integers(0, 3), st.integers(0, 40))
@settings(max_examples=4)
def test_the_same_seed_and_frame_give_the_same_to_the_bit_in_any_order(seed: int, frame: int) -> None:
    one, other = (silhouette_scene("runner", seed=seed, cameras=1, size_px=(48, 36)) for _ in range(2))
    other.images(frame + 1)
    for a, b in ((one.images(frame), other.images(frame)), (one.masks(frame), other.masks(frame))):
        np.testing.assert_array_equal(a[0], b[0])
    another = silhouette_scene("runner", seed=seed + 1, cameras=1, size_px=(48, 36))
    assert (another.images(frame)[0] != one.images(frame)[0]).any()


def test_two_pictures_of_an_empty_room_differ_by_noise_only() -> None:
    s = scene("t-pose")
    first, second = (np.array(s.background(k), float) for k in (0, 1))
    difference = second - first
    assert 0.5 < difference.std() < 8
    assert abs(difference.mean()) < 0.3


def test_flicker_and_drift_change_the_light_of_whole_pictures() -> None:
    look = CameraLook(flicker=0.1, photons=1e9, read_noise=0.0)
    s = silhouette_scene("t-pose", seed=1, look=look, cameras=1, size_px=(48, 36))
    means = [s.background(k)[0].mean() for k in range(20)]
    assert np.std(np.log(means)) > 0.01
    steady = silhouette_scene("t-pose", seed=1, look=CameraLook(), cameras=1, size_px=(48, 36))
    assert np.std([steady.background(k)[0].mean() for k in range(20)]) < 0.2


def test_an_exposure_smears_what_moves() -> None:
    sharp, smeared = (scene("runner", cameras=1, look=CameraLook(exposure_s=e)) for e in (0.0, 0.03))
    s, placed = smeared, next(iter(smeared.rig.cameras.values()))
    k = 20
    stages = [s._stage_at(s.times_s[k] + late) for late in (-0.015, 0.015)]
    still, moving = (painted(some, placed).alpha for some in (stages[:1], stages))
    assert ((moving > 0.1) & (moving < 0.9)).sum() > 1.3 * ((still > 0.1) & (still < 0.9)).sum()
    assert (sharp.images(k)[0] != smeared.images(k)[0]).any()
    np.testing.assert_array_equal(sharp.masks(k)[0], smeared.masks(k)[0])


def test_corruption_is_put_on_top() -> None:
    worse = Corruption(noise=0.15, seed=1)
    clean, bad = scene(), scene(corruption=worse)
    np.testing.assert_array_equal(worse.of(clean.images(5)[1], 5, 1), bad.images(5)[1])
    np.testing.assert_array_equal(clean.masks(5)[1], bad.masks(5)[1])


def test_bodies_are_as_bright_as_the_light_allows_and_throw_a_shadow() -> None:
    s = scene("t-pose")
    mesh = s.mesh
    white = Garment("plain", (0.5, 0.5, 0.5))
    cast = make_cast([mesh], [dressed(mesh, Outfit(white, white, white, white, white))])
    light = s.backdrop.light
    stage = stand(cast, posed(mesh, s.pose(0)), light)
    assert (stage.shade > 0.9).any()
    assert (stage.shade[[0, -1]] < 0.01).all()
    for placed in s.rig.cameras.values():
        layer = painted([stage], placed)
        inside = layer.alpha > 0.99
        grey = layer.colour[inside][:, 1] / 0.5
        darkest = np.percentile(grey, 0.5)  # but for a few pixels, such as the mouth
        assert darkest >= light.ground.min() * 0.7, "never darker than what comes from below on folds"
        assert grey.max() <= 1.25 * (light.strength[1] + light.sky[1])


def test_shadows_fall_away_from_the_light() -> None:
    s = scene("t-pose")
    stage = s._stage(0)
    cells = np.argwhere(stage.shade > 0.5)[:, ::-1]
    on_floor = stage.first_m + cell_m() * cells
    head = s.landmarks(0)[list(s.mesh.landmarks).index("head")]
    towards = s.backdrop.light.towards
    expected = head[[0, 2]] - (head[1] - 0.05) * towards[[0, 2]] / towards[1]
    assert np.linalg.norm(on_floor - expected, axis=1).min() < 0.03
    assert np.linalg.norm(on_floor - (2 * head[[0, 2]] - expected), axis=1).min() > 0.2


def test_light_arrives_where_nothing_is_above() -> None:
    tops = np.zeros((9, 9))
    tops[4, 4] = 1.0 + 1.5  # a thing at 1.5 m
    first = np.zeros(2)
    for (x, z, y), share in {
        (0.4, 0.4, 0.2): 0.0, (0.4, 0.4, 1.5): 1.0, (0.1, 0.1, 0.2): 1.0, (0.45, 0.4, 0.2): 0.5, (5.0, 0.4, 0.2): 1.0
    }.items():  # fmt: skip
        assert body_paint_kernels.lit_share(tops, first, 0.1, x, z, y) == pytest.approx(share, abs=1e-6)


# ------------------------------------------------------------------ how they move


@cache
def moved(name: str, seed: int = 0) -> Any:
    mesh = body_mesh(("male", "female")[seed % 2])
    return mesh, body_motion(name, mesh, seed=seed)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", MOTIONS)
def test_joints_keep_their_limits(name: str, seed: int) -> None:
    mesh, motion = moved(name, seed)
    angles = motion.pose(np.linspace(0, motion.seconds, 300)).angles
    assert (angles >= mesh.tree.limits[:, 0] - 1e-6).all()
    assert (angles <= mesh.tree.limits[:, 1] + 1e-6).all()


@pytest.mark.parametrize("name", MOTIONS)
def test_nobody_sinks_into_the_floor_nor_floats(name: str) -> None:
    mesh, motion = moved(name)
    lowest = posed(mesh, motion.pose(np.linspace(0, motion.seconds, 200)))[..., 1].min(axis=1)
    assert lowest.min() > -0.001
    assert np.median(lowest) < 0.02
    assert lowest.max() < 0.9  # in flight
    for who, flies in (("runner", 0.04), ("flick-flack", 0.2)):
        assert name != who or lowest.max() > flies


@pytest.mark.parametrize("name", ["runner", "flick-flack"])
def test_who_is_in_the_air_falls_as_everything_does(name: str) -> None:
    mesh, motion = moved(name)
    h = 1e-2
    at = np.arange(0.0, motion.seconds, h)
    vertices = posed(mesh, motion.pose(at))
    falling = np.diff(vertices[..., 1].mean(axis=1), 2) / h**2
    high = vertices[1:-1, :, 1].min(axis=1)
    flying = high > 0.6 * high.max()
    assert flying.sum() > 5
    assert np.median(falling[flying]) == pytest.approx(-9.81, rel=0.2 if name == "flick-flack" else 0.5)


@pytest.mark.parametrize(
    ("name", "most"),
    [("knee-bend", 8.0), ("runner", 60.0), ("walk", 40.0), ("cartwheel", 60.0), ("flick-flack", 70.0)],
)
def test_motions_are_smooth(name: str, most: float) -> None:
    _, motion = moved(name)
    h = 1e-3
    at = np.arange(0.05, motion.seconds - 0.05, h)
    place = motion.place(at)
    second = np.diff(place, 2, axis=0) / h**2
    assert np.abs(second).max() < most  # m/s²
    assert np.abs(np.diff(second, axis=0)).max() < 0.2 * most  # and it does not jump
    turning = np.diff(motion.angles(at), 2, axis=0) / h**2
    assert np.abs(np.diff(turning, axis=0)).max() < 0.2 * max(np.abs(turning).max(), 1.0)


def test_feet_that_stand_do_not_slide() -> None:
    mesh, motion = moved("knee-bend")
    names = list(mesh.landmarks)
    feet = landmarks_at(mesh, motion.pose(np.linspace(0.1, motion.seconds - 0.1, 60)))[
        :, [names.index("left toe"), names.index("right heel")]
    ]
    assert np.ptp(feet, axis=0).max() < 0.02
    assert np.ptp(motion.place(np.linspace(0, motion.seconds, 60))[:, 1]) > 0.2  # while the body goes down


def test_what_the_motions_are_called_is_what_they_do() -> None:
    up = {}
    for name in MOTIONS:
        mesh, motion = moved(name)
        T = motion.pose(np.linspace(0, motion.seconds, 200)).T_world_model
        up[name] = (T[:, 1, 1].min(), np.ptp(T[:, :3, 3] + T[:, :3, :3] @ mesh.tree.root, axis=0))
    assert up["cartwheel"][0] < -0.95
    assert up["flick-flack"][0] < -0.95
    assert min(up[name][0] for name in ("knee-bend", "runner", "walk", "t-pose")) > 0.9
    assert np.hypot(*up["walk"][1][[0, 2]]) > 1.5
    assert np.hypot(*up["runner"][1][[0, 2]]) < 0.4


def test_after_its_end_a_body_stands_still() -> None:
    _, motion = moved("cartwheel")
    np.testing.assert_array_equal(motion.pose(99.0).T_world_model, motion.pose(motion.seconds).T_world_model)


# ------------------------------------------------------------------ BVH


@pytest.mark.parametrize(
    ("name", "most_deg"),
    [
        ("PyMO/AV_8Walk_Meredith_HVHA_Rep1.bvh", 4.0),
        ("bvh-python/test_freebvh.bvh", 1.0),
        ("bvh-python/test_mocapbank.bvh", 16.0),  # a hip beyond its limits
    ],
)
def test_bones_point_where_the_files_point(mocap_files: Path, name: str, most_deg: float) -> None:
    mesh, bvh = body_mesh(), read_bvh(mocap_files / name)
    angles, turns, path = body_angles(bvh, mesh)
    places = landmarks_at(mesh, TreePose(rigid(turned(turns), np.zeros(3)), angles))
    own = {landmark: places[:, k] for k, landmark in enumerate(mesh.landmarks)}
    file = {joint: bvh.positions()[:, column] for joint, column in joint_columns(bvh).items()}
    for side in ("left", "right"):
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")):
            u = own[f"{side} {b}"] - own[f"{side} {a}"]
            v = file[b.title() + side.title()] - file[a.title() + side.title()]
            cosine = (u * v).sum(axis=1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
            wrong = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
            assert np.median(wrong) < 1.5
            assert wrong.max() < most_deg, (side, a, b)
    assert (angles >= mesh.tree.limits[:, 0]).all()
    assert (angles <= mesh.tree.limits[:, 1]).all()
    assert np.isfinite(path).all()


def test_a_file_moves_a_body_on_the_floor(mocap_files: Path) -> None:
    mesh, bvh = body_mesh("female"), read_bvh(mocap_files / "PyMO/AV_8Walk_Meredith_HVHA_Rep1.bvh")
    motion = body_motion_of(bvh, mesh, 2.0, start_s=1.0)
    lowest = posed(mesh, motion.pose(np.linspace(0, 2, 80)))[..., 1].min(axis=1)
    assert motion.seconds == pytest.approx(2.0)
    assert lowest.min() > -0.001
    assert lowest.max() < 0.05
    with pytest.raises(SettingsError, match="start_s"):
        body_motion_of(bvh, mesh, start_s=1000.0)
    with pytest.raises(SettingsError, match="seconds"):
        body_motion_of(bvh, mesh, 1000.0)


# ------------------------------------------------------------------ clothes and guards


@pytest.mark.parametrize("name", OUTFITS)
def test_outfits_show_their_colours(name: str) -> None:
    mesh = body_mesh()
    outfit = make_outfit(name)
    baked = make_cast([mesh], [dressed(mesh, outfit)]).baked
    faces = mesh.vertices[mesh.faces].mean(axis=1)
    foot = faces[:, 1] < 0.04
    assert np.abs(baked[foot, 2, 2, :3].mean(axis=0) / np.array(outfit.shoes.colour) - 1).max() < 0.4
    head = mesh.landmarks["head"].point
    crown = np.linalg.norm(faces - head, axis=1) < 0.06
    assert np.abs(baked[crown, 2, 2, :3].mean(axis=0) / np.array(outfit.hair.colour) - 1).max() < 0.5
    assert (baked[..., :3] <= 0.95).all()


def test_clothes_like_the_room_have_its_colours() -> None:
    s = scene("t-pose", outfit="background")
    wall = s.backdrop.materials[s.backdrop.faces[0, 0], 1:4]
    np.testing.assert_allclose(s.outfits[0].shirt.colour, wall)
    assert "background" in outfit_names()
    with pytest.raises(SettingsError, match="colours of a room"):
        make_outfit("background")


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: silhouette_scene("cartweel"), "cartwheel"),
        (lambda: silhouette_scene("runner", outfit="strips"), "stripes"),
        (lambda: silhouette_scene("runner", cameras=0), "cameras is 0"),
        (lambda: silhouette_scene("runner", people=9), "people is 9"),
        (lambda: silhouette_scene("runner", fps=0), "fps is 0"),
        (lambda: silhouette_scene("runner", size_px=(8, 8)), "size_px"),
        (lambda: silhouette_scene("runner", seed=-1), "seed is -1"),
        (lambda: silhouette_scene("runner", bvh="a.bvh"), "bvh"),
        (lambda: silhouette_scene("runner", seconds=0), "seconds is 0"),
        (lambda: CameraLook(exposure=0), "exposure is 0"),
        (lambda: CameraLook(photons=1), "photons is 1"),
        (lambda: CameraLook(read_noise=1), "read_noise is 1"),
        (lambda: CameraLook(flicker=1), "flicker is 1"),
        (lambda: CameraLook(drift=1), "drift is 1"),
        (lambda: CameraLook(exposure_s=1), "exposure_s is 1"),
        (lambda: Garment("stripe", (0, 0, 0)), "unknown pattern"),
        (lambda: Garment("plain", (2, 0, 0)), "colours"),
        (lambda: Garment("plain", (0, 0, 0), size_m=0), "size_m is 0"),
        (lambda: Garment("plain", (0, 0, 0), shine=2), "shine is 2"),
        (lambda: Outfit(*[Garment("plain", (0, 0, 0))] * 5, sleeve=2), "sleeve is 2"),
        (lambda: Outfit(*[Garment("plain", (0, 0, 0))] * 5, leg=2), "leg is 2"),
    ],
)
def test_what_cannot_be_is_said(call: Any, says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        call()
