"""The study log: what is written comes back, all three headers say the same, and every bad file is named."""

from __future__ import annotations

import csv
import gzip
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support import study_examples as examples

from mocapella import decoding
from mocapella.errors import DiskFullError, InputError, RecordingError, SettingsError, TakeExistsError
from mocapella.model.session import PLACEMENTS, SCENARIOS
from mocapella.model.study_log import StudyLog, StudyRow
from mocapella.recording import disk, study_log
from mocapella.recording.study_columns import HEADER
from mocapella.recording.study_log import read_study_log, write_study_log

_PAGE = Path(__file__).parents[2] / "docs" / "study-log.md"

quick = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def text(tmp_path: Path) -> str:
    """A log of eight rows, header A."""
    path = tmp_path / "written.csv"
    write_study_log(path, examples.Rows().log().rows())
    return path.read_text()


@pytest.fixture(scope="module")
def real_logs(study_logs: Path) -> dict[str, StudyLog]:
    return examples.real_logs_of(study_logs)


# What is written comes back


@quick
@given(rows=st.lists(examples.study_rows(), min_size=1, max_size=3), name=st.sampled_from(["log.csv", "log.csv.gz"]))
def test_what_is_written_comes_back_to_the_bit(tmp_path: Path, rows: list[StudyRow], name: str) -> None:
    path = tmp_path / name
    path.unlink(missing_ok=True)
    assert write_study_log(path, rows) == len(rows)
    back = list(read_study_log(path).rows())
    assert len(back) == len(rows)
    for wrote, read in zip(rows, back, strict=True):
        for field in StudyRow.__struct_fields__:
            np.testing.assert_array_equal(getattr(read, field), getattr(wrote, field))


def test_the_header_is_the_real_one_and_there_are_87_columns(study_logs: Path) -> None:
    with gzip.open(next(study_logs.glob("*.csv.gz")), "rt") as real:
        assert tuple(real.readline().strip().split(", ")) == HEADER
    assert len(HEADER) == 87


def test_a_missing_joint_is_written_as_9999_three_times(tmp_path: Path) -> None:
    rows = examples.Rows()
    rows["positions"][:, 3, 1] = np.nan  # one coordinate is enough: a joint has three or none
    write_study_log(tmp_path / "log.csv", rows.log().rows())
    with (tmp_path / "log.csv").open() as file:
        first = next(csv.DictReader(file, skipinitialspace=True))
    assert [first[f"Head_{axis}"] for axis in "XYZ"] == ["-9999"] * 3
    assert np.isnan(read_study_log(tmp_path / "log.csv").positions[:, 3]).all()


def test_rows_are_written_as_they_come_and_the_same_rows_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.csv.gz", "b.csv.gz"):
        write_study_log(tmp_path / name, (row for row in examples.Rows().log().rows()))
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()


@pytest.mark.parametrize("kinect", ["=1+1", "+1", "-9999", "@sum", "'quoted", "'=x"])
def test_an_id_that_a_spreadsheet_would_take_for_a_formula_is_escaped(tmp_path: Path, kinect: str) -> None:
    rows = examples.Rows()
    rows["kinect_id"] = np.full(8, kinect)
    write_study_log(tmp_path / "log.csv", rows.log().rows())
    cells = [line.split(", ")[9] for line in (tmp_path / "log.csv").read_text().splitlines()[1:]]
    assert all(cell == "'" + kinect for cell in cells)
    assert set(read_study_log(tmp_path / "log.csv").kinect_id) == {kinect}


# Real files, and the three headers


@pytest.mark.slow
def test_every_real_log_is_read_and_written_back_with_the_same_text(
    tmp_path: Path, study_logs: Path, real_logs: dict[str, StudyLog]
) -> None:
    assert len(real_logs) == 38
    for name in list(real_logs)[::4]:
        path = tmp_path / name.removesuffix(".gz")
        write_study_log(path, real_logs[name].rows())
        with gzip.open(study_logs / name, "rt") as real:
            for wanted, written in zip(real.read().splitlines(), path.read_text().splitlines(), strict=True):
                if wanted != written:
                    _assert_same_numbers(wanted.split(", "), written.split(", "))


def _assert_same_numbers(wanted: list[str], written: list[str]) -> None:
    """The thesis writes 0 where a joint is missing, and sometimes a digit more than brings back the float32."""
    for i in range(12, 87, 3):
        if np.abs(np.array(wanted[i : i + 3], dtype=float)).max() < 1e-6:
            wanted[i : i + 3] = ["-9999"] * 3
    assert len(wanted) == len(written)
    for ours, theirs in zip(written, wanted, strict=True):
        assert ours == theirs or (np.float32(ours) == np.float32(theirs) and len(ours) < len(theirs))


@pytest.mark.parametrize("variant", ["A", "B", "C"])
def test_all_three_headers_give_the_same_log(tmp_path: Path, text: str, variant: str) -> None:
    wanted = examples.Rows()
    if variant == "C":
        wanted["study_id"] = wanted["kinect_config"] = np.full(8, -9999)
    path = examples.saved(tmp_path, examples.in_variant(text, variant))
    assert examples.same(read_study_log(path), wanted.log())


def test_the_oldest_header_may_number_its_kinects(tmp_path: Path, text: str) -> None:
    numbered = text.replace(examples.FRONT, "0").replace(examples.SIDE, "1")
    log = read_study_log(examples.saved(tmp_path, examples.in_variant(numbered, "C")))
    assert log.kinect_id.tolist() == ["0", "1"] * 4


@quick
@given(order=st.permutations(range(87)))
def test_the_order_of_the_columns_does_not_matter(tmp_path: Path, text: str, order: list[int]) -> None:
    cells = [line.split(", ") for line in text.strip().split("\n")]
    shuffled = "\n".join(", ".join(line[i] for i in order) for line in cells)
    assert examples.same(read_study_log(examples.saved(tmp_path, shuffled)), examples.Rows().log())


@pytest.mark.parametrize(
    "values", [("0", "0", "0"), ("0.0", "-0", "0E0"), ("-2.980232E-08", "0", "0"), ("-9999", "-9999", "-9999")]
)
def test_a_joint_at_the_origin_or_at_9999_is_missing(tmp_path: Path, text: str, values: tuple[str, ...]) -> None:
    for axis, value in zip("XYZ", values, strict=True):
        text = examples.edited(text, 3, f"Neck_{axis}", value)
    log = read_study_log(examples.saved(tmp_path, text))
    missing = np.isnan(log.positions)
    assert missing[1, 2].all()
    assert missing.sum() == 3


def test_a_joint_is_missing_within_a_micrometre_of_the_origin_and_not_at_it(tmp_path: Path, text: str) -> None:
    for axis in "XYZ":
        text = examples.edited(text, 2, f"Neck_{axis}", "1e-6")
        text = examples.edited(text, 3, f"Neck_{axis}", "9.999e-7")
    missing = np.isnan(read_study_log(examples.saved(tmp_path, text)).positions)
    assert missing[1, 2].all()
    assert missing.sum() == 3


def test_a_missing_joint_before_a_wrong_field_is_not_named_for_it(tmp_path: Path, text: str) -> None:
    for axis in "XYZ":
        text = examples.edited(text, 5, f"Head_{axis}", "-9999")
    last = text.partition("\n")[0].split(", ")[-1]
    message = _refusal(examples.saved(tmp_path, examples.edited(text, 5, last, "abc")))
    assert f"row 5: field {last}: " in message
    assert "is no number" in message


@pytest.mark.slow
def test_zeros_that_went_to_the_world_and_back_are_missing_too(real_logs: dict[str, StudyLog]) -> None:
    log = real_logs["Study_20_Kinect_1_Time_1_30_34_PM.csv.gz"]
    assert np.isnan(log.positions[..., 0]).sum() == 24  # 8 at exactly 0, 16 at −3e-8
    assert np.nanmin(np.linalg.norm(log.positions, axis=-1)) > 0.1


def test_a_joint_in_the_sensors_plane_is_not_missing(tmp_path: Path, text: str) -> None:
    text = examples.edited(examples.edited(text, 2, "Neck_X", "0"), 2, "Neck_Y", "0")
    assert not np.isnan(read_study_log(examples.saved(tmp_path, text)).positions).any()


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace(", ", ","),
        lambda text: text + "\n\n",
        lambda text: text.replace(examples.SIDE, f'"{examples.SIDE}"'),
        lambda text: text.rstrip("\n"),
    ],
    ids=["byte order mark", "crlf", "no spaces", "empty lines at the end", "quoted", "no newline at the end"],
)
def test_what_spreadsheets_do_to_a_file_changes_nothing(tmp_path: Path, text: str, change: Any) -> None:
    assert examples.same(read_study_log(examples.saved(tmp_path, change(text))), examples.Rows().log())


def test_9999_in_a_number_that_is_no_count_is_not_available(tmp_path: Path, text: str) -> None:
    log = read_study_log(examples.saved(tmp_path, examples.edited(text, 2, "Kinect_Height", "-9999")))
    assert np.isnan(log.height_cm[0])
    assert log.height_cm[1] == 100


# The tables of the thesis, from the logs as they are read

_SCENARIOS = {1: "Stationary", 2: "Steps", 3: "Walk"}
_PLACEMENTS = {0: "parallel", 1: "45", 2: "90"}


@pytest.mark.slow
def test_the_thesis_tables_come_out_of_the_logs(study_logs: Path, real_logs: dict[str, StudyLog]) -> None:
    means: dict[tuple[int, int], dict[int, list[Any]]] = {}
    for log in real_logs.values():
        if log.study_id[0] < 10:
            for (scenario, placement), deltas in _pair_distances(log).items():
                means.setdefault((scenario, placement), {}).setdefault(int(log.study_id[0]), []).append(deltas)
    with (study_logs / "expected_tables_participants_0_9.csv").open() as file:
        expected = list(csv.DictReader(file))
    assert len(expected) == 9
    placements, scenarios = {v: k for k, v in _PLACEMENTS.items()}, {v: k for k, v in _SCENARIOS.items()}
    for row in expected:
        by_participant = means[scenarios[row["task"]], placements[row["placement"]]]
        frames = [np.concatenate(deltas) for deltas in by_participant.values()]
        assert len(frames) == int(row["participants"])
        assert sum(map(len, frames)) == int(row["pairs"])
        M = np.mean([deltas.mean(axis=0) for deltas in frames], axis=0)  # (joints, 4) cm
        wanted = [float(row[f"{what}_{d}"]) for what in ("avg", "std") for d in ("dx", "dy", "dz", "dd")]
        np.testing.assert_allclose([*M.mean(axis=0), *M.std(axis=0, ddof=1)], wanted, atol=0.005)


def _pair_distances(log: StudyLog) -> dict[tuple[int, int], Any]:
    """(scenario, placement) → (pairs, joints, 4): Δx Δy Δz Δd in cm between the first two rows of a time and person."""
    rows: dict[tuple[int, ...], list[int]] = {}
    for i, key in enumerate(zip(log.scenario_id, log.kinect_config, log.tracker_time_ms, log.person_id, strict=True)):
        rows.setdefault(tuple(map(int, key)), []).append(i)
    found: dict[tuple[int, int], list[Any]] = {}
    for (scenario, placement, *_), indices in rows.items():
        if len(indices) > 1 and scenario in _SCENARIOS:
            first, second = log.positions[indices[:2]].astype(np.float64)
            delta = np.abs(first - second)
            delta = np.concatenate([delta, np.linalg.norm(delta, axis=-1, keepdims=True)], axis=-1)
            found.setdefault((scenario, placement), []).append(100 * delta)
    return {key: np.array(deltas) for key, deltas in found.items()}


# The documentation


def test_the_documentation_has_every_column_placement_and_scenario() -> None:
    page = _PAGE.read_text(encoding="utf-8")
    for other, title in {"": "Tracker_Time", **{b: a for a, b in examples.HEADER_B.items()}}.items():
        assert f"| `{title}` | " + (f"`{other}` |" if other else "|") in page
    assert [title for title in HEADER[:12] if f"| `{title}` |" not in page] == []
    assert ", ".join(f"{number} {name}" for name, number in PLACEMENTS.items()) in page
    assert ", ".join(f"{number} {name}" for name, number in SCENARIOS.items()) in page


def test_the_example_of_the_documentation_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_study_log(tmp_path / "walk.csv.gz", examples.Rows().log().rows())
    monkeypatch.chdir(tmp_path)
    example = _PAGE.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    exec(compile(example, "study-log.md", "exec"), {})
    assert [line.split()[1:] for line in capsys.readouterr().out.splitlines()] == [["front", "1"], ["side", "1"]] * 4


# Bad files


def _refusal(path: Path | str) -> str:
    with pytest.raises(InputError) as caught:
        read_study_log(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    assert "no such file" in _refusal(tmp_path / "nowhere.csv")
    assert "is a folder" in _refusal(tmp_path)
    assert "cannot be read" in _refusal(examples.saved(tmp_path, "") / "below.csv")


@pytest.mark.parametrize("name", ["log.csv", "log.csv.gz"])
def test_an_empty_file(tmp_path: Path, name: str) -> None:
    assert "the file is empty; a study log begins with the row Study_Id" in _refusal(
        examples.saved(tmp_path, b"", name)
    )


def test_a_file_that_begins_with_an_empty_row(tmp_path: Path, text: str) -> None:
    assert "the first row is empty" in _refusal(examples.saved(tmp_path, "\n" + text))


def test_a_header_and_no_rows(tmp_path: Path, text: str) -> None:
    assert "a header and no rows" in _refusal(examples.saved(tmp_path, text.split("\n", maxsplit=1)[0] + "\n"))


def test_plain_text_and_damage_under_the_name_gz(tmp_path: Path, text: str) -> None:
    assert "not gzip-compressed; drop .gz" in _refusal(examples.saved(tmp_path, text, "log.csv.gz"))
    whole = gzip.compress(text.encode())
    assert "end early or are damaged" in _refusal(examples.saved(tmp_path, whole[:-30], "cut.csv.gz"))
    torn = whole[:60] + bytes(40) + whole[100:]
    assert "damaged" in _refusal(examples.saved(tmp_path, torn, "torn.csv.gz"))


def test_binary_junk(tmp_path: Path, text: str) -> None:
    assert "row 1: b'\\xff\\xd8\\xff': is not plain text" in _refusal(examples.saved(tmp_path, b"\xff\xd8\xff"))
    assert "row 3: b'\\xe4" in _refusal(examples.saved(tmp_path, _insert(text, 3, "ä").encode("latin-1")))
    assert "row 1" in _refusal(examples.saved(tmp_path, bytes(range(128))))


def _insert(text: str, row: int, extra: str) -> str:
    lines = text.split("\n")
    lines[row - 1] = extra + lines[row - 1]
    return "\n".join(lines)


def test_a_field_longer_than_any_table_has(tmp_path: Path, text: str) -> None:
    assert "row 1" in _refusal(examples.saved(tmp_path, "a" * 200_000 + ",b\n1,2\n"))
    assert "row 2" in _refusal(examples.saved(tmp_path, examples.edited(text, 2, "Study_Id", "1" * 200_000)))


@pytest.mark.parametrize("title", ["Skeleton_Time", "Kinect_Id", "WristRight_Z", "AnkleLeft_X"])
def test_a_missing_column(tmp_path: Path, text: str, title: str) -> None:
    place = HEADER.index(title)
    without = "\n".join(
        ", ".join(cell for i, cell in enumerate(line.split(", ")) if i != place) for line in text.strip().split("\n")
    )
    assert f"row 1: field {title}: this column is missing" in _refusal(examples.saved(tmp_path, without))


def test_several_missing_columns_are_counted(tmp_path: Path, text: str) -> None:
    short = "\n".join(", ".join(line.split(", ")[:84]) for line in text.strip().split("\n"))
    assert "field WristRight_X: this column and 2 more is missing" in _refusal(examples.saved(tmp_path, short))


def test_an_unknown_column_gets_a_suggestion(tmp_path: Path, text: str) -> None:
    message = _refusal(examples.saved(tmp_path, text.replace("Head_X", "Haed_X", 1)))
    assert "row 1: 'Haed_X': column 43 is unknown" in message
    assert "did you mean Head_X?" in message
    assert len(message) < 500


def test_a_column_that_is_there_twice(tmp_path: Path, text: str) -> None:
    message = _refusal(examples.saved(tmp_path, text.replace("Neck_Y", "Neck_X", 1)))
    assert "field Neck_X: 'Neck_X': columns 58 and 59 are the same" in message


def test_other_separators(tmp_path: Path, text: str) -> None:
    assert "the header has one column" in _refusal(examples.saved(tmp_path, text.replace(", ", ";")))


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("Head_X", "abc", "is no number"),
        ("Head_X", "", "is no number"),
        ("Head_X", "1_0", "is no number"),
        ("Head_X", "0x10", "is no number"),
        ("Head_X", "nan", "is not finite"),
        ("Head_Y", "inf", "is not finite"),
        ("Head_Y", "1e999", "is not finite"),
        ("Head_Z", "-9999", "Head has a part of its coordinates"),
        ("Head_Z", "12000", "is 9999 m away or farther"),
        ("Head_Z", "9999", "is 9999 m away or farther"),
        ("Skeleton_Init_Angle", "left", "is no number"),
        ("Kinect_Height", "NaN", "is not finite"),
        ("Person_Id", "1.5", "is no whole number"),
        ("Person_Id", "1_0", "is no whole number"),
        ("Skeleton_Time", "", "is no whole number"),
        ("Skeleton_Time", "9223372036854775808", "has more than 64 bits"),
        ("Tracker_Time", "-" + "9" * 30, "has more than 64 bits"),
        ("Tracker_Time", "9" * 5000, "is no whole number"),
        ("Kinect_Id", "", "the Kinect's id is empty"),
        ("Kinect_Id", "k" * 65, "longer than 64 characters"),
        ("Kinect_Id", "a\tb", "ASCII characters only"),
    ],
)
def test_a_field_that_is_wrong_is_named(tmp_path: Path, text: str, field: str, value: str, problem: str) -> None:
    message = _refusal(examples.saved(tmp_path, examples.edited(text, 5, field, value)))
    assert f"row 5: field {field}: " in message
    assert problem in message


def test_the_first_of_several_wrong_rows_is_named(tmp_path: Path, text: str) -> None:
    twice = examples.edited(examples.edited(text, 7, "Study_Id", "x"), 4, "ThumbRight_Z", "y")
    assert "row 4: field ThumbRight_Z: 'y'" in _refusal(examples.saved(tmp_path, twice))


@pytest.mark.parametrize("change", [lambda line: line + ", 1", lambda line: line.rsplit(", ", 1)[0], lambda line: ""])
def test_a_ragged_row(tmp_path: Path, text: str, change: Any) -> None:
    lines = text.strip().split("\n")
    lines[5] = change(lines[5])
    message = _refusal(examples.saved(tmp_path, "\n".join(lines)))
    assert "row 6: the row has " in message
    assert "fields and the header 87" in message


@pytest.mark.parametrize("cell", ['"a\nb"', '"a,b"', '"unclosed'])
def test_a_quoted_id_with_what_an_id_cannot_have(tmp_path: Path, text: str, cell: str) -> None:
    assert "row 3" in _refusal(examples.saved(tmp_path, examples.edited(text, 3, "Kinect_Id", cell)))


def test_two_numbers_in_one_quoted_cell_are_not_taken_apart(tmp_path: Path, text: str) -> None:
    lines = text.split("\n")
    lines[2] = lines[2].replace(", 0, 100, ", ', "0, 100", ')
    assert "row 3: the row has 86 fields" in _refusal(examples.saved(tmp_path, "\n".join(lines)))


def test_a_number_with_many_spaces_around_it_is_not_cut_off(tmp_path: Path, text: str) -> None:
    padded = examples.edited(text, 3, "Skeleton_Time", " " * 22 + "12345" + " " * 30)
    assert read_study_log(examples.saved(tmp_path, padded)).skeleton_time_ticks[1] == 12345


_decimals = st.from_regex(r"[+-]?([0-9]{1,20}(\.[0-9]{0,20})?|\.[0-9]{1,20})([eE][+-]?[0-9]{1,2})?", fullmatch=True)


@settings(quick, max_examples=100)
@given(cells=st.lists(_decimals, min_size=1, max_size=8))
def test_any_decimal_is_rounded_once_as_by_python(tmp_path: Path, text: str, cells: list[str]) -> None:
    for row, cell in enumerate(cells, start=2):
        text = examples.edited(text, row, "Skeleton_Init_Angle", cell)
    found = read_study_log(examples.saved(tmp_path, text)).init_angle[: len(cells)]
    wanted = [np.nan if float(cell) == -9999 else float(cell) for cell in cells]
    np.testing.assert_array_equal(found.view(np.int64), np.array(wanted).view(np.int64))


@settings(quick, max_examples=150)
@given(data=st.data())
def test_damaged_bytes_give_a_log_or_one_line(tmp_path: Path, text: str, data: st.DataObject) -> None:
    damaged = bytearray(text.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        damaged[at : at + data.draw(st.integers(0, 8))] = data.draw(st.binary(max_size=6))
    path = examples.saved(tmp_path, bytes(damaged))
    outcome: StudyLog | str
    try:
        outcome = read_study_log(path)
    except InputError as error:
        outcome = str(error)
    assert outcome.isprintable() if isinstance(outcome, str) else outcome.positions.shape[1:] == (25, 3)


# Writing


def _names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def _rows() -> list[StudyRow]:
    return list(examples.Rows().log().rows())


def test_nothing_is_overwritten_and_nothing_is_left_behind(tmp_path: Path) -> None:
    path = examples.saved(tmp_path, "precious")
    with pytest.raises(TakeExistsError, match="nothing is overwritten"):
        write_study_log(path, _rows())
    assert path.read_text() == "precious"
    assert _names(tmp_path) == ["log.csv"]


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_appears_while_we_write_is_not_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    path = tmp_path / "log.csv"
    if not links:
        monkeypatch.setattr(os, "link", _no_links)

    def rows() -> Any:
        yield from _rows()
        path.write_text("faster")

    with pytest.raises(TakeExistsError):
        write_study_log(path, rows())
    assert path.read_text() == "faster"
    assert _names(tmp_path) == ["log.csv"]


def _no_links(*_: object) -> None:
    raise OSError(95, "Operation not supported")


def test_a_file_system_without_hard_links_will_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "link", _no_links)
    write_study_log(tmp_path / "log.csv", _rows())
    assert examples.same(read_study_log(tmp_path / "log.csv"), examples.Rows().log())
    assert _names(tmp_path) == ["log.csv"]


def test_rows_that_break_off_leave_nothing(tmp_path: Path) -> None:
    def rows() -> Any:
        yield _rows()[0]
        raise InputError("the take ends early")

    with pytest.raises(InputError, match="ends early"):
        write_study_log(tmp_path / "log.csv", rows())
    assert _names(tmp_path) == []


def test_a_full_disk_says_so_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(fd: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(disk, "sync", full)
    with pytest.raises(DiskFullError, match="No space left"):
        write_study_log(tmp_path / "log.csv", _rows())
    assert _names(tmp_path) == []


def test_what_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="there are no rows"):
        write_study_log(tmp_path / "log.csv", [])
    with pytest.raises(RecordingError, match=r"ends in \.csv or \.csv\.gz"):
        write_study_log(tmp_path / "log.txt", _rows())
    with pytest.raises(RecordingError, match="does not exist"):
        write_study_log(tmp_path / "nowhere" / "log.csv", _rows())
    far = examples.Rows()
    far["positions"][3, 3] = np.inf
    with pytest.raises(RecordingError, match="row 5: Head is 9999 m away or farther"):
        write_study_log(tmp_path / "log.csv", far.log().rows())
    assert _names(tmp_path) == []


@pytest.mark.parametrize("kinect", ["", "a,b", 'a"b', " a", "ä", "k" * 65, "a\nb"])
def test_an_id_that_cannot_stand_in_a_cell(tmp_path: Path, kinect: str) -> None:
    rows = examples.Rows()
    rows["kinect_id"] = np.full(8, kinect)
    with pytest.raises(SettingsError, match="take the sensor's name or address"):
        write_study_log(tmp_path / "log.csv", rows.log().rows())
    assert _names(tmp_path) == []


def test_what_the_fast_and_the_slow_pass_disagree_on_is_still_refused(
    tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> StudyLog:
        raise ValueError("for no reason")

    monkeypatch.setattr(study_log, "_parse", fails)
    path = examples.saved(tmp_path, text)
    assert "the rows cannot be read" in _refusal(path)


@pytest.mark.parametrize("name", ["log.csv", "log.csv.gz"])
def test_a_log_read_in_small_blocks_is_the_same(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / name
    write_study_log(path, examples.Rows().log().rows())
    whole = read_study_log(path)
    monkeypatch.setattr(decoding, "_PIECE", 1000)
    parts = read_study_log(path)
    for field in StudyLog.__struct_fields__:
        np.testing.assert_array_equal(getattr(parts, field), getattr(whole, field))
        assert getattr(getattr(parts, field), "dtype", None) == getattr(getattr(whole, field), "dtype", None)


def test_a_fault_in_a_late_block_names_its_row(tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "_PIECE", 1000)
    lines = text.splitlines()
    lines[6] = lines[6].replace(", ", ", x", 1)
    (tmp_path / "log.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"log\.csv: row 7: field "):
        read_study_log(tmp_path / "log.csv")


def test_a_packed_log_of_one_long_line_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(b"1" * (1 << 20)) * 1500)
    with pytest.raises(InputError, match="has a line of more than"):
        read_study_log(path)


# Blocks


def blocks_of(path: Path) -> tuple[list[StudyLog], list[InputError], InputError | None]:
    """The blocks, the errors of rows that were left out, and the error at the end."""
    blocks, left_out, end = [], list[InputError](), None
    try:
        for block in study_log.study_log_blocks(path, left_out.append):
            blocks.append(block)
    except InputError as error:
        end = error
    return blocks, left_out, end


def test_invalid_rows_are_left_out_with_the_rows_numbers(tmp_path: Path, text: str) -> None:
    for row in (3, 4, 9):
        text = examples.edited(text, row, "Head_X", "abc")
    (block,), left_out, end = blocks_of(examples.saved(tmp_path, text))
    assert [error.row for error in left_out] == [3, 4, 9]
    assert examples.same(block, examples.Rows().take([0, 3, 4, 5, 6]).log())
    assert end is None
    all_bad = examples.saved(tmp_path, "\n".join([text.split("\n")[0], *["x"] * 5]))
    blocks, left_out, end = blocks_of(all_bad)
    assert (blocks, len(left_out), end) == ([], 5, None)


def test_a_file_of_too_many_invalid_rows_is_read_up_to_them(tmp_path: Path, text: str) -> None:
    most = study_log.MOST_LEFT_OUT
    (block,), left_out, end = blocks_of(examples.saved(tmp_path, text + "x\n" * (most + 5)))
    assert (len(block), len(left_out)) == (8, most)
    assert end is not None
    assert end.row == 10 + most
    header = text.split("\n", maxsplit=1)[0] + "\n"
    blocks, left_out, end = blocks_of(examples.saved(tmp_path, header + "x\n" * (most + 5)))
    assert (blocks, len(left_out)) == ([], most)
    assert end is not None


def test_an_invalid_row_beside_quotation_marks_is_not_left_out(tmp_path: Path, text: str) -> None:
    quoted = examples.edited(text.replace(examples.SIDE, f'"{examples.SIDE}"'), 3, "Head_X", "abc")
    blocks, left_out, end = blocks_of(examples.saved(tmp_path, quoted))
    assert (blocks, left_out) == ([], [])
    assert end is not None
    assert end.row == 3


def test_rows_that_cannot_be_read_for_no_row_s_fault(
    tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> StudyLog:
        raise ValueError("for no reason")

    monkeypatch.setattr(study_log, "_parse", fails)
    path = examples.saved(tmp_path, text)
    assert "the rows cannot be read" in _refusal(path)
    blocks, left_out, end = blocks_of(path)
    assert (blocks, left_out) == ([], [])
    assert end is not None


def test_what_precedes_the_damage_of_a_compressed_log_is_read(tmp_path: Path, text: str) -> None:
    header, _, rows = text.partition("\n")
    packed = gzip.compress((header + "\n" + rows * 300).encode())
    for cut in (len(packed) // 2, 40):
        blocks, left_out, end = blocks_of(examples.saved(tmp_path, packed[:cut], "log.csv.gz"))
        assert left_out == []
        assert end is not None
        assert "end early" in end.problem
        assert all(block.study_id.tolist() == [7] * len(block) for block in blocks)
        assert bool(blocks) == (cut > 40)
