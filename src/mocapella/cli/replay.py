"""``mocapella replay``: recordings through the very same tracker."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocapella.cli import app
from mocapella.cli.common import (
    DEFAULT_PORT,
    DEFAULT_VIEW_PORT,
    JsonOut,
    MethodSettings,
    console,
    exit_by,
    method_settings,
    say,
    write_json,
)
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.cli.recordings import Recording


@app.command()
def replay(
    files: Annotated[list[Path], typer.Argument(help="Study logs (.csv, .csv.gz) and takes (.mcap).")],
    live: Annotated[
        bool, typer.Option("--live", help="In real time, with the view, through nodes and the bus.")
    ] = False,
    placement: Annotated[str | None, typer.Option(help="Refuse a study log of another placement.")] = None,
    method: Annotated[str | None, typer.Option(help="Tracking method for study logs; a take has its own.")] = None,
    settings: MethodSettings = None,
    json: JsonOut = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Bus port, with --live.")] = DEFAULT_PORT,
    view_port: Annotated[int, typer.Option(min=1, max=65535, help="View port, with --live.")] = DEFAULT_VIEW_PORT,
    no_view: Annotated[bool, typer.Option("--no-view", help="With --live: no view.")] = False,
    record: Annotated[Path | None, typer.Option(metavar="TAKE", help="With --live: record it.")] = None,
) -> None:
    """Track what was recorded: as fast as it goes, or in real time with --live.

    A take is tracked with the setup and the commands it was recorded with, and its new results are compared with the
    recorded ones, to the bit.

    Example:  mocapella replay walk-1.mcap --json -
    """
    from mocapella.cli.recordings import open_recording

    if record is not None and (not live or len(files) > 1):
        raise SettingsError("--record wants --live and one file; `mocapella record` records a running server")
    rows: list[dict[str, Any]] = []
    for file in files:
        open_it = partial(open_recording, file, placement, method, method_settings(settings))
        if live:
            row = _replay_live(file, open_it(), port, None if no_view else view_port, record)
        else:
            row = _replay_fast(file, open_it)
        rows.append({"file": str(file), **row})
    write_json(json, rows)
    for row in rows:
        if row.get("differing_scenes"):
            raise typer.Exit(1)
        exit_by(row.get("recording"))


def _replay_fast(file: Path, open_it: Callable[[], Recording]) -> dict[str, Any]:
    began = time.perf_counter()
    with console.status(f"tracking {file.name} …"):
        recording = open_it()
        replayed = recording.replay(lambda scene: None)
    took = time.perf_counter() - began
    row = {
        "sensors": list(recording.sensors),
        **replayed.tally.as_json(),
        "recorded_s": round(replayed.seconds, 3),
        "took_s": round(took, 3),
        "times_real_time": round(replayed.seconds / took, 1),
        **replayed.notes,
    }
    say(
        f"{file.name}: {row['frames_in']} frames of {len(recording.sensors)} sensors, {row['most_people']} people, "
        f"{replayed.seconds:.1f} s in {took:.2f} s ({row['times_real_time']:.0f} × real time)"
    )
    for problem in replayed.notes.get("problems", []):
        say(f"{file.name}: {problem}")
    if replayed.notes.get("differing_scenes"):
        say(f"{file.name}: {replayed.notes['differing_scenes']} scenes differ from the recorded ones")
    return row


def _replay_live(
    file: Path, recording: Recording, port: int, view_port: int | None, record: Path | None
) -> dict[str, Any]:
    from mocapella.cli.serve import finish, live_session, start_together, wait_while
    from mocapella.live.server import ServerSettings

    settings = ServerSettings(
        listen=f"tcp/127.0.0.1:{port}", setup=recording.setup, method_settings=recording.method_settings
    )
    with live_session(settings, view_port=view_port) as session:
        if record is not None:
            say(session.server.record_to(record))
        start_together(
            session,
            [["replay", str(file), "--sensor", name, "--connect", settings.listen] for name in recording.sensors],
        )
        wait_while(session, None, until=session.nodes.all_ended)
        return finish(session.server)
