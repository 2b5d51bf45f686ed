"""The commands of ``mocapella export``, which convert a take to files for other programs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer

from mocapella.cli import INTERRUPTED
from mocapella.cli.common import (
    OUT_HELP,
    PLACEMENT_HELP,
    AllPoints,
    Every,
    JsonOut,
    TakeArgument,
    say,
    working,
    write_json,
)

if TYPE_CHECKING:
    from mocapella.model.scene import Scene
    from mocapella.model.session import Setup
    from mocapella.recording.take_reader import Take


def study_log(
    take: TakeArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="New file to write, .csv, .csv.gz or .parquet. By default the take's name with .study-log.csv.",
        ),
    ] = None,
    every: Every = 1,
    reference: Annotated[
        str | None,
        typer.Option(
            metavar="SENSOR", help="Sensor whose camera frame the log uses; by default each person's first view."
        ),
    ] = None,
    participant: Annotated[
        int | None, typer.Option(metavar="NUMBER", help="Study_Id of the log; by default as recorded.")
    ] = None,
    placement: Annotated[
        str | None, typer.Option(metavar="NAME", help=f"{PLACEMENT_HELP} By default as recorded.")
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(metavar="NAME", help="Scenario_Id of the log, such as walk; by default as recorded.")
    ] = None,
    json: JsonOut = None,
) -> None:
    """Write the study log: the thesis' 87 columns, a row for each sensor's view of each person.

    A log is never overwritten. docs/study-log.md describes the columns. `mocapella export csv` writes the fused people.

    Example:  mocapella export study-log walk-1 --every 2
    """
    import os

    from mocapella.cli.recordings import open_take
    from mocapella.errors import TakeExistsError
    from mocapella.live.recordings import find_recording
    from mocapella.recording.study_export import export_study_log
    from mocapella.recording.study_log import write_study_log
    from mocapella.studies.parquet_log import SUFFIX, write_parquet_log

    take = find_recording(take)
    target = out or take.with_suffix(".study-log.csv")
    if os.path.lexists(target):
        raise TakeExistsError(f"{target} exists, and a study log is never overwritten; name another file with --out")
    source = open_take(take)
    given = {"participant": participant, "placement": placement, "scenario": scenario}
    chosen: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
    with working(f"writing {target} …", status=INTERRUPTED):
        write: Any = write_parquet_log if target.suffix.lower() == SUFFIX else write_study_log
        scenes = _timed_scenes(source, chosen)
        report = export_study_log(scenes, target, every=every, reference=reference, write=write)
    say(f"{report.rows} rows of {report.written} results in {target}")
    if report.not_tracking:
        say(f"left out: {report.not_tracking} results with people, as the tracker was still calibrating")
    if report.mirrored:
        say(f"left and right were swapped in {report.mirrored} of them; rows are as the sensor labels them")
    for problem in source.problems:
        say(f"{take.name}: {problem}")
    write_json(json, {"path": str(target), **msgspec.to_builtins(report), "take_problems": list(source.problems)})


def arms(
    take: TakeArgument,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} By default the take's name with .arms.csv."),
    ] = None,
    every: Every = 1,
    all_points: AllPoints = False,
    json: JsonOut = None,
) -> None:
    """Write the arms of a take's results, in the world: a row for each joint of each arm, with its state.

    docs/arms/fusion.md describes the columns. If a take's results contain no arms, `mocapella replay` prints which
    frames could not be used.

    Example:  mocapella export arms grab-1 --out grab-1.csv
    """
    from mocapella.cli.recordings import open_take
    from mocapella.exports.arm_tracks import write_arm_tracks
    from mocapella.live.recordings import find_recording
    from mocapella.recording.take_trajectories import labels_of

    take = find_recording(take)
    source = open_take(take)
    target = out or take.with_suffix(".arms.csv")
    with working(f"writing {target} …", status=INTERRUPTED):
        scenes = ((run.number, scene) for run in source.runs for _, scene in source.scenes(run.number))
        labels = labels_of(source)
        report = write_arm_tracks(scenes, target, every=every, all_points=all_points, labels=labels)
    say(f"{report.rows} rows of {report.with_arms} results with arms in {target}; arms: {report.arms}")
    for problem in source.problems:
        say(f"{take.name}: {problem}")
    write_json(json, {"path": str(target), **msgspec.to_builtins(report), "take_problems": list(source.problems)})


def json_lines(
    take: TakeArgument,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} By default the take's name with .jsonl.")
    ] = None,
    every: Every = 1,
    json: JsonOut = None,
) -> None:
    """Write everything of a take's results: a line of JSON for each, with all fields of its parts, also of a plug-in's.

    Arrays are lists, and null marks unknown values. Parts whose package is not installed are named with their size.

    Example:  mocapella export json walk-1 --out walk-1.jsonl
    """
    from mocapella.cli.recordings import open_take
    from mocapella.exports.scene_lines import write_scene_lines
    from mocapella.live.recordings import find_recording
    from mocapella.recording.take_trajectories import labels_of

    take = find_recording(take)
    source = open_take(take)
    target = out or take.with_suffix(".jsonl")
    with working(f"writing {target} …", status=INTERRUPTED):
        scenes = ((run.number, log_ns, scene) for run in source.runs for log_ns, scene in source.scenes(run.number))
        report = write_scene_lines(scenes, target, every=every, labels=labels_of(source))
    parts = ", ".join(f"{name} {count}" for name, count in report.parts.items()) or "none"
    say(f"{report.written} lines of {report.scenes} results in {target}; parts: {parts}")
    for problem in source.problems:
        say(f"{take.name}: {problem}")
    write_json(json, {"path": str(target), **msgspec.to_builtins(report), "take_problems": list(source.problems)})


def _timed_scenes(take: Take, chosen: dict[str, Any]) -> Iterator[tuple[Setup, Scene, int]]:
    """Yield each scene with its run's setup, and its wall-clock time in milliseconds since year 1, as in the study log.

    Args:
        take: the take.
        chosen: labels for all runs instead of their own.
    """
    import dataclasses

    from mocapella.model.study_log import YEAR_1_TO_1970_MS

    for run in take.runs:
        wall_ns = run.info.started_unix_ns - run.info.started_ns
        setup = dataclasses.replace(run.info.setup, **chosen)
        for log_ns, scene in take.scenes(run.number):
            yield setup, scene, (log_ns + wall_ns) // 1_000_000 + YEAR_1_TO_1970_MS
