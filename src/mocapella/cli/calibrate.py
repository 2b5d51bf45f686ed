"""``mocapella calibrate cameras`` and ``board``: intrinsics and extrinsics from views of a calibration board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import msgspec
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import calibrate_app
from mocapella.cli.common import (
    DEFAULT_ADDRESS,
    OUT_HELP,
    RIG_HELP,
    Connect,
    FrameChoice,
    JsonOut,
    console,
    need_cameras,
    say,
    seconds_option,
    working,
    write_json,
)
from mocapella.errors import CalibrationError, SettingsError, one_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mocapella.calibration.cameras import CameraCalibration
    from mocapella.model.board import Board, BoardView
    from mocapella.model.camera import Camera
    from mocapella.model.session import SensorHealth
    from mocapella.sources.video import Frames

ALONE_FROM = 1_000_000
"""First frame number of the views of ``--alone``, so that they are never paired with another camera's frame."""
FILMED_S: Final = 60.0
"""Time for which live cameras film the board if --seconds is not given [s]."""
NODE = "node:"
"""Prefix of an input that is the camera of a running node."""


@calibrate_app.command("cameras")
def calibrate(
    videos: Annotated[
        list[str],
        typer.Argument(
            metavar="[NAME=]VIDEO…",
            help="A video, image or folder of images for each camera, or camera:0, camera:1 … for live ones, or "
            "node:left, node:right … for the cameras of running nodes. A camera is called as its file, or NAME.",
        ),
    ],
    board: Annotated[Path, typer.Option(metavar="BOARD.toml", help="The board: docs/cameras.md says how to write it.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} The camera rig (TOML).")],
    timestamps: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="CSV: when each frame was captured. Without it, equal numbers are one instant."
        ),
    ] = None,
    tolerance_ms: Annotated[
        float | None,
        typer.Option(metavar="MS", min=0, help="Frames so close are of one instant; a third of an interval."),
    ] = None,
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} Keep the intrinsics of this rig.")
    ] = None,
    alone: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VIDEO", help="More pictures of the board, for that camera's lens only; repeatable."),
    ] = None,
    frames: FrameChoice = None,
    origin: Annotated[
        int | None, typer.Option(metavar="FRAME", help="The world is the board in this frame, lying on the floor.")
    ] = None,
    upright: Annotated[bool, typer.Option("--upright", help="The board of --origin hung on a wall.")] = False,
    seconds: Annotated[float | None, seconds_option(f"Live cameras only; {FILMED_S:g} s by default.")] = None,
    connect: Connect = DEFAULT_ADDRESS,
    json: JsonOut = None,
) -> None:
    """Calibrate intrinsics and extrinsics of cameras by images of a board, and print the accuracy in millimetres.

    docs/cameras.md says how to print a board, how to film, and what the messages mean.

    Example:  mocapella calibrate cameras left.mp4 right.mp4 --board board.toml --out rig.toml
    """
    need_cameras("calibrate cameras")
    from mocapella.calibration.cameras import Origin, calibrate_cameras
    from mocapella.calibration.rig_report import as_result
    from mocapella.model.board import load_board
    from mocapella.model.camera_rig_file import load_camera_rig, save_camera_rig
    from mocapella.sources.video import parse_frames

    if not out.parent.is_dir():
        raise SettingsError(f"--out {out}: there is no folder {out.parent}; name a file in one that exists")
    chosen = load_board(board)
    inputs = named_inputs(videos)
    wanted = parse_frames(frames)
    known = {} if rig is None else _lenses(load_camera_rig(rig).cameras, inputs, rig)
    live = _are_live(inputs)
    with working("looking for the board …", status=INTERRUPTED):
        if live:
            views, instants = _films(inputs, chosen, FILMED_S if seconds is None else seconds, known, connect)
        else:
            views, counts = look(inputs, chosen, wanted, str(board))
            instants = _instants(views, timestamps, tolerance_ms, counts)
        extra = _views_alone(alone or [], inputs, chosen, wanted, str(board))
        instants |= {(view.camera, view.frame): view.frame for view in extra}
        paired = [view for view in views if (view.camera, view.frame) in instants]
    place = None if origin is None else Origin(_instant_of(origin, instants), upright)
    with working("calibrating …", status=INTERRUPTED):
        found = calibrate_cameras(paired + extra, chosen, instants, known=known, origin=place)
    save_camera_rig(out, found.rig)
    result = as_result(found)
    write_json(json, result | {"rig": str(out)})
    if json != "-":
        show(found, Console())
    for hint in found.hints:
        say(hint.text)
    say(f"{out}: {len(found.rig.cameras)} cameras")


def _are_live(inputs: Mapping[str, str]) -> bool:
    """Return whether the inputs are live cameras or running nodes.

    Raises:
        SettingsError: cameras, nodes and videos are mixed.
    """
    from mocapella.sources.video import LIVE

    kinds = {path.startswith((LIVE, NODE)) and path.partition(":")[0] for path in inputs.values()}
    if len(kinds) > 1:
        raise SettingsError(
            "live cameras, nodes and videos cannot be calibrated together; film with all, or give videos of all"
        )
    return kinds != {False}


def _views_alone(
    texts: Sequence[str], inputs: Mapping[str, str], board: Board, frames: Frames, label: str
) -> list[BoardView]:
    """Return the board's views of ``--alone``, for one camera's lens each, under frame numbers of their own.

    Raises:
        SettingsError: a name is not one of the cameras.
    """
    extra: list[BoardView] = []
    for name, path in [_named(text) for text in texts]:
        if name not in inputs:
            raise SettingsError(f"--alone {name}: no such camera; there are {one_of(name, inputs)}")
        seen, _ = look({name: path}, board, frames, label)
        extra += [msgspec.structs.replace(view, frame=ALONE_FROM + len(extra) + k) for k, view in enumerate(seen)]
    return extra


@calibrate_app.command("board")
def draw(
    board: Annotated[
        Path, typer.Argument(metavar="BOARD.toml", help="The board: docs/cameras.md says how to write it.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} A PNG image.")],
    dpi: Annotated[int, typer.Option(metavar="DOTS", min=50, max=2400, help="Of the printer, an inch.")] = 300,
    json: JsonOut = None,
) -> None:
    """Draw a calibration board, to be printed in its size.

    Example:  mocapella calibrate board board.toml --out board.png
    """
    need_cameras("calibrate board")
    from mocapella.model.board import load_board
    from mocapella.model.whole_file import write_whole
    from mocapella.sensing.boards import board_png

    chosen = load_board(board)
    write_whole(out, board_png(chosen, dpi))
    width, height = (round(1e3 * chosen.square_m * (count + 1)) for count in (chosen.columns, chosen.rows))
    say(f"{out}: {width} × {height} mm with its margin; print it at 100 %, then measure a square and correct square_m")
    write_json(json, {"path": str(out), "width_mm": width, "height_mm": height})


def named_inputs(texts: Sequence[str]) -> dict[str, str]:
    """Parse ``[NAME=]PATH`` texts; return the paths by camera name, in the order of the texts.

    Without NAME, a camera is called like the file without its suffix (``camera_0`` for ``camera:0``); a node's camera
    keeps its name.

    Raises:
        SettingsError: an invalid or repeated name.
    """
    found: dict[str, str] = {}
    for text in texts:
        name, path = _named(text)
        if name in found:
            raise SettingsError(f"two cameras are called {name!r}; write NAME=VIDEO to tell them apart")
        found[name] = path
    return found


def _named(text: str) -> tuple[str, str]:
    from mocapella.model.observations import check_sensor_name

    name, equals, path = text.partition("=")
    if not equals:
        name, path = Path(text).stem.replace(":", "_"), text
    if path.startswith(NODE):
        called = path.removeprefix(NODE)
        if equals and name != called:
            raise SettingsError(f"{text}: a node's camera keeps its name; write {path}")
        name = called
    return check_sensor_name(name), path


def _lenses(cameras: Mapping[str, Any], inputs: Mapping[str, str], path: Path) -> dict[str, Camera]:
    found = {name: cameras[name].camera for name in inputs if name in cameras}
    missing = [name for name in inputs if name not in cameras]
    if missing:
        raise SettingsError(
            f"--rig {path}: has no camera {missing[0]!r}; it has {one_of(missing[0], cameras)}: name the videos "
            "so (NAME=VIDEO)"
        )
    return found


def look(
    inputs: Mapping[str, str], board: Board, wanted: Any, board_file: str
) -> tuple[list[BoardView], dict[str, int]]:
    """Detect the board in the images of all cameras, and print the number of detections.

    Args:
        inputs: path of the images by the camera's name.
        board: the board to detect.
        wanted: the frames to use (`mocapella.sources.video.Frames`).
        board_file: path of the board's file, named in errors.

    Returns:
        The board's views; and by camera, the number of the last frame that was searched plus one.

    Raises:
        CalibrationError: a camera never sees the board; the message describes what its images show.
    """
    from mocapella.sensing.boards import BoardDetector, why_not_found
    from mocapella.sources.video import pictures

    views, counts = [], {}
    for name, path in inputs.items():
        detector = BoardDetector(board)
        without: list[NDArray[np.uint8]] = []
        for frame, image in pictures(path, wanted):
            counts[name] = frame + 1
            view = detector.update(image, name, frame)
            if view is not None:
                views.append(view)
            elif len(without) < 3 and not detector.report.found:
                without.append(image)
        report = detector.report
        if not report.found:
            raise CalibrationError(f"camera {name}: {why_not_found(without, board)} ({board_file})")
        console.print(
            f"{name}: the board in {report.found} of {report.pictures} pictures, {report.corners} corners", markup=False
        )
    return views, counts


def _films(
    inputs: Mapping[str, str], board: Board, seconds: float, known: Mapping[str, Camera], connect: str
) -> tuple[list[BoardView], dict[tuple[str, int], int]]:
    """Film with local cameras or running nodes for some time; report missing views meanwhile."""
    import time
    from functools import partial

    from mocapella.calibration.board_run import BoardRun
    from mocapella.live.board_cameras import BoardCameras, LocalCameras, NodeCameras, film, node_names, urgent
    from mocapella.sources.video import LIVE
    from mocapella.wire.questions import ask_node
    from mocapella.wire.reader import send_command
    from mocapella.wire.session import open_reader

    clock = time.monotonic
    with ExitStack() as stack:
        cameras: BoardCameras
        if next(iter(inputs.values())).startswith(NODE):
            session = open_reader(connect)
            stack.callback(session.close)

            def sensors() -> Sequence[SensorHealth]:
                status = send_command(session, "status").status
                return status.sensors if status is not None else ()

            names = node_names(list(inputs.values()), NODE, sensors())
            cameras = NodeCameras(partial(ask_node, session), sensors, names, board)
            run = BoardRun(board, names, known=known)
        else:
            numbers = {name: _number(path.removeprefix(LIVE)) for name, path in inputs.items()}
            cameras, run = LocalCameras(numbers, board, clock=clock), BoardRun(board, list(inputs), known=known)
        stack.callback(cameras.close)
        end, said = clock() + seconds, [""]

        def tell() -> None:
            text = next(iter(urgent(run)), "")
            if text and text != said[0]:
                say(text)
            said[0] = text

        film(cameras, run, lambda: clock() >= end, tell, clock=clock)
    for name, count in run.report.unanswered.items():
        if count:
            say(f"camera {name} gave no picture {count} times")
    if words := run.report.words():
        say(words)
    return run.seen_by_all(), run.instants


def _number(text: str) -> int:
    if not text.isdecimal():
        raise SettingsError(f"camera:{text} cannot be used; write camera:0 for the first camera of this machine")
    return int(text)


def _instants(
    views: Sequence[BoardView], timestamps: Path | None, tolerance_ms: float | None, counts: Mapping[str, int]
) -> dict[tuple[str, int], int]:
    from mocapella.calibration.frame_sync import synchronise_frames
    from mocapella.sources.video import read_timestamps

    if timestamps is None:
        if tolerance_ms is not None:
            raise SettingsError("--tolerance-ms has no meaning without --timestamps; give both or none")
        return {(view.camera, view.frame): view.frame for view in views}
    times = read_timestamps(timestamps, list(counts))
    for name, count in counts.items():
        if len(times[name]) < count:
            say(f"{timestamps}: {len(times[name])} times for {count} frames of {name}; the rest is left out")
    return synchronise_frames(times, None if tolerance_ms is None else tolerance_ms / 1e3)


def _instant_of(frame: int, instants: Mapping[tuple[str, int], int]) -> int:
    found = [instant for (_, number), instant in instants.items() if number == frame]
    if not found:
        raise SettingsError(f"--origin {frame}: no camera has that frame; take a frame that shows the board")
    return found[0]


def show(found: CameraCalibration, out: Console) -> None:
    """Print the calibration as tables."""
    from mocapella.calibration.rig_report import HEADINGS, sentences, table, tape_measure

    shown = Table(box=SIMPLE_HEAD, padding=0, show_edge=False)
    for k, (words, unit) in enumerate(HEADINGS):
        shown.add_column(f"{words}\n{unit}" if unit else words, justify="right" if k else "left", no_wrap=True)
    for row in table(found):
        shown.add_row(*row)
    out.print(shown)
    for sentence in [*sentences(found), tape_measure(found)]:
        out.print(sentence, highlight=False, markup=False)
