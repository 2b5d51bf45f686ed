"""Detections and pickled names that cannot be read: each is refused with what is wrong."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import polars as pl
import pytest

from mocapella.decoding import DEEPEST, MOST_TOML_BYTES, decode_xml
from mocapella.decoding.hdf5 import Hdf5, decode_pickled_texts
from mocapella.decoding.parquet import ParquetTable
from mocapella.errors import InputError
from mocapella.recording.detection_files import read_detections
from mocapella.recording.image_tracks_file import read_image_tracks

FIX = "give a file"


def h5(path: Path, **arrays: Any) -> Path:
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
    return path


TRACKS = np.ones((1, 2, 2, 3))
NODES = [b"a", b"b"]


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"tracks": np.ones((1, 3, 2, 3)), "node_names": NODES}, r"is not \(tracks, 2, nodes, frames\)"),
        ({"tracks": TRACKS, "node_names": NODES, "point_scores": np.ones((1, 2, 4))}, "fits not the tracks"),
        ({"tracks": np.ones((1, 2)), "node_names": NODES}, "is no array of numbers"),
        ({"tracks": TRACKS, "node_names": [1.0, 2.0]}, "is no list of names"),
        ({"tracks": TRACKS, "node_names": [b"a", b""]}, "has an empty name"),
    ],
)
def test_sleaps_arrays_that_do_not_fit_are_refused(arrays: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        read_detections([h5(tmp_path / "cam.h5", **arrays)])


def test_sleaps_file_without_scores_and_names_of_tracks_is_read(tmp_path: Path) -> None:
    (found,) = read_detections([h5(tmp_path / "cam.h5", tracks=TRACKS, node_names=NODES)])
    assert (found.individuals, found.frames[0].confidences.tolist()) == ((), [[1.0, 1.0]])


def table(path: Path, columns: Any, rows: Any, blocks: tuple[str, ...] = ("values_block_0",)) -> Path:
    """A table of pandas, whose column names are a pickled attribute; ``rows`` are the numbers of frames."""
    kind = np.dtype([("index", np.asarray(rows).dtype), *((block, "<f8", (3,)) for block in blocks)])
    with h5py.File(path, "w") as file:
        group = file.create_group("df")
        group.attrs["pandas_type"] = "frame_table"
        values = np.zeros(len(rows), kind)
        values["index"] = rows
        file["df/table"] = values
        file["df/table"].attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(columns, 0))
    return path


POINT = [("net", "a", part) for part in ("x", "y", "likelihood")]


@pytest.mark.parametrize(
    ("columns", "rows", "blocks", "said"),
    [
        (POINT, [0, 1], ("values_block_0", "values_block_1"), "has no table of DeepLabCut"),
        (POINT[:2], [0, 1], ("values_block_0",), "another number of names than columns"),
        (POINT, [0.0, 1.0], ("values_block_0",), "has no numbers of frames"),
        (POINT, [1, 1], ("values_block_0",), "a frame is there twice"),
        ([("net", "a", "z"), *POINT[1:]], [0, 1], ("values_block_0",), "has columns of another program"),
        ([], [0, 1], ("values_block_0",), "has no columns x, y and likelihood"),
        (3, [0, 1], ("values_block_0",), "has no columns x, y and likelihood"),
    ],
)
def test_tables_of_another_kind_are_refused(
    columns: Any, rows: list[Any], blocks: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=said):
        read_detections([table(tmp_path / "a.h5", columns, rows, blocks)])


def test_a_table_without_likelihoods_has_certain_points(tmp_path: Path) -> None:
    columns = [("net", "a", "x"), ("net", "a", "y"), ("net", "b", "x")]
    (found,) = read_detections([table(tmp_path / "a.h5", columns, [0])])
    assert found.frames[0].confidences.max() == 1.0


def test_groups_and_attributes_that_are_others_are_named(tmp_path: Path) -> None:
    with Hdf5(table(tmp_path / "a.h5", POINT, [0]), fix=FIX) as file:
        with pytest.raises(InputError, match="odd"):
            file.attribute("odd", "any")
        assert file.attribute("df", "absent") is None
        assert file.attribute("df", "pandas_type") == b"frame_table"


def test_an_attribute_that_cannot_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Hdf5(table(tmp_path / "a.h5", POINT, [0]), fix=FIX) as file:

        class Damaged:
            @property
            def attrs(self) -> Any:
                raise OSError("damaged")

        monkeypatch.setattr(file, "_at", lambda name: Damaged())
        with pytest.raises(InputError, match=r"df: .*damaged"):
            file.attribute("df", "pandas_type")
        monkeypatch.setattr(file, "_at", lambda name: None)
        with pytest.raises(InputError, match="df"):
            file.names("df")


@pytest.mark.parametrize("protocol", range(5))
@pytest.mark.parametrize(
    "value", [[], (), ("a",), ("a", "b"), ("a", "b", "c"), ("a", "b", "c", "d"), ["a"], ["a", "a", 3], [("x", "x")]]
)
def test_texts_of_any_pickle_come_back(value: Any, protocol: int) -> None:
    assert decode_pickled_texts(pickle.dumps(value, protocol)) == value


@pytest.mark.parametrize("data", [b"", b"]", b"(", b".", pickle.dumps(print), pickle.dumps({"a": 1}), b"l."])
def test_pickles_of_something_else_are_refused(data: bytes) -> None:
    with pytest.raises(InputError, match="has names that cannot be read"):
        decode_pickled_texts(data)


def person(count: int) -> dict[str, Any]:
    return {"pose_keypoints_2d": [1.0] * (3 * count)}


def openpose(folder: Path, *people: Any, name: str = "cam_0.json") -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    (folder / name).write_text(json.dumps({"people": list(people)}))
    return folder


def test_folders_of_one_name_and_of_other_models_are_refused(tmp_path: Path) -> None:
    one, other = openpose(tmp_path / "a" / "cam", person(17)), openpose(tmp_path / "b" / "cam", person(17))
    with pytest.raises(InputError, match="two cameras have this name"):
        read_detections([one, other])
    with pytest.raises(InputError, match="the cameras have different keypoints"):
        read_image_tracks([one, openpose(tmp_path / "c", person(18))], order="auto")


def test_names_without_a_number_and_lists_of_no_people_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no frame number in its name"):
        read_detections([openpose(tmp_path / "a", person(17), name="none.json")])
    with pytest.raises(InputError, match="no number of a frame"):
        read_detections([openpose(tmp_path / "b", person(17), name=f"cam_{'1' * 19}.json")])
    path = tmp_path / "mm.json"
    path.write_text(json.dumps({"instance_info": [{"frame_id": 1, "instances": 3}]}))
    with pytest.raises(InputError, match="is no list of people"):
        read_detections([path])


def test_a_frame_of_a_table_is_a_whole_number(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("frame,camera,person,point,x_px,y_px\n0.5,a,c,b,1,2\n")
    with pytest.raises(InputError, match="not a whole number"):
        read_detections([path])


def test_a_declared_order_holds_for_images_without_people(tmp_path: Path) -> None:
    (found,) = read_detections([openpose(tmp_path / "a")], order="COCO_18")
    assert len(found.frames[0].ids) == 0


def test_files_without_a_frame_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the files have no frame"):
        read_detections([h5(tmp_path / "cam.h5", tracks=np.ones((1, 2, 2, 0)), node_names=NODES)])


def test_values_of_another_file_are_not_followed(tmp_path: Path) -> None:
    layout = h5py.VirtualLayout((1, 2, 2, 3), "<f8")
    layout[:] = h5py.VirtualSource(str(h5(tmp_path / "other.h5", tracks=TRACKS)), "tracks", (1, 2, 2, 3))
    with h5py.File(h5(tmp_path / "cam.h5", node_names=NODES), "a") as file:
        file.create_virtual_dataset("tracks", layout)
    with pytest.raises(InputError, match="its values are in another file"):
        read_detections([tmp_path / "cam.h5"])


def test_an_absent_parquet_file_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.parquet"):
        ParquetTable(pl, tmp_path / "absent.parquet", fix=FIX)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"<a>" + b" " * MOST_TOML_BYTES + b"</a>", "it has more than"),
        (b"<a>" * (DEEPEST + 1) + b"</a>" * (DEEPEST + 1), "nested deeper"),
    ],
)
def test_xml_beyond_the_limits_is_refused(text: bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        decode_xml(text)
