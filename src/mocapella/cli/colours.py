"""``mocapella calibrate colours``: learn the markers' colours from their positions in an image, and check them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import colours_app
from mocapella.cli.command_settings import SettingsFile, read_keys, set_option
from mocapella.cli.common import OUT_HELP, JsonOut, Seed, console, need_cameras, say, write_json
from mocapella.cli.nodes import NAME_HELP
from mocapella.cli.pictures import CameraKeys, Fps, Profile, Size, Source, wishes
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.sensing.colour_table import Separability

Frame = Annotated[
    int | None,
    typer.Option(
        metavar="NUMBER",
        min=0,
        help="Frame number, from 0; of a camera the 30th by default, when exposure has settled.",
    ),
]


@colours_app.command("learn")
def learn(
    source: Source,
    point: Annotated[
        list[str],
        typer.Option(
            "--point",
            metavar="NAME=X,Y",
            help="Pixel at the centre of a marker, or of skin (skin=X,Y). Repeatable.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} The colour profile (JSON).")],
    name: Annotated[str, typer.Option("--name", metavar="SENSOR", help=f"{NAME_HELP} As in the rig.")],
    frame: Frame = None,
    empty: Annotated[
        list[str] | None,
        typer.Option(metavar="SOURCE[@NUMBER]", help="Image without markers, of the background. Repeatable."),
    ] = None,
    size: Size = None,
    fps: Fps = None,
    seed: Seed = 0,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(CameraKeys)] = None,
    json: JsonOut = None,
) -> None:
    """Learn colours from a picture, and say how well they can be told apart.

    `mocapella calibrate colours check SOURCE --out shot.png` writes an image to find the coordinates in; it can be the
    SOURCE here. The profile holds the camera's controls: as read back, or for an image file as the options say.

    Example:  mocapella calibrate colours learn shot.png --name left --point red=301,84 --out left.json
    """
    need_cameras("calibrate colours learn")
    from mocapella.model.observations import check_sensor_name
    from mocapella.sensing.colour_learning import ColourSample, learn_colours
    from mocapella.sensing.colour_profile import CameraControls, save_profile
    from mocapella.sensing.colour_table import separability
    from mocapella.sources.open_pictures import one_picture

    check_sensor_name(name)
    keys = read_keys(CameraKeys, settings_file, settings)
    given = keys.controls
    wanted = wishes(size, fps, keys.fourcc, given, None)
    clicks = points(point)
    image, state = one_picture(source, frame, wanted, seed=seed)
    without = [_background(text, wanted, seed) for text in empty or []]
    controls = given if state.controls == CameraControls() else state.controls
    profile = learn_colours(name, [ColourSample(image, clicks)], backgrounds=without, controls=controls)
    found = separability(profile)
    save_profile(out, profile)
    show(found, console if json == "-" else Console())
    for problem in (*state.problems, *found.problems):
        say(problem)
    said = f"{len(found.problems)} problems" if found.problems else "they can be told apart"
    say(f"{out}: {len(profile.colours)} colours of {name}; {said}")
    write_json(
        json,
        {
            "profile": str(out),
            "kept": found.kept,
            "in_background": found.in_background,
            "distances": found.distances.tolist(),
            "problems": [*state.problems, *found.problems],
        },
    )


@colours_app.command("check")
def check(
    source: Source,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} A PNG image.")],
    profile: Profile = None,
    frame: Frame = None,
    size: Size = None,
    fps: Fps = None,
    seed: Seed = 0,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(CameraKeys)] = None,
    json: JsonOut = None,
) -> None:
    """Draw the regions of each marker colour in an image, and the detected markers.

    Example:  mocapella calibrate colours check camera:0 --profile left.json --out mask.png
    """
    need_cameras("calibrate colours check")
    from mocapella.model.whole_file import write_whole
    from mocapella.sensing.colour_profile import load_profile
    from mocapella.sensing.marker_mask import encode_image, mask_image
    from mocapella.sensing.markers import MarkerDetector
    from mocapella.sources.open_pictures import one_picture

    known = None if profile is None else load_profile(profile)
    keys = read_keys(CameraKeys, settings_file, settings)
    image, state = one_picture(source, frame, wishes(size, fps, keys.fourcc, keys.controls, known), seed=seed)
    for problem in state.problems:
        say(problem)
    result: dict[str, Any] = {"picture": str(out), "size_px": state.size_px, "markers": {}, "light": ""}
    if known is not None:
        detector = MarkerDetector(known)
        seen = detector.update(image, 0.0)
        image = mask_image(image, known, detector.table, seen)
        result["light"] = detector.report.light
        for k, marker in enumerate(seen.names):
            x, y = (float(value) for value in seen.positions_px[k])
            candidates = 0 if seen.candidates is None else int(seen.candidates[k])
            there = bool(seen.found[k])
            result["markers"][marker] = {"x_px": x, "y_px": y, "candidates": candidates} if there else None
            many = f", one of {candidates} that could be it" if candidates > 1 else ""
            say(f"{marker}: " + (f"({x:.1f}, {y:.1f}){many}" if there else "not seen"))
        if detector.report.light:
            say(detector.report.light)
    write_whole(out, encode_image(image, "png"))
    say(f"{out}: {image.shape[1]} × {image.shape[0]} px")
    write_json(json, result)


def points(texts: list[str]) -> dict[str, tuple[float, float]]:
    """Parse texts such as ``red=301,84``; return the position [px] by name.

    Raises:
        SettingsError: a text has another form, or a name is repeated.
    """
    found: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, _, place = text.partition("=")
        try:
            x, y = (float(part) for part in place.split(","))
        except ValueError:
            raise SettingsError(f"--point {text!r} cannot be used; write it as red=301,84") from None
        if not name or name in found:
            raise SettingsError(f"--point {text!r}: each marker is pointed at once, and has a name")
        found[name] = x, y
    return found


def show(found: Separability, out: Console) -> None:
    """Print how well each colour is separated from the background and from the other colours."""
    table = Table(title="colours", title_justify="left")
    for heading in ("colour", "told from the rest, %", "in the background, %", "nearest colour"):
        table.add_column(heading, justify="left" if heading in ("colour", "nearest colour") else "right")
    names = list(found.kept)
    for k, name in enumerate(names):
        others = [(float(found.distances[k, j]), other) for j, other in enumerate(names) if j != k]
        nearest = "" if not others else f"{min(others)[1]}, {min(others)[0]:.1f} standard deviations"
        table.add_row(name, f"{100 * found.kept[name]:.1f}", f"{100 * found.in_background[name]:.2f}", nearest)
    out.print(table)


def _background(text: str, wanted: Any, seed: int) -> Any:
    from mocapella.sources.open_pictures import one_picture

    source, at, number = text.rpartition("@")
    if at and number.isdecimal():
        return one_picture(source, int(number), wanted, seed=seed)[0]
    return one_picture(text, None, wanted, seed=seed)[0]
