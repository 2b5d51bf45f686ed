"""The command line: one module a verb. What a verb needs is imported when it runs, so that ``--help`` is quick."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from mocapella import __version__
from mocapella.errors import MocapellaError

app = typer.Typer(
    name="mocapella",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="""Tracks people, live, with several cheap depth sensors, and sees around occlusion.

    Try it without any hardware:  [bold]mocapella demo[/bold]

    With sensors: [bold]mocapella serve[/bold], and one [bold]mocapella node …[/bold] for each sensor, in any order.
    """,
)
node_app = typer.Typer(no_args_is_help=True, help="Serve one sensor: a recording, a simulation, or a foreign program.")
export_app = typer.Typer(no_args_is_help=True, help="Make files for other programs out of a take.")
evaluate_app = typer.Typer(no_args_is_help=True, help="Say how good tracking methods are, in figures.")
app.add_typer(node_app, name="node")
app.add_typer(export_app, name="export")
app.add_typer(evaluate_app, name="evaluate")


def _print_version(wanted: bool) -> None:
    if wanted:
        from mocapella.schema import SCHEMA_VERSION

        typer.echo(f"mocapella {__version__} (schema {SCHEMA_VERSION})")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Version, and the schema's.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; an error of ours is one line on standard error and exit status 1."""
    from mocapella.cli import demo, doctor, evaluate, export, node, record, replay, serve, view  # noqa: F401  (they register)

    try:
        app()
    except MocapellaError as error:
        typer.secho(f"mocapella: {error}", fg=typer.colors.RED, err=True)
        sys.exit(1)
