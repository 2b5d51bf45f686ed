"""``mocapella calibrate cameras`` and ``board``: intrinsics and extrinsics from views of a calibration board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

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
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.calibration.cameras import CameraCalibration
    from mocapella.model.board import Board, BoardView
    from mocapella.model.camera import Camera
    from mocapella.model.session import SensorHealth

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
    from mocapella.calibration.rig_report import as_result
    from mocapella.library.calibration import (
        board_views,
        calibrate_views,
        known_lenses,
        named_input,
        named_inputs,
        simultaneous,
        views_alone,
    )
    from mocapella.model.board import load_board
    from mocapella.model.camera_rig_file import save_camera_rig
    from mocapella.sources.video import parse_frames

    if not out.parent.is_dir():
        raise SettingsError(f"--out {out}: there is no folder {out.parent}; name a file in one that exists")
    chosen = load_board(board)
    inputs = named_inputs(videos, NODE)
    wanted = parse_frames(frames)
    known = {} if rig is None else known_lenses(rig, inputs)
    live = _are_live(inputs)
    with working("looking for the board …", status=INTERRUPTED):
        if live:
            views, instants = _films(inputs, chosen, FILMED_S if seconds is None else seconds, known, connect)
        else:
            views, counts = board_views(inputs, chosen, wanted, str(board), _tell)
            tolerance_s = None if tolerance_ms is None else tolerance_ms / 1e3
            instants = simultaneous(views, timestamps, tolerance_s, counts, say)
        more = dict(named_input(text, NODE) for text in alone or [])
        extra = views_alone(more, inputs, chosen, wanted, str(board), say=_tell)
    with working("calibrating …", status=INTERRUPTED):
        found = calibrate_views(views, instants, extra, chosen, known=known, origin=origin, upright=upright)
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


def _tell(text: str) -> None:
    console.print(text, markup=False)


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
