from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from mocapella.errors import InputError, SettingsError
from mocapella.exports.space_tracks import COLUMNS, as_csv, as_trc, write_space_tracks
from mocapella.model.point_tracks import SpaceTracks

NAN = np.nan
TRACKS = SpaceTracks(
    ("a", "b"),
    np.array([3, 5]),
    np.array([10.0, 10.5]),
    np.array([[[1, 2, 3], [NAN, NAN, NAN]], [[4, 5, 6], [7, 8, 9]]], dtype=float),
    np.array([[0.001, NAN], [NAN, 0.002]]),
    np.array([[0.5, NAN], [0.25, 1]]),
    np.array([[2, 0], [3, 4]]),
    np.array([[0, 1], [0, 0]], dtype=np.uint8),
)


def places(trc: str) -> list[list[str]]:
    return [line.split("\t") for line in trc.splitlines()[5:]]


def test_a_csv_has_a_row_for_each_point_that_is_known() -> None:
    rows = [line.split(",") for line in as_csv(TRACKS).splitlines()]
    assert tuple(rows[0]) == COLUMNS
    assert rows[1] == ["3", "10.000000", "a", "1.000000", "2.000000", "3.000000", "0.001000", "2", "0.500"]
    assert [row[2] for row in rows[1:]] == ["a", "a", "b"]
    assert rows[2][6] == ""


def test_a_trc_has_every_frame_and_nan_where_a_point_is_unknown() -> None:
    trc = as_trc(TRACKS, "x.trc")
    lines = [line.split("\t") for line in trc.splitlines()]
    assert lines[2][:5] == ["2", "2", "2", "2", "m"]
    assert [name for name in lines[3] if name] == ["Frame#", "Time", "a", "b"]
    assert lines[4][2:] == ["X1", "Y1", "Z1", "X2", "Y2", "Z2"]
    assert places(trc)[0] == ["3", "0.000000", "1.000000", "2.000000", "3.000000", "NaN", "NaN", "NaN"]
    assert places(trc)[1][1] == "0.500000"


@pytest.mark.parametrize(("up", "wanted"), [("y", [1, 2, 3]), ("z", [2, 3, 1]), ("-y", [1, -2, -3])])
def test_a_trc_has_y_up_and_stays_right_handed(up: str, wanted: list[float]) -> None:
    assert [float(cell) for cell in places(as_trc(TRACKS, "x.trc", up))[0][2:5]] == wanted
    axes = msgspec.structs.replace(TRACKS, points=("x", "y", "z"), frames=np.array([0]), at_s=np.array([0.0]),
                                   positions=np.eye(3)[None])  # fmt: skip
    R = np.array([float(cell) for cell in places(as_trc(axes, "x.trc", up))[0][2:]]).reshape(3, 3).T
    assert np.linalg.det(R) == 1.0


def test_without_times_a_rate_gives_them() -> None:
    timeless = msgspec.structs.replace(TRACKS, at_s=np.full(2, NAN))
    assert as_csv(timeless).splitlines()[1].split(",")[1] == ""
    assert as_csv(timeless, hz=10).splitlines()[1].split(",")[1] == "0.300000"
    assert places(as_trc(timeless, "x.trc", hz=10))[1][1] == "0.200000"
    with pytest.raises(InputError, match=r"needs times.*--fps"):
        as_trc(timeless, "x.trc")


def test_equal_times_give_a_rate_from_the_others_and_none_alone() -> None:
    still = msgspec.structs.replace(
        TRACKS, frames=np.arange(4), at_s=np.array([1.0, 1.0, 1.0, 1.5]), positions=np.zeros((4, 2, 3))
    )
    assert as_trc(still, "x.trc").splitlines()[2].startswith("2\t2\t4\t")
    with pytest.raises(InputError, match=r"times that rise.*--fps"):
        as_trc(msgspec.structs.replace(TRACKS, at_s=np.ones(2)), "x.trc")
    assert as_trc(msgspec.structs.replace(TRACKS, at_s=np.ones(2)), "x.trc", hz=10)


def test_a_file_is_written_as_its_name_says(tmp_path: Path) -> None:
    write_space_tracks(TRACKS, tmp_path / "a.csv")
    write_space_tracks(TRACKS, tmp_path / "a.TRC")
    assert (tmp_path / "a.csv").read_text().startswith("frame,")
    assert (tmp_path / "a.TRC").read_text().startswith("PathFileType")
    assert len(list(tmp_path.iterdir())) == 2


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    for name, options, said in (
        ("a.c3d", {}, "end its name with .csv, .trc"),
        ("a.csv", {"up": "x"}, "up is 'x'"),
        ("a.csv", {"hz": 0.0}, "hz is 0.0"),
        ("none/a.csv", {}, "a folder that exists"),
    ):
        with pytest.raises(SettingsError, match=said):
            write_space_tracks(TRACKS, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


def test_a_points_name_is_no_formula_and_no_line_of_its_own() -> None:
    named = msgspec.structs.replace(TRACKS, points=("=1+1", "a\tb\n\x1b[2J"))
    rows = as_csv(named).splitlines()
    assert [row.split(",")[2] for row in rows[1:3]] == ["'=1+1", "'=1+1"]
    assert [row.split(",")[3] for row in rows[1:3]] == ["1.000000", "4.000000"]  # numbers are numbers
    lines = as_trc(named, "x\n.trc").splitlines()
    assert len(lines) == 5 + len(TRACKS.frames)
    assert lines[0].endswith("x\\n.trc")
    assert lines[3].rstrip().split("\t")[2::3] == ["=1+1", "a\\tb\\n\\x1b[2J"]
