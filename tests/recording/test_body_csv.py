"""Files of one sensor's bodies: what they say is read, and every bad file is named."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.body_tables import AZURE, AZURE_COLUMNS, KINECT, azure_rows, azure_text, kinect_rows, kinect_text

from mocapella import decoding
from mocapella.errors import InputError
from mocapella.recording.body_csv import is_body_csv, read_body_csv

quick = settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])


def saved(folder: Path, text: str, name: str = "bodies.csv") -> Path:
    path = folder / name
    if name.endswith(".gz"):
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_bytes(text.encode())
    return path


@quick
@given(seed=st.integers(0, 999), order=st.permutations(AZURE_COLUMNS), name=st.sampled_from(["a.csv", "a.csv.gz"]))
def test_an_azure_kinects_rows_are_in_camera_space(tmp_path: Path, seed: int, order: list[str], name: str) -> None:
    rows = azure_rows(seed=seed)
    first = [one for one in order if one in {"timestamp", "body_idx"}][:1]
    columns = first + [one for one in order if one not in first]
    path = saved(tmp_path, azure_text(rows, columns), name)
    assert is_body_csv(path)
    read = read_body_csv(path)
    assert (read.topology, read.first_row) == (AZURE, 2)
    assert read.time_ns.tolist() == [row.time * 1000 for row in rows]
    assert read.ids.tolist() == [row.body for row in rows]
    for k, row in enumerate(rows):
        assert read.states[k].tolist() == np.minimum(row.states, 2).tolist()
        expected = np.where(row.states[:, None] > 0, row.at * (-1e-3, -1e-3, 1e-3), np.nan)
        np.testing.assert_array_equal(read.positions[k], expected.astype(np.float32))


@pytest.mark.parametrize("end", ["", ","])
def test_a_kinect_v2s_rows_are_read_without_a_header(tmp_path: Path, end: str) -> None:
    rows = kinect_rows()
    path = saved(tmp_path, kinect_text(rows, end))
    assert is_body_csv(path)
    read = read_body_csv(path)
    assert (read.topology, read.first_row, read.ids.tolist()) == (KINECT, 1, [0, 0, 0])
    assert read.time_ns.tolist() == [row.time * 100 for row in rows]
    for k, row in enumerate(rows):
        assert read.states[k].tolist() == row.states.tolist()
        expected = np.where(row.states[:, None] > 0, row.at, np.nan)
        np.testing.assert_array_equal(read.positions[k], expected.astype(np.float32))


@pytest.mark.parametrize("text", [azure_text(azure_rows(300)), kinect_text(kinect_rows(600))])
def test_a_file_of_several_blocks_is_read_as_one(tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path, text)
    whole = read_body_csv(path)
    monkeypatch.setattr(decoding, "_PIECE", 50_000)
    parts = read_body_csv(path)
    assert len(whole.ids) == 600
    np.testing.assert_array_equal(parts.positions, whole.positions)
    np.testing.assert_array_equal(parts.time_ns, whole.time_ns)


@pytest.mark.parametrize("ending", ["\r\n", "\r"])
def test_any_line_ending_and_a_byte_order_mark_are_read(tmp_path: Path, ending: str) -> None:
    plain = read_body_csv(saved(tmp_path, azure_text(azure_rows())))
    path = tmp_path / "windows.csv"
    path.write_bytes(b"\xef\xbb\xbf" + azure_text(azure_rows()).replace("\n", ending).encode())
    np.testing.assert_array_equal(read_body_csv(path).positions, plain.positions)


def test_the_real_recordings_are_read(azure_and_vicon: Path, kinect_v2_gestures: Path) -> None:
    azure = read_body_csv(azure_and_vicon / "azure_positions.csv.gz")
    assert (len(azure.ids), set(azure.ids.tolist())) == (1105, {1})
    assert azure.time_ns[0] == 333_500_000
    np.testing.assert_allclose(azure.positions[0, 0], (-0.044451725, -0.085544258, 2.215282715), rtol=1e-6)
    assert (azure.states == 0).sum() == 532
    for name, rows in (("joints", 371), ("Ges01_wavehand", 154)):
        kinect = read_body_csv(kinect_v2_gestures / f"{name}.csv.gz")
        assert len(kinect.ids) == rows
        up = kinect.positions[:, KINECT.index("Head"), 1] - kinect.positions[:, KINECT.index("SpineBase"), 1]
        assert (up > 0.5).all()
    with pytest.raises(InputError, match=r"row 1: field PELVIS \(w\): has orientations; .*give the file of positions"):
        read_body_csv(azure_and_vicon / "azure_orientations.csv.gz")


def test_a_study_log_is_another_file(study_logs: Path, tmp_path: Path) -> None:
    assert not is_body_csv(next(study_logs.glob("*.csv.gz")))
    assert not is_body_csv(tmp_path / "none.csv")
    assert not is_body_csv(saved(tmp_path, "1.5\n2.5\n"))  # one column of numbers
    assert not is_body_csv(saved(tmp_path, ""))


def changed(text: str, row: int, column: str, cell: str) -> str:
    lines = [line.split(";") for line in text.split("\n")]
    lines[row - 1][AZURE_COLUMNS.index(column)] = cell
    return "\n".join(map(";".join, lines))


@pytest.mark.parametrize(
    ("column", "cell", "message"),
    [
        ("HEAD (x)", "abc", r"row 4: field HEAD \(x\): 'abc': is no number; write a number with a point"),
        ("HEAD (x)", "1,5", r"row 4: field HEAD \(x\): '1,5': is no number"),
        ("HEAD (x)", "1_5", r"row 4: field HEAD \(x\): '1_5': is no number"),
        ("HEAD (x)", "", r"row 4: field HEAD \(x\): '': is no number"),
        ("HEAD (y)", "nan", r"row 4: field HEAD \(y\): 'nan': is no number"),
        ("HEAD (y)", "1e999", r"row 4: field HEAD \(y\): '1e999': is no number"),
        ("HEAD (z)", "100000", r"row 4: field HEAD \(z\): '100000': is 100 m away or farther; .*millimetres"),
        ("NECK (c)", "4", r"row 4: field NECK \(c\): '4': is no state; states are 0 to 3"),
        ("NECK (c)", "1.5", r"row 4: field NECK \(c\): '1.5': is no state"),
        ("timestamp", "-1", "row 4: field timestamp: '-1': is no time of a sensor; it counts 1000 ns"),
        ("timestamp", "1e16", "row 4: field timestamp: '1e16': is no time of a sensor"),
        ("body_idx", "-1", "row 4: field body_idx: '-1': is no number of a body"),
        ("body_idx", "1e17", "row 4: field body_idx: '1e17': is no number of a body"),
    ],
)
def test_a_bad_cell_is_named(tmp_path: Path, column: str, cell: str, message: str) -> None:
    path = saved(tmp_path, changed(azure_text(azure_rows()), 4, column, cell))
    with pytest.raises(InputError, match=message) as caught:
        read_body_csv(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("PELVIS (c)", "PELVIS (q)", r"row 1: 'PELVIS \(q\)': is an unknown column; .*did you mean PELVIS"),
        ("EAR_RIGHT (z)", "EAR_RIGHT (y)", r"row 1: field EAR_RIGHT \(y\): is there twice"),
        (";EAR_RIGHT (z)", "", r"row 1: field EAR_RIGHT \(z\): the column is missing"),
        ("timestamp;", "time;", "is no file of a sensor's bodies; .*begins with timestamp;body_idx"),
        ("\n33000;", "\n33000;7;", "row 2: the row has 131 cells and not 130; remove the row or complete it"),
        ("\n33000;", "\n\n33000;", "row 2: the row has 1 cells"),
    ],
)
def test_a_bad_header_or_row_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = azure_text(azure_rows(bodies=1))
    assert text.count(old) == 1
    with pytest.raises(InputError, match=message):
        read_body_csv(saved(tmp_path, text.replace(old, new)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty; a file of Azure Kinect"),
        (azure_text([]), "the file has a header and no rows"),
        ("hello\n1\n", "row 1: 'hello': is no file of a sensor's bodies"),
        ("1,2,3\n", "row 1: the row has 3 cells and not 101"),
        (
            kinect_text(kinect_rows()).replace("330000,", "330000.5,", 1),
            "field time: '330000.5': is no time of a sensor",
        ),
        (
            kinect_text([row._replace(at=1e3 * row.at) for row in kinect_rows()]),
            "field SpineBase z: .*in metres",
        ),
        (azure_text([row._replace(at=1e-3 * row.at) for row in azure_rows()]), "within 0.1 m of .*in millimetres"),
        (azure_text(azure_rows()) + "\xff", "row 8.*is not plain text"),
    ],
)
def test_another_file_or_unit_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bodies.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=message):
        read_body_csv(path)


def test_a_packed_file_that_unpacks_to_far_more_than_a_recording_is_refused(tmp_path: Path) -> None:
    line = azure_text(azure_rows(1, 1)).split("\n")
    with gzip.open(tmp_path / "bomb.csv.gz", "wb") as file:
        file.write((line[0] + "\n").encode())
        for _ in range(40):
            file.write(((line[1] + "\n") * 1000).encode())
    with pytest.raises(InputError, match="unpacks to more than 20 times its size"):
        read_body_csv(tmp_path / "bomb.csv.gz")


def test_rows_that_end_with_a_separator_are_read(tmp_path: Path) -> None:
    text = azure_text(azure_rows())
    one = read_body_csv(saved(tmp_path, text))
    other = read_body_csv(saved(tmp_path, text.rstrip("\n").replace("\n", ";\n") + ";\n", "other.csv"))
    np.testing.assert_array_equal(other.positions, one.positions)


def test_rows_that_nothing_is_wrong_with_and_that_cannot_be_read_are_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_args: object, **_options: object) -> None:
        raise ValueError

    monkeypatch.setattr(np, "loadtxt", fails)
    with pytest.raises(InputError, match="the rows cannot be read"):
        read_body_csv(saved(tmp_path, azure_text(azure_rows())))
