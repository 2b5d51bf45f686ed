"""The command group ``mocapella study``; `mocapella.cli.study_protocol` has the commands of protocol and folder."""

from __future__ import annotations

import typer

from mocapella.cli.app import app

study_app = typer.Typer(
    no_args_is_help=True,
    help="""Plan a study with participants, keep its recordings in order, and analyse them.

    Example:  mocapella study new my-study --by OP1
    """,
)
app.add_typer(study_app, name="study", hidden=True)  # for researchers; the introduction of --help names it
