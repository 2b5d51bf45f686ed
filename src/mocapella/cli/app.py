"""What the verbs register with, and what ``mocapella --help`` says before it lists them."""

from __future__ import annotations

from typing import Annotated

import typer

from mocapella import __version__
from mocapella.cli.registered import ExportVerbs, NodeVerbs

TELL_OF_PLUGINS = frozenset({"demo", "serve", "node", "view", "replay", "export"})
"""Verbs that begin with a line for each plug-in that cannot be used."""

app = typer.Typer(
    name="mocapella",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",  # which wraps paragraphs to the window; "rich" keeps the breaks of the source
    pretty_exceptions_enable=False,
    help="""Tracks people, live, with several cheap depth sensors, and sees around occlusion.

    Try it without any hardware:  **mocapella demo**

    With sensors:  **mocapella serve**, and one **mocapella node …** for each sensor, in any order.

    Record:  **mocapella record walk-1**; afterwards **mocapella replay walk-1**

    Something does not work?  **mocapella doctor**

    Ctrl-C ends every command, and closes a take properly.
    """,
)
node_app = typer.Typer(
    cls=NodeVerbs,
    no_args_is_help=True,
    help="""Serve one sensor: a camera, a recording, a simulation, or a foreign program.

    Example:  mocapella node simulate --scene walk --sensor front
    """,
)
colours_app = typer.Typer(
    no_args_is_help=True,
    help="""Learn the markers' colours by pointing at them, and look at what is taken for them.

    Example:  mocapella colours check camera:0 --out shot.png
    """,
)
export_app = typer.Typer(
    cls=ExportVerbs,
    no_args_is_help=True,
    help="""Make files for other programs out of a take.

    Example:  mocapella export csv walk-1
    """,
)
evaluate_app = typer.Typer(
    no_args_is_help=True,
    help="""Say how good tracking methods are, in figures.

    Example:  mocapella evaluate kinectmultitrack recordings/ --methods stand-still
    """,
)
train_app = typer.Typer(no_args_is_help=True, help="Learn from recordings of real people.")
depth_app = typer.Typer(no_args_is_help=True, help="Depth images: bodies as lines; depth from two parallel cameras.")
tune_app = typer.Typer(no_args_is_help=True, help="Find settings from recordings, step by step.")
hand_app = typer.Typer(no_args_is_help=True, help="A person's hand, measured.")
app.add_typer(node_app, name="node")
app.add_typer(colours_app, name="colours")
app.add_typer(export_app, name="export")
app.add_typer(evaluate_app, name="evaluate")
app.add_typer(train_app, name="train")
app.add_typer(depth_app, name="depth")
app.add_typer(tune_app, name="tune")
app.add_typer(hand_app, name="hand")


def _print_version(wanted: bool) -> None:
    if wanted:
        from mocapella.schema import SCHEMA_VERSION

        typer.echo(f"mocapella {__version__} (schema {SCHEMA_VERSION})")
        raise typer.Exit


@app.callback()
def _root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Version, and the schema's.")
    ] = False,
) -> None:
    if context.invoked_subcommand in TELL_OF_PLUGINS:
        from mocapella.cli.plugins import tell_of_skipped

        tell_of_skipped()
