"""``mocapella record``."""

from __future__ import annotations

from typing import Annotated

import typer

from mocapella.cli import app
from mocapella.cli.common import DEFAULT_ADDRESS, Connect, JsonOut, console, recording_row, say, write_json


@app.command()
def record(
    name: Annotated[str, typer.Argument(help="Name of the take; the server adds .mcap and keeps it in its folder.")],
    connect: Connect = DEFAULT_ADDRESS,
    seconds: Annotated[float | None, typer.Option(min=0, help="End after so long; without it, at Ctrl-C.")] = None,
    json: JsonOut = None,
) -> None:
    """Have a running server record a take, until Ctrl-C.

    The server writes it, so nothing is lost between the two; a take that is being recorded goes on without a view.

    Example:  mocapella record walk-1 --seconds 30
    """
    import time

    from mocapella.errors import RecordingError
    from mocapella.live.stopping import stop_on_signals
    from mocapella.wire.reader import send_command
    from mocapella.wire.session import open_reader

    session = open_reader(connect)
    try:
        with stop_on_signals() as stop, console.status("") as line:
            began = send_command(session, "record", {"name": name})
            if not began.ok:
                raise RecordingError(began.message)
            say(began.message)
            deadline = None if seconds is None else time.monotonic() + seconds
            while not stop.wait(0.25) and (deadline is None or time.monotonic() < deadline):
                status = send_command(session, "status").status
                if status is None or not status.recording.active:
                    raise RecordingError(status.recording.problem if status else "the server said nothing")
                take = status.recording
                line.update(f"{take.seconds:.0f} s, {take.frames} frames, {take.size_bytes / 1e6:.1f} MB")
            ended = send_command(session, "record-stop", timeout=150.0)
    finally:
        session.close()  # type: ignore[no-untyped-call]
    if not ended.ok or ended.status is None:
        raise RecordingError(ended.message)
    say(ended.message)
    write_json(json, recording_row(ended.status.recording))
