"""All files with trajectories, by suffix: takes too, and what else is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.take_making import info, record

from mocapella.errors import InputError
from mocapella.recording.take_reader import Take
from mocapella.recording.take_writer import TakeWriter
from mocapella.recording.trajectory_files import open_trajectories, trajectories_in


def test_a_take_is_found_with_or_without_its_ending(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0)
    record(writer, 0, 5)
    writer.close()
    for name in ("walk", "walk.mcap"):
        path, take = open_trajectories(tmp_path / name)
        assert path == tmp_path / "walk.mcap"
        assert isinstance(take, Take)
        found = trajectories_in(tmp_path / name)
        assert (list(found.found), found.problems, found.damaged) == (["people"], (), False)


def test_a_file_has_one_kind_and_its_notes(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("head (x);head (y);head (z)\n1;2;3\n", encoding="utf-8")
    found = trajectories_in(tmp_path / "a.csv")
    assert list(found.found) == ["points"]
    assert found.problems[0].startswith("has no times")
    assert not found.damaged


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("x", encoding="utf-8")
    with pytest.raises(InputError, match=r"\.mcap, \.trc, \.c3d, \.json, \.bvh, \.csv, \.csv\.gz"):
        open_trajectories(tmp_path / "a.txt")
    with pytest.raises(InputError, match="there is no such file"):
        open_trajectories(tmp_path / "b.txt")
    with pytest.raises(InputError, match=r"b\.mcap"):
        open_trajectories(tmp_path / "b.mcap")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="is a folder; name a file in it"):
        open_trajectories(tmp_path / "folder")


def test_a_study_log_has_no_results(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("Study_Id,Tracker_Time\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match="is a study log, which has no results; make a take of it with"):
        trajectories_in(tmp_path / "log.csv")
