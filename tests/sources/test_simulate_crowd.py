"""Simulated crowds: geometry, determinism, and each fault of the detector alone."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.topology import topology
from mocapella.sources.simulate.body import JOINT, body_template
from mocapella.sources.simulate.crowd import (
    CameraRing,
    CrowdPerson,
    CrowdScene,
    CrowdSettings,
    Mirror,
    build_crowd,
    crowd_names,
    crowd_scene,
    crowd_settings,
    ring_rig,
)
from mocapella.sources.simulate.keypoint_body import (
    HALPE,
    detected_positions,
    face_hidden,
    halpe_positions,
    keypoint_weights,
)
from mocapella.sources.simulate.keypoint_camera import PHANTOM, KeypointCameraSettings, SimulatedKeypoints
from mocapella.sources.simulate.keypoint_errors import DetectorErrors, ErrorTables, detector_errors
from mocapella.sources.simulate.keypoint_faults import NO_FAULTS, KeypointFaults

REST = body_template().chain @ body_template().offsets * 1.75
TWO = (CrowdPerson((-0.7, 0.3), "stand"), CrowdPerson((0.8, -0.2), "stand", stature=1.6))
BEHIND = (CrowdPerson((0.0, 0.0), "stand"), CrowdPerson((0.02, -0.7), "stand"))
BVH = Path(__file__).resolve().parents[3] / "shared/data/mocap_files/PyMO/AV_8Walk_Meredith_HVHA_Rep1.bvh"


def made(
    people: tuple[CrowdPerson, ...] = TWO, faults: KeypointFaults = NO_FAULTS, *, seconds: float = 1.0,
    readout_s: float = 0.0, mirrors: tuple[Mirror, ...] = (), first_deg: float = 20.0, seed: int = 3,
    **camera: object,
) -> CrowdScene:  # fmt: skip
    settings = CrowdSettings(
        "test", "a test", seconds, people, camera=KeypointCameraSettings(faults=faults, **camera),  # type: ignore[arg-type]
        mirrors=mirrors, seed=seed,
    )  # fmt: skip
    ring = dataclasses.replace(settings.ring, readout_s=readout_s, first_deg=first_deg)
    return build_crowd(dataclasses.replace(settings, ring=ring))


def items(scene: CrowdScene) -> list[SimulatedKeypoints]:
    return list(scene.frames())


def projected(scene: CrowdScene, item: SimulatedKeypoints) -> np.ndarray:
    placed = scene.rig.cameras[item.frame.sensor]
    return project(apply(placed.T_camera_world, item.positions), placed.camera.lens)


def test_without_faults_every_detection_is_the_projection_of_its_person() -> None:
    scene = made()
    for item in items(scene):
        assert sorted(item.detected.tolist()) == [0, 1]
        expected = projected(scene, item)[item.detected]
        found = item.frame.found
        assert found.mean() > 0.9
        np.testing.assert_allclose(item.frame.positions_px[found], expected[found], atol=0.01)


def test_equal_seeds_give_equal_bits_and_others_do_not() -> None:
    one, same, other = (items(made(faults=KeypointFaults(), seed=seed)) for seed in (3, 3, 4))
    for a, b in zip(one, same, strict=True):
        assert a.frame.positions_px.tobytes() == b.frame.positions_px.tobytes()
        assert a.frame.confidences.tobytes() == b.frame.confidences.tobytes()
        assert a.at_ns == b.at_ns
    assert any(
        a.frame.positions_px.tobytes() != b.frame.positions_px.tobytes() for a, b in zip(one, other, strict=False)
    )


def test_keypoints_keep_distances_when_the_body_turns() -> None:
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    np.testing.assert_allclose(halpe_positions(REST @ turn.T), halpe_positions(REST) @ turn.T, atol=1e-12)


def test_the_keypoints_of_a_standing_person_are_where_they_belong() -> None:
    at = dict(zip(HALPE.joints, halpe_positions(REST), strict=True))
    assert at["Nose"][2] > 0.05
    assert at["LEye"][0] > 0 > at["REye"][0]
    assert at["LHeel"][2] < 0 < at["LBigToe"][2]
    assert at["Head"][1] == max(point[1] for point in at.values())
    assert at["LSmallToe"][0] > at["LBigToe"][0]
    assert at["RSmallToe"][0] < at["RBigToe"][0]


def test_a_face_is_hidden_from_behind_and_seen_from_the_front() -> None:
    face = [HALPE.index(name) for name in ("Nose", "LEye", "REye")]
    assert face_hidden(REST, np.array([0.0, 0.7, -4.0]))[face].all()
    assert not face_hidden(REST, np.array([0.0, 0.7, 4.0]))[face].any()
    side = face_hidden(REST, np.array([4.0, 0.7, 0.0]))
    assert side[HALPE.index("REar")]
    assert not side[HALPE.index("LEar")]


def test_who_stands_behind_another_is_less_visible() -> None:
    scene = made(BEHIND, first_deg=0.0)
    front = [item for item in items(scene) if item.frame.sensor == "c1"]
    share = np.mean([item.visible.mean(axis=1) for item in front], axis=0)
    assert share[1] < share[0] - 0.2


def test_taken_keypoints_are_those_of_the_person_in_front() -> None:
    exact, taken = (
        [i for i in items(made(BEHIND, faults, first_deg=0.0)) if i.frame.sensor == "c1"]
        for faults in (NO_FAULTS, dataclasses.replace(NO_FAULTS, taken=1.0))
    )
    moved = 0
    for a, b in zip(exact, taken, strict=True):
        one, other = (item.frame.positions_px[np.argsort(item.detected)] for item in (a, b))
        changed = np.linalg.norm(one - other, axis=-1) > 1
        assert not changed[0].any()
        np.testing.assert_allclose(other[1][changed[1]], one[0][changed[1]], atol=0.01)
        moved += int(changed[1].sum())
    assert moved > 20


def test_a_swapped_person_has_left_and_right_exchanged() -> None:
    mirror = np.array(HALPE.mirror)
    exact = items(made())
    for a, b in zip(exact, items(made(faults=dataclasses.replace(NO_FAULTS, mirrored=(1.0, 1.0, 1.0)))), strict=True):
        one, other = (item.frame.positions_px[np.argsort(item.detected)] for item in (a, b))
        np.testing.assert_array_equal(one, other[:, mirror])
        assert b.mirrored.all()


@pytest.mark.parametrize(("field", "value"), [("missed", (1.0, 1.0, 1.0, 1.0)), ("least_px", 1000.0)])
def test_missed_people_are_not_there(field: str, value: object) -> None:
    scene = made(faults=dataclasses.replace(NO_FAULTS, **{field: value}))  # type: ignore[arg-type]
    assert all(len(item.frame.ids) == 0 for item in items(scene))


def test_duplicates_have_the_same_person() -> None:
    for item in items(made(faults=dataclasses.replace(NO_FAULTS, duplicates=1.0))):
        assert sorted(item.detected.tolist()) == [0, 0, 1, 1]


def test_merged_people_are_one_detection() -> None:
    close = (CrowdPerson((0.0, 0.0), "stand"), CrowdPerson((0.02, -0.25), "stand"))
    scene = made(close, dataclasses.replace(NO_FAULTS, merged=1.0), first_deg=0.0)
    front = [item for item in items(scene) if item.frame.sensor == "c1"]
    assert all(item.detected.tolist() == [0] for item in front)


def test_false_detections_belong_to_nobody() -> None:
    found = items(made(faults=dataclasses.replace(NO_FAULTS, false_per_image=3.0)))
    counts = [(item.detected == PHANTOM).sum() for item in found]
    assert 2.0 < np.mean(counts) < 4.0
    assert all((item.frame.confidences[item.detected == PHANTOM] < 0.5).all() for item in found)


def test_coordinates_are_rounded_to_the_step() -> None:
    for item in items(made(faults=dataclasses.replace(NO_FAULTS, step_px=4.0))):
        found = item.frame.positions_px[item.frame.found]
        np.testing.assert_array_equal(found, 4.0 * np.round(found / 4.0))


def test_bystanders_and_mirror_images_are_nobody() -> None:
    people = (*TWO, CrowdPerson((0.0, -6.0), "stand", seen_by=("c1",)))
    scene = made(people, mirrors=(Mirror("c2", (-3.0, 0.0), 90.0),))
    for item in items(scene):
        extra = int((item.detected == PHANTOM).sum())
        assert item.people.tolist() == [0, 1]
        assert extra == {"c1": 1, "c2": 3}.get(item.frame.sensor, 0) or item.frame.sensor == "c2"
    images = [item for item in items(scene) if item.frame.sensor == "c2"]
    assert any((item.detected == PHANTOM).any() for item in images)


def test_a_mirror_image_is_where_the_mirrored_person_would_be_with_sides_exchanged() -> None:
    scene = made(TWO[:1], mirrors=(Mirror("c2", (-3.0, 0.0), 90.0),))
    item = next(item for item in items(scene) if item.frame.sensor == "c2" and (item.detected == PHANTOM).any())
    image = item.positions[0] * [-1, 1, 1] + [-6.0, 0.0, 0.0]
    placed = scene.rig.cameras["c2"]
    expected = project(apply(placed.T_camera_world, image[np.array(HALPE.mirror)]), placed.camera.lens)
    found = item.frame.positions_px[item.detected == PHANTOM][0]
    known = np.isfinite(found[:, 0])
    assert known.sum() > 10
    feet = np.array(["Toe" in name or "Heel" in name for name in HALPE.joints])
    np.testing.assert_allclose(found[known & ~feet], expected[known & ~feet], atol=0.5)


def test_a_rolling_shutter_sees_the_feet_later_than_the_head() -> None:
    walker = (CrowdPerson((0.0, 0.0), "route", route=("go 1.5 0", "go 0 0")),)
    still, rolled = (items(made(walker, readout_s=r, seconds=2.0)) for r in (0.0, 0.03))
    moved = [
        np.linalg.norm(a.frame.positions_px[0] - b.frame.positions_px[0], axis=-1)
        for a, b in zip(still, rolled, strict=True)
        if len(a.frame.ids) and a.frame.sensor == "c1"
    ]
    mean = np.nanmean(np.stack(moved), axis=0)
    assert mean[HALPE.index("LBigToe")] > 1.2 * mean[HALPE.index("Head")] > 0


def test_clocks_run_apart_and_frames_are_lost() -> None:
    scene = made(clock_offset_s=100.0, clock_drift_ppm=500.0, lost=0.3, seconds=2.0)
    found = [item for item in items(scene) if item.frame.sensor == "c1"]
    assert 28 < len(found) < 55
    for item in found:
        assert item.frame.time_ns == round(item.room_ns * 1.0005 + 100e9)
    assert [item.frame.sequence for item in found] == list(range(len(found)))
    assert all(a.due_ns <= b.due_ns for a, b in pairwise(items(scene)))


@pytest.mark.parametrize("name", ["coco_17", "coco_18", "body_25", "body_25b", "halpe_26"])
def test_topologies_have_all_their_keypoints(name: str) -> None:
    weights = keypoint_weights(name)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert {len(item.frame.topology) for item in items(made(topology=name, seconds=0.2))} == {len(weights)}


@pytest.mark.parametrize("name", ["coco_18", "body_25"])
def test_openposes_neck_is_halfway_between_the_shoulders(name: str) -> None:
    body = REST.copy()
    body[[JOINT["ShoulderLeft"], JOINT["ShoulderRight"]]] -= (0.0, 0.02, 0.0)
    own, halpe = topology(name), halpe_positions(body)
    places = keypoint_weights(name) @ detected_positions(body, name)
    shoulders = halpe[[HALPE.index(f"{side}Shoulder") for side in "LR"]].mean(axis=0)
    np.testing.assert_allclose(places[own.index("Neck")], shoulders)
    np.testing.assert_allclose(places[own.index("Nose")], halpe[HALPE.index("Nose")])
    assert halpe[HALPE.index("Neck"), 1] - shoulders[1] == pytest.approx(0.02)
    np.testing.assert_array_equal(detected_positions(body, "halpe_26"), halpe)


def test_a_topology_without_its_keypoints_is_refused() -> None:
    with pytest.raises(SettingsError, match="not simulated"):
        keypoint_weights("kinect_v2")


@pytest.mark.parametrize(
    "wrong", [{"noise": -1.0}, {"taken": 2.0}, {"mirrored": (0.0, 2.0, 0.0)}, {"missed_s": 0.0}, {"step_px": -1.0},
              {"false_per_image": -1.0}, {"least_px": -1.0}, {"noise_px": -1.0}, {"exchanged_limbs": 2.0},
              {"unrelated_confidences": -1.0}],
)  # fmt: skip
def test_faults_out_of_range_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        KeypointFaults(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "wrong", [{"hz": 0.0}, {"jitter_s": 1.0}, {"lost": 1.0}, {"latency_s": -1.0}, {"known_clock_s": -2.0}]
)
def test_timing_out_of_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        KeypointCameraSettings(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [{"out_of_step": -1}, {"rig_error_px": -1.0}])
def test_scenes_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        dataclasses.replace(made().settings, **wrong)
    with pytest.raises(SettingsError, match="centre_sd"):
        CameraRing(centre_sd=-0.1)


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    with pytest.raises(SettingsError, match="six-walk"):
        crowd_scene("nowhere")
    with pytest.raises(SettingsError, match="openpose"):
        detector_errors("nothing")
    with pytest.raises(SettingsError, match="c1, c2"):
        made((CrowdPerson((0.0, 0.0), "stand", seen_by=("c9",)),))


def test_tables_of_another_shape_are_refused() -> None:
    data = detector_errors("openpose").data
    wrong = {field: getattr(data, field) for field in DetectorErrors.__struct_fields__} | {"core": [[1.0]]}
    with pytest.raises(SettingsError, match="core"):
        ErrorTables(DetectorErrors(**wrong))


def test_confidences_follow_their_quantiles() -> None:
    tables = detector_errors("openpose")
    states, groups = np.zeros(3, int), np.full(3, 2)
    found = tables.confidences(states, groups, np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(found, tables.quantiles[0, 2, [0, 3, 6]])


def test_errors_have_the_measured_size() -> None:
    """The median error of visible keypoints in simulation is that of the table, weighted by its confidences."""
    faults = dataclasses.replace(NO_FAULTS, noise=1.0)
    scene = made(TWO[:1], faults, seconds=3.0)
    far = []
    for item in items(scene):
        if item.frame.sensor == "c1" and len(item.frame.ids):
            size = scene.rig.cameras["c1"].camera.lens[0] * 1.75 / 4.5
            apart = np.linalg.norm(item.frame.positions_px[0] - projected(scene, item)[0], axis=-1) / size
            far.append(apart[item.visible[0] & np.isfinite(apart)])
    core = np.median(np.concatenate(far)) / np.sqrt(2 * np.log(2))
    assert 0.012 < core < 0.024  # the table's groups have 1.1 to 3 %


def test_cameras_look_at_the_middle() -> None:
    ring = crowd_settings("six-walk").ring
    rig = ring_rig(ring)
    for placed in rig.cameras.values():
        middle = project(apply(placed.T_camera_world, np.array([ring.centre])), placed.camera.lens)
        np.testing.assert_allclose(middle[0], placed.camera.lens[2:4], atol=1e-6)
        np.testing.assert_allclose(np.linalg.det(placed.T_camera_world[:3, :3]), 1.0)


def test_a_rig_with_errors_moves_the_middle_of_the_images() -> None:
    exact = made()
    assert exact.calibrated is exact.rig
    scene = build_crowd(dataclasses.replace(exact.settings, rig_error_px=5.0))
    middle, off = np.array([scene.settings.ring.centre]), []
    for name, placed in scene.rig.cameras.items():
        wrong = scene.calibrated.cameras[name]
        true, given = (project(apply(one.T_camera_world, middle), placed.camera.lens) for one in (placed, wrong))
        off.append(given[0] - true[0])
    assert 1.0 < np.sqrt(np.mean(np.square(off))) < 8.0
    assert np.abs(np.mean(off, axis=0)[1]) < 1.0  # an error of all cameras is a motion of the world


def test_cameras_out_of_step_have_one_time_and_see_others() -> None:
    scene = build_crowd(dataclasses.replace(made().settings, out_of_step=2))
    apart = {item.frame.sensor: round((item.room_ns - item.at_ns) / 1e9 * 30) for item in items(scene)}
    assert apart["c4"] == 0
    assert set(apart.values()) <= {-2, -1, 0, 1, 2}
    assert len(set(apart.values())) > 1
    order = [(round(item.at_ns / 1e6), item.frame.sensor) for item in items(scene)]
    assert order == sorted(order)


def test_limbs_are_exchanged_errors_of_pixels_added_and_confidences_unrelated() -> None:
    near = (CrowdPerson((-0.2, 0.0), "stand"), CrowdPerson((0.2, 0.0), "stand"))
    plain = made(near, seconds=0.5)
    exchanged = made(near, dataclasses.replace(NO_FAULTS, exchanged_limbs=1.0), seconds=0.5)
    moved = 0
    for one in items(exchanged):
        expected = projected(exchanged, one)[one.detected]
        moved += int((np.linalg.norm(one.frame.positions_px - expected, axis=-1) > 5.0).any(axis=1).sum())
    assert moved > 0
    noisy = made(near, dataclasses.replace(NO_FAULTS, noise_px=3.0), seconds=0.5)
    errors = np.concatenate(
        [(one.frame.positions_px - projected(noisy, one)[one.detected]).ravel() for one in items(noisy)]
    )
    assert np.nanstd(errors) == pytest.approx(3.0, rel=0.1)
    unrelated = made(near, dataclasses.replace(NO_FAULTS, unrelated_confidences=1.0), seconds=0.5)
    honest, told = (
        np.concatenate([one.frame.confidences.ravel() for one in items(scene)]) for scene in (plain, unrelated)
    )
    assert np.mean(honest > 0.99) != np.mean(told > 0.99)
    assert np.quantile(told[told > 0], 0.5) == pytest.approx(0.5, abs=0.15)


@pytest.mark.slow
def test_in_no_scene_does_a_person_walk_through_another() -> None:
    for name in crowd_names():
        scene = crowd_scene(name)
        poses = int(scene.settings.seconds * 50)
        root = scene.room.motion.root[:poses, scene.room.numbers >= 0][..., [0, 2]]
        apart = np.linalg.norm(root[:, :, None] - root[:, None], axis=-1) + 9 * np.eye(root.shape[1])
        assert apart.min() > 0.2, name
        jump = np.linalg.norm(np.diff(scene.room.motion.root[:poses], axis=0), axis=-1).max()
        assert jump < 0.1, name


@pytest.mark.slow
@pytest.mark.skipif(not BVH.is_file(), reason="the recordings are not there")
def test_a_person_moves_as_in_a_bvh_file() -> None:
    scene = crowd_scene("turning", bvh=BVH)
    found = [item for item in items(scene) if item.frame.sensor == "c1"]
    assert np.linalg.norm(found[-1].positions[0, 19] - found[0].positions[0, 19]) > 0.2
