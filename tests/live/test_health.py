"""The free disk space that the server tells of."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from mocapella.live import health


@pytest.mark.parametrize("below", [".", "takes", "takes/of/today"])
def test_the_free_space_of_a_folder_is_that_of_the_nearest_one_that_exists(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, below: str
) -> None:
    asked, usage = list[Path](), shutil.disk_usage(tmp_path)

    def used(folder: Path) -> Any:
        asked.append(folder)
        return usage

    monkeypatch.setattr(shutil, "disk_usage", used)
    assert health.free_bytes(tmp_path / below) == usage.free
    assert asked == [tmp_path]


def test_the_free_space_of_a_disk_that_does_not_answer_is_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(folder: Path) -> Any:
        raise OSError("the disk is gone")

    monkeypatch.setattr(shutil, "disk_usage", gone)
    assert health.free_bytes(tmp_path) is None
