"""Files that are written whole: their modes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from support import study_examples as examples

from mocapella.model.whole_file import usual_mode, write_whole
from mocapella.recording.study_log import write_study_log

WRITERS: dict[str, Callable[[Path], object]] = {
    "rig.toml": lambda path: write_whole(path, b"x = 1\n"),
    "log.csv": lambda path: write_study_log(path, examples.Rows().log().rows()),
}


@pytest.mark.skipif(os.name == "nt", reason="Windows has no modes of files")
@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o027, 0o640), (0o077, 0o600)])
def test_a_file_has_the_mode_that_its_user_gives_new_files(tmp_path: Path, name: str, umask: int, mode: int) -> None:
    before = os.umask(umask)
    try:
        WRITERS[name](tmp_path / name)
        assert usual_mode() == mode
    finally:
        assert os.umask(before) == umask
    assert (tmp_path / name).stat().st_mode & 0o777 == mode
