"""The analysis of recordings: what is cleaned and what is left alone, pairs, bad input, and the laws of merging."""

from __future__ import annotations

import gzip
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support import study_examples as examples
from support.evaluation_sessions import log_of
from support.take_making import small_take, unclosed_take

from mocapella.errors import InputError, SettingsError
from mocapella.evaluation.study_pairs import pairs_of
from mocapella.model.study_log import StudyLog
from mocapella.recording.study_log import write_study_log
from mocapella.studies.analysis import analyze_file, merge
from mocapella.studies.cleaning import STEPS, RowCleaner, only
from mocapella.studies.differences import AlignedPairs
from mocapella.studies.naming import NOT_SAID
from mocapella.studies.pairing import LOOK_ROWS, RowPairing, joined
from mocapella.studies.recordings import find_recordings
from mocapella.studies.results import ComparedViews, FileResults, StudyResults

quick = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def written(folder: Path, log: StudyLog, name: str = "any name.csv") -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    write_study_log(folder / name, log.rows())
    return folder / name


def changed(log: StudyLog, **fields: Any) -> StudyLog:
    return msgspec.structs.replace(log, **fields)


def steps_of(results: FileResults) -> dict[str, int]:
    """The steps that concern rows, but for those that concern all."""
    return {
        one.step: one.rows
        for one in results.cleaning
        if one.rows and "time c" not in one.step and "to cm" not in one.step
    }


def said(results: FileResults | StudyResults) -> list[tuple[str, str, int]]:
    return [(one.what, one.effect, one.rows) for one in results.findings]


def figures(results: FileResults | StudyResults) -> dict[ComparedViews, tuple[int, bytes, bytes]]:
    return {one.key: (one.pairs, one.sums.tobytes(), one.histogram.tobytes()) for one in results.summaries}


# Cleaning


def cleaned(log: StudyLog, blocks: int = 1) -> tuple[StudyLog, RowCleaner, RowPairing]:
    """The rows that all steps leave, read in blocks."""
    cleaner, pairing = RowCleaner(), RowPairing()
    found = [pairing.add(cleaner.clean(only(log, rows))) for rows in np.array_split(np.arange(len(log)), blocks)]
    last = pairing.end()
    assert last is not None
    rows = found[0].rows
    for one in (*found[1:], last):
        rows = joined(rows, one.rows)
    return rows, cleaner, pairing


@st.composite
def messy_logs(draw: st.DrawFn) -> StudyLog:
    """Logs with repeated, lost and disordered rows, several sensors, people, participants, scenarios and units."""
    rows = examples.Rows(frames=draw(st.integers(1, 20)), seed=draw(st.integers(0, 9)))
    count = 2 * rows.frames
    columns = {
        "scenario_id": [3, 4, 8, -9999],
        "person_id": [0, 1],
        "study_id": [7, 8],
        "kinect_id": [examples.FRONT, examples.SIDE, "left"],
    }
    for name, values in columns.items():
        rows[name] = np.array(draw(st.lists(st.sampled_from(values), min_size=count, max_size=count)))
    positions = rows["positions"].copy()
    positions[draw(st.lists(st.integers(0, count - 1), max_size=3))] = np.nan
    rows["positions"] = positions * np.float32(draw(st.sampled_from([1, 100])))
    return rows.take(draw(st.lists(st.integers(0, count - 1), min_size=1, max_size=40))).log()


@quick
@given(log=messy_logs())
def test_cleaning_twice_is_cleaning_once(log: StudyLog) -> None:
    once, _, _ = cleaned(log)
    twice, cleaner, pairing = cleaned(once)
    assert examples.same(once, twice)
    changes = {step: rows for step, rows in cleaner.counts.items() if STEPS[step] or "cm to m" in step or "8" in step}
    assert set(changes.values()) == {0}
    assert (pairing.repeated, pairing.singletons) == (0, 0)


@quick
@given(log=messy_logs(), blocks=st.integers(1, 6))
def test_blocks_change_nothing(log: StudyLog, blocks: int) -> None:
    whole, cleaner, pairing = cleaned(log)
    if cleaner.in_cm is not None and not np.isnan(log.positions).all(axis=(1, 2)).any():
        pieces, others, paired = cleaned(log, blocks)
        order, again = (np.lexsort([r.tracker_time_ms, r.person_id, r.study_id]) for r in (whole, pieces))
        assert np.array_equal(np.sort(whole.tracker_time_ms[order]), np.sort(pieces.tracker_time_ms[again]))
        assert cleaner.counts == others.counts
        assert (pairing.repeated, pairing.singletons) == (paired.repeated, paired.singletons)


@quick
@given(log=messy_logs())
def test_what_cleaning_keeps_is_unchanged_but_for_scenario_and_unit(log: StudyLog) -> None:
    cleaner = RowCleaner()
    rows = cleaner.clean(log)
    kept = np.flatnonzero((log.scenario_id != -9999) & ~np.isnan(log.positions).all(axis=(1, 2)))
    wanted = only(log, kept)
    positions = wanted.positions / np.float32(100 if cleaner.in_cm else 1)
    after = np.logical_or.accumulate(log.scenario_id == 8)[kept]
    study = np.isin(wanted.kinect_id, [examples.FRONT, examples.SIDE])
    tasks = np.where(after & (wanted.scenario_id == 4) & study, 8, wanted.scenario_id)
    assert examples.same(rows, changed(wanted, scenario_id=tasks, positions=positions))


def test_another_programs_four_after_eight_is_a_four(tmp_path: Path) -> None:
    log = log_of(frames=12)
    tasks = np.repeat([8, 4], 12)
    ours = changed(log, scenario_id=tasks, kinect_id=np.where(log.kinect_id == examples.FRONT, "front", "side"))
    for given_log, wanted in (
        (changed(log, scenario_id=tasks), ["around-second"]),
        (ours, ["around-first", "around-second"]),
    ):
        found = analyze_file(written(tmp_path, given_log, f"{len(wanted)}.csv"))
        assert [one.key.task for one in found.summaries] == wanted


def test_each_scenario_begins_at_zero(tmp_path: Path) -> None:
    rows = examples.Rows(frames=6)
    rows["scenario_id"] = np.repeat([2, 3], 6)
    rows["tracker_time_ms"] = examples.NOON_MS + np.repeat([0, 500, 900, 5_000, 5_050, 5_950], 2)
    found = {one.key.task: one.timeline_counts[:, 0] for one in analyze_file(written(tmp_path, rows.log())).summaries}
    assert np.flatnonzero(found["steps"]).tolist() == [0, 5, 9]
    assert np.flatnonzero(found["walk"]).tolist() == [0, 9]


def test_late_rows_are_counted_and_paired(tmp_path: Path) -> None:
    log = log_of(frames=12)
    order = np.arange(24)
    order[[2, 3, 4, 5]] = [4, 5, 2, 3]
    found, in_order = (
        analyze_file(written(tmp_path, only(log, rows), f"{rows[4]}.csv")) for rows in (order, np.arange(24))
    )
    assert steps_of(found) == {"rows out of the order of time put in order": 2}
    assert figures(found) == figures(in_order)


# Pairs


@quick
@given(log=messy_logs())
def test_two_sensors_give_the_thesis_pairs(log: StudyLog) -> None:
    alternating = np.where(np.arange(len(log)) % 2, examples.SIDE, examples.FRONT)
    log = changed(log, kinect_id=alternating, study_id=np.full(len(log), 7))
    pairing = RowPairing()
    pairing.add(log)
    found = pairing.end()
    assert found is not None
    wanted = {tuple(sorted(pair)) for pair in log.skeleton_time_ticks[pairs_of(log).rows].tolist()}
    same_sensor = {
        tuple(sorted(log.skeleton_time_ticks[pair].tolist()))
        for pair in pairs_of(log).rows
        if len(set(log.kinect_id[pair])) == 1
    }
    pairs = {tuple(sorted(pair)) for pair in found.rows.skeleton_time_ticks[found.pairs].tolist()}
    assert wanted - same_sensor <= pairs


def test_all_pairs_of_three_sensors_and_a_repeated_row() -> None:
    rows = examples.Rows(frames=2)
    rows["kinect_id"] = np.array(["a", "b", "c", "b"])
    rows["tracker_time_ms"] = np.full(4, examples.NOON_MS)
    pairing = RowPairing()
    assert len(pairing.add(rows.log()).pairs) == 0
    found = pairing.end()
    assert found is not None
    assert {tuple(pair) for pair in found.rows.kinect_id[found.pairs].tolist()} == {("a", "b"), ("a", "c"), ("b", "c")}
    assert (pairing.repeated, pairing.singletons) == (1, 0)


def test_rows_far_apart_in_a_file_are_no_pair() -> None:
    for between, singletons in ((LOOK_ROWS - 1, 0), (LOOK_ROWS, 2)):
        rows = examples.Rows(frames=between // 2 + 2)
        rows["tracker_time_ms"] = np.arange(len(rows["study_id"])) // 2
        log = rows.log()
        others = np.repeat(np.arange(4, len(log)), 1)[:between]
        order = np.array([0, *others, 1])
        pairing = RowPairing()
        pairing.add(only(log, order))
        pairing.end()
        assert pairing.singletons == singletons + len(others) % 2


# Files


@quick
@given(seed=st.integers(0, 9), split=st.integers(1, 5), order=st.permutations(range(6)))
def test_merging_in_pieces_and_other_names_change_nothing_but_the_order(
    tmp_path: Path, seed: int, split: int, order: list[int]
) -> None:
    folder = tmp_path / "study"
    shutil.rmtree(folder, ignore_errors=True)
    log = log_of(frames=36, seed=seed)
    parts = np.array_split(np.arange(36), 6)
    files = [
        written(folder, only(log, np.sort(np.r_[2 * part, 2 * part + 1])), f"{k}.csv") for k, part in enumerate(parts)
    ]
    found = [analyze_file(path) for path in files]
    whole = merge(found)
    pieces = merge([found[k] for k in order])
    assert figures(whole) == figures(pieces)
    assert [one.file for one in pieces.files] == [path.name for path in files]
    assert figures(merge([*found[:split], *found[split:]])) == figures(analyze_file(written(folder, log, "whole.csv")))
    renamed = [folder / f"x{k}.csv" for k in order]
    for path, name in zip(files, renamed, strict=True):
        path.rename(name)
    assert figures(merge(map(analyze_file, renamed))) == figures(whole)


@quick
@given(moved=st.tuples(*[st.integers(-2048, 2048)] * 3))
def test_a_study_somewhere_else_in_space_has_the_same_figures(tmp_path: Path, moved: Any) -> None:
    log = log_of(frames=12)
    log = changed(log, positions=np.rint(log.positions * 1024) / np.float32(1024))
    there = changed(log, positions=log.positions + np.array(moved, dtype=np.float32) / np.float32(1024))
    found = []
    for number, one in enumerate((log, there)):
        path = tmp_path / f"{number}.csv"
        path.unlink(missing_ok=True)
        found.append(figures(analyze_file(written(tmp_path, one, path.name))))
    assert found[0] == found[1]


def test_other_methods_views_are_beside_the_recorded_ones(tmp_path: Path) -> None:
    key = ComparedViews("default", "90", "walk", "7", "front", "side")
    views = AlignedPairs(key, np.zeros((3, 2, 25, 3)), np.zeros(3))

    def fails(path: Path) -> Any:
        raise InputError("no motion in time")

    path = written(tmp_path, log_of(frames=12))
    found = analyze_file(path, views_of_methods=lambda _: [views, views])
    assert {one.key.method: one.pairs for one in found.summaries if one.key.task == "walk"} == {
        "default": 6,
        "stand-still": 4,
    }
    found = analyze_file(path, views_of_methods=fails)
    assert said(found) == [
        ("another method cannot align it: no motion in time", "only the recorded views are analysed", 0)
    ]
    assert len(found.summaries) == 3


def test_only_chosen_participants(tmp_path: Path) -> None:
    log = log_of(frames=12)
    path = written(tmp_path, changed(log, study_id=np.where(np.arange(24) < 12, 7, 8)))
    found = analyze_file(path, participants=["8"])
    assert {one.key.participant for one in found.summaries} == {"8"}
    assert found.rows == 12
    assert said(analyze_file(path, participants=["9"])) == []


def test_a_take_is_compared_with_its_fused_people(tmp_path: Path) -> None:
    found = analyze_file(small_take(tmp_path / "walk.mcap", 3))
    keys = [msgspec.structs.astuple(one.key) for one in found.summaries]
    assert keys == [("stand-still", "90", "walk", "7", sensor, "fused") for sensor in ("front", "side")]
    assert found.origin["method"] == "stand-still"
    assert max(one.worst.max() for one in found.summaries) < 1e-6


def test_a_take_that_was_not_closed_is_analysed_and_named(tmp_path: Path) -> None:
    found = analyze_file(unclosed_take(tmp_path / "walk.mcap", 4))
    assert found.used == found.rows == 16
    (finding,) = found.findings
    assert finding.effect == "the 16 rows before are analysed"


# Bad input: named, counted, and the rest is analysed


def text_of(tmp_path: Path, frames: int = 12) -> str:
    return written(tmp_path / "source", log_of(frames=frames)).read_text()


def cut(data: bytes) -> bytes:
    return data[:-300]


def test_a_log_whose_last_row_is_cut(tmp_path: Path) -> None:
    path = examples.saved(tmp_path, cut(text_of(tmp_path).encode()))
    found = analyze_file(path)
    assert found.used == 22
    assert [(one[1], one[2]) for one in said(found)] == [("these rows are left out", 1)]
    assert said(found)[0][0].startswith("row 25: the row has ")
    assert steps_of(found) == {"rows that cannot be read removed": 1, "rows without a partner removed": 1}


def test_a_compressed_log_that_is_cut(tmp_path: Path) -> None:
    text = text_of(tmp_path, frames=600).encode()
    path = examples.saved(tmp_path, gzip.compress(text)[:-100_000], "log.csv.gz")
    found = analyze_file(path)
    assert 200 < found.used < 1200
    assert said(found) == [
        ("the compressed data end early or are damaged", f"the {found.rows} rows before are analysed", 0)
    ]


def test_rows_that_cannot_be_read_and_too_many_of_them(tmp_path: Path) -> None:
    lines = text_of(tmp_path, frames=120).split("\n")
    for row in (4, 9):
        lines[row] = lines[row].replace(", ", ", x", 3)
    found = analyze_file(examples.saved(tmp_path, "\n".join(lines)))
    assert found.used == 236
    assert said(found) == [
        ("row 5: Kinect_Config: 'x2': is no whole number, and 1 more rows", "these rows are left out", 2)
    ]
    lines[20:] = [line.replace(", ", ", x", 3) for line in lines[20:]]
    found = analyze_file(examples.saved(tmp_path, "\n".join(lines)))
    assert found.used == 14
    assert [one[1] for one in said(found)] == ["these rows are left out", "the 17 rows before are analysed"]


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("a.csv", lambda text: text.split("\n")[0] + "\n", "has a header and no rows"),
        ("a.csv", lambda text: text.replace("Head_X", "Heart_X"), "row 1: 'Heart_X': column 43 is unknown"),
        ("a.csv.gz", lambda text: text, "is not gzip-compressed"),
        ("a.csv", lambda text: text.replace("Tracker_Time", "time"), "is no recording of a study"),
        ("a.mcap", lambda text: text, "is no MCAP file"),
    ],
)
def test_a_file_without_a_usable_row(tmp_path: Path, name: str, content: Callable[[str], str], what: str) -> None:
    found = analyze_file(examples.saved(tmp_path, content(text_of(tmp_path)), name))
    assert said(found) == [(what, "the file is left out", 0)]
    assert (found.rows, found.summaries) == (0, ())


def test_centimetres_are_found_by_the_size_of_the_bodies(tmp_path: Path) -> None:
    log = log_of(frames=12)
    found = analyze_file(written(tmp_path, changed(log, positions=log.positions * 100), "cm.csv"))
    assert said(found) == [("positions are in cm, by the size of the bodies", "converted to m", 24)]
    for a, b in zip(found.summaries, analyze_file(written(tmp_path, log, "m.csv")).summaries, strict=True):
        np.testing.assert_allclose(a.means, b.means, atol=1e-6)


def test_a_participant_without_partners_and_one_who_is_not_named(tmp_path: Path) -> None:
    log = log_of(frames=12)
    several = changed(log, study_id=np.where(np.arange(24) < 8, 7, 8))
    alone = only(several, np.flatnonzero((several.study_id == 7) | (several.skeleton_id == 0)))
    found = analyze_file(written(tmp_path, alone))
    assert {one.key.participant for one in found.summaries} == {"7"}
    assert said(found)[0] == ("has several participants: 7, 8", "each is analysed on their own", 0)
    assert said(found)[1] == ("no row of participant 8, steps, 90 has a partner", "this task is left out", 4)
    unnamed = changed(log, study_id=np.full(24, -9999), kinect_config=np.full(24, -9999))
    found = analyze_file(written(tmp_path, unnamed, "first visit.csv"))
    assert said(found) == [("says no participant", "counted as participant first visit", 0)]
    assert {(one.key.participant, one.key.placement) for one in found.summaries} == {("first visit", NOT_SAID)}


def test_a_missing_condition_and_two_files_for_one(tmp_path: Path) -> None:
    log = log_of(frames=12)
    logs = {
        "a.csv": log,
        "b.csv": log,
        "c.csv": changed(log, kinect_config=np.full(24, 0)),
        "d.csv": changed(log, study_id=np.full(24, 8)),
    }
    found = merge(analyze_file(written(tmp_path, one, name)) for name, one in logs.items())
    tasks = "stationary, steps, walk"
    assert said(found) == [
        (f"participant 7, 90: {tasks} in 2 files: a.csv, b.csv", "merged, as in the thesis: all pairs count alike", 0),
        (f"participant 8 has no {tasks} in placement parallel", "the placement's means are those of the others", 0),
    ]
    (walk,) = [
        one for one in found.summaries if one.key == ComparedViews("stand-still", "90", "walk", "7", "front", "side")
    ]
    assert walk.pairs == 8


def test_recordings_are_found_under_any_name(tmp_path: Path) -> None:
    log = log_of(frames=12)
    for name in ("b/deep/er/log.CSV.gz", "a.csv", ".hidden.csv", ".git/x.csv"):
        folder = (tmp_path / name).parent
        written(folder, log, "new.csv.gz" if name.endswith("gz") else "new.csv").rename(tmp_path / name)
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    (tmp_path / "broken.csv.gz").write_text("no gzip")
    (tmp_path / "notes.txt").write_text("x")
    small_take(tmp_path / "b" / "take.mcap", 2)
    found = find_recordings(tmp_path)
    assert [path.relative_to(tmp_path).as_posix() for path in found.paths] == [
        "a.csv",
        "broken.csv.gz",
        "b/deep/er/log.CSV.gz",
        "b/take.mcap",
    ]
    assert [(one.file, one.what) for one in found.findings] == [("", "1 table is no study log: notes.csv")]
    with pytest.raises(InputError, match="no such folder"):
        find_recordings(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="has no recordings"):
        find_recordings(tmp_path / "empty")


def test_recordings_of_different_joints_are_refused(tmp_path: Path) -> None:
    one = analyze_file(written(tmp_path, log_of(frames=12)))
    with pytest.raises(SettingsError, match="different joints"):
        merge([one, msgspec.structs.replace(one, joints=("Head",))])
