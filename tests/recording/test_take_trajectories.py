"""Trajectories of takes: the fast way to the people gives what the slow way gives, also for damaged entries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.take_making import KIND, STEP, info, scene, write_frame

from mocapella.model.scene import Person, TrackedObject
from mocapella.model.trajectories import Trajectories
from mocapella.recording import take_reader
from mocapella.recording import take_trajectories as module
from mocapella.recording.take_reader import Take, read_take
from mocapella.recording.take_trajectories import take_trajectories
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_scene

JOINTS = len(KIND)


def person(number: int, seed: int, *, name: str, with_sd: bool) -> Person:
    rng = np.random.default_rng([number, seed])
    states = rng.integers(0, 3, JOINTS).astype(np.uint8)
    positions = np.where(states[:, None] > 0, rng.normal(size=(JOINTS, 3)), np.nan)
    sd = rng.uniform(0.001, 0.1, JOINTS).astype(np.float32) if with_sd else None
    return Person(number, positions, states, (), sd, name)


def make(path: Path, rows: Sequence[Sequence[tuple[int, str, bool]]], runs: int = 1, **parts: Any) -> Take:
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    for run in range(runs):
        if run:
            writer.start_run(info(started_ns=run * 1000 * STEP))
        for k, who in enumerate(rows):
            people = tuple(person(number, k, name=name, with_sd=sd) for number, name, sd in who)
            one = msgspec.structs.replace(scene(k, "front", k), at_ns=(run * 1000 + k) * STEP)
            write_frame(writer, "front", k, k * STEP)
            writer.write_scene(encode_scene(one.with_parts(people=people, **parts)), k * STEP)
    writer.close()
    return read_take(path)


def equal(one: Trajectories, other: Trajectories) -> None:
    for field in fields(Trajectories):
        np.testing.assert_equal(getattr(one, field.name), getattr(other, field.name))


people = st.lists(
    st.lists(st.tuples(st.integers(0, 2), st.sampled_from(["", "anna"]), st.booleans()), max_size=2,
             unique_by=(lambda row: row[0], lambda row: row[1] or row[0])),
    min_size=1, max_size=8,
)  # fmt: skip


@settings(deadline=None, max_examples=40)
@given(rows=people, runs=st.integers(1, 2))
def test_the_fast_way_is_the_slow_way(
    rows: list[list[tuple[int, str, bool]]], runs: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    take = make(tmp_path_factory.mktemp("takes") / "a.mcap", rows, runs)
    slow = take_trajectories(take)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "COMPILED_FROM_SCENES", 0)
        fast = take_trajectories(take)
        assert module._people_alone(take, ("people",)) is not None
    assert fast.keys() == slow.keys()
    for kind, some in fast.items():
        equal(some, slow[kind])


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have short takes decoded in the way of long ones."""
    monkeypatch.setattr(module, "COMPILED_FROM_SCENES", 0)


@pytest.mark.usefixtures("fast")
def test_other_parts_are_not_lost(tmp_path: Path) -> None:
    cup = TrackedObject("cup", np.eye(4), np.empty((0, 3)), 2)
    take = make(tmp_path / "a.mcap", [[(1, "", True)]] * 3, objects=(cup,))
    assert set(take_trajectories(take)) == {"people", "objects"}
    equal(take_trajectories(take, ("people",))["people"], take_trajectories(take)["people"])


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize(
    "names",
    [
        [(1, "anna", True), (2, "anna", False)],
        [(1, "", True), (2, "person_1", True)],
        [(k, "", True) for k in range(9)],
    ],
)
def test_people_of_one_scene_are_kept_apart(tmp_path: Path, names: list[tuple[int, str, bool]]) -> None:
    """Two of one name are told apart in the other way; many are no problem."""
    take = make(tmp_path / "a.mcap", [names] * 3)
    people = take_trajectories(take)["people"]
    assert len(people.individuals) == len(names)
    assert people.present.all()


def test_scenes_far_apart_are_read_without_what_is_between(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take = make(tmp_path / "a.mcap", [[(1, "anna", True)]] * 12, runs=2)
    everything = np.arange(take.scene_count)
    wanted = [data[a : a + n] for _, data, begins, lengths in take.scene_blocks(everything)
              for a, n in zip(begins.tolist(), lengths.tolist(), strict=True)]  # fmt: skip
    assert len(wanted) == 24
    for name, value in (("_GAP_BYTES", 0), ("_BYTES_AT_ONCE", 1)):
        monkeypatch.setattr(take_reader, name, value)
        blocks = list(take.scene_blocks(everything))
        assert [data[a : a + n] for _, data, begins, lengths in blocks
                for a, n in zip(begins.tolist(), lengths.tolist(), strict=True)] == wanted  # fmt: skip
        assert len(blocks) > 12
        assert sum(len(data) for _, data, _, _ in blocks) == sum(map(len, wanted))
    assert list(take.scene_blocks(everything[:0])) == []


@pytest.mark.usefixtures("fast")
def test_a_run_whose_description_is_lost_has_no_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its capture times since 1970 are unknown; the other runs keep theirs."""
    take = make(tmp_path / "a.mcap", [[(1, "anna", True)]] * 4, runs=2)
    second = [run for run in take.runs if run.number == 1]
    monkeypatch.setattr(type(take), "runs", property(lambda _: tuple(second)))
    found = take_trajectories(take)["people"]
    assert (len(found), set(found.runs.tolist())) == (4, {1})
    assert found.began_unix_ns > 1e18


@pytest.mark.usefixtures("fast")
def test_an_unusual_scene_is_read_by_protobuf(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    group = b"\xab\x01\xac\x01"  # an empty group, which no schema of ours has
    for k in range(3):
        one = scene(k, "front", k).with_parts(people=(person(1, k, name="anna", with_sd=True),))
        write_frame(writer, "front", k, k * STEP)
        writer.write_scene(encode_scene(one) + (group if k == 1 else b""), k * STEP)
    writer.close()
    people = take_trajectories(read_take(tmp_path / "a.mcap"))["people"]
    assert (people.individuals, len(people)) == (("anna",), 3)


@pytest.mark.usefixtures("fast")
def test_more_names_than_the_fast_way_can_tell_apart_are_read(tmp_path: Path) -> None:
    take = make(tmp_path / "a.mcap", [[(k, f"name {k}", True)] for k in range(300)])
    assert len(take_trajectories(take)["people"].individuals) == 300


@pytest.mark.parametrize(
    "broken",
    [
        lambda one: msgspec.structs.replace(one, positions=np.full((JOINTS, 3), 1e9)),
        lambda one: msgspec.structs.replace(one, positions=np.zeros((JOINTS - 1, 3))),
        lambda one: msgspec.structs.replace(one, states=np.full(JOINTS, 9, np.uint8)),
        lambda one: msgspec.structs.replace(one, sd=np.full(JOINTS, -1.0, np.float32)),
        lambda one: msgspec.structs.replace(one, sd=np.full(JOINTS, np.inf, np.float32)),
        lambda one: msgspec.structs.replace(one, states=np.full(JOINTS + 1, 2, np.uint8)),
    ],
)
@pytest.mark.usefixtures("fast")
def test_an_invalid_entry_is_left_out_and_named(tmp_path: Path, broken: Any) -> None:
    writer = TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    for k in range(6):
        one = scene(k, "front", k)
        if k == 3:
            bad = broken(person(0, k, name="", with_sd=True))
            one = one.with_parts(people=(bad,))
        write_frame(writer, "front", k, k * STEP)
        writer.write_scene(encode_scene(one), k * STEP)
    writer.close()
    take = read_take(tmp_path / "a.mcap")
    take.skips = True
    found = take_trajectories(take)["people"]
    assert len(found) == 5
    assert any("Person." in problem for problem in take.problems)


def test_labels_are_of_their_run(tmp_path: Path) -> None:
    found = take_trajectories(make(tmp_path / "a.mcap", [[(1, "", True)]] * 2, runs=2))["people"]
    assert found.labels[0] == {"participant": 7, "placement": "right-90", "scenario": "walk", "method": "stand-still"}
    assert set(found.individuals) == {"person_1", "run1_person_1"}
