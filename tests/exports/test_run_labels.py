"""Labels that change during a take reach every format, or the command says which cannot carry them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.programs import run_here
from support.take_making import STEP, info, record

import mocapella
from mocapella.exports.c3d_file import write_c3d
from mocapella.exports.export import EXPORTS
from mocapella.exports.needs import needed
from mocapella.exports.run_labels import in_words, label_changes, label_texts, left_out
from mocapella.exports.trajectory_arrays import as_dataset, write_npz
from mocapella.exports.trajectory_tables import write_csv, write_wide_csv
from mocapella.model.resampling import resampled
from mocapella.model.session import Setup
from mocapella.model.trajectories import LABELS, Trajectories
from mocapella.recording.c3d_file import _parsed
from mocapella.recording.take_writer import TakeWriter

FIRST = {"participant": "7", "placement": "right-90", "scenario": "walk"}
SECOND = {"participant": "", "placement": "", "scenario": "steps"}


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A take of two runs, in the second of which neither participant nor placement is given."""
    path = tmp_path_factory.mktemp("takes") / "walk-1.mcap"
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    record(writer, 0, 10)
    writer.start_run(replace(info(), setup=Setup("stand-still", 2, scenario="steps")))
    record(writer, 10, 20, step=20)
    writer.close()
    return path


@pytest.fixture
def people(take: Path) -> Trajectories:
    found = mocapella.load(take).people
    assert found is not None
    return found


def frames_of(labels: dict[str, str], people: Trajectories) -> list[bool]:
    return [label_texts(people.labels[run]) == labels for run in people.runs.tolist()]


def test_the_take_of_these_tests_has_both_labels(people: Trajectories) -> None:
    assert sum(frames_of(FIRST, people)) == 20
    assert sum(frames_of(SECOND, people)) == 40


def test_tables_have_the_labels_of_every_row(people: Trajectories, tmp_path: Path) -> None:
    for write, name in ((write_csv, "long.csv"), (write_wide_csv, "wide.csv")):
        write(people, tmp_path / name)
        with (tmp_path / name).open(newline="") as file:
            rows = list(csv.DictReader(file))
        for row in rows:
            assert {label: row[label] for label in LABELS} == label_texts(people.labels[int(row["run"])])
        assert {row["scenario"] for row in rows} == {"walk", "steps"}


def test_arrays_have_them_for_each_frame_and_data_sets_for_each_run(people: Trajectories, tmp_path: Path) -> None:
    write_npz(people, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as found:
        columns = [found[name].tolist() for name in LABELS]
    labels = [dict(zip(LABELS, row, strict=True)) for row in zip(*columns, strict=True)]
    assert labels == [label_texts(people.labels[run]) for run in people.runs.tolist()]
    data = as_dataset(people)
    assert json.loads(data.attrs["labels"]) == {"0": FIRST, "1": SECOND}
    data.to_netcdf(tmp_path / "a.nc", engine="scipy")
    with needed("xarray").open_dataset(tmp_path / "a.nc", engine="scipy") as read:
        by_run = json.loads(read.attrs["labels"])
        assert [by_run[str(run)]["scenario"] for run in read.run.values.tolist()] == [one["scenario"] for one in labels]


def test_a_c3d_has_an_event_at_each_change(people: Trajectories, tmp_path: Path) -> None:
    own = resampled(people.of(people.individuals[0]), 30.0)
    write_c3d(own, tmp_path / "a.c3d")
    found = _parameters_of(tmp_path / "a.c3d")
    assert found["EVENT:USED"] == [2]
    assert found["EVENT:DESCRIPTIONS"] == ["participant 7, placement right-90, scenario walk", "scenario steps"]
    minutes = np.array(found["EVENT:TIMES"]).reshape(2, 2)
    np.testing.assert_allclose(minutes @ [60.0, 1.0], [0.0, 20 * STEP / 1e9], atol=0.05)
    again = mocapella.load(tmp_path / "a.c3d").points
    assert again is not None
    np.testing.assert_allclose(again.positions, own.positions, atol=1e-6)
    write_c3d(replace(own, labels={}), tmp_path / "b.c3d")
    assert _parameters_of(tmp_path / "b.c3d")["EVENT:USED"] == [0]


def test_more_labels_than_a_c3d_holds_are_told(take: Path, tmp_path: Path) -> None:
    people = mocapella.load(take).people
    assert people is not None
    own = resampled(people.of(people.individuals[0]), 30.0).at(slice(0, 1))
    many = replace(
        own, times_s=np.arange(300) / 30, runs=np.arange(300),
        labels={k: {"scenario": f"s{k}"} for k in range(300)},
        **{name: np.repeat(getattr(own, name), 300, axis=0) for name in ("positions", "states", "sd")},
    )  # fmt: skip
    assert write_c3d(many, tmp_path / "a.c3d") == ["has the first 255 of 300 labels; a C3D holds no more"]
    assert write_c3d(own, tmp_path / "b.c3d") == []


def _parameters_of(path: Path) -> dict[str, list[object]]:
    from mocapella.recording import c3d_file

    data = path.read_bytes()
    assert _parsed(data) is not None
    at = 512 * (data[0] - 1)
    return c3d_file._parameters(data, at + 4, 84, "<")  # type: ignore[return-value]


def test_a_format_without_a_place_for_them_says_so_in_one_line(take: Path, tmp_path: Path) -> None:
    people = mocapella.load(take).people
    assert people is not None
    line = (
        "the labels change during the take (scenario steps from 0.7 s), which this format cannot tell; csv and c3d do"
    )
    assert left_out(people) == [line]
    assert left_out(replace(people, labels={0: people.labels[0], 1: people.labels[0]})) == []
    for name in ("bvh", "mot", "html", "csv", "npz"):
        done = run_here(tmp_path, "export", name, str(take), "--out", name, "--json", "-")
        assert done.returncode == 0, done.stderr
        (row,) = json.loads(done.stdout)
        notes = [note for file in row["files"] for note in file.get("notes", [])]
        assert (line in notes) == (not EXPORTS[name].with_labels), name
    done = run_here(tmp_path, "export", "trc", str(take), "--out", "c.trc", "--people", people.individuals[0])
    assert done.returncode == 0, done.stderr
    assert line in done.stderr


def test_lines_of_json_have_those_of_their_run(take: Path, tmp_path: Path) -> None:
    assert run_here(tmp_path, "export", "json", str(take), "--out", "a.jsonl").returncode == 0
    rows = [json.loads(line) for line in (tmp_path / "a.jsonl").read_text().splitlines()]
    assert [row["labels"] for row in rows] == [FIRST] * 20 + [SECOND] * 40


@given(st.lists(st.integers(0, 3), min_size=1, max_size=30), st.lists(st.sampled_from("ab"), min_size=4, max_size=4))
def test_between_changes_the_labels_are_those_of_the_last_change(steps: list[int], scenarios: list[str]) -> None:
    runs = np.minimum(np.cumsum(steps), 3)
    shape = (len(runs), 1, 1)
    some = Trajectories(
        "people", np.arange(len(runs)) / 30, runs, ("a",), ("Head",), np.zeros((*shape, 3)),
        np.full(shape, 2, np.uint8), np.zeros(shape, np.float32),
        labels={run: {"scenario": name, "participant": -9999} for run, name in enumerate(scenarios)},
    )  # fmt: skip
    changes = label_changes(some)
    frames = [frame for frame, _ in changes]
    assert frames[0] == 0
    assert frames == sorted(set(frames))
    assert all(one != other for (_, one), (_, other) in pairwise(changes))
    for frame in range(len(runs)):
        last = changes[int(np.searchsorted(frames, frame, side="right")) - 1][1]
        assert last == {"participant": "", "placement": "", "scenario": scenarios[runs[frame]]}
    assert len(left_out(some)) == (len(changes) > 1)
    assert label_changes(some.at(slice(0, 0))) == []


def test_without_labels_there_are_no_words() -> None:
    assert in_words(label_texts({})) == ""
    assert in_words(label_texts({"participant": 3, "method": "default"})) == "participant 3"
