"""``mocapella calibrate people``: intrinsics, extrinsics and clocks of cameras from people, without a board."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import calibrate_app
from mocapella.cli.command_settings import KeySpec, SettingsFile, read_keys, set_option
from mocapella.cli.common import ORDER, OUT_HELP, RIG_HELP, JsonOut, Plot, parse_size, say, working, write_json
from mocapella.cli.pictures import Fps, Size
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.calibration.people_rig import RigFromPeople, RigScale


@dataclass(frozen=True)
class PeopleRigKeys:
    """Settings of `calibrate people`."""

    order: Annotated[str, ORDER] = "auto"
    camera_height: Annotated[str, KeySpec("Height of a camera above the floor, for the scale.", "NAME:METRES")] = ""
    instants: Annotated[int, KeySpec("Most instants that are used.", "instants")] = 600
    every_s: Annotated[float, KeySpec("Shortest interval between instants.", "s")] = 0.1
    clock_search_s: Annotated[float, KeySpec("Largest difference of two cameras' clocks to search.", "s")] = 0.0
    same_lenses: Annotated[bool, KeySpec("All cameras of one image size are of one model.")] = False
    seed: Annotated[int, KeySpec("Of the random samples.", "number")] = 0


@calibrate_app.command("people")
def calibrate_people(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES…",
            help="A folder with a folder or file of keypoints for each camera, several of these, or a take.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} The camera rig (TOML).")],
    height: Annotated[
        float | None, typer.Option("--height", metavar="METRES", help="Mean stature of the people, for the scale.")
    ] = None,
    distance: Annotated[
        str | None,
        typer.Option("--distance", metavar="NAME:NAME:METRES", help="Measured distance of two cameras, for the scale."),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} Keep its lenses and world; name moved cameras."),
    ] = None,
    size: Size = None,
    fps: Fps = None,
    plot: Plot = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(PeopleRigKeys)] = None,
    json: JsonOut = None,
) -> None:
    """Calibrate cameras from the people they see, without a board: walk about for half a minute.

    Reads the keypoint files of `mocapella triangulate`, and takes of webcams or of `mocapella people`;
    docs/cameras-people.md describes its limits.

    Example:  mocapella calibrate people session/pose --size 1280x720 --fps 30 --height 1.75 --out rig.toml
    """
    from mocapella.library.people_calibration import calibrate_people as library_calibrate_people
    from mocapella.model.camera_rig_file import save_camera_rig

    keys = read_keys(PeopleRigKeys, settings_file, settings)
    if not out.parent.is_dir():
        raise SettingsError(f"--out {out}: there is no folder {out.parent}; name a file in one that exists")
    scale = _scale(height, distance, keys.camera_height)
    with working("reading …", status=INTERRUPTED) as status:
        found = library_calibrate_people(
            files, size_px=parse_size(size) if size else None, fps=fps, scale=scale, rig=rig, order=keys.order,
            progress=lambda text: status.update(text.replace("[", "(")), instants=keys.instants, every_s=keys.every_s,
            clock_search_s=keys.clock_search_s, same_lenses=keys.same_lenses, seed=keys.seed,
        )  # fmt: skip
    save_camera_rig(out, found.rig)
    if plot is not None:
        _draw(found, plot)
    write_json(json, as_result(found) | {"rig": str(out)})
    if json != "-":
        show(found, Console(highlight=False))
    for note in found.notes:
        say(note)
    say(f"{out}: {len(found.rig.cameras)} cameras, {'good' if found.good else 'not good yet'}")


def _scale(height: float | None, distance: str | None, camera_height: str) -> RigScale:
    from mocapella.calibration.people_rig import RigScale

    one, other, metres = _split(distance, "--distance", 3) if distance else ("", "", None)
    camera, above = _split(camera_height, "camera_height", 2) if camera_height else ("", None)
    return RigScale(height, metres, (one, other), above, camera)


def _split(text: str, option: str, count: int) -> tuple[Any, ...]:
    *names, last = text.split(":")
    try:
        metres = float(last)
    except ValueError:
        metres = float("nan")
    if len(names) + 1 != count or not metres > 0 or not all(names):
        form = "left:right:2.4" if count == 3 else "left:1.8"
        raise SettingsError(f"{option} {text}: write it like {form}, in metres")
    return (*names, metres)


def as_result(found: RigFromPeople) -> dict[str, Any]:
    """Return all results as values for JSON."""
    import msgspec

    values: dict[str, Any] = msgspec.to_builtins(
        {name: getattr(found, name) for name in found.__struct_fields__ if name != "rig"}
    )
    return values | {"good": found.good}


def show(found: RigFromPeople, out: Console) -> None:
    """Print the quality of the cameras as a table, and the scale and the floor in sentences."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    for words in (
        "camera", "keypoints", "residual\npx", "place\n± mm", "turn\n± °", "focal\n± %", "clock\nms", "clock\n± ms",
    ):  # fmt: skip
        table.add_column(words, justify="left" if words == "camera" else "right")
    for name, camera in found.cameras.items():
        table.add_row(
            name, str(camera.keypoints), f"{camera.residual_px:.1f}", f"{camera.position_sd_mm:.0f}",
            f"{camera.rotation_sd_deg:.2f}", f"{camera.focal_sd_percent:.1f}", f"{camera.clock_ms:.0f}",
            f"{camera.clock_sd_ms:.1f}",
        )  # fmt: skip
    out.print(table)
    floor = f"up ± {found.up_sd_deg:.1f}°" if found.floor_known else f"no floor, up ± {found.up_sd_deg:.1f}°"
    out.print(
        f"{found.people} people, {found.instants} instants; scale {found.scale_words}, ± {100 * found.scale_sd:.0f} %"
    )
    out.print(f"{floor}; people are {found.stature_m:.2f} m tall with this scale", markup=False)


def _draw(found: RigFromPeople, plot: Path) -> None:
    """Draw the cameras from above, with twice the standard deviations of their positions as circles."""
    import numpy as np

    from mocapella.evaluation.plots import new_figure, save_figure
    from mocapella.geometry.rigid import inverse

    figure = new_figure(plot, 6.0, 6.0)
    axes = figure.subplots()
    turn = np.linspace(0.0, 2 * np.pi, 60)
    for name, placed in found.rig.cameras.items():
        T = inverse(placed.T_camera_world)
        radius = 2e-3 * found.cameras[name].position_sd_mm
        axes.plot(T[0, 3] + radius * np.cos(turn), T[2, 3] + radius * np.sin(turn), "C0-", linewidth=1)
        axes.arrow(T[0, 3], T[2, 3], 0.5 * T[0, 2], 0.5 * T[2, 2], width=0.02, color="C0")
        axes.annotate(f"{name}, {T[1, 3]:.2f} m high", (T[0, 3], T[2, 3]), textcoords="offset points", xytext=(6, 6))
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.set_xlabel("x [m]")
    axes.set_ylabel("z [m]")
    axes.margins(0.2)
    save_figure(figure, plot)
