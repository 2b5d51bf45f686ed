"""``mocapella replay``: track recordings again, with the tracker of a live session."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli import DAMAGED, INTERRUPTED
from mocapella.cli.app import RECORDINGS, app
from mocapella.cli.command_settings import KeySpec, SettingsFile, read_settings, set_option
from mocapella.cli.common import (
    DEFAULT_PORT,
    DEFAULT_VIEW_PORT,
    LAYOUT,
    PLACEMENT_HELP,
    RIG_HELP,
    BusPort,
    JsonOut,
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
    from mocapella.live.recorded import ReplayableRecording
    from mocapella.live.thread_deaths import StopEvent
    from mocapella.live.track_again import Changes

_AS_RECORDED: Final = "A take keeps its own without it."


@dataclass(frozen=True)
class TrackAgainKeys:
    """Settings of the command `replay`, for ``--set``."""

    layout: Annotated[Path | None, LAYOUT] = None
    recalibrate: Annotated[bool, KeySpec("Estimate the sensors' poses anew, not from the recorded ones.")] = False


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
    placement: Annotated[
        str | None, typer.Option("--placement", metavar="NAME", help=f"{PLACEMENT_HELP} Of a take: its new label.")
    ] = None,
    method: Annotated[str, method_option(_AS_RECORDED)] = "default",
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} Of a take: in place of its own.")
    ] = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(TrackAgainKeys, method_keys, _AS_RECORDED)] = None,
    json: JsonOut = None,
    port: BusPort = DEFAULT_PORT,
    view_port: ViewPort = DEFAULT_VIEW_PORT,
    view: View = True,
    record: RecordTo = None,
) -> None:
    """Track a recording again: as fast as possible, or in real time with --live.

    The ports and the view go with --live. `mocapella replay walk-1` finds walk-1.mcap, also in the folder takes.

    A take is tracked with the method, the settings and the commands it was recorded with, and its new results are
    compared with the recorded ones, to the bit. With --method, --set, --rig or --placement all its frames are tracked
    otherwise, and with --record the results become a new take; the recorded one is not changed (docs/takes.md).

    Exit status: 1 if results differ; 3 if the take is damaged or was not closed, and what can be read was tracked.

    Example:  mocapella replay walk-1 --json -

    Example:  mocapella replay walk-1 --method stand-still --record walk-1-stand-still
    """
    from mocapella.live.recordings import open_to_track
    from mocapella.live.signals import stop_on_signals

    if record is not None and len(files) > 1:
        raise SettingsError("--record wants one file, which is tracked again; give one")
    take = None if record is None else record_file(record)
    keys, method_settings = read_settings(TrackAgainKeys, settings_file, settings)
    rows: list[dict[str, Any]] = []
    with stop_on_signals() if live else nullcontext() as stop:
        for file in files:
            changes = _changes(file, keys, placement, chosen(context, "method", method), (rig, method_settings))
            open_it = partial(open_to_track, file, changes)
            if stop is None:
                row = _replay_fast(file, open_it, again=bool(changes) or take is not None, take=take)
            elif not stop.is_set():
                recording = open_it()
                row = _replay_live(recording, changes, stop, (port, view_port if view else None), take)
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


def _changes(
    file: Path, keys: TrackAgainKeys, placement: str | None, method: str | None,
    rig_and_settings: tuple[Path | None, dict[str, Any]],
) -> Changes:  # fmt: skip
    """Return what the options change; a rig is read as the setting of the method, which may be the recorded one."""
    from mocapella.cli.serve import load_layout_option
    from mocapella.live.recordings import open_recording
    from mocapella.live.track_again import Changes
    from mocapella.settings import merged
    from mocapella.tracker.method_files import settings_of_files, settings_of_rig_for_recording

    rig, settings = rig_and_settings
    if rig is not None:
        tracked_with = method or open_recording(file, Changes(placement=placement)).setup.method
        settings = merged(settings, settings_of_files(tracked_with, {"rig": rig}))
        settings = settings_of_rig_for_recording(tracked_with, settings)
    layout = None if keys.layout is None else load_layout_option(keys.layout)
    return Changes(method, settings, placement, layout, keys.recalibrate)


def _replay_fast(
    file: Path, open_it: Callable[[], ReplayableRecording], *, again: bool, take: Path | None
) -> dict[str, Any]:
    from mocapella.live.recorded import track_again
    from mocapella.recording.disk import check_can_record

    began = time.perf_counter()
    with working(f"reading {file.name} …", status=INTERRUPTED):
        recording = open_it()
        if take is not None:
            check_can_record(take)
        runs = recording.runs_to_track() if again else []
    read_s = time.perf_counter() - began
    get_ready(recording.setup.method, status=INTERRUPTED)
    began = time.perf_counter() - read_s
    with working(f"tracking {file.name} …", status=INTERRUPTED):
        if again:
            replayed = track_again(recording, runs, lambda run, scene: None, take)
        else:
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
    written = replayed.written
    if written is not None:
        row["recording"] = {
            "path": str(written.path), "frames": sum(written.frames.values()), "scenes": written.scenes,
            "lost": sum(written.lost.values()), "size_bytes": written.size_bytes, "seconds": written.seconds,
            "problem": written.problem,
        }  # fmt: skip
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
    if written is not None:
        say(f"{written.scenes} results of {sum(written.frames.values())} frames in {written.path}")
    elif again and "clean" in notes:
        say(f"{file.name}: nothing was written; --record NAME writes a take")
    return row


def _comparison(recorded: int, differing: int) -> str:
    """Return a text that compares a replay's results with the recorded ones."""
    if differing:
        return f"{differing} results differ from the {recorded} of the live run"
    return f"all {recorded} results identical to the live run" if recorded else "no results to compare are in it"


def _replay_live(
    recording: ReplayableRecording, changes: Changes, stop: StopEvent, ports: tuple[int, int | None], take: Path | None
) -> dict[str, Any]:
    from mocapella.cli.live_session import finish, live_session, start_together, wait_while
    from mocapella.live.server import ServerSettings
    from mocapella.wire.address import Address
    from mocapella.wire.session_key import session_name

    port, view_port = ports
    settings = ServerSettings(
        listen=str(Address(session_name(), "127.0.0.1", port)),
        setup=recording.setup,
        method_settings=recording.method_settings,
        layout=changes.layout,
    )
    with live_session(settings, stop, view_port=view_port, track_at_once=True) as session:
        if take is not None:
            say(session.server.record_to(take))
        start_together(
            session,
            [
                ["replay", str(recording.files[0]), "--sensor", name, "--connect", settings.listen]
                for name in recording.sensors
            ],
        )
        wait_while(session, None, until=session.nodes.all_ended)
        return finish(session.server)
