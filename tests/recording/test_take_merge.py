"""A merged take is compared with what it was made of, entry by entry, before it replaces it."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mocapella.errors import RecordingError
from mocapella.recording import merge, take
from mocapella.recording.take_file import TakeFile


def written(path: Path, *texts: str, closed: bool = True, log_ns: int = 5) -> Path:
    """A file with these notices, and an end if ``closed``."""
    fd = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        file = TakeFile(fd)
        for number, text in enumerate(texts):
            file.add(take.STATUS, text.encode(), log_ns, number)
        if closed:
            file.finish()
        else:
            file.flush(durable=False)
    finally:
        os.close(fd)
    return path


def found(count: int, rows: int = 0) -> Any:
    return SimpleNamespace(counts={"front": count}, rows=[{}] * rows)


def test_a_copy_of_all_parts_in_their_order_is_accepted(tmp_path: Path) -> None:
    parts = [written(tmp_path / "a", "1", "2"), written(tmp_path / "b", closed=False)]
    merge._compare(parts, written(tmp_path / "copy", "1", "2"), None)
    merge._compare(parts, written(tmp_path / "more", "1", "2", "3", "4"), found(1, rows=1))


@pytest.mark.parametrize(
    ("texts", "added", "closed", "said"),
    [
        (("1",), None, True, "is not equal to the parts .*, at /status"),
        (("2", "1"), None, True, "is not equal"),
        (("1", "2", "3"), None, True, "is not equal"),
        (("1", "2", "3", "4"), found(1), True, "is not equal"),
        (("1", "2", "3"), found(1, rows=1), True, "has no end"),
        (("1", "2"), found(1), True, "has no end"),
        (("1", "2"), None, False, "has no end"),
    ],
)
def test_a_copy_that_lacks_or_adds_something_is_refused(
    texts: tuple[str, ...], added: Any, closed: bool, said: str, tmp_path: Path
) -> None:
    part = written(tmp_path / "a", "1", "2")
    copy = written(tmp_path / "copy", *texts, closed=closed)
    with pytest.raises(RecordingError, match=said):
        merge._compare([part], copy, added)


def test_an_entry_at_another_time_is_another(tmp_path: Path) -> None:
    part = written(tmp_path / "a", "1")
    with pytest.raises(RecordingError, match="is not equal"):
        merge._compare([part], written(tmp_path / "copy", "1", log_ns=6), None)
