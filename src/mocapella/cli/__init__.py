"""The command line: one module a verb. What a verb needs is imported when it runs, so that ``--help`` is quick.

Exit status: 0, also when Ctrl-C ends a verb that runs until then; 1 for an error of ours; 2 for a command line that
cannot be read; 130 when Ctrl-C ends a verb before it has made what it was to make.
"""

from __future__ import annotations

import sys

RUN_UNTIL_CTRL_C = frozenset({"demo", "serve", "node", "record", "view"})


def main() -> None:
    """Run the command line; an error of ours is one line on standard error and exit status 1."""
    from mocapella.live.stopping import INTERRUPTED, end_at_once, ignore_interrupts

    end_at_once(0 if sys.argv[1:2] and sys.argv[1] in RUN_UNTIL_CTRL_C else INTERRUPTED)
    # What takes long to import comes after it, so that Ctrl-C finds a handler.
    import typer

    from mocapella.cli import demo, doctor, evaluate, export, node, record, replay, serve, train, view  # noqa: F401
    from mocapella.cli.app import app
    from mocapella.errors import MocapellaError

    try:
        app(prog_name="mocapella")
    except MocapellaError as error:
        typer.secho(f"mocapella: {error}", fg=typer.colors.RED, err=True)
        sys.exit(1)
    finally:
        ignore_interrupts()
