"""Former names of commands and options end with exit status 2 and the present name."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.programs import run_here

from mocapella.cli.moved import CALIBRATIONS, COMMANDS, moved


@pytest.mark.parametrize(("former", "present"), COMMANDS.items())
def test_a_former_command_names_the_present_one(former: str, present: str, tmp_path: Path) -> None:
    done = run_here(tmp_path, *former.split(), "file.mp4")
    assert done.returncode == 2
    assert done.stderr == f"mocapella: `mocapella {former}` is now `mocapella {present}`\n"
    assert run_here(tmp_path, *present.split(), "--help").returncode == 0


def test_the_group_that_took_a_commands_name_is_reached(tmp_path: Path) -> None:
    shown = run_here(tmp_path, "calibrate", "--help")
    assert shown.returncode == 0
    assert all(moved(["calibrate", name]) == "" and name in shown.stdout for name in CALIBRATIONS)
    assert moved(["calibrate"]) == ""


def test_present_commands_pass() -> None:
    assert moved([]) == moved(["--version"]) == moved(["demo", "hands"]) == moved(["node", "arm", "frames"]) == ""
