"""Former names of commands and options end with exit status 2 and the present name."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from support.commands import command_at, root
from support.programs import run_here
from typer.testing import CliRunner

from mocapella.cli.app import app
from mocapella.cli.moved import CALIBRATIONS, COMMANDS, OPTIONS, moved

EVERY_OPTION = [(path, option, now) for path, table in OPTIONS.items() for option, now in table.items()]


@pytest.mark.parametrize(("former", "present"), COMMANDS.items())
def test_a_former_command_names_the_present_one(former: str, present: str, tmp_path: Path) -> None:
    done = run_here(tmp_path, *former.split(), "file.mp4")
    assert done.returncode == 2
    assert done.stderr == f"mocapella: `mocapella {former}` is now `mocapella {present}`\n"
    assert command_at(root(), present).name == present.rsplit(maxsplit=1)[-1]


@pytest.mark.parametrize(("path", "option", "now"), EVERY_OPTION)
def test_a_former_option_names_the_present_one(path: str, option: str, now: str, tmp_path: Path) -> None:
    done = run_here(tmp_path, *path.split(), "file.mp4", option, "3")
    former = f"{option} 3" if "{}" in now else option
    assert done.returncode == 2
    assert done.stderr == f"mocapella: `{former}` is now `{now.format(3)}`\n"
    if "{}" in now:
        assert moved([*path.split(), f"{option}=3"]) == moved([*path.split(), option, "3"])
    assert is_there(path, now)
    options = {name for one in command_at(root(), path).params for name in (*one.opts, *one.secondary_opts)}
    assert option not in options


@cache
def keys_of(path: str) -> set[str]:
    """The keys that ``--set help`` lists, without those of the method."""
    listed = CliRunner().invoke(app, [*path.split(), "--set", "help"], env={"COLUMNS": "200"}).output
    return {line.split(" ")[0] for line in listed.split("\n\n")[0].splitlines()[1:]}


def is_there(path: str, now: str) -> bool:
    """Whether the command has the option, and with ``--set`` the key, that a text names."""
    option, _, value = now.partition(" ")
    options = {name for one in command_at(root(), path).params for name in (*one.opts, *one.secondary_opts)}
    if option != "--set":
        return option in options
    return value.partition("=")[0] in keys_of(path)


def test_a_text_that_names_no_option_or_key_is_noticed() -> None:
    assert is_there("serve", "--set reserve_gib={}")
    assert not is_there("serve", "--set reserve_mb={}")
    assert not is_there("serve", "--set frames={}")  # a setting of the method
    assert not is_there("serve", "--interface {}")


def test_a_former_command_with_former_options_names_all() -> None:
    line = ["silhouettes", "a.mp4", "--late", "a=3", "--no-browser"]
    assert moved(line) == (
        "`mocapella silhouettes` is now `mocapella track silhouettes`; `--late a=3` is now `--set late=a=3`; "
        "`--no-browser` is now `--set browser=false`"
    )
    assert moved(["colours", "learn", "a.png", "--gain", "2"]).endswith("`--gain 2` is now `--set gain=2`")
    assert moved(["serve", "--", "--wait"]) == ""


def test_the_group_that_took_a_commands_name_is_reached(tmp_path: Path) -> None:
    shown = run_here(tmp_path, "calibrate", "--help")
    assert shown.returncode == 0
    assert all(moved(["calibrate", name]) == "" and name in shown.stdout for name in CALIBRATIONS)
    assert moved(["calibrate"]) == ""


def test_present_commands_pass() -> None:
    assert moved([]) == moved(["--version"]) == moved(["demo", "hands"]) == moved(["node", "arm", "frames"]) == ""
