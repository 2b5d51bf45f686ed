"""``mocapella lab depth lines``: the line skeleton of whole bodies in recorded depth images."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocapella.cli.app import depth_app
from mocapella.cli.arm import Intrinsics, Rig, Stages, Unit
from mocapella.cli.common import JsonOut, console, need_cameras, say, write_json
from mocapella.cli.pictures import Fps

if TYPE_CHECKING:
    from mocapella.sensing.body_lines import BodyLinesSettings
    from mocapella.sources.depth_files import DepthRecording, RecordedDepth
    from mocapella.sources.depth_options import UnitCheck

_MOST_NAMED = 5


@depth_app.command("lines")
def lines(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="PATH…", help="16-bit PNGs, folders of them, takes, or rendered:room-SCENE/SEED, such as room-walk."
        ),
    ],
    intrinsics: Intrinsics = None,
    unit: Unit = None,
    rig: Rig = None,
    fps: Fps = None,
    near: Annotated[float, typer.Option(metavar="METRES", help="Ignore depth below this distance.")] = 0.8,
    far: Annotated[
        float, typer.Option(metavar="METRES", help="Ignore depth beyond this distance, as of a wall.")
    ] = 4.0,
    keep_floor: Annotated[bool, typer.Option("--keep-floor", help="Do not detect and remove the floor.")] = False,
    stages: Stages = None,
    json: JsonOut = None,
) -> None:
    """Thin whole bodies to lines: head, trunk, arms and legs, each depth image by itself.

    docs/arms/line-skeleton.md describes stages and results.

    Example:  mocapella lab depth lines rendered:room-walk --fps 1 --stages looked --json lines.json
    """
    need_cameras("lab depth lines")
    from mocapella.cli import INTERRUPTED
    from mocapella.cli.depth_recordings import depth_options, depth_recordings
    from mocapella.live.signals import interruptible
    from mocapella.sensing.body_lines import BodyLinesSettings
    from mocapella.settings import check

    check(fps is None or 0 < fps <= 1000, "--fps", fps, "above 0, at most 1000")
    settings = BodyLinesSettings(near_m=near, far_m=far, floor=not keep_floor)
    recordings = depth_recordings(paths, depth_options(intrinsics, unit, rig, fps))
    try:
        with interruptible():
            found = [_looked(recording, settings, stages) for recording in recordings]
    except KeyboardInterrupt:
        say("stopped before the end")
        raise typer.Exit(INTERRUPTED) from None
    write_json(json, {"recordings": found})


def _looked(recording: DepthRecording, settings: BodyLinesSettings, stages: Path | None) -> dict[str, Any]:
    """Return a recording's part of the JSON, and print its summary."""
    from mocapella.sources.depth_options import UnitCheck, complete

    camera, unit_m = complete(recording.state, recording.name), recording.state.unit_m
    assert unit_m is not None  # `complete` guarantees it
    check, rows = UnitCheck(unit_m, recording.name), []
    with console.status(f"{recording.name}: reading …") as status:
        for number, image in enumerate(recording.images()):
            rows.append(_row(image, check, camera, settings, stages, number))
            status.update(f"{recording.name.replace('[', '(')}: image {number + 1} of {recording.count} …")
    seen, reasons = sum(bool(row["bodies"]) for row in rows), Counter(row["reason"] for row in rows if row["reason"])
    say(f"{recording.name}: bodies in {seen} of {len(rows)} images")
    for reason, count in reasons.most_common(_MOST_NAMED):
        say(f"  {count} times: {reason}")
    return {
        "recording": recording.name, "size_px": list(camera.size_px), "lens": camera.lens.tolist(), "unit_m": unit_m,
        "frames": rows,
    }  # fmt: skip


def _row(
    image: RecordedDepth, check: UnitCheck, camera: Any, settings: BodyLinesSettings, stages: Path | None, number: int
) -> dict[str, Any]:
    import numpy as np

    from mocapella.cli.depth_recordings import write_stages
    from mocapella.sensing.body_lines import body_lines, pictures

    row: dict[str, Any] = {"file": image.file, "floor": None, "bodies": [], "reason": image.problem}
    if image.depth is None:
        return row
    check.update(image.depth)
    seen = body_lines(image.depth * np.float32(check.unit_m), camera, settings)
    if stages is not None:
        write_stages(stages, number, image.file, pictures(seen))
    row["floor"] = None if seen.floor is None else seen.floor.round(5).tolist()
    row["bodies"] = [
        {
            "distance_m": round(body.distance_m, 4),
            "lines": [
                {"px": px.tolist(), "m": m.round(4).tolist()}
                for px, m in zip(body.segments_px, body.segments, strict=True)
            ],
            "ends": [
                {"px": px.tolist(), "m": m.round(4).tolist()} for px, m in zip(body.ends_px, body.ends, strict=True)
            ],
        }
        for body in seen.bodies
    ]
    row["reason"] = seen.reason
    return row
