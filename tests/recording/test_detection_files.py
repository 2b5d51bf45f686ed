"""Keypoint files of other programs: what is written in a program's format is read, and what is damaged is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.association.keypoint_rays import halpe_keypoints
from mocapella.errors import InputError, SettingsError
from mocapella.model.keypoints import NO_ID
from mocapella.model.topology import topology
from mocapella.recording import detection_h5
from mocapella.recording.detection_files import camera_name, read_detections
from mocapella.recording.detections import (
    MOST_PEOPLE,
    ORDERS,
    CameraDetections,
    image_tracks,
    keypoint_frames,
    order_of_25,
    topology_by_names,
)
from mocapella.tracker.webcams_warmup import standing_person

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
ANIMAL = ("snout", "left_ear", "tail")


def people(seed: int, count: int, points: int) -> np.ndarray:
    """(count, points, 3) x, y [px] and confidence of detections."""
    random = np.random.default_rng(seed)
    values = np.round(random.uniform(5, 600, (count, points, 3)), 3)
    values[..., 2] = np.round(random.uniform(0.1, 1.0, (count, points)), 3)
    return values


def as_openpose(folder: Path, frames: dict[int, np.ndarray]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, rows in frames.items():
        data = {"people": [{"pose_keypoints_2d": row.ravel().tolist()} for row in rows]}
        (folder / f"{folder.name}_{number:06}_keypoints.json").write_text(json.dumps(data))
    return folder


def instances(rows: np.ndarray) -> list[dict[str, Any]]:
    return [
        {"keypoints": row[:, :2].tolist(), "keypoint_scores": row[:, 2].tolist(), "bbox": [[0, 0, 1, 1]]}
        for row in rows
    ]


def as_mmpose_video(folder: Path, frames: dict[int, np.ndarray]) -> Path:
    rows = [{"frame_id": number, "instances": instances(values)} for number, values in frames.items()]
    path = folder / "cam.json"
    path.write_text(json.dumps({"meta_info": {"dataset_name": "x"}, "instance_info": rows}))
    return path


def as_mmpose_list(folder: Path, frames: dict[int, np.ndarray]) -> Path:
    path = folder / "cam.json"
    path.write_text(json.dumps([{"frame_id": n, "instances": instances(rows)} for n, rows in frames.items()]))
    return path


def as_mmpose_images(folder: Path, frames: dict[int, np.ndarray]) -> Path:
    (folder / "cam").mkdir()
    for number, rows in frames.items():
        (folder / "cam" / f"{number:04}.json").write_text(json.dumps(instances(rows)))
    return folder / "cam"


def as_alphapose(folder: Path, frames: dict[int, np.ndarray]) -> Path:
    rows = [
        {"image_id": f"{number}.jpg", "category_id": 1, "keypoints": row.ravel().tolist(), "score": 2.9, "idx": [k + 1]}
        for number, some in frames.items()
        for k, row in enumerate(some)
    ]
    path = folder / "cam.json"
    path.write_text(json.dumps(rows))
    return path


def as_own(folder: Path, frames: dict[int, np.ndarray]) -> Path:
    names = topology("halpe_26").joints
    rows = [
        f"{number},cam,p{k},{name},{x},{y},{c}"
        for number, some in frames.items()
        for k, row in enumerate(some)
        for name, (x, y, c) in zip(names, row, strict=True)
    ]
    path = folder / "own.csv"
    path.write_text("\n".join(["frame,camera,person,point,x_px,y_px,confidence", *rows]) + "\n")
    return path


WRITERS: dict[str, Callable[[Path, dict[int, np.ndarray]], Path]] = {
    "openpose": lambda folder, frames: as_openpose(folder / "cam", frames),
    "mmpose video": as_mmpose_video, "mmpose list": as_mmpose_list, "mmpose images": as_mmpose_images,
    "alphapose": as_alphapose, "own": as_own,
}  # fmt: skip


def only(found: list[CameraDetections]) -> CameraDetections:
    (one,) = found
    return one


@pytest.mark.parametrize("writer", WRITERS)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 3))
def test_all_people_of_a_format_are_read(
    writer: str, seed: int, count: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    frames = {number: people(seed + number, count, 26) for number in (3, 4, 12)}
    found = only(read_detections([WRITERS[writer](tmp_path_factory.mktemp("in"), frames)]))
    assert found.topology is topology("halpe_26")
    assert (found.camera, found.numbers.tolist()) == ("cam", [3, 4, 12])
    for number, frame in zip(found.numbers.tolist(), found.frames, strict=True):
        np.testing.assert_allclose(frame.positions_px, frames[number][..., :2])
        np.testing.assert_allclose(frame.confidences, frames[number][..., 2])
    ids = found.frames[0].ids.tolist()
    assert ids == {"alphapose": [*range(1, count + 1)], "own": [*range(count)]}.get(writer, [NO_ID] * count)


@pytest.mark.parametrize(("order", "name"), ORDERS.items())
def test_the_number_of_points_tells_the_topology(order: str, name: str, tmp_path: Path) -> None:
    count = len(topology(name))
    path = as_openpose(tmp_path / "cam", {0: people(0, 1, count)})
    assert only(read_detections([path], order=order.lower() if count != 25 else "auto")).topology is not None
    if count != 25:
        assert only(read_detections([path])).topology is topology(name)
        with pytest.raises(InputError, match=rf"has {count} points, and the order \w+ has"):
            read_detections([path], order="COCO_17" if count != 17 else "COCO_18")


def body_25(seed: int, *, b: bool) -> np.ndarray:
    """People of 25 points: a standing person as OpenPose's two models have it."""
    own = topology("body_25b" if b else "body_25")
    at = {"Nose": (0, -70), "Neck": (0, -50 if not b else -60), "LShoulder": (20, -50), "RShoulder": (-20, -50),
          "LEye": (4, -75), "REye": (-4, -75)}  # fmt: skip
    random = np.random.default_rng(seed)
    values = np.ones((6, 25, 3))
    values[..., :2] = random.uniform(-30, 90, (6, 25, 2))
    for joint, place in at.items():
        values[:, own.index(joint), :2] = np.array(place) * 4 + random.normal(0, 1, (6, 2))
    values[..., :2] += 400
    return values


@given(st.integers(0, 10_000))
def test_the_two_orders_of_25_points_are_told_apart_by_places(seed: int) -> None:
    assert order_of_25(body_25(seed, b=True)) == "BODY_25B"
    assert order_of_25(body_25(seed, b=False)) == "BODY_25"
    assert order_of_25(np.ones((6, 25, 3))) is None


def small_people(name: str, seed: int, height_px: float) -> np.ndarray:
    """People (20, 25, 3) of a height in images, seen from any side, with errors of a pixel."""
    own, random = topology(name), np.random.default_rng(seed)
    at = dict(zip(topology("halpe_26").joints, standing_person(), strict=True))
    at |= {"MidHip": at["Hip"]} | ({"Neck": (at["LShoulder"] + at["RShoulder"]) / 2} if name == "body_25" else {})
    values = np.ones((20, 25, 3))
    for one, turn in zip(values, random.uniform(0.0, 2.0 * np.pi, 20), strict=True):
        body = np.array([at[joint] for joint in own.joints]) * height_px / 1.75
        one[:, 0] = 100.0 + body[:, 0] * np.cos(turn) + body[:, 2] * np.sin(turn)
        one[:, 1] = 100.0 - body[:, 1]
    values[..., :2] += random.normal(0.0, 1.0, (20, 25, 2))
    return values


@given(st.integers(0, 10_000), st.floats(50.0, 90.0))
def test_people_who_are_small_in_the_image_tell_the_order_of_25_points_too(seed: int, height_px: float) -> None:
    for name in ("body_25", "body_25b"):
        values = small_people(name, seed, height_px)
        assert order_of_25(values) == name.upper()
        values[..., 2] = 0.0
        assert order_of_25(values) is None


def test_people_of_a_recording_tell_the_order_of_25_points_also_if_they_are_made_small() -> None:
    if not (DATA / "pose2sim_single_person").is_dir():
        pytest.skip("pose2sim_single_person is not there")
    folder = DATA / "pose2sim_single_person" / "pose" / "cam01_json"
    found = only(read_detections([folder]))
    values = [np.concatenate([one.positions_px, one.confidences[..., None]], -1) for one in found.frames]
    people_seen = np.concatenate(values)
    people_seen[..., :2] = np.round(people_seen[..., :2] / 12.0)
    assert found.topology is topology("body_25b")
    assert order_of_25(people_seen) == "BODY_25B"


def test_18_points_of_openpose_are_read_as_its_order_says(tmp_path: Path) -> None:
    names = topology("coco_18").joints
    assert names[:8] == ("Nose", "Neck", "RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist")
    rows = people(3, 2, 18)
    rows[..., 2] = 0.9
    found = only(read_detections([as_openpose(tmp_path / "cam", {0: rows})]))
    assert found.topology is topology("coco_18")
    halpe, (frame,) = topology("halpe_26"), found.frames
    places, sure = halpe_keypoints("coco_18", frame.positions_px, frame.confidences)
    for k, name in enumerate(names):
        if name != "Neck":
            np.testing.assert_allclose(places[:, halpe.index(name)], rows[:, k, :2])
    assert (sure > 0).sum(axis=1).tolist() == [18, 18]
    neck = rows[:, 1, :2] + 0.1 * (rows[:, 0, :2] - rows[:, 1, :2])
    np.testing.assert_allclose(places[:, halpe.index("Neck")], neck)


def test_a_wrongly_declared_order_is_refused(tmp_path: Path) -> None:
    path = as_openpose(tmp_path / "cam", {0: body_25(1, b=False)})
    assert only(read_detections([path])).topology is topology("body_25")
    assert only(read_detections([path], order="BODY_25")).topology is topology("body_25")
    with pytest.raises(InputError, match=r"not in the order BODY_25B: by their places it is BODY_25; leave the order"):
        read_detections([path], order="BODY_25B")
    with pytest.raises(InputError, match="no order of keypoints is called 'MPII'"):
        read_detections([path], order="MPII")


def test_people_without_keypoints_are_nobody(tmp_path: Path) -> None:
    folder = tmp_path / "cam_json"
    folder.mkdir()
    empty = [{}, {"pose_keypoints_2d": []}, {"pose_keypoints_2d": [0.0] * 78}, {"person_id": [-1]}]
    seen = {"person_id": [7], "pose_keypoints_2d": people(0, 1, 26).ravel().tolist()}
    (folder / "a_0.json").write_text(json.dumps({"people": [*empty, seen]}))
    (folder / "a_1.json").write_text(json.dumps({"people": empty[:2]}))
    found = only(read_detections([folder]))
    assert [frame.ids.tolist() for frame in found.frames] == [[7], []]


def test_pose2sims_folders_stand_for_their_cameras(tmp_path: Path) -> None:
    for folder in ("pose", "pose-sync", "pose-associated"):
        for camera in ("cam01_json", "cam02_json"):
            as_openpose(tmp_path / folder / camera, {0: people(len(folder), 1, 26)})
    (tmp_path / "videos").mkdir()
    found = read_detections([tmp_path])
    assert [one.camera for one in found] == ["cam01_json", "cam02_json"]
    np.testing.assert_allclose(found[0].frames[0].positions_px[0], people(len("pose-sync"), 1, 26)[0, :, :2])
    assert len(read_detections([tmp_path / "pose-associated" / "cam01_json", tmp_path / "pose" / "cam02_json"])) == 2


def deeplabcut(names: tuple[str, ...], individuals: tuple[str, ...] = ()) -> str:
    columns = [(one, name, part) for one in individuals or ("",) for name in names for part in ("x", "y", "likelihood")]
    heads = [["scorer", *("net" for _ in columns)]]
    heads += [["individuals", *(one for one, _, _ in columns)]] if individuals else []
    heads += [["bodyparts", *(name for _, name, _ in columns)], ["coords", *(part for _, _, part in columns)]]
    rows = [[str(n), *(str(100 * n + k) if k % 3 < 2 else "0.9" for k in range(len(columns)))] for n in range(3)]
    rows[1][1:4] = ["", "", ""]
    return "\n".join(",".join(row) for row in [*heads, *rows]) + "\n"


def test_deeplabcuts_table_has_points_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "cam1DLC_resnet50_mouseNov3shuffle1_1000.csv"
    path.write_text(deeplabcut(ANIMAL))
    found = only(read_detections([path]))
    assert (found.camera, found.points, found.topology, found.individuals) == ("cam1", ANIMAL, None, ())
    np.testing.assert_array_equal(found.frames[2].positions_px[0], [[200, 201], [203, 204], [206, 207]])
    assert np.isnan(found.frames[1].positions_px[0, 0]).all()
    with pytest.raises(InputError, match="no person's keypoints"):
        keypoint_frames(found, "cam1", (640, 480), 30.0)


def test_deeplabcuts_individuals_are_points_of_their_own(tmp_path: Path) -> None:
    for camera in ("cam1", "cam2"):
        (tmp_path / f"{camera}.csv").write_text(deeplabcut(ANIMAL, ("anna", "bert")))
    found = read_detections([tmp_path])
    assert found[0].individuals == ("anna", "bert")
    tracks = image_tracks(found)
    assert tracks.points == tuple(f"{one}.{name}" for one in ("anna", "bert") for name in ANIMAL)
    np.testing.assert_array_equal(tracks.pixels[2, 1, 3], [209, 210])


def test_names_of_a_persons_joints_make_a_person(tmp_path: Path) -> None:
    names = tuple(name.replace("_", " ").title() for name in topology("coco_17").joints[5:])
    (tmp_path / "a.csv").write_text(deeplabcut(names))
    found = only(read_detections([tmp_path / "a.csv"]))
    assert found.topology is topology("coco_17")
    np.testing.assert_array_equal(found.frames[2].positions_px[0, 5], [200, 201])
    assert np.isnan(found.frames[2].positions_px[0, 0]).all()
    assert topology_by_names(ANIMAL) is None
    assert topology_by_names([*names, "tail"]) is None


def test_sleaps_table_has_tracks(tmp_path: Path) -> None:
    columns = ["track", "frame_idx", "instance.score", *(f"{n}.{part}" for n in ANIMAL for part in ("x", "y", "score"))]
    rows = [
        ["a", "4", "0.9", "1", "2", "0.5", "3", "4", "0.6", "", "", ""],
        ["b", "4", "0.9", *(str(k) for k in range(9))],
        ["b", "5", "0.9", *(str(k) for k in range(9))],
    ]
    path = tmp_path / "labels.analysis.csv"
    path.write_text("\n".join(",".join(row) for row in [columns, *rows]) + "\n")
    found = only(read_detections([path]))
    assert (found.camera, found.points, found.individuals) == ("labels", ANIMAL, ("a", "b"))
    assert (found.numbers.tolist(), [frame.ids.tolist() for frame in found.frames]) == ([4, 5], [[0, 1], [1]])
    np.testing.assert_array_equal(found.frames[0].positions_px[0], [[1, 2], [3, 4], [np.nan, np.nan]])


def test_sleaps_h5_is_read(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    tracks = np.random.default_rng(0).uniform(0, 500, (2, 2, 3, 5))
    tracks[1, :, :, 2] = np.nan
    with h5py.File(tmp_path / "cam.analysis.h5", "w") as file:
        file["tracks"], file["point_scores"] = tracks, np.full((2, 3, 5), 0.8)
        file["node_names"] = [name.encode() for name in ANIMAL]
        file["track_names"] = [b"a", b"b"]
    found = only(read_detections([tmp_path / "cam.analysis.h5"]))
    assert (found.camera, found.points, found.individuals, len(found.frames)) == ("cam", ANIMAL, ("a", "b"), 5)
    np.testing.assert_allclose(found.frames[1].positions_px[1, 2], tracks[1, :, 2, 1])
    assert found.frames[2].ids.tolist() == [0]


def deeplabcut_h5(path: Path, columns: Any) -> None:
    """What pandas writes for DeepLabCut, of which the columns are a pickled attribute."""
    import pickle

    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = np.bytes_(b"frame_table")
        kind = np.dtype([("index", "<i8"), ("values_block_0", "<f8", (len(columns),))])
        rows = np.zeros(4, kind)
        rows["index"], rows["values_block_0"] = np.arange(4), np.arange(4 * len(columns)).reshape(4, -1)
        table = group.create_dataset("table", data=rows)
        table.attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(columns, 0))


def test_deeplabcuts_h5_is_read_without_running_its_pickle(tmp_path: Path) -> None:
    parts = ("x", "y", "likelihood")
    one = [("net", name, part) for name in ANIMAL for part in parts]
    deeplabcut_h5(tmp_path / "a.h5", one)
    found = only(read_detections([tmp_path / "a.h5"]))
    assert (found.points, found.individuals, found.numbers.tolist()) == (ANIMAL, (), [0, 1, 2, 3])
    np.testing.assert_array_equal(found.frames[2].positions_px[0, 1], [21, 22])
    deeplabcut_h5(tmp_path / "b.h5", [("net", who, name, part) for who in "ab" for name in ANIMAL for part in parts])
    assert only(read_detections([tmp_path / "b.h5"])).individuals == ("a", "b")
    deeplabcut_h5(tmp_path / "c.h5", [print, *one])
    with pytest.raises(InputError, match="has names that cannot be read: GLOBAL"):
        read_detections([tmp_path / "c.h5"])
    deeplabcut_h5(tmp_path / "d.h5", one[:-1] + one[:1])
    with pytest.raises(InputError, match="or one twice"):
        read_detections([tmp_path / "d.h5"])


def test_h5_of_another_program_and_a_link_out_of_the_file_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["other"] = np.zeros(3)
    with pytest.raises(InputError, match=r"'other': has no detections"):
        read_detections([path])
    with h5py.File(path, "w") as file:
        file["tracks"], file["node_names"] = h5py.ExternalLink("b.h5", "/tracks"), [b"a"]
    with pytest.raises(InputError, match="tracks: cannot be read as HDF5: there is none of this name"):
        read_detections([path])
    with h5py.File(path, "w") as file:
        file.create_dataset("tracks", (1, 2, 1, 1 << 26), "<f8", compression="gzip")
        file["node_names"] = [b"a"]
    with pytest.raises(InputError, match="it unpacks to 1024 MiB"):
        read_detections([path])
    path.write_bytes(b"not hdf5")
    with pytest.raises(InputError, match="cannot be read as HDF5"):
        read_detections([path])
    monkeypatch.setattr("mocapella.decoding.hdf5.find_spec", lambda name: None)
    with pytest.raises(SettingsError, match=r"a.h5 needs h5py: uv sync --extra keypoints"):
        detection_h5.read_detection_h5(path, "a")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.csv", "scorer,n,n\nbodyparts,a,a\n0,1,2\n", "no header rows of DeepLabCut"),
        ("a.csv", "scorer,n,n\nbodyparts,a,a\ncoords,x,z\n0,x,2\n", "row 4: field a: 'x': not a number"),
        ("a.csv", "scorer,n,n\nbodyparts,a,a\ncoords,u,v\n0,1,2\n", "no columns x, y and likelihood"),
        ("a.csv", "scorer,n,n\nbodyparts,a,a\ncoords,x,y\n0,1,2\n0,1,2\n", "row 5: 0: the frame is there twice"),
        ("a.csv", "scorer,n,n\nbodyparts,a,a\ncoords,x,y\n0,1e9,2\n", "not a place in an image"),
        ("a.csv", "track,frame_idx,instance.score,a.x\n,0,1,2\n", "columns of SLEAP are missing"),
        ("a.csv", "track,frame_idx,instance.score,a.x,a.y,a.score\n,0.5,1,2,3,1\n", "row 2: field frame_idx: 0.5"),
        ("a.csv", "frame,camera,person,point,x_px\n", "columns of 2D points are missing"),
        ("a.csv", "frame,camera,person,point,x_px,y_px\n0,a,,b,1,2\n", "row 2: field person: empty"),
        ("a.csv", "frame,camera,person,point,x_px,y_px\n0,a,c,b,1,2\n0,a,c,b,1,2\n", "row 3: field point: 'b'"),
        ("a.csv", "frame,camera,person,point,x_px,y_px,confidence\n0,a,c,b,1,2,3\n", "confidence: 3.0"),
        ("a.json", "[{}]", r"field \[0\].image_id: no frame number"),
        ("a.json", '[{"image_id":"1.jpg","keypoints":[1,2]}]', "not x, y and confidence"),
        ("a.json", '{"a": 1}', "no keypoints of people that are known here"),
        ("a.json", '[{"frame_id":1.5,"instances":[]}]', r"\[0\].frame_id: 1.5: no number of a frame"),
        ("a.json", '[{"frame_id":1,"instances":[]},{"frame_id":1,"instances":[]}]', "the frame is there twice"),
        ("a.json", '[{"frame_id":1,"instances":[{"keypoints":[[1,2,3]],"keypoint_scores":[1]}]}]', "not in space"),
        ("a.json", '[{"frame_id":1,"instances":[{"keypoints":"x","keypoint_scores":[1]}]}]', "not numbers"),
        ("a.txt", "", "no file of detections"),
    ],
)
def test_files_of_no_use_are_refused_by_name(name: str, text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=said) as error:
        read_detections([path])
    assert name in str(error.value)


def test_folders_of_no_use_are_refused(tmp_path: Path) -> None:
    for paths, said in (([], "no detections are named"), ([tmp_path / "gone"], "no such file"),
                        ([tmp_path], "no detections in this folder")):  # fmt: skip
        with pytest.raises(InputError, match=said):
            read_detections(paths)
    (tmp_path / "films").mkdir()
    (tmp_path / "films" / "left.MP4").touch()
    with pytest.raises(InputError, match="no detections in this folder; these are films: mocapella people"):
        read_detections([tmp_path / "films"])
    crowd = as_openpose(tmp_path / "crowd", {0: people(0, MOST_PEOPLE + 1, 17)})
    with pytest.raises(InputError, match=f"{MOST_PEOPLE + 1}: too many people in an image"):
        read_detections([crowd])
    mixed = as_openpose(tmp_path / "mixed", {0: people(0, 1, 17), 1: people(0, 1, 26)})
    with pytest.raises(InputError, match="has 26 points, and others have 17"):
        read_detections([mixed])
    for folder in ("one", "two"):
        as_openpose(tmp_path / folder / "cam", {0: people(0, 1, 17)})
    with pytest.raises(InputError, match="cam: two cameras have this name"):
        read_detections([tmp_path / "one", tmp_path / "two"])


def test_frames_have_the_times_of_their_numbers_or_files(tmp_path: Path) -> None:
    found = only(read_detections([as_openpose(tmp_path / "cam", {0: people(0, 1, 26), 30: people(1, 2, 26)})]))
    frames = keypoint_frames(found, "cam_1", (640, 480), 60.0)
    assert [frame.time_ns for frame in frames] == [1_000_000_000, 1_500_000_000]
    assert [(frame.sensor, frame.size_px, frame.bodies) for frame in frames] == [
        ("cam_1", (640, 480), 1), ("cam_1", (640, 480), 2),
    ]  # fmt: skip
    with pytest.raises(InputError, match="the files have no times; give the frame rate with --fps"):
        keypoint_frames(found, "cam_1", (640, 480))
    csv = tmp_path / "t.csv"
    names = topology("coco_17").joints
    csv.write_text("frame,camera,person,point,x_px,y_px,time_s\n" + "".join(
        f"{n},c,a,{name},1,{k},{at}\n" for n, at in ((0, 0.5), (1, 0.25)) for k, name in enumerate(names)
    ))  # fmt: skip
    with pytest.raises(InputError, match="times of the frames do not rise"):
        keypoint_frames(only(read_detections([csv])), "c", (640, 480))


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("cam1DLC_resnet50_x.csv", "cam1"), ("a.predictions.analysis.h5", "a"), ("DLC_x.csv", "DLC_x"),
        ("left.json", "left"),
    ],
)  # fmt: skip
def test_cameras_have_the_name_of_their_file(file: str, name: str) -> None:
    assert camera_name(Path(file)) == name


@pytest.mark.skipif(not (DATA / "pose2sim_two_people").is_dir(), reason="the recordings are not here")
def test_the_two_people_and_bystanders_of_pose2sims_demonstration_are_read() -> None:
    found = read_detections([DATA / "pose2sim_two_people"])
    assert [(one.camera, one.topology and one.topology.name) for one in found] == [
        (f"cam0{k}_json", "body_25b") for k in (1, 2, 3, 4)
    ]
    assert [sum(len(frame.ids) for frame in one.frames) for one in found] == [299, 300, 200, 200]


@pytest.mark.skipif(not (DATA / "mediapipe_holistic_4cam").is_dir(), reason="the recordings are not here")
def test_caliscopes_numbers_of_mediapipes_points_are_named() -> None:
    found = read_detections([DATA / "mediapipe_holistic_4cam" / "recording_1" / "HOLISTIC" / "xy_HOLISTIC.csv"])
    assert found[0].points[:1] == ("NOSE",)
    assert {"RIGHT_HAND_WRIST", "LEFT_HAND_WRIST", "FACE_4", "LEFT_WRIST"} <= set(found[0].points)
    one = found[0].frames[0]
    index = {name: i for i, name in enumerate(found[0].points)}
    far = {
        (a, b): np.nanmedian(
            [np.linalg.norm(f.positions_px[0, index[f"{a}_HAND_WRIST"]] - f.positions_px[0, index[f"{b}_WRIST"]])
             for camera in found for f in camera.frames if len(f.ids)]
        )
        for a in ("LEFT", "RIGHT") for b in ("LEFT", "RIGHT")
    }  # fmt: skip
    assert one.positions_px.shape[1:] == (82, 2)
    assert far["RIGHT", "RIGHT"] < far["RIGHT", "LEFT"]
    assert far["LEFT", "LEFT"] < far["LEFT", "RIGHT"]
