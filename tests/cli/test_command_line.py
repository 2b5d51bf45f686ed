"""The shape of the command line: how many commands and options it has, and one meaning for each option."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import typer
from support.commands import command_at, commands_below, root, visible_options
from typer.main import get_command

from mocapella.cli.command_settings import rows_of_keys
from mocapella.cli.common import method_setting_names
from mocapella.cli.serve import ServeKeys
from mocapella.detectors import DETECTORS
from mocapella.tracker.method import METHODS

MOST_COMMANDS = 16
MOST_OPTIONS = 12
DEFAULTS_DIFFER = {
    "--listen": "each protocol has its own port",
    "--name": "a node that has only one sensor names it",
    "--seeds": "each evaluation keeps the seeds that its document quotes",
    "--methods": "as --seeds",
    "--bodies": "as --seeds",
    "--detector": "arms have another default detector than keypoints, which a camera of images has not",
    "--space": "a node names its space; an alignment takes the only one; an export is in the world",
    "--sensor": "a simulated node has a first sensor; a plan has the kind of its room's file",
    "--sensors": "a server waits for one or more; a plan has the number of its room's file",
    "--rate": "a source has a rate; an export has the results' own times",
}
"""Options with more than one default, each with the reason."""
HELP_DIFFERS = {
    "--detector": "of arms in depth images, or of keypoints in colour images",
    "--folds": "one of the two keeps the models",
    "--out": "a study log is never overwritten",
    "--rate": "of images that arrive, or of results that are interpolated",
    "--sensor": "one of a scene or recording, or the kind that a plan places",
    "--sensors": "how many a server waits for, or a plan places",
    "--space": "another tracker's coordinates, or those of an export",
}
"""Options with more than one meaning, each with the reason."""


def every_command() -> dict[str, Any]:
    return dict(commands_below(root()))


def first_sentence(text: str) -> str:
    return text.split(". ", maxsplit=1)[0].rstrip(".")


def test_a_new_user_sees_few_commands() -> None:
    line = root()
    shown = [name for name in line.list_commands(None) if not line.get_command(None, name).hidden]
    assert len(shown) <= MOST_COMMANDS, shown


def test_no_command_has_many_options() -> None:
    """Counted are the options in ``--help`` without ``--help`` itself; ``--view/--no-view`` is one."""
    counts = {name: len(visible_options(command)) for name, command in every_command().items()}
    assert max(counts.values()) <= MOST_OPTIONS, {name: n for name, n in counts.items() if n > MOST_OPTIONS}


def test_a_thirteenth_option_would_be_noticed() -> None:
    one = typer.Typer(add_completion=False)

    def command(a: int = 0, b: int = typer.Option(0, hidden=True)) -> None: ...

    one.command()(command)
    assert [option.name for option in visible_options(get_command(one))] == ["a"]


def meanings() -> dict[str, dict[str, set[Any]]]:
    """For each option the names, metavars, defaults and first help sentences that it has in any command."""
    found: dict[str, dict[str, set[Any]]] = {}
    for command in every_command().values():
        for option in visible_options(command):
            seen = found.setdefault(
                option.opts[0], {"names": set(), "metavars": set(), "defaults": set(), "help": set()}
            )
            seen["names"].add((*option.opts, *option.secondary_opts))
            seen["metavars"].add(option.metavar)
            if not option.required:
                seen["defaults"].add(repr(option.default))
            seen["help"].add(first_sentence(option.help))
    return found


@pytest.mark.parametrize(("what", "allowed"), [("names", {}), ("metavars", {}), ("defaults", DEFAULTS_DIFFER),
                                               ("help", HELP_DIFFERS)])  # fmt: skip
def test_an_option_is_the_same_in_every_command(what: str, allowed: dict[str, str]) -> None:
    differing = {option: seen[what] for option, seen in meanings().items() if len(seen[what]) > 1}
    assert set(differing) == set(allowed), differing


def test_every_option_with_a_value_names_its_kind() -> None:
    unnamed = [
        (name, option.name)
        for name, command in every_command().items()
        for option in visible_options(command)
        if not option.is_flag and not option.metavar
    ]
    assert unnamed == []


def test_settings_are_listed_with_unit_default_and_meaning() -> None:
    rows = {row.name: row for row in rows_of_keys(ServeKeys)}
    assert (rows["reserve_gib"].unit, rows["reserve_gib"].default) == ("GiB", "1.0")
    assert all(row.meaning.endswith(".") for row in rows.values())


def test_a_command_that_has_settings_lists_them() -> None:
    with_settings = [
        name for name, command in every_command().items() if any("--set" in o.opts for o in command.params)
    ]
    assert {"serve", "demo", "replay", "track silhouettes", "node markers", "calibrate hand"} <= set(with_settings)
    for name in with_settings:
        options = {opt for option in command_at(root(), name).params for opt in option.opts}
        assert "--settings" in options or name == "demo"


def test_no_key_of_serve_hides_a_setting_of_a_method() -> None:
    own = {field.name for field in dataclasses.fields(ServeKeys)}
    for method in METHODS:
        assert not own & set(method_setting_names(method)), method
    from mocapella.cli.node_arm import ArmNodeKeys

    own = {field.name for field in dataclasses.fields(ArmNodeKeys)}
    for detector in DETECTORS.values():
        assert not own & {field.name for field in dataclasses.fields(detector.settings())}, detector.name
