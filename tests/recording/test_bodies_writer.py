"""Followed bodies written as they come: readable after every frame, whole at the end, and never in the way."""

from __future__ import annotations

import errno
import io
import json

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import DiskFullError, RecordingError
from mocapella.recording import bodies_writer
from mocapella.recording.bodies_file import (
    ALONE,
    FollowedBody,
    FollowedFrame,
    read_followed_body,
    read_followed_people,
)
from mocapella.recording.bodies_writer import BodiesWriter, left_behind

HOW = {"rig": "rig.toml", "cameras": {"c1": {"source": "c1.mp4", "size_px": [64, 48]}}, "rate_hz": 30.0}
SUMMARY = {"frames": 3, "notes": ["ö"]}
BODIES = {
    "anna": FollowedBody("female", [], 1.7, {"thigh": 0.4}),
    "bén/2": FollowedBody("male", [], None, {}),
}
NAMES = (*BODIES,)


def row(k, what=0.0):
    return FollowedFrame(
        k, k / 30, (what, 0.0, 0.0, 0.0, 0.0, 0.0), {"left knee flexion": what}, {"left hip": (what, 0.0, 1.0)},
        {"c1": 0.9}, {"c2": 'its "image" is\nblack'}, k % 2 == 0,
    )  # fmt: skip


def alone(path):
    return BodiesWriter(path, {ALONE: BODIES["anna"]}, HOW)


@pytest.fixture(autouse=True, params=[7, 1 << 20])
def piece(request, monkeypatch):
    monkeypatch.setattr(bodies_writer, "PIECE", request.param)


def test_after_every_frame_there_is_a_file_that_is_read_as_any_result(tmp_path):
    out = tmp_path / "out.json"
    with alone(out) as growing:
        assert growing.part == tmp_path / "out.part.json"
        assert json.loads(growing.part.read_text())["frames"] == []
        for k in range(4):
            growing.add({ALONE: row(k, 0.25 * k)})
            found = read_followed_body(growing.part)
            assert found.frames == [row(i, 0.25 * i) for i in range(k + 1)]
            assert (found.model, found.height_m, found.proportions) == ("female", 1.7, {"thigh": 0.4})
        assert not out.exists()
        growing.finish(SUMMARY, {ALONE: {"lost": 2}})
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]
    whole = json.loads(out.read_text())
    assert whole["summary"] == {"lost": 2, **SUMMARY}
    assert {key: whole[key] for key in HOW} == HOW
    assert read_followed_body(out).frames == [row(k, 0.25 * k) for k in range(4)]


def test_of_several_each_frame_has_all_of_them_and_in_the_end_each_has_all_frames(tmp_path):
    out = tmp_path / "out.json"
    with BodiesWriter(out, BODIES, HOW) as growing:
        for k in range(3):
            growing.add({"anna": row(k, 1.0), "bén/2": row(k, 2.0)})
            found = read_followed_people(growing.part)
            assert list(found) == list(NAMES)
            for what, body in enumerate(found.values()):
                assert body.frames == [row(i, what + 1.0) for i in range(k + 1)]
        assert [rows["anna"].frame for rows in growing.rows(FollowedFrame)] == [0, 1, 2]
        growing.finish(SUMMARY, {name: {"lost": k} for k, name in enumerate(NAMES)})
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]
    whole = json.loads(out.read_text())
    assert list(whole["people"]) == list(NAMES)
    assert whole["summary"] == SUMMARY
    assert "rows" not in whole
    for k, (name, one) in enumerate(whole["people"].items()):
        assert (one["format"], one["model"]) == ("mocapella followed body", BODIES[name].model)
        assert one["summary"] == {"lost": k}
        assert msgspec.convert(one["frames"], list[FollowedFrame]) == [row(i, k + 1.0) for i in range(3)]
    assert read_followed_people(out)["anna"].height_m == 1.7


@settings(max_examples=20)
@given(st.lists(st.floats(-1e3, 1e3), max_size=12))
def test_what_goes_elsewhere_is_what_a_file_has(values):
    for bodies in ({ALONE: BODIES["anna"]}, BODIES):
        out = io.StringIO()
        with BodiesWriter(None, bodies, HOW) as growing:
            assert growing.part is None
            for k, value in enumerate(values):
                growing.add({name: row(k, value) for name in bodies})
            assert [one for rows in growing.rows(FollowedFrame) for one in rows.values()] == [
                row(k, value) for k, value in enumerate(values) for _ in bodies
            ]
            growing.finish(SUMMARY, {name: {} for name in bodies})
            growing.copy_to(out)
        whole = json.loads(out.getvalue())
        assert whole["summary"] == SUMMARY
        people = whole.get("people", {ALONE: whole})
        for one in people.values():
            assert [each["angles"]["left knee flexion"] for each in one["frames"]] == values


def test_what_is_there_is_not_touched_before_the_end_and_what_was_killed_not_at_all(tmp_path):
    out = tmp_path / "out.json"
    out.write_text("of last week")
    killed = alone(out)
    killed.add({ALONE: row(0)})
    assert left_behind(out) == [tmp_path / "out.part.json"]
    with alone(out) as growing:
        assert growing.part == tmp_path / "out.part2.json"
        growing.add({ALONE: row(1)})
        assert out.read_text() == "of last week"
        growing.finish(SUMMARY, {ALONE: {}})
    assert [one.frame for one in read_followed_body(out).frames] == [1]
    assert [one.frame for one in read_followed_body(tmp_path / "out.part.json").frames] == [0]
    killed.close()
    assert left_behind(out) == [tmp_path / "out.part.json"]


def test_a_run_that_ends_before_its_end_keeps_its_frames_and_one_without_a_frame_leaves_nothing(tmp_path):
    out = tmp_path / "out.json"
    with alone(out):
        pass
    assert list(tmp_path.iterdir()) == []
    with alone(out) as growing:
        growing.add({ALONE: row(0)})
    assert [path.name for path in tmp_path.iterdir()] == ["out.part.json"]
    assert len(read_followed_body(tmp_path / "out.part.json").frames) == 1


@pytest.mark.parametrize("bodies", [{ALONE: BODIES["anna"]}, BODIES], ids=["one", "several"])
def test_a_full_disk_is_said_and_what_was_before_is_there(tmp_path, bodies):
    class Full:
        """Takes a little, and then nothing more."""

        def __init__(self, file):
            self.file, self.takes = file, 40

        def __getattr__(self, name):
            return getattr(self.file, name)

        def write(self, data):
            if len(data) < 10:  # as much as was there
                return self.file.write(data)
            if not self.takes:
                raise OSError(errno.ENOSPC, "No space left on device")
            taken, self.takes = self.file.write(bytes(data[: self.takes])), 0
            return taken

    with BodiesWriter(tmp_path / "out.json", bodies, HOW) as growing:
        growing.add({name: row(0) for name in bodies})
        growing._file = Full(growing._file)
        with pytest.raises(DiskFullError, match=r"No space left on device; .*out\.part\.json has the 1 frames before"):
            growing.add({name: row(1) for name in bodies})
    assert [len(one.frames) for one in read_followed_people(tmp_path / "out.part.json").values()] == [1] * len(bodies)


def test_where_nothing_can_be_written_it_is_said_at_once(tmp_path):
    with pytest.raises(RecordingError, match="nowhere"):
        alone(tmp_path / "nowhere" / "out.json")
    (tmp_path / "out.part.json").symlink_to(tmp_path / "gone")  # somebody's, though it leads nowhere
    with alone(tmp_path / "out.json") as growing:
        assert growing.part == tmp_path / "out.part2.json"


def test_a_part_file_that_became_shorter_is_an_error_and_no_endless_loop(tmp_path):
    with BodiesWriter(tmp_path / "out.json", BODIES, HOW) as growing:
        growing.add({name: row(0) for name in NAMES})
        growing.part.write_bytes(growing.part.read_bytes()[:-40])
        with pytest.raises(RecordingError, match=r"out\.part\.json became shorter"):
            growing.finish(SUMMARY, dict.fromkeys(NAMES, SUMMARY))
