"""`mocapella export` for tables, arrays and markers, as a user runs it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.programs import run_here
from support.take_making import STEP, info, record, scene, write_frame

import mocapella
from mocapella.exports.export import EXPORTS, TRAJECTORIES
from mocapella.geometry.twists import exp_twist
from mocapella.model.hand import ANGLES, LANDMARKS, hand_model
from mocapella.model.hand_flesh import digits_at_rest
from mocapella.model.scene import Scene, SensorPlace, TrackedHand, TrackedObject
from mocapella.model.session import SCENARIOS
from mocapella.recording.study_log import read_study_log
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_scene

FORMATS = [each.name for each in EXPORTS.values() if each.command == TRAJECTORIES]
T = exp_twist(np.array([0.5, -1.0, 2.0, 0.1, 0.4, -0.2]))


def take(path: Path, people: int = 1, **parts: tuple) -> Path:
    """A take of a second, whose sensor has a pose."""
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    for k in range(30):
        one = scene(k, "front", k, people=people)
        made = Scene(**{name: getattr(one, name) for name in one.__struct_fields__})
        made = msgspec.structs.replace(made.with_parts(**parts), sensors=(SensorPlace("front", T),))
        write_frame(writer, "front", k, k * STEP)
        writer.write_scene(encode_scene(made), k * STEP)
    writer.close()
    return path


def content(path: Path) -> dict[str, bytes]:
    """Bytes of a file, or of each file in a folder."""
    files = path.iterdir() if path.is_dir() else [path]
    return {one.name: one.read_bytes() for one in files}


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_is_written_once(tmp_path: Path, name: str) -> None:
    take(tmp_path / "a.mcap")
    done = run_here(tmp_path, "export", name, "a", "--json", "-")
    assert done.returncode == 0, done.stderr
    (of_take,) = json.loads(done.stdout)
    (row,) = of_take["files"]
    assert (of_take["take"], of_take["take_problems"]) == ("a.mcap", [])
    assert ("notes" in row) == (EXPORTS[name].humanoids or name in {"mot", "sto", "opensim"})
    row.pop("notes", None)
    assert row == {"path": f"a{EXPORTS[name].suffix}", "frames": 30, "individuals": ["person_0"]}
    written = content(tmp_path / row["path"])
    again = run_here(tmp_path, "export", name, "a")
    assert again.returncode == 1
    assert "exists; add --force to replace it" in again.stderr
    assert content(tmp_path / row["path"]) == written
    assert run_here(tmp_path, "export", name, "a", "--force").returncode == 0
    assert {one.name for one in tmp_path.iterdir()} == {"a.mcap", row["path"]}


def test_people_have_a_file_each_where_a_format_is_for_one(tmp_path: Path) -> None:
    take(tmp_path / "a.mcap", people=2)
    assert run_here(tmp_path, "export", "trc", "a").returncode == 0
    assert run_here(tmp_path, "export", "c3d", "a", "--people", "person_1").returncode == 0
    assert {one.name for one in tmp_path.iterdir()} == {
        "a.mcap", "a.person_0.trc", "a.person_1.trc", "a.c3d",
    }  # fmt: skip
    own = mocapella.load(tmp_path / "a.mcap").people
    assert own is not None
    found = mocapella.load(tmp_path / "a.person_1.trc").points
    assert found is not None
    np.testing.assert_allclose(found.positions, own.at_rate().of(["person_1"]).positions, atol=1e-6)
    wrong = run_here(tmp_path, "export", "trc", "a", "--people", "anna")
    assert "--people: a.mcap has no 'anna'; it has person_0, person_1" in wrong.stderr


def test_each_kind_has_a_file_and_a_name_that_a_system_forbids_is_replaced(tmp_path: Path) -> None:
    cup = TrackedObject("cup/of:tea", T, np.empty((0, 3)), 2)
    take(tmp_path / "a.mcap", objects=(cup,))
    assert run_here(tmp_path, "export", "csv", "a").returncode == 0
    assert (tmp_path / "a.people.csv").exists()
    assert "cup/of:tea" in (tmp_path / "a.objects.csv").read_text(encoding="utf-8")
    take(tmp_path / "b.mcap", people=0, objects=(cup, replace_name(cup, "lid")))
    assert run_here(tmp_path, "export", "trc", "b").returncode == 0
    assert (tmp_path / "b.cup-of-tea.trc").exists()


def replace_name(thing: TrackedObject, name: str) -> TrackedObject:
    return msgspec.structs.replace(thing, name=name)


def test_raw_views_rates_and_spaces(tmp_path: Path) -> None:
    take(tmp_path / "a.mcap")
    own = mocapella.load(tmp_path / "a.mcap")
    assert run_here(tmp_path, "export", "npz", "a", "--raw", "--out", "raw.npz").returncode == 0
    with np.load(tmp_path / "raw.npz") as arrays:
        assert arrays["individuals"].tolist() == ["person_0@front"]
    assert run_here(tmp_path, "export", "npz", "a", "--rate", "10", "--out", "slow.npz").returncode == 0
    with np.load(tmp_path / "slow.npz") as arrays:
        assert len(arrays["times_s"]) == 10
    assert run_here(tmp_path, "export", "npz", "a", "--space", "sensor:front", "--out", "s.npz").returncode == 0
    with np.load(tmp_path / "s.npz") as arrays:
        np.testing.assert_array_equal(arrays["positions"], own.seen_from("front")["people"].positions)
    assert run_here(tmp_path, "export", "npz", "a", "--space", "opensim", "--out", "o.npz").returncode == 0
    assert own.people is not None
    with np.load(tmp_path / "o.npz") as arrays:
        x, y, z = np.moveaxis(own.people.positions, -1, 0)
        np.testing.assert_allclose(arrays["positions"], np.stack([-z, y, x], axis=-1), atol=1e-12)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("npz", "a", "--rate", "0"), "rate is 0.0"),
        (("npz", "a", "--space", "mars"), "--space 'mars': known: world, opensim, sensor:NAME"),
        (("npz", "a", "--space", "sensor:"), "known: world, opensim, sensor:NAME"),
        (("npz", "a", "--people", ","), "--people has no name"),
        (("npz", "a", "--out", ".csv"), "--out .csv: name a file or a folder"),
        (("npz", "a", "--out", "gone/folder"), "no folder can be made there"),
        (("npz", "a", "more/a", "--out", "out"), "two takes are called a"),
        (("bvh", "things"), "things.mcap has no results for bvh"),
        (("csv", "a", "--humanoid", "vrm"), "--humanoid: csv has no bones; formats that have: bvh, glb, usd"),
        (("glb", "a", "--humanoid", "robot"), "--humanoid 'robot': known: vrm, unity, mixamo, kinect, smpl"),
        (("npz", "a", "--space", "sensor:back"), "no pose of a sensor 'back'; sensors: front"),
        (("npz", "a", "b", "--out", "c.npz"), "there are 2 takes; name a folder"),
        (("npz", "a", "--out", "gone/c.npz"), "name a file in a folder that exists"),
        (("npz", "gone"), "no such file"),
        (("trc", "empty"), "empty.mcap has no results"),
    ],
)
def test_a_mistake_is_a_line_and_nothing_is_half_written(tmp_path: Path, words: tuple[str, ...], why: str) -> None:
    take(tmp_path / "a.mcap")
    take(tmp_path / "b.mcap")
    (tmp_path / "more").mkdir()
    take(tmp_path / "more" / "a.mcap")
    take(tmp_path / "things.mcap", people=0, objects=(TrackedObject("cup", T, np.empty((0, 3)), 2),))
    TakeWriter.create(tmp_path / "empty.mcap", info=info(), reserve_bytes=0).close()
    there = sorted(tmp_path.rglob("*"))
    done = run_here(tmp_path, "export", *words)
    assert done.returncode == 1
    assert why in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(tmp_path.rglob("*")) == there


def test_formats_of_opensim_have_its_axes_unless_others_are_chosen(tmp_path: Path) -> None:
    take(tmp_path / "a.mcap")

    def position(*words: str) -> list[float]:
        assert run_here(tmp_path, "export", "mot", "a", "--force", *words).returncode == 0
        head, first = (tmp_path / "a.mot").read_text(encoding="utf-8").partition("endheader\n")[2].splitlines()[:2]
        cells = dict(zip(head.split("\t"), map(float, first.split("\t")), strict=True))
        return [cells[f"pelvis_t{axis}"] for axis in "xyz"]

    x, y, z = position("--space", "world")
    np.testing.assert_allclose(position(), [-z, y, x], atol=1e-6)
    assert run_here(tmp_path, "export", "npz", "a", "--space", "").returncode == 1


def hand(number: int, angles: np.ndarray) -> TrackedHand:
    landmarks = np.random.default_rng(number).normal(size=(len(LANDMARKS), 3))
    states, sd = np.full(len(LANDMARKS), 2, np.uint8), np.full(len(LANDMARKS), 0.01, np.float32)
    return TrackedHand(number, True, landmarks, states, sd, angles, T)


def test_somebody_without_a_file_does_not_stop_the_others(tmp_path: Path) -> None:
    """A hand whose angles are unknown has no STO."""
    unknown, known = np.full(len(ANGLES), np.nan), np.full(len(ANGLES), 0.5)
    take(tmp_path / "a.mcap", people=0, hands=(hand(1, unknown), hand(2, known)))
    done = run_here(tmp_path, "export", "sto", "a", "--json", "-")
    assert done.returncode == 1
    (of_take,) = json.loads(done.stdout)
    assert [row["path"] for row in of_take["files"]] == ["a.hand_2_left.sto"]
    assert of_take["take_problems"] == ["hand_1_left has no known joint angle in any frame"]
    assert "a.mcap: hand_1_left has no known joint angle in any frame" in done.stderr
    assert {one.name for one in tmp_path.iterdir()} == {"a.mcap", "a.hand_2_left.sto"}


def test_several_takes_go_to_a_folder_that_is_made(tmp_path: Path) -> None:
    take(tmp_path / "a.mcap")
    take(tmp_path / "b.mcap")
    assert run_here(tmp_path, "export", "csv", "a", "b", "--out", "out").returncode == 0
    assert {one.name for one in (tmp_path / "out").iterdir()} == {"a.csv", "b.csv"}


def test_a_take_that_cannot_be_exported_does_not_stop_the_others(tmp_path: Path) -> None:
    TakeWriter.create(tmp_path / "empty.mcap", info=info(), reserve_bytes=0).close()
    take(tmp_path / "a.mcap")
    done = run_here(tmp_path, "export", "csv", "empty", "a", "--json", "-")
    assert done.returncode == 1
    assert "empty.mcap has no results" in done.stderr
    assert (tmp_path / "a.csv").exists()
    assert [len(row["files"]) for row in json.loads(done.stdout)] == [0, 1]


def test_one_damaged_take_of_several_is_told_by_the_status(tmp_path: Path) -> None:
    take(tmp_path / "a.mcap")
    writer = TakeWriter.create(tmp_path / "open.mcap", info=info(), reserve_bytes=0)
    record(writer, 0, 8)
    writer.flush()
    (tmp_path / "torn.mcap").write_bytes((tmp_path / "open.mcap").read_bytes())
    writer.close()
    for words in (("torn", "a"), ("a", "torn")):
        assert run_here(tmp_path, "export", "csv", *words, "--force").returncode == 3


def test_two_individuals_never_share_a_file(tmp_path: Path) -> None:
    things = tuple(TrackedObject(name, T, np.empty((0, 3)), 2) for name in ("cup:1", "cup?1", "CUP/1"))
    take(tmp_path / "a.mcap", people=0, objects=things)
    assert run_here(tmp_path, "export", "trc", "a").returncode == 0
    assert {one.name for one in tmp_path.glob("*.trc")} == {"a.CUP-1.trc", "a.cup-1 (2).trc", "a.cup-1 (3).trc"}


def test_names_and_endings_are_taken_as_they_are_meant(tmp_path: Path) -> None:
    take(tmp_path / "a.mcap", people=2)
    done = run_here(tmp_path, "export", "csv-wide", "a", "--people", " person_1, person_1 ,", "--out", "x.csv")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "x.wide.csv").exists()
    head = (tmp_path / "x.wide.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "person_0" not in head
    assert head.count("person_1.Head.x_m") == 1
    assert run_here(tmp_path, "export", "npz", "a", "--space", " opensim ", "--out", "o.npz").returncode == 0
    own = mocapella.load(tmp_path / "a.mcap").people
    assert own is not None
    with np.load(tmp_path / "o.npz") as arrays:
        np.testing.assert_allclose(arrays["positions"][..., 0], -own.positions[..., 2])


def test_labels_of_each_run_reach_the_table(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    record(writer, 0, 4)
    second = info(started_ns=10 * STEP)
    writer.start_run(replace(second, setup=replace(second.setup, scenario="steps", participant=8)))
    record(writer, 10, 4, step=20)
    writer.close()
    assert run_here(tmp_path, "export", "csv", "a").returncode == 0
    lines = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()[1:]
    cells = {tuple(line.split(",")[1:5]) for line in lines}
    assert cells == {("0", "7", "right-90", "walk"), ("1", "8", "right-90", "steps")}
    assert run_here(tmp_path, "export", "study-log", "a").returncode == 0
    log = read_study_log(tmp_path / "a.study-log.csv")
    assert set(zip(log.study_id.tolist(), log.scenario_id.tolist(), strict=True)) == {
        (7, SCENARIOS["walk"]), (8, SCENARIOS["steps"]),
    }  # fmt: skip


def test_help_describes_the_format(tmp_path: Path) -> None:
    text = run_here(tmp_path, "export", "parquet", "--help").stdout
    assert "The table of csv as Parquet" in text
    assert "mocapella export parquet walk-1 --people person_0" in text


def test_an_animated_skeleton_has_the_bones_of_a_humanoid(tmp_path: Path) -> None:
    take(tmp_path / "a.mcap")
    for name, humanoid in (("glb", "unity"), ("usd", "unity"), ("bvh", "unity")):
        done = run_here(tmp_path, "export", name, "a", "--humanoid", humanoid)
        assert done.returncode == 0, done.stderr
        assert "observed twists, share of frames" in done.stderr
        assert b"LeftUpperArm" in (tmp_path / f"a{EXPORTS[name].suffix}").read_bytes()
    assert run_here(tmp_path, "export", "glb", "a", "--force").returncode == 0
    assert b"leftUpperArm" in (tmp_path / "a.glb").read_bytes()


@pytest.mark.slow
def test_a_person_has_the_fingers_of_the_hand_at_the_wrist(tmp_path: Path) -> None:
    take(tmp_path / "a.mcap")
    own = mocapella.load(tmp_path / "a.mcap").people
    assert own is not None
    wrist = own.positions[0, 0, own.keypoints.index("WristLeft")]
    shape = hand_model("full").shape("left")
    places = wrist + np.vstack([np.zeros(3), digits_at_rest(hand_model("full"), shape)[1]])
    hand = TrackedHand(
        1, True, places, np.full(21, 2, np.uint8), np.full(21, 0.01, np.float32), np.zeros(21), np.eye(4)
    )
    take(tmp_path / "b.mcap", hands=(hand,))
    assert run_here(tmp_path, "export", "glb", "b").returncode == 0
    assert {one.name for one in tmp_path.iterdir()} == {"a.mcap", "b.mcap", "b.people.glb", "b.hands.glb"}
    assert b"leftIndexProximal" in (tmp_path / "b.people.glb").read_bytes()
    assert b"rightIndexProximal" not in (tmp_path / "b.people.glb").read_bytes()


def test_a_damaged_take_is_named_once_in_each_line(tmp_path: Path) -> None:
    data = take(tmp_path / "a.mcap").read_bytes()
    (tmp_path / "torn.mcap").write_bytes(data[: len(data) * 2 // 3])
    (tmp_path / "none.mcap").write_bytes(data[:2000])
    done = run_here(tmp_path, "export", "csv", "a", "torn", "none", "--out", ".")
    lines = [line for line in done.stderr.splitlines() if line.startswith(("torn.mcap", "none.mcap"))]
    assert {line.split(".mcap")[0] for line in lines} == {"torn", "none"}
    for line in lines:
        words = line.split("`", maxsplit=1)[0]
        assert words.count("torn.mcap") + words.count("none.mcap") == 1, line


def test_a_line_break_in_a_files_name_is_shown_as_an_escape(tmp_path: Path) -> None:
    take(tmp_path / "a.mcap")
    for words in ((), ("--force",), ()):
        done = run_here(tmp_path, "export", "bvh", "a", "--out", "b\nc.bvh", *words)
        assert "b\\nc.bvh" in done.stderr
        assert "b\nc.bvh" not in done.stderr
    assert (tmp_path / "b\nc.bvh").exists()
    done = run_here(tmp_path, "export", "csv", "a", "--out", "x\ny/z.csv")
    assert len(done.stderr.strip().splitlines()) == 1
