"""The commands of ``mocapella take``, which inspect, check, recover and complete takes."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocapella.cli import DAMAGED
from mocapella.cli.app import take_app
from mocapella.cli.common import JsonOut, TakeArgument, say, write_json

if TYPE_CHECKING:
    from mocapella.recording.take import NodeFrames
    from mocapella.recording.take_origin import TakeOrigin
    from mocapella.recording.take_reader import Take


@take_app.command()
def info(take: TakeArgument, json: JsonOut = None) -> None:
    """Print what is in a take: its origin, the stored and missing frames of each sensor, and when there were problems.

    Exit status: 3 if the take is damaged or was not closed, and what can be read was told.

    Example:  mocapella take info walk-1
    """
    from mocapella.recording.take_conditions import condition_intervals

    found = _open(take)
    row = _row(found)
    _say_row(row)
    if origin := _origin(found):
        say(str(origin))
    began_ns = found.runs[0].info.started_ns if found.runs else 0
    intervals = condition_intervals(found.statuses(), began_ns)
    for one in intervals:
        who = f"{one.sensor}: " if one.sensor else ""
        say(f"{who}from {one.from_s:.0f} to {one.to_s:.0f} s: {one.condition}")
    write_json(json, {**row, "conditions": [asdict(one) for one in intervals]})
    if found.damaged:
        raise typer.Exit(DAMAGED)


@take_app.command()
def check(take: TakeArgument, json: JsonOut = None) -> None:
    """Check every byte of a take, and that no frame is missing; exit with status 1 if it is not whole.

    Example:  mocapella take check walk-1
    """
    row = _row(_open(take))
    _say_row(row)
    write_json(json, row)
    if not row["whole"]:
        raise typer.Exit(1)


@take_app.command()
def recover(take: TakeArgument, json: JsonOut = None) -> None:
    """Make one file of an interrupted take, also if its server never came back. A closed take stays unchanged.

    Example:  mocapella take recover walk-1
    """
    from mocapella.live.recordings import find_recording
    from mocapella.recording.merge import merge_parts

    path = find_recording(take)
    merge_parts(path)
    row = _row(_open(path))
    _say_row(row)
    write_json(json, row)


@take_app.command()
def merge(
    take: TakeArgument,
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE…", help="Files of a node's folder spool, or takes that nodes recorded themselves."
        ),
    ],
    json: JsonOut = None,
) -> None:
    """Add frames that a take lacks and other files have. Only frames that belong to the take are added.

    Example:  mocapella take merge walk-1 spool/front-*.mcap
    """
    from mocapella.live.recordings import find_recording
    from mocapella.recording.merge import merge_frames

    path = find_recording(take)
    added = merge_frames(path, [find_recording(file) for file in files])
    for sensor, count in sorted(added.items()):
        say(f"{sensor}: {count} frames added")
    if not added:
        say("no frame added: the files have none that the take lacks")
    row = _row(_open(path))
    _say_row(row)
    write_json(json, {**row, "added": added})


def _open(take: Path) -> Take:
    from mocapella.live.recordings import find_recording
    from mocapella.recording.take_reader import read_take

    return read_take(find_recording(take))


def _row(take: Take) -> dict[str, Any]:
    nodes = take.complete()
    lost = sum(node.lost for node in nodes)
    return {
        "path": str(take.path),
        "parts": len(take.parts),
        "take_id": take.take_id,
        "method": take.runs[0].info.method if take.runs else None,
        "origin": asdict(origin) if (origin := _origin(take)) else None,
        "seconds": round(take.seconds, 3),
        "frames": take.frame_count,
        "scenes": take.scene_count,
        "lost": lost,
        "nodes": [_node_row(node) for node in nodes],
        "interruptions": len(take.interruptions),
        "clean": take.clean,
        "problems": list(take.problems),
        "whole": take.clean and not lost and not take.problems,
    }


def _origin(take: Take) -> TakeOrigin | None:
    return take.runs[0].info.origin if take.runs else None


def _node_row(node: NodeFrames) -> dict[str, Any]:
    return {
        "sensor": node.sensor,
        "node_id": f"{node.node_id:016x}",
        "first": node.first,
        "last": node.last,
        "stored": node.stored,
        "lost": node.lost,
        "missing": [list(gap) for gap in node.missing],
        "end_known": node.end_known,
    }


def _say_row(row: dict[str, Any]) -> None:
    recovered = f", recovered after {row['interruptions']} interruptions" if row["interruptions"] else ""
    state = "whole" if row["whole"] else "not whole"
    say(
        f"{row['path']}: {state}; {row['seconds']:.1f} s, {row['frames']} frames, {row['scenes']} results, "
        f"{row['lost']} frames lost{recovered}"
    )
    for node in row["nodes"]:
        lost = f", {node['lost']} lost" if node["lost"] else ""
        end = "" if node["end_known"] else f", unknown after {node['last']}"
        say(f"{node['sensor']} ({node['node_id']}): {node['stored']} frames stored{lost}{end}")
    for problem in row["problems"]:
        say(problem)
