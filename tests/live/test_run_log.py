"""The structured log of a run."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mocapella.live.run_log import KEPT_PIECES, KEPT_RUNS, MOST_BYTES, RunLog, log_folder, log_in_use
from mocapella.supervision import Boundary

LOG = logging.getLogger("mocapella.live.test")


@pytest.fixture
def opened() -> Iterator[Callable[[Path], RunLog]]:
    """Opens a log in a folder; it is closed at the end of the test."""
    logs: list[RunLog] = []

    def open_one(folder: Path) -> RunLog:
        logs.append(RunLog("serve", folder))
        return logs[-1]

    yield open_one
    for log in logs:
        log.close()


def rows(log: RunLog) -> list[dict[str, Any]]:
    log.close()
    return [json.loads(line) for line in log.path.read_text(encoding="utf-8").splitlines()]


def test_every_entry_is_a_line_of_json_that_no_text_can_break(opened: Callable[[Path], RunLog], tmp_path: Path) -> None:
    log = opened(tmp_path / "new" / "logs")
    assert log_in_use() == str(log.path)
    LOG.info("sensor %s\n\x1b[31m", "front")
    Boundary().run("frame", lambda: 1 / 0)
    one, error = rows(log)
    assert (one["level"], one["part"], one["text"]) == ("info", "live.test", r"sensor front\n\x1b[31m")
    assert error["level"] == "error"
    assert error["count"] == 1
    assert error["reason"].startswith("frame: ZeroDivisionError")
    assert error["traceback"].splitlines()[-1] == "ZeroDivisionError: division by zero"
    assert log_in_use() == ""


def test_a_run_without_entries_leaves_no_file(opened: Callable[[Path], RunLog], tmp_path: Path) -> None:
    opened(tmp_path / "logs").close()
    assert not (tmp_path / "logs").exists()


def test_a_log_that_cannot_be_written_stops_nothing(
    opened: Callable[[Path], RunLog], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "logs").write_text("a file where the folder should be")
    log = opened(tmp_path / "logs")
    LOG.warning("half of the disk is left")
    log.close()
    assert capsys.readouterr().err == "half of the disk is left\n"


def test_a_warning_is_one_line_in_the_terminal_unless_it_is_told_there_already(
    opened: Callable[[Path], RunLog], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = opened(tmp_path)
    Boundary().run("frame", lambda: 1 / 0)
    LOG.info("nothing to warn of")
    LOG.warning("a\x1bb", exc_info=ValueError())
    log.close()
    assert capsys.readouterr().err == "a\\x1bb\n"


def test_a_long_log_is_rotated(opened: Callable[[Path], RunLog], tmp_path: Path) -> None:
    log = opened(tmp_path)
    for _ in range(5):
        LOG.error("x", extra={"reason": "y" * (MOST_BYTES // 2)})
    log.close()
    assert len(list(tmp_path.iterdir())) == 1 + KEPT_PIECES
    assert max(path.stat().st_size for path in tmp_path.iterdir()) < MOST_BYTES


def test_the_oldest_logs_are_deleted_and_nothing_else(opened: Callable[[Path], RunLog], tmp_path: Path) -> None:
    for k in range(KEPT_RUNS + 5):
        path = tmp_path / f"serve-{k}.jsonl"
        path.touch()
        os.utime(path, (k, k))
    (tmp_path / "notes.txt").touch()
    log = opened(tmp_path)
    LOG.info("begun")
    log.close()
    left = {path.name for path in tmp_path.iterdir()}
    assert len(left) == KEPT_RUNS + 1
    assert {"notes.txt", log.path.name, f"serve-{KEPT_RUNS + 4}.jsonl"} <= left
    assert "serve-5.jsonl" not in left


def test_the_folder_can_be_chosen(tmp_path: Path) -> None:
    assert log_folder({"MOCAPELLA_LOGS": str(tmp_path)}) == tmp_path
    assert log_folder({}).name == "logs"
