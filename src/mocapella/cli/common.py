"""What several verbs share: options, addresses, and how results are printed."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.model.session import RecordingHealth

DEFAULT_PORT = 7447
DEFAULT_VIEW_PORT = 7448
DEFAULT_ADDRESS = f"tcp/127.0.0.1:{DEFAULT_PORT}"

console = Console(stderr=True, highlight=False)
"""Everything for people goes to standard error, so that standard output is a program's."""

Connect = Annotated[str, typer.Option("--connect", help="Address of the server.", show_default=True)]
JsonOut = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the result as JSON to FILE; - is standard output."),
]

MethodSettings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="A setting of the method, such as frames=60; may be repeated."),
]


def method_settings(pairs: list[str] | None) -> dict[str, Any]:
    """``["frames=60", "compare_with=first"]`` as a mapping; the method itself checks names and ranges.

    Raises:
        SettingsError: one is not of the form NAME=VALUE, or is a number that a take could not keep.
    """
    found: dict[str, Any] = {}
    for pair in pairs or []:
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise SettingsError(f"--set {pair!r} cannot be used; write it as NAME=VALUE, such as frames=60")
        try:
            found[name] = json.loads(text, parse_float=_finite, parse_constant=_finite)
        except json.JSONDecodeError:
            found[name] = text
    return found


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise SettingsError(f"--set: {text} cannot be kept in a take; leave the setting out where it has no limit")
    return value


def warn_if_open(what: str, host: str, port: int) -> None:
    """Say in words that other machines can reach it, where they can."""
    from mocapella.wire.session import is_loopback

    if not is_loopback(f"tcp/{host}:{port}"):
        say(f"WARNING: {what} open to everybody who can reach {host}:{port}")


def recording_row(take: RecordingHealth) -> dict[str, Any] | None:
    """How a take ended, as ``--json`` prints it; None where nothing was recorded."""
    if not take.path:
        return None
    return {
        "path": take.path,
        "frames": take.frames,
        "scenes": take.scenes,
        "lost": take.lost,
        "size_bytes": take.size_bytes,
        "seconds": take.seconds,
        "problem": take.problem,
    }


def exit_by(recording: dict[str, Any] | None) -> None:
    """Exit with status 1 where a `recording_row` has a problem."""
    if recording is not None and recording["problem"]:
        raise typer.Exit(1)


def say(text: str) -> None:
    """A line for a person; names that come from elsewhere cannot make markup."""
    console.print(text, markup=False)


def write_json(target: str | None, value: Any) -> None:
    """Write the result where ``--json`` says, if it says."""
    if target is None:
        return
    text = json.dumps(value, indent=2, ensure_ascii=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    try:
        Path(target).write_text(text, encoding="utf-8")
    except OSError as error:
        raise SettingsError(f"--json {target}: {error.strerror}; name a file in a folder that exists") from error
