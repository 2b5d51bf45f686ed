"""The typer applications of all command groups, and the introduction that ``mocapella --help`` prints."""

from __future__ import annotations

from typing import Annotated, Final

import typer

from mocapella import __version__
from mocapella.cli.registered import ExportVerbs, NodeVerbs, StreamVerbs

LOGGED: Final = frozenset({"demo", "serve", "node", "view"})
"""Long-running commands, which write a structured log."""
REPORT_PLUGINS: Final = frozenset({"demo", "serve", "node", "view", "replay", "export", "stream"})
"""Commands that print a line for each unusable plug-in when they begin."""

LIVE: Final = "Track live"
RECORDINGS: Final = "Recordings and files"
SET_UP: Final = "Set up"
RESEARCH: Final = "Research"

app = typer.Typer(
    name="mocapella",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",  # wraps paragraphs to the window; "rich" keeps the line breaks of the source
    pretty_exceptions_enable=False,
    help="""Track people and hands live with several cheap cameras, also where one camera's sight is blocked.

    Try it without hardware:  **mocapella demo**

    With webcams:  **mocapella demo webcam**

    With films:  **mocapella people left.mp4 right.mp4 --rig rig.toml --out walk-1**

    With keypoints of other programs:  **mocapella triangulate folder --rig rig.toml --out walk-1**

    With sensors:  **mocapella serve**, and one **mocapella node …** for each sensor, in any order.

    Record:  **mocapella record walk-1**; afterwards **mocapella replay walk-1** or **mocapella export csv walk-1**

    Studies with participants:  **mocapella study new my-study**

    Plan where sensors should stand in a room:  **mocapella plan room.toml**

    Check the installation and the devices:  **mocapella doctor**

    Sensors on other machines need a key:  **mocapella session invite sensor**

    Ctrl-C ends every command and closes its take.
    """,
)
node_app = typer.Typer(
    cls=NodeVerbs,
    no_args_is_help=True,
    help="""Serve one sensor: a camera, a recording, a simulation, or another program.

    Example:  mocapella node simulate --scene walk --sensor front
    """,
)
track_app = typer.Typer(
    no_args_is_help=True,
    help="""Track in images without a server: bodies, arms, or 2D points of any program.

    Example:  mocapella track silhouettes cam1.mp4 cam2.mp4 --rig rig.toml --start joints.json --json out.json
    """,
)
calibrate_app = typer.Typer(
    no_args_is_help=True,
    help="""Calibrate cameras, marker colours, a person's hand, or another tracker's space.

    Example:  mocapella calibrate cameras left.mp4 right.mp4 --board board.toml --out rig.toml
    """,
)
colours_app = typer.Typer(
    no_args_is_help=True,
    help="""Learn the colours of markers from clicks in an image, and check the detection.

    Example:  mocapella calibrate colours check camera:0 --out shot.png
    """,
)
session_app = typer.Typer(
    no_args_is_help=True,
    help="""Let other machines and programs into a session: give them keys, or make all keys void.

    Programs of yours on this machine need nothing.

    Example:  mocapella session invite sensor
    """,
)
export_app = typer.Typer(
    cls=ExportVerbs,
    no_args_is_help=True,
    help="""Export a take to files for other programs.

    Exit status: 3 if the take is damaged or was not closed, and what can be read was written.

    Example:  mocapella export csv walk-1
    """,
)
stream_app = typer.Typer(
    cls=StreamVerbs,
    no_args_is_help=True,
    help="""Send a running server's results to another program by UDP, while people move.

    Example:  mocapella stream vmc --to 127.0.0.1:39539
    """,
)
take_app = typer.Typer(
    no_args_is_help=True,
    help="""Inspect, check, recover and complete takes.

    Example:  mocapella take check walk-1
    """,
)
study_app = typer.Typer(
    no_args_is_help=True,
    help="""Plan a study with participants, keep its recordings in order, and analyse them.

    Example:  mocapella study new my-study --by OP1
    """,
)
lab_app = typer.Typer(
    no_args_is_help=True,
    help="""Evaluate, train and tune tracking methods, and study depth images.

    Example:  mocapella lab evaluate simulation --methods default
    """,
)
evaluate_app = typer.Typer(
    no_args_is_help=True,
    help="""Measure the accuracy of tracking methods.

    Example:  mocapella lab evaluate kinectmultitrack recordings/ --methods stand-still
    """,
)
train_app = typer.Typer(no_args_is_help=True, help="Train models on recordings of real people.")
depth_app = typer.Typer(no_args_is_help=True, help="Extract body lines from depth images; fit a stereo model.")
tune_app = typer.Typer(no_args_is_help=True, help="Tune filter settings on recordings, step by step.")
app.add_typer(node_app, name="node", rich_help_panel=LIVE)
app.add_typer(stream_app, name="stream", rich_help_panel=LIVE)
app.add_typer(track_app, name="track", rich_help_panel=RECORDINGS)
app.add_typer(take_app, name="take", rich_help_panel=RECORDINGS)
app.add_typer(export_app, name="export", rich_help_panel=RECORDINGS)
app.add_typer(session_app, name="session", hidden=True)  # only for several machines; serve names it
app.add_typer(calibrate_app, name="calibrate", rich_help_panel=SET_UP)
app.add_typer(study_app, name="study", rich_help_panel=RESEARCH)
app.add_typer(
    lab_app, name="lab", hidden=True
)  # for authors of methods; docs/evaluation.md and docs/extending.md name it
calibrate_app.add_typer(colours_app, name="colours")
lab_app.add_typer(evaluate_app, name="evaluate")
lab_app.add_typer(train_app, name="train")
lab_app.add_typer(tune_app, name="tune")
lab_app.add_typer(depth_app, name="depth")


def _print_version(wanted: bool) -> None:
    if wanted:
        from mocapella.conventions import SCHEMA_VERSION

        typer.echo(f"mocapella {__version__} (schema {SCHEMA_VERSION})")
        raise typer.Exit


@app.callback()
def _root(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and the schema's."),
    ] = False,
) -> None:
    if context.invoked_subcommand in LOGGED:
        from mocapella.live.run_log import RunLog

        context.call_on_close(RunLog(context.invoked_subcommand).close)
    if context.invoked_subcommand in REPORT_PLUGINS:
        from mocapella.cli.plugins import tell_of_skipped

        tell_of_skipped()
