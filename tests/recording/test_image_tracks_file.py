from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocapella.errors import InputError
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.topology import topology
from mocapella.recording.image_tracks_file import CALISCOPE_COLUMNS, OWN_COLUMNS, read_image_tracks
from mocapella.recording.measured_distances import read_measured_distances
from mocapella.recording.point_recordings import read_point_recording

BODY_25, BODY_25B = topology("body_25").joints, topology("body_25b").joints

OWN = (
    "frame,camera,point,x_px,y_px,confidence,time_s\n7,left,tip,1.5,2,0.5,0.1\n7,right,tip,3,4,1,0.11\n"
    "9,left,tip,5,6,0,\n"
)


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def openpose(folder: Path, camera: str, frame: int, people: Any) -> Path:
    (folder / camera).mkdir(exist_ok=True)
    return written(folder / camera, f"{camera}.{frame:04}.json", json.dumps({"people": people}))


def person(x: float, confidence: float) -> dict[str, Any]:
    return {"pose_keypoints_2d": [x, 2.0, confidence] * 24 + [0.0, 0.0, 0.0]}


def test_our_own_csv(tmp_path: Path) -> None:
    tracks = read_image_tracks([written(tmp_path, "a.csv", OWN)])
    assert (tracks.cameras, tracks.points, tracks.frames.tolist()) == (("left", "right"), ("tip",), [7, 9])
    np.testing.assert_array_equal(tracks.pixels[0, :, 0], [[1.5, 2], [3, 4]])
    assert np.isnan(tracks.pixels[1]).all()  # a confidence of 0 is: not seen
    np.testing.assert_array_equal(tracks.confidences[0, :, 0], [0.5, 1.0])
    np.testing.assert_array_equal(tracks.at_s, [[0.1, 0.11], [np.nan, np.nan]])


def test_caliscopes_csv_sorts_by_number(tmp_path: Path) -> None:
    text = "sync_index,port,frame_time,point_id,img_loc_x,img_loc_y,obj_loc_x\n" + "".join(
        f"0,{port},0.5,{point},{port},{point},\n" for port in (10, 2) for point in (100, 9)
    )
    tracks = read_image_tracks([written(tmp_path, "xy.csv", text)])
    assert (tracks.cameras, tracks.points) == (("2", "10"), ("9", "100"))
    np.testing.assert_array_equal(tracks.pixels[0, 1, 1], [10, 100])
    assert (tracks.confidences == 1).all()


def test_images_that_a_camera_lacks_are_counted(tmp_path: Path) -> None:
    for camera, numbers in (("left", (0, 1, 2)), ("right", (0, 1)), ("top", (0, 2))):
        for number in numbers:
            openpose(tmp_path, camera, number, [person(1, 0.5)])
    tracks = read_image_tracks([tmp_path / camera for camera in ("left", "right", "top")])
    assert tracks.notes == ("2 frames are missing in some camera",)


@pytest.mark.parametrize("columns", [CALISCOPE_COLUMNS, OWN_COLUMNS])
def test_no_more_columns_are_needed_than_those_of_a_point(tmp_path: Path, columns: tuple[str, ...]) -> None:
    cells = {"frame": "0", "sync_index": "0", "camera": "7", "port": "7", "point": "3", "point_id": "3"}
    row = ",".join(cells.get(column, "1.5") for column in columns)
    tracks = read_image_tracks([written(tmp_path, "xy.csv", f"{','.join(columns)}\n{row}\n")])
    assert (tracks.cameras, tracks.points) == (("7",), ("3",))
    np.testing.assert_array_equal(tracks.pixels[0, 0, 0], [1.5, 1.5])


def test_openposes_folders_and_the_surest_person(tmp_path: Path) -> None:
    openpose(tmp_path, "cam1_json", 0, [person(1, 0.2), person(5, 0.9)])
    openpose(tmp_path, "cam1_json", 1, [{}])
    openpose(tmp_path, "cam2_json", 1, [person(7, 0.5)])
    told: list[str] = []
    folders = [tmp_path / "cam1_json", tmp_path / "cam2_json"]
    tracks = read_image_tracks(folders, progress=told.append)
    assert tracks.points == BODY_25B
    np.testing.assert_array_equal(tracks.pixels[:, :, 0, 0], [[5, np.nan], [np.nan, 7]])
    assert np.isnan(tracks.pixels[0, 0, 24]).all()
    assert len(tracks.notes) == 2
    assert len(told) == 3
    assert read_image_tracks(folders, order="BODY_25").points == BODY_25
    assert set(BODY_25B) - set(BODY_25) == {"Head"}
    assert len(set(BODY_25B)) == len(set(BODY_25)) == 25


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (OWN.replace("x_px", "u"), "row 1.*columns"),
        (OWN.replace("1.5", "abc"), "row 2: field x_px: 'abc': not a number"),
        (OWN.replace("1.5", "nan"), "row 2: field x_px"),
        (OWN.replace("0.5,0.1", "1.5,0.1"), "row 2: field confidence: 1.5"),
        (OWN.replace("7,right", "7.5,right"), "row 3: field frame: 7.5"),
        (OWN.replace("7,right", "7,"), "row 3: field camera: empty"),
        (OWN.replace("7,right", "7,left"), "row 3: field point: 'tip': the point is there twice"),
        (OWN + "9,left,tip,5,6,1,\n", "row 5: field point: 'tip': the point is there twice"),
        (OWN.splitlines()[0] + "\n", "no rows|columns"),
        ("", "columns"),
        ("\udcff", "no text in UTF-8"),
    ],
)
def test_a_csv_of_no_use_is_refused_with_row_and_field(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=said) as error:
        read_image_tracks([path])
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "is no JSON"),
        ("{}", "no list of people"),
        ("[3]", "no list of people|keypoint_scores"),
        ('{"people": [{"pose_keypoints_2d": [1, 2, 3]}]}', r"people\[0\].pose_keypoints_2d: 1: no known set"),
        ('{"people": [{"pose_keypoints_2d": [1, 2]}]}', r"people\[0\].pose_keypoints_2d: 2: not x, y"),
        (json.dumps({"people": [{"pose_keypoints_2d": ["a"] * 75}]}), "not numbers"),
        (json.dumps({"people": [{"pose_keypoints_2d": [-1.0] * 75}]}), "confidence below 0"),
    ],
)
def test_json_of_no_use_is_refused_with_file_and_field(tmp_path: Path, content: str, said: str) -> None:
    written(tmp_path, "cam.0000.json", content)
    with pytest.raises(InputError, match=said) as error:
        read_image_tracks([tmp_path])
    assert "cam.0000.json" in str(error.value)


def test_files_and_folders_of_no_use_are_refused(tmp_path: Path) -> None:
    csv, empty = written(tmp_path, "a.csv", OWN), tmp_path / "empty"
    empty.mkdir()
    for paths, said in (
        ([], "no points are named"),
        ([tmp_path / "none"], "no such file"),
        ([csv, csv], "several folders, or one file"),
        ([csv, empty], "several folders, or one file"),
        ([empty], "no JSON"),
    ):
        with pytest.raises(InputError, match=said):
            read_image_tracks(paths)
    openpose(tmp_path, "cam", 0, [])
    written(tmp_path / "cam", "again_0.json", '{"people": []}')
    with pytest.raises(InputError, match="two files of one frame"):
        read_image_tracks([tmp_path / "cam"])
    written(empty, "keypoints.json", '{"people": []}')
    with pytest.raises(InputError, match="no frame number"):
        read_image_tracks([empty])


RIG = """
[cam_{0}]
size = [640, 480]
matrix = [[600, 0, 320], [0, 590, 240], [0, 0, 1]]
distortions = [-0.1, 0.01, 0, 0]
rotation = [0, 1.5707963267948966, 0]
translation = [0, 0, 2]
"""


def test_a_rig_of_other_programs(tmp_path: Path) -> None:
    rig = load_camera_rig(written(tmp_path, "rig.toml", RIG.format(1) + RIG.format(2) + "[metadata]\nerror = 0\n"))
    camera = rig.cameras["cam_2"]
    assert camera.camera.size_px == (640, 480)
    np.testing.assert_array_equal(camera.camera.lens, [600, 590, 320, 240, -0.1, 0.01, 0, 0, 0])
    R = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    np.testing.assert_allclose(camera.T_camera_world[:3], np.c_[R, [0, 0, 2]], atol=1e-12)


def test_measured_distances(tmp_path: Path) -> None:
    path = written(tmp_path, "m.csv", "disparity_px,distance_cm,note\n40,100,a\n-76,50,b\n")
    depth, disparity = read_measured_distances(path)
    assert (depth.tolist(), disparity.tolist()) == ([1.0, 0.5], [40.0, -76.0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("distance_cm\n1\n", "field disparity_px: a column is missing"),
        (
            "distance_cm,disparity_px\n1,2\n0,3\n",
            "not a number above 0",
        ),
        ("distance_cm,disparity_px\n1,x\n", "not a number of pixels"),
    ],
)
def test_measured_distances_of_no_use_are_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_measured_distances(written(tmp_path, "m.csv", text))
    with pytest.raises(InputError, match="cannot be read"):
        read_measured_distances(tmp_path / "none.csv")


def test_a_recording_in_space_and_one_in_a_picture(tmp_path: Path) -> None:
    space = read_point_recording(written(tmp_path, "s.csv", "time_s,point,x_m,y_m,z_m\n0.5,b,1,2,3\n0.1,a,4,5,6\n"))
    assert (space.unit, space.at_s.tolist(), space.points.shape) == ("m", [0.1, 0.5], (2, 2, 3))
    np.testing.assert_array_equal(space.points[1, 1], [1, 2, 3])
    assert np.isnan(space.points[0, 1]).all()
    assert read_point_recording(written(tmp_path, "p.csv", "time_s,point,x_px,y_px\n0,b,1,2\n")).unit == "px"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s,point,x_px\n", "columns are missing"),
        ("time_s,point,x_px,y_px\n0,a,1,\n", "row 2: field y_px"),
        ("time_s,point,x_px,y_px\n0,a,1,2\n0,a,1,2\n", "row 3: field point: 'a': the point is there twice"),
        ("time_s,point,camera,x_px,y_px\n0,a,l,1,2\n0,a,r,1,2\n", "row 3: field camera: 'r'"),
    ],
)
def test_a_recording_of_no_use_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_point_recording(written(tmp_path, "p.csv", text))


def test_a_small_csv_does_not_ask_for_a_large_array(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(OWN.splitlines()[0] + "\n" + "".join(f"{k},c{k},p{k},1,2,1,0\n" for k in range(300)))
    with pytest.raises(InputError, match="27000000 places would be needed"):
        read_image_tracks([path])
    path.write_text(OWN.replace("7,right", "1e300,right"))
    with pytest.raises(InputError, match="row 3: field frame: 1e\\+300: not a whole number"):
        read_image_tracks([path])


def test_a_small_recording_of_points_does_not_ask_for_a_large_array(tmp_path: Path) -> None:
    text = "time_s,point,x_px,y_px\n" + "".join(f"{k},p{k},1,2\n" for k in range(2100))
    with pytest.raises(InputError, match="4410000 places would be needed"):
        read_point_recording(written(tmp_path, "p.csv", text))


def test_names_are_in_the_order_of_their_numbers_however_long(tmp_path: Path) -> None:
    names = ["cam_0", "cam_02", "cam_10", "cam_" + "9" * 5000, "cam_1" + "0" * 5000, "left"]
    rows = "".join(f"0,{name},tip,1,2,1,0\n" for name in reversed(names))
    assert read_image_tracks([written(tmp_path, "a.csv", OWN.splitlines()[0] + "\n" + rows)]).cameras == tuple(names)
