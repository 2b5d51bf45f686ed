"""`mocapella.triangulate_people`: people of keypoint files, their report, and the files of all exports."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.keypoint_folders import RATE_HZ, walkers, write_openpose

import mocapella
from mocapella.errors import InputError, MocapellaError, SettingsError
from mocapella.geometry.rigid import rigid
from mocapella.geometry.twists import exp_twist
from mocapella.library import people_triangulation
from mocapella.library.keypoint_tracking import UP
from mocapella.library.people_files import export_of, with_names_of
from mocapella.library.people_report import PeopleReport, people_report
from mocapella.library.people_triangulation import TriangulatedPeople, triangulate_people
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.topology import topology

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
FRAMES = 24


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("people")
    write_openpose(path, walkers(FRAMES))
    return path


@pytest.fixture(scope="module")
def found(folder: Path) -> TriangulatedPeople:
    return triangulate_people(folder, folder / "rig.toml", fps=RATE_HZ)


def moved(rig: CameraRig, name: str, twist: list[float]) -> CameraRig:
    cameras = dict(rig.cameras)
    one = cameras[name]
    cameras[name] = PlacedCamera(one.camera, exp_twist(np.array(twist)) @ one.T_camera_world, one.covariance)
    return CameraRig(cameras)


def nearest(found: TriangulatedPeople, truth: np.ndarray) -> np.ndarray:
    """Distances (frames, people, joints) of the people from the true ones, each from the nearest [m]."""
    people = found.people
    assert people is not None
    middle = np.nanmean(people.positions, axis=(0, 2))
    order = [int(np.linalg.norm(middle - one, axis=-1).argmin()) for one in truth.mean(axis=(0, 2))]
    assert sorted(order) == list(range(truth.shape[1]))
    return np.linalg.norm(people.positions[:, order] - truth, axis=-1)


def test_all_people_are_where_they_were(found: TriangulatedPeople) -> None:
    far = nearest(found, walkers(FRAMES)[:])
    assert far.shape == (FRAMES, 2, 26)
    assert np.nanmedian(far) < 0.01
    assert found.notes == ()
    assert (found.report.instants, list(found.report.people)) == (FRAMES, ["person_0", "person_1"])
    assert [one.share for one in found.report.people.values()] == [1.0, 1.0]
    assert [(one.detections, one.used) for one in found.report.cameras.values()] == [(2 * FRAMES, 2 * FRAMES)] * 4
    assert found.report.residual_px < 5.0
    assert found.topology is topology("halpe_26")
    assert repr(found) == f"<person_0, person_1 in {FRAMES} instants of 4 cameras>"
    assert found.people is not None
    np.testing.assert_allclose(found.people.times_s, np.arange(FRAMES) / RATE_HZ, atol=1e-6)


def test_the_rigs_upward_axis_is_turned_to_y(folder: Path, found: TriangulatedPeople) -> None:
    from mocapella.model.camera_rig_file import load_camera_rig

    rig = load_camera_rig(folder / "rig.toml")
    for up in ("z", "-y"):
        T = rigid(UP[up], np.zeros(3))
        cameras = {n: PlacedCamera(c.camera, c.T_camera_world @ T, c.covariance) for n, c in rig.cameras.items()}
        turned = triangulate_people(folder, CameraRig(cameras), fps=RATE_HZ, up=up)
        assert turned.people is not None
        assert found.people is not None
        np.testing.assert_allclose(turned.people.positions, found.people.positions, atol=2e-3)
    said = triangulate_people(folder, CameraRig(cameras), fps=RATE_HZ).notes
    assert any("people stand along -y of the results' world" in note and "--up" in note for note in said)
    with pytest.raises(SettingsError, match="up is 'x'"):
        triangulate_people(folder, rig, fps=RATE_HZ, up="x")


def test_at_most_so_many_people_are_returned(folder: Path) -> None:
    some = triangulate_people(folder, folder / "rig.toml", fps=RATE_HZ, most=1)
    assert some.people is not None
    assert len(some.people.individuals) == 1
    assert len(some.report.people) == 2


def test_a_take_has_the_keypoints_and_can_be_tracked_again(folder: Path, tmp_path: Path) -> None:
    done = triangulate_people(folder, folder / "rig.toml", fps=RATE_HZ, record=tmp_path / "walk")
    take = mocapella.load(tmp_path / "walk.mcap")
    assert take.sensors == ("cam-0", "cam-1", "cam-2", "cam-3")
    again = mocapella.track(take)
    assert again.people is not None
    assert done.people is not None
    np.testing.assert_array_equal(again.people.positions, done.people.positions)


def test_points_get_the_names_and_the_order_of_the_detector(tmp_path: Path, found: TriangulatedPeople) -> None:
    write_openpose(tmp_path, walkers(8), kind="body_25b")
    some = triangulate_people(tmp_path, tmp_path / "rig.toml", fps=RATE_HZ)
    written = some.save(tmp_path / "walk.trc")
    assert [path.name for path in written] == ["walk.person_0.trc", "walk.person_1.trc"]
    assert written[0].read_text().splitlines()[3].split("\t")[2::3] == list(topology("body_25b").joints)
    points = mocapella.load(written[0]).points
    assert points is not None
    assert points.keypoints == topology("body_25b").joints
    assert found.people is not None
    few = with_names_of(found.people, topology("body_25"))
    assert few.keypoints == topology("body_25").joints
    more = with_names_of(found.people, topology("body_25"), others=True)
    assert more.keypoints == (*few.keypoints, "Head")
    head = found.people.keypoints.index("Head")
    np.testing.assert_array_equal(more.positions[:, :, -1], found.people.positions[:, :, head])
    np.testing.assert_array_equal(more.states[:, :, :-1], few.states)
    column = few.keypoints.index("MidHip")
    np.testing.assert_array_equal(few.positions[:, :, column], found.people.positions[:, :, 19])
    assert with_names_of(found.people, topology("halpe_26")) is found.people


EXPORTS = (
    "a.csv", "a.wide.csv", "a.parquet", "a.npz", "a.nc", "a.trc", "a.c3d", "a.bvh", "a.glb", "a.usda", "a.html",
    "a.angles.csv", "a.angles.png", "a.mot", "a.sto", "a.opensim", "a.rosbag2",
)  # fmt: skip


@pytest.mark.parametrize("name", EXPORTS)
def test_every_export_writes_people_of_halpe(name: str, found: TriangulatedPeople, tmp_path: Path) -> None:
    try:
        written = found.save(tmp_path / name)
    except SettingsError as error:
        if "is not installed" in str(error):
            pytest.skip(str(error))
        raise
    alone = export_of(Path(name)).alone
    assert len(written) == (2 if alone else 1)
    assert all(path.exists() for path in written)
    if name == "a.bvh":
        from mocapella.recording.bvh_file import read_bvh_joints

        assert read_bvh_joints(written[0]) is not None
    if name == "a.angles.csv":
        assert "knee_angle_r" in written[0].read_text()


def test_every_export_of_people_is_tried() -> None:
    from mocapella.exports.export import EXPORTS as ALL
    from mocapella.exports.export import TRAJECTORIES

    able = {one.suffix for one in ALL.values() if one.command == TRAJECTORIES and "people" in (one.parts or ())}
    assert able == {name.removeprefix("a") for name in EXPORTS}
    with pytest.raises(SettingsError, match=r"end its name with one of .*\.mcap for a take"):
        export_of(Path("a.xyz"))


def test_a_camera_that_moved_is_named(folder: Path, found: TriangulatedPeople) -> None:
    from mocapella.model.camera_rig_file import load_camera_rig

    rig = moved(load_camera_rig(folder / "rig.toml"), "cam-2", [0.0, 0.0, 0.0, 0.0, 0.6, 0.0])
    said = triangulate_people(folder, rig, fps=RATE_HZ).notes
    assert any(note.startswith("camera cam-2:") and "moved after the calibration" in note for note in said), said


def test_frames_without_a_scene_are_left_out_of_the_report(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[Any, ...]] = []

    def noted(*arguments: Any) -> PeopleReport:
        given.append(arguments)
        return people_report(*arguments)

    monkeypatch.setattr(people_triangulation, "people_report", noted)
    triangulate_people(folder, folder / "rig.toml", fps=RATE_HZ)
    arrivals, scenes, rig = given[0]
    assert len(arrivals) == len(scenes) == 4 * FRAMES
    rest = [*scenes[:20], *scenes[30:]]
    own = people_report([*arrivals[:20], *arrivals[30:]], rest, rig)
    assert people_report(arrivals, rest, rig) == own != people_report(arrivals, scenes, rig)


def test_a_wrong_rig_is_named(folder: Path) -> None:
    from mocapella.model.camera_rig_file import load_camera_rig

    rig = load_camera_rig(folder / "rig.toml")
    names = list(rig.cameras)
    shuffled = CameraRig({name: rig.cameras[other] for name, other in zip(names, names[1:] + names[:1], strict=True)})
    for one in names:
        for axis in range(3):
            shuffled = moved(shuffled, one, [0.0] * 3 + [0.5 * (k == axis) for k in range(3)])
    done = triangulate_people(folder, shuffled, fps=RATE_HZ)
    assert any("compare the rig with the recording" in note for note in done.notes) or len(done.notes) >= 2


def test_what_cannot_be_tracked_is_named(folder: Path, tmp_path: Path) -> None:
    rig = folder / "rig.toml"
    one = folder / "pose" / "cam-0_json"
    cases: list[tuple[list[Path], dict[str, object], str]] = [
        ([folder], {}, "the files have no times; give the frame rate with --fps"),
        ([folder], {"fps": 0.0}, "fps is 0.0"),
        ([folder], {"fps": 30.0, "most": 0}, "most is 0"),
        ([one], {"fps": 30.0}, "has the keypoints of one camera"),
        ([folder], {"fps": 30.0, "order": "BODY_25"}, "has 26 points, and the order BODY_25 has 25"),
        ([folder], {"fps": 30.0, "unseen_s": -1.0}, "unseen_s"),
    ]
    for files, options, said in cases:
        with pytest.raises(MocapellaError, match=said):
            triangulate_people(files, rig, **options)  # type: ignore[arg-type]
    other = tmp_path / "pose" / "kitchen_json"
    shutil.copytree(one, other)
    with pytest.raises(InputError, match="'kitchen_json': the rig has no such camera"):
        triangulate_people([folder / "pose" / "cam-1_json", other], rig, fps=30.0)


def test_one_frame_and_frames_that_a_camera_lacks(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "pose", tmp_path / "pose")
    for path in sorted((tmp_path / "pose" / "cam-1_json").iterdir())[5:]:
        path.unlink()
    some = triangulate_people(tmp_path / "pose", folder / "rig.toml", fps=RATE_HZ)
    assert [one.share for one in some.report.people.values()] == [1.0, 1.0]
    for path in (tmp_path / "pose").rglob("*.json"):
        if "000000" not in path.name:
            path.unlink()
    single = triangulate_people(tmp_path / "pose", folder / "rig.toml", fps=RATE_HZ)
    assert single.report.instants == 1
    assert len(single.report.people) == 2


def test_nobody_is_told(tmp_path: Path) -> None:
    write_openpose(tmp_path, [np.empty((0, 26, 3))] * 3)
    done = triangulate_people(tmp_path, tmp_path / "rig.toml", fps=RATE_HZ)
    assert done.people is None
    with pytest.raises(SettingsError, match="nobody was tracked"):
        done.save(tmp_path / "a.trc")


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "pose2sim_two_people").is_dir(), reason="the recordings are not here")
def test_the_two_people_of_pose2sims_demonstration_are_near_the_authors_own() -> None:
    folder = DATA / "pose2sim_two_people"
    done = triangulate_people(folder, folder / "Calib_qualisys.toml", fps=60.0, up="z")
    assert done.people is not None
    assert done.topology is not None
    assert len(done.people.individuals) == 2
    assert min(one.share for one in done.report.people.values()) >= 0.97
    own = with_names_of(done.people, done.topology)
    for number in (1, 2):
        reference = mocapella.load(next((folder / "pose-3d").glob(f"*P{number}_0-100.trc"))).points
        assert reference is not None
        both = [name for name in reference.keypoints if name in own.keypoints]
        theirs = reference.positions[:, 0][:, [reference.keypoints.index(name) for name in both]]
        ours = own.positions[:, :, [own.keypoints.index(name) for name in both]]
        count = min(len(theirs), len(ours))
        far = np.linalg.norm(ours[:count] - theirs[:count, None], axis=-1)
        best = far[:, int(np.nanmedian(far, axis=(0, 2)).argmin())]
        assert np.nanmedian(best) < 0.035
        assert np.nanpercentile(best, 95) < 0.11
        first = best[:5, [both.index(name) for name in both if name[1:] in {"Hip", "Knee", "Ankle", "Elbow", "Wrist"}]]
        assert np.nanmax(first) < 0.13  # cross-legged: a knee began 0.4 m off, and was called measured
