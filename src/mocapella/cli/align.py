"""``mocapella align``: another tracker's space, in the world of the cameras."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import app
from mocapella.cli.common import JsonOut, say, working, write_json

if TYPE_CHECKING:
    from mocapella.recording.take_reader import Take

_AXIS_M = 0.05
"""Points on the axes of a thing, so far from its origin, stand for its pose."""


@app.command()
def align(
    take: Annotated[Path, typer.Argument(metavar="TAKE", help="A take of the method hands, recorded as below.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="What to write, a TOML for serve --alignment.")],
    body: Annotated[str, typer.Option(metavar="NAME", help="The other tracker's name of the thing that was moved.")],
    space: Annotated[
        str, typer.Option(metavar="NAME", help="Its space; may be left out where the take has one only.")
    ] = "",
    marker: Annotated[str, typer.Option(metavar="NAME", help="The hand's marker that was fixed on it …")] = "",
    thing: Annotated[str, typer.Option(metavar="NAME", help="… or the thing, by its tags or markers.")] = "",
    vertical: Annotated[
        bool, typer.Option("--vertical", help="Both spaces have y up: one angle less to find.")
    ] = False,
    json: JsonOut = None,
) -> None:
    """Find how the space of another tracker (OSC, OpenVR) lies in the world of the cameras, and how late its poses are.

    Fix a tag or a marker of ours on the thing that the other tracker follows. Run `serve --method hands` with both, and
    `--record`; for 20 s, move it through all of the space that the cameras see, tilting and turning it about every
    axis. Where that was not enough, this says what was missing.

    Example:  mocapella align takes/move.mcap --body LHR-1 --thing wand --out vr.toml
    """
    from mocapella.calibration.space_alignment import SpaceAlignmentSettings, align_space
    from mocapella.errors import SettingsError
    from mocapella.model.space import SpaceAlignment, rows_of, save_space
    from mocapella.recording.take_reader import read_take

    if bool(marker) == bool(thing):
        raise SettingsError("name what was fixed on it: either --marker or --thing")
    with working("reading …", status=INTERRUPTED):
        recorded = read_take(take)
        space, poses_s, poses = _poses(recorded, take, space, body)
        at_s, points = _points(recorded, marker, thing)
        fit = align_space(at_s, points, poses_s, poses, SpaceAlignmentSettings(vertical=vertical))
        alignment = SpaceAlignment(
            space, rows_of(fit.T_world_space), fit.delay_s, fit.position_sd_m, fit.rotation_sd_rad, fit.delay_sd_s
        )
        save_space(out, alignment)
    lever = [round(float(x), 4) for x in fit.lever_m[0]]
    write_json(
        json,
        {
            "space": space,
            "body": body,
            "out": str(out),
            "T_world_space": fit.T_world_space.tolist(),
            "lever_m": lever,
            **{name: getattr(fit, name) for name in fit.__struct_fields__ if name not in ("T_world_space", "lever_m")},
        },
    )
    say(
        f"{space}: known to {1e3 * fit.position_sd_m:.1f} mm and {math.degrees(fit.rotation_sd_rad):.2f}°; its poses "
        f"are {1e3 * fit.delay_s:.0f} ± {1e3 * fit.delay_sd_s:.0f} ms late; {1e3 * fit.residual_m:.1f} mm are left at "
        f"{fit.instants} instants, {fit.left_out} of them left out"
    )
    say(f"{thing or marker} is at {lever} m of {body}, ± {1e3 * fit.lever_sd_m:.1f} mm")
    say(f"alignment saved to {out}: mocapella serve --method hands --alignment {out}")


def _poses(take: Take, path: Path, space: str, body: str) -> tuple[str, Any, Any]:
    """The space's name, times [s] and poses (n, 4, 4) of the body."""
    import numpy as np

    from mocapella.conventions import NS_PER_S
    from mocapella.errors import InputError, one_of
    from mocapella.model.poses import PoseFrame

    heard: dict[float, Any] = {}
    spaces: dict[str, set[str]] = {}
    for arrival in take.arrivals():
        frame = arrival.frame
        if isinstance(frame, PoseFrame):
            spaces.setdefault(frame.space, set()).update(frame.names)
            if (not space or frame.space == space) and (T := frame.T_space_body(body)) is not None:
                heard[arrival.at_ns / NS_PER_S] = T
    if not spaces:
        raise InputError("has no poses of another tracker", file=path, fix="record with mocapella node osc or openvr")
    space = space or (next(iter(spaces)) if len(spaces) == 1 else "")
    if space not in spaces:
        fix = f"--space is one of {', '.join(sorted(spaces))}"
        raise InputError("has no such space" if space else "has several spaces", file=path, value=space, fix=fix)
    if not heard:
        fix = f"--body is one of {one_of(body, sorted(spaces[space]))}"
        raise InputError("has no pose of the body", file=path, value=body, fix=fix)
    times = sorted(heard)
    return space, np.array(times), np.array([heard[t] for t in times])


def _points(take: Take, marker: str, thing: str) -> tuple[Any, Any]:
    """Times [s] and points (n, m, 3) of the marker, or of the thing's origin and axes."""
    import numpy as np

    from mocapella.conventions import NS_PER_S
    from mocapella.errors import SettingsError, one_of
    from mocapella.geometry.rigid import apply
    from mocapella.model.observations import JointState

    local = np.vstack([np.zeros(3), _AXIS_M * np.eye(3)])
    at_s, points, known = [], [], set()
    for _, scene in take.scenes():
        if thing:
            known.update(one.name for one in scene.objects)
            found = next((one for one in scene.objects if one.name == thing), None)
            if found is not None and found.state == JointState.TRACKED and found.T_world_object is not None:
                at_s.append(scene.at_ns / NS_PER_S)
                points.append(apply(found.T_world_object, local))
        elif scene.points is not None:
            known.update(scene.points.names)
            if marker in scene.points.names and scene.points.cameras[k := scene.points.names.index(marker)] >= 2:
                at_s.append(scene.at_ns / NS_PER_S)
                points.append(scene.points.positions[k : k + 1])
    wanted, what = (thing, "--thing") if thing else (marker, "--marker")
    if wanted not in known:
        raise SettingsError(f"{what} {wanted!r}: the take has {one_of(wanted, sorted(known)) or 'none'}")
    return np.array(at_s), np.array(points).reshape(len(at_s), -1, 3) if at_s else np.empty((0, 1, 3))
