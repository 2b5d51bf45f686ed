"""The unit of a rig is found by the size of people; what tells no unit changes nothing."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.keypoint_folders import RATE_HZ, frames_of, walkers, write_openpose

from mocapella.library.people_report import PeopleReport, alarms
from mocapella.library.people_triangulation import triangulate_people
from mocapella.library.rig_units import FEWEST, people_lengths, rig_in_metres, unlikely_scale
from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import load_camera_rig, save_camera_rig
from mocapella.model.keypoints import KeypointFrame

Frames = dict[str, list[KeypointFrame]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("units")
    write_openpose(path, walkers(24))
    return path


@pytest.fixture(scope="module")
def rig(folder: Path) -> CameraRig:
    return load_camera_rig(folder / "rig.toml")


@pytest.fixture(scope="module")
def frames(folder: Path, rig: CameraRig) -> Frames:
    return frames_of(folder, rig)


def times(rig: CameraRig, factor: float) -> CameraRig:
    """The rig with its lengths in another unit."""
    cameras = {}
    for name, one in rig.cameras.items():
        T = one.T_camera_world.copy()
        T[:3, 3] *= factor
        cameras[name] = msgspec.structs.replace(one, T_camera_world=T)
    return CameraRig(cameras)


def test_lengths_are_those_of_people_and_follow_the_unit(frames: Frames, rig: CameraRig) -> None:
    metres, others = people_lengths(frames, rig), people_lengths(frames, times(rig, 100.0))
    assert len(metres) >= FEWEST
    assert 0.8 < np.median(metres) < 1.6
    np.testing.assert_allclose(others, 100.0 * metres, rtol=1e-6)


@pytest.mark.parametrize(
    ("factor", "unit"), [(0.1, "centimetres"), (100.0, "centimetres"), (1000.0, "millimetres"), (0.001, "metres")]
)
def test_the_unit_is_found_and_named(frames: Frames, rig: CameraRig, factor: float, unit: str) -> None:
    found, text = rig_in_metres(frames, times(rig, factor))
    assert f"taken as {unit}, and the results are in metres" in text
    for name, one in rig.cameras.items():
        np.testing.assert_allclose(found.cameras[name].T_camera_world, one.T_camera_world, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0, 10.0, 0.01])
def test_a_rig_in_metres_or_in_no_unit_is_kept(frames: Frames, rig: CameraRig, factor: float) -> None:
    given = times(rig, factor)
    assert rig_in_metres(frames, given) == (given, "")


def test_too_few_people_tell_no_unit(frames: Frames, rig: CameraRig) -> None:
    given = times(rig, 100.0)
    assert rig_in_metres({name: some[:0] for name, some in frames.items()}, given) == (given, "")
    assert rig_in_metres({name: some[:1] for name, some in list(frames.items())[:1]}, given) == (given, "")


@pytest.mark.parametrize(
    ("factor", "said"), [(1.0, ""), (0.7, ""), (1.6, "times too large"), (0.3, "times too small"), (10.0, "too large")]
)
def test_people_of_an_impossible_size_are_told_with_the_scale(
    frames: Frames, rig: CameraRig, factor: float, said: str
) -> None:
    text = unlikely_scale(frames, times(rig, factor))
    assert said in text
    assert bool(said) == bool(text)
    assert unlikely_scale({name: some[:0] for name, some in frames.items()}, times(rig, factor)) == ""


def test_lengths_do_not_need_a_neck_which_not_every_detector_has(frames: Frames, rig: CameraRig) -> None:
    neck = next(iter(frames.values()))[0].topology.index("Neck")
    for some in (without := {name: list(some) for name, some in frames.items()}).values():
        for k, one in enumerate(some):
            confidences = np.array(one.confidences)
            confidences[:, neck] = 0.0
            some[k] = msgspec.structs.replace(one, confidences=confidences)
    np.testing.assert_allclose(
        np.median(people_lengths(without, rig)), np.median(people_lengths(frames, rig)), atol=0.1
    )


def test_an_impossible_size_is_an_alarm_of_its_own() -> None:
    report = PeopleReport(10, {}, {}, float("nan"), scale="people are 2 m …")
    assert alarms(report)[0] == report.scale


@pytest.mark.slow
def test_whoever_triangulates_with_a_scaled_rig_is_told_so(folder: Path, rig: CameraRig) -> None:
    folders = [one for one in sorted(folder.iterdir()) if one.is_dir()]
    notes = triangulate_people(folders, times(rig, 1.6), fps=RATE_HZ).notes
    assert any("times too large" in note for note in notes)


@pytest.mark.slow
def test_people_of_a_rig_in_centimetres_are_in_metres(folder: Path, rig: CameraRig) -> None:
    save_camera_rig(folder / "centimetres.toml", times(rig, 100.0))
    folders = [one for one in sorted(folder.iterdir()) if one.is_dir()]
    own, other = (triangulate_people(folders, folder / name, fps=RATE_HZ) for name in ("rig.toml", "centimetres.toml"))
    assert any("centimetres" in note for note in other.notes)
    assert not any("metres" in note for note in own.notes)
    assert own.people is not None
    assert other.people is not None
    np.testing.assert_allclose(other.people.positions, own.people.positions, atol=1e-3)
