"""The commands of the command line and their options."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

from typer.main import get_command

from mocapella.cli import import_commands
from mocapella.cli.app import app

__all__ = ["child", "command_at", "commands_below", "import_commands", "root", "visible_options"]
import_commands()


@cache
def root() -> Any:
    """The whole command line."""
    return get_command(app)


def child(group: Any, name: str) -> Any:
    """A group's command, also of a group whose commands packages register."""
    return group.commands[name] if name in group.commands else group.verb(name)


def command_at(root: Any, path: str) -> Any:
    """The command or group of that path."""
    for name in path.split():
        root = child(root, name)
    return root


def commands_below(group: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every command below a group, with its path."""
    for name in group.list_commands(None):
        one = child(group, name)
        whole = f"{path} {name}".strip()
        if hasattr(one, "list_commands"):
            yield from commands_below(one, whole)
        else:
            yield whole, one


def visible_options(command: Any) -> list[Any]:
    """The options that a command's help shows, without ``--help``."""
    return [one for one in command.params if one.param_type_name == "option" and not one.hidden]
