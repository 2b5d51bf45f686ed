"""``mocapella replay``: track recordings again, with the tracker of a live session."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli import DAMAGED, INTERRUPTED
from mocapella.cli.app import RECORDINGS, app
from mocapella.cli.command_settings import NoKeys, SettingsFile, read_settings, set_option
from mocapella.cli.common import (
    DEFAULT_PORT,
    DEFAULT_VIEW_PORT,
    BusPort,
    JsonOut,
    Placement,
    RecordTo,
    View,
    ViewPort,
    chosen,
    exit_by,
    get_ready,
    method_keys,
    method_option,
    most_of,
    record_file,
    say,
    say_if_never_tracked,
    working,
    write_json,
)
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.cli.recordings import ReplayableRecording
    from mocapella.live.thread_deaths import StopEvent

_NOT_OF_TAKES: Final = "For study logs and CSV files; a take keeps its own."


@app.command(rich_help_panel=RECORDINGS)
def replay(
    context: typer.Context,
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Takes (.mcap), study logs, and one sensor's bodies as CSV (.csv, .csv.gz)."
        ),
    ],
    live: Annotated[
        bool, typer.Option("--live", help="In real time, with the view, through nodes and the bus.")
    ] = False,
    placement: Placement = None,
    method: Annotated[str, method_option(_NOT_OF_TAKES)] = "default",
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(NoKeys, method_keys, _NOT_OF_TAKES)] = None,
    json: JsonOut = None,
    port: BusPort = DEFAULT_PORT,
    view_port: ViewPort = DEFAULT_VIEW_PORT,
    view: View = True,
    record: RecordTo = None,
) -> None:
    """Track a recording again: as fast as possible, or in real time with --live.

    The ports, the view and --record go with --live.

    A take is tracked with the method, the settings and the commands it was recorded with, and its new results are
    compared with the recorded ones, to the bit. `mocapella replay walk-1` finds walk-1.mcap, also in the folder takes.

    Exit status: 1 if results differ; 3 if the take is damaged or was not closed, and what can be read was tracked.

    Example:  mocapella replay walk-1 --json -
    """
    from mocapella.cli.recordings import open_to_track
    from mocapella.live.signals import stop_on_signals

    if record is not None and (not live or len(files) > 1):
        raise SettingsError("--record wants --live and one file; `mocapella record` records a running server")
    take = None if record is None else record_file(record)
    named_method = chosen(context, "method", method)
    _, method_settings = read_settings(NoKeys, settings_file, settings)
    rows: list[dict[str, Any]] = []
    with stop_on_signals() if live else nullcontext() as stop:
        for file in files:
            open_it = partial(open_to_track, file, placement, named_method, method_settings)
            if stop is None:
                row = _replay_fast(file, open_it)
            elif not stop.is_set():
                recording = open_it()
                row = _replay_live(file, recording, stop, port, view_port if view else None, take)
                row["damaged"] = recording.damaged
            else:
                break
            rows.append({"file": str(file), **row})
        write_json(json, rows)
    for row in rows:
        if row.get("differing_scenes") and not row.get("damaged"):
            raise typer.Exit(1)
        exit_by(row.get("recording"))
    if any(row.get("damaged") for row in rows):
        raise typer.Exit(DAMAGED)


def _replay_fast(file: Path, open_it: Callable[[], ReplayableRecording]) -> dict[str, Any]:
    began = time.perf_counter()
    with working(f"reading {file.name} …", status=INTERRUPTED):
        recording = open_it()
    read_s = time.perf_counter() - began
    get_ready(recording.setup.method, status=INTERRUPTED)
    began = time.perf_counter() - read_s
    with working(f"tracking {file.name} …", status=INTERRUPTED):
        replayed = recording.replay(lambda scene: None)
    took = time.perf_counter() - began
    row = {
        "sensors": list(recording.sensors),
        **replayed.summary.as_json(replayed.last),
        "recorded_s": round(replayed.seconds, 3),
        "took_s": round(took, 3),
        "times_real_time": round(replayed.seconds / took, 1),
        **replayed.notes,
    }
    say(
        f"{file.name}: sensors: {len(recording.sensors)}, frames in: {row['frames_in']}, "
        f"{most_of(row)}; "
        f"{replayed.seconds:.1f} s in {took:.2f} s ({row['times_real_time']:.0f} × real time)"
    )
    notes = replayed.notes
    for problem in notes["problems"]:
        say(f"{file.name}: {problem}")
    for why, count in notes["unusable"].items():
        say(f"{file.name}: {count} frames could not be used: {why}")
    for why, count in replayed.summary.errors.items():
        say(f"{file.name}: {count} unexpected errors: {why}")
    say_if_never_tracked(row, f"{file.name}: ")
    if "recorded_scenes" in notes:
        say(f"{file.name}: {_comparison(notes['recorded_scenes'], notes['differing_scenes'])}")
    return row


def _comparison(recorded: int, differing: int) -> str:
    """Return a text that compares a replay's results with the recorded ones."""
    if differing:
        return f"{differing} results differ from the {recorded} of the live run"
    return f"all {recorded} results identical to the live run" if recorded else "no results to compare are in it"


def _replay_live(
    file: Path, recording: ReplayableRecording, stop: StopEvent, port: int, view_port: int | None, take: Path | None
) -> dict[str, Any]:
    from mocapella.cli.live_session import finish, live_session, start_together, wait_while
    from mocapella.live.server import ServerSettings
    from mocapella.wire.address import Address
    from mocapella.wire.session_key import session_name

    settings = ServerSettings(
        listen=str(Address(session_name(), "127.0.0.1", port)),
        setup=recording.setup,
        method_settings=recording.method_settings,
    )
    with live_session(settings, stop, view_port=view_port, track_at_once=True) as session:
        if take is not None:
            say(session.server.record_to(take))
        start_together(
            session,
            [["replay", str(file), "--sensor", name, "--connect", settings.listen] for name in recording.sensors],
        )
        wait_while(session, None, until=session.nodes.all_ended)
        return finish(session.server)
