"""``mocapella record``: record a take on a running server."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated

import typer

from mocapella.cli.app import RECORDINGS, app
from mocapella.cli.common import (
    DEFAULT_ADDRESS,
    Connect,
    JsonOut,
    Seconds,
    console,
    exit_by,
    recording_row,
    say,
    write_json,
)
from mocapella.errors import RecordingError, SettingsError

if TYPE_CHECKING:
    import threading

    import zenoh

    from mocapella.model.session import RecordingHealth

PROGRAM = "mocapella record"
_CLOSING_S = 150.0
"""Longest time for which the end of a take may wait for missed frames and for the disk [s]."""


@app.command(rich_help_panel=RECORDINGS)
def record(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="Name of the take; the server adds .mcap and keeps it in its folder."),
    ] = None,
    stop: Annotated[
        bool, typer.Option("--stop", help="End the take that is being recorded, whoever began it.")
    ] = False,
    connect: Connect = DEFAULT_ADDRESS,
    seconds: Seconds = None,
    json: JsonOut = None,
) -> None:
    """Have a running server record a take, until Ctrl-C; or end one with --stop.

    The server writes it, so nothing is lost between the two. If this command is killed the take goes on, and --stop
    ends it.

    Example:  mocapella record walk-1 --seconds 30
    """
    from mocapella.live.signals import stop_on_signals
    from mocapella.wire.session import open_reader

    if stop == (name is not None) or (stop and seconds is not None):
        raise SettingsError("name a take to record, such as `mocapella record walk-1`, or give --stop alone to end one")
    session = open_reader(connect)
    try:
        with stop_on_signals() as interrupted:
            ended = None if name is None else _record(session, name, seconds, interrupted)
            row = recording_row(ended or _end(session))
            write_json(json, row)
    finally:
        session.close()  # type: ignore[no-untyped-call]
    exit_by(row)


def _record(
    session: zenoh.Session, name: str, seconds: float | None, interrupted: threading.Event
) -> RecordingHealth | None:
    """Start the take and show its progress until its end; return its health if another program ended it."""
    from mocapella.wire.reader import send_command

    began = send_command(session, "record", {"name": name}, program=PROGRAM)
    if not began.ok:
        raise RecordingError(began.message)
    say(f"{began.message} (Ctrl-C ends)")
    deadline = None if seconds is None else time.monotonic() + seconds
    with console.status("") as line:
        while not interrupted.wait(0.25) and (deadline is None or time.monotonic() < deadline):
            status = send_command(session, "status").status
            if status is None:
                raise RecordingError("the server's answer has no status; is it of another version?")
            take = status.recording
            if not take.active:
                if take.problem:
                    raise RecordingError(take.problem)
                say(f"the take was ended by another program: {take.frames} frames in {take.path}")
                return take
            line.update(f"{take.seconds:.0f} s, {take.frames} frames, {take.size_bytes / 1e6:.1f} MB")
    return None


def _end(session: zenoh.Session) -> RecordingHealth:
    from mocapella.wire.reader import send_command

    ended = send_command(session, "record-stop", timeout=_CLOSING_S, program=PROGRAM)
    if not ended.ok or ended.status is None:
        raise RecordingError(ended.message)
    say(ended.message)
    return ended.status.recording
