"""A study log in Parquet is the same as its text: the same rows, figures and tables to the bit."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support import study_examples as examples
from support.programs import result_here
from support.take_making import small_take

from mocapella.decoding import FREE_UNPACKED
from mocapella.errors import InputError, RecordingError, TakeExistsError
from mocapella.model.study_log import StudyLog
from mocapella.recording.study_log import read_study_log, write_study_log
from mocapella.studies import parquet_log
from mocapella.studies.analysis import analyze_file, merge
from mocapella.studies.parquet_log import parquet_log_blocks, write_parquet_log
from mocapella.studies.recordings import find_recordings, whole_log
from mocapella.studies.study_tables import tables_of
from mocapella.studies.whole_analysis import analyze_recordings

polars = pytest.importorskip("polars")
quick = settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def both(folder: Path, log: StudyLog) -> tuple[Path, Path]:
    """The log as text and in Parquet, in folders of their own."""
    for name in ("text", "parquet"):
        (folder / name).mkdir()
    write_study_log(folder / "text" / "any.csv", log.rows())
    write_parquet_log(folder / "parquet" / "any.parquet", log.rows())
    return folder / "text" / "any.csv", folder / "parquet" / "any.parquet"


def changed(path: Path, **columns: Any) -> Path:
    """Write other columns into a file; None removes one."""
    table = polars.read_parquet(path)
    table = table.drop([name for name, column in columns.items() if column is None])
    table = table.with_columns(**{name: column for name, column in columns.items() if column is not None})
    table.write_parquet(path)
    return path


def left_out(path: Path) -> tuple[int, list[str]]:
    errors: list[InputError] = []
    rows = sum(len(block) for block in parquet_log_blocks(path, errors.append))
    return rows, [f"{error.row}: {error.problem}" for error in errors]


@quick
@given(frames=st.integers(1, 20), seed=st.integers(0, 9), missing=st.lists(st.integers(0, 9), max_size=4))
def test_the_rows_are_the_same(
    tmp_path_factory: pytest.TempPathFactory, frames: int, seed: int, missing: list[int]
) -> None:
    rows = examples.Rows(frames=frames, seed=seed)
    positions = rows["positions"].copy()
    for joint in missing:
        positions[joint % len(positions), joint] = np.nan
    rows["positions"] = positions
    rows["init_angle"] = np.where(np.arange(2 * frames) % 3, 0.1, np.nan)
    text, parquet = both(tmp_path_factory.mktemp("log"), rows.log())
    (found,) = parquet_log_blocks(parquet, pytest.fail)
    assert examples.same(found, read_study_log(text))


def test_the_tables_are_the_same_in_any_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = examples.Rows(frames=40)
    rows["tracker_time_ms"] = rows["tracker_time_ms"] // 10  # of both sensors at once
    text, parquet = both(tmp_path, rows.log())
    monkeypatch.setattr(parquet_log, "BLOCK_ROWS", 7)
    tables = [
        repr(tables_of(merge([analyze_file(path)]))[:-3])
        for path in (text, parquet)  # the last three name the file
    ]
    assert "walk-by-joint" in tables[0]
    assert tables[0] == tables[1]


def test_the_tables_of_a_real_log_are_the_same(study_logs: Path, tmp_path: Path) -> None:
    log = read_study_log(study_logs / "Study_4_Kinect_2_Time_1_27_36_PM.csv.gz")
    write_parquet_log(tmp_path / "Study_4.parquet", log.rows())
    (ours,) = analyze_recordings([tmp_path / "Study_4.parquet"])
    (text,) = analyze_recordings([study_logs / "Study_4_Kinect_2_Time_1_27_36_PM.csv.gz"])
    assert repr(ours.measured) == repr(text.measured)  # the measures use it, too
    assert [one.sums.tobytes() for one in ours.summaries] == [one.sums.tobytes() for one in text.summaries]
    assert repr(tables_of(merge([ours]))[:-3]) == repr(tables_of(merge([text]))[:-3])


def test_a_log_is_analysed_once_if_both_are_there(tmp_path: Path) -> None:
    log = examples.Rows(frames=4).log()
    write_study_log(tmp_path / "a.csv.gz", log.rows())
    write_parquet_log(tmp_path / "a.parquet", log.rows())
    write_parquet_log(tmp_path / "b.parquet", log.rows())
    polars.DataFrame({"time_s": [1.0]}).write_parquet(tmp_path / "a.people.parquet")
    found = find_recordings(tmp_path)
    assert [path.name for path in found.paths] == ["a.csv.gz", "b.parquet"]
    assert [one.what for one in found.findings] == ["1 log is there as text and in Parquet"]


def test_invalid_rows_are_left_out_and_named(tmp_path: Path) -> None:
    _, path = both(tmp_path, examples.Rows(frames=4).log())
    numbers = [1.0, None, float("inf"), 0.3, 0.0, 0.0, 0.0, 12_000.0]
    changed(
        path,
        Head_X=polars.Series(numbers),
        Person_Id=polars.Series([None, 0, 0, 0, 0, 0, 0, 0], dtype=polars.Int64),
        Kinect_Id=polars.Series(["a", "b", "a", "b" * 99, "a", "b", "a", "b"]),
    )
    rows, faults = left_out(path)
    joint = "a joint has a part of its coordinates, or is too far away"
    assert faults == [
        "2: Person_Id is missing", f"3: {joint}", f"4: {joint}", "5: Kinect_Id is no id of a Kinect", f"9: {joint}"
    ]  # fmt: skip
    assert rows == 3


def test_too_many_invalid_rows_end_the_reading(tmp_path: Path) -> None:
    _, path = both(tmp_path, examples.Rows(frames=80).log())
    changed(path, Head_X=polars.Series([0.1] + [None] * 159))
    with pytest.raises(InputError, match=r"row 103: a joint has a part"):
        left_out(path)
    results = analyze_file(path)
    assert not results.whole
    assert results.rows == 101


@pytest.mark.parametrize(
    ("columns", "problem"),
    [
        ({"Head_X": None}, "Head_X: this column is missing"),
        ({"Odd": polars.lit(1)}, "is unknown"),
        ({"Person_Id": polars.lit("a")}, "Person_Id: 'String': is no column of whole numbers"),
        ({"Head_X": polars.lit("a")}, "Head_X: 'String': is no column of numbers"),
        ({"Kinect_Id": polars.lit(1)}, "Kinect_Id: 'Int32': is no column of texts"),
        ({"Person_Id": polars.lit(2**64 - 1, dtype=polars.UInt64)}, "Person_Id: has more than 64 bits"),
    ],
)
def test_other_columns_are_refused_and_named(tmp_path: Path, columns: dict[str, Any], problem: str) -> None:
    _, path = both(tmp_path, examples.Rows(frames=2).log())
    with pytest.raises(InputError) as refused:
        left_out(changed(path, **columns))
    assert problem in str(refused.value)
    assert not analyze_file(path).whole


def test_the_oldest_header_has_no_participant_and_no_placement(tmp_path: Path) -> None:
    _, path = both(tmp_path, examples.Rows(frames=2).log())
    log = whole_log(changed(path, Study_Id=None, Kinect_Config=None))
    assert log is not None
    assert set(log.study_id.tolist()) == set(log.kinect_config.tolist()) == {-9999}


def test_a_damaged_file_is_a_finding(tmp_path: Path) -> None:
    _, path = both(tmp_path, examples.Rows(frames=50).log())
    data = path.read_bytes()
    for damaged in (data[: len(data) // 2], b"", b"PAR1" + bytes(60), data[:-200] + bytes(200)):
        path.write_bytes(damaged)
        found = find_recordings(path.parent)
        (results,) = analyze_recordings(found.paths)
        assert not results.whole
        assert "is damaged, or is no Parquet file" in results.findings[0].what


def test_a_file_that_unpacks_to_far_more_than_its_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "large.parquet"
    polars.select(Tracker_Time=polars.repeat(0, FREE_UNPACKED // 4 + 1, dtype=polars.Int32)).write_parquet(path)
    with pytest.raises(InputError, match="unpacks to more than 20 times"):
        left_out(path)


def test_nothing_is_overwritten_and_no_empty_log_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    with pytest.raises(RecordingError, match="there are no rows"):
        write_parquet_log(path, [])
    write_parquet_log(path, examples.Rows(frames=1).log().rows())
    with pytest.raises(TakeExistsError):
        write_parquet_log(path, examples.Rows(frames=1).log().rows())


def test_without_polars_the_texts_are_analysed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = examples.Rows(frames=4).log()
    write_study_log(tmp_path / "a.csv", log.rows())
    write_parquet_log(tmp_path / "b.parquet", log.rows())
    monkeypatch.setitem(sys.modules, "polars", None)
    found = find_recordings(tmp_path)
    assert [path.name for path in found.paths] == ["a.csv"]
    assert "1 Parquet files cannot be read: polars is not installed" in found.findings[0].what


def test_the_command_writes_a_log_that_the_analysis_reads(tmp_path: Path) -> None:
    small_take(tmp_path / "walk.mcap", 30)
    result_here(tmp_path, "export", "study-log", "walk.mcap", "--out", "walk.parquet", "--placement", "parallel")
    result_here(tmp_path, "export", "study-log", "walk.mcap", "--out", "walk.csv", "--placement", "parallel")
    log = whole_log(tmp_path / "walk.parquet")
    assert log is not None
    assert examples.same(log, read_study_log(tmp_path / "walk.csv"))
