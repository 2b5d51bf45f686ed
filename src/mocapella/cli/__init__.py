"""The command line, with one module for each command.

A command imports its packages only when it runs, so that ``--help`` is fast.

Exit status: 0 for success, also if Ctrl-C ends a command that runs until then; 1 for an error of
`mocapella.errors`; 2 for an invalid command line; 3 if a take is damaged or was not closed, so that the
result covers only its readable part; 130 if Ctrl-C ends a command before its result is complete.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Sequence
from functools import cache

RUN_UNTIL_CTRL_C = frozenset({"demo", "serve", "node", "record", "view"})
LONGEST_ERROR = 4000
"""Longest printed error message, in characters, because a message may come from another program."""
DAMAGED = 3
"""Exit status of a command whose take is damaged or was not closed; its result covers the readable part."""
INTERRUPTED = 130
"""Exit status of a command that Ctrl-C ended before its result was complete, as shells expect it."""


def main() -> None:
    """Run the command line of this process (``sys.argv``), and exit; Ctrl-C and SIGTERM end the process at once."""
    _end_at_once_on_signals(0 if sys.argv[1:2] and sys.argv[1] in RUN_UNTIL_CTRL_C else INTERRUPTED)
    try:
        run(sys.argv[1:])
    finally:
        # While the interpreter takes itself down, Ctrl-C changes no exit status.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def run(arguments: Sequence[str]) -> None:
    """Run a command line, and exit; an error of `mocapella.errors` is printed as one line and gives exit status 1.

    Args:
        arguments: the command and its options, without the program's name.

    Raises:
        SystemExit: always, with the exit status.
    """
    from mocapella.cli.moved import moved

    note = moved(arguments)
    if note:
        sys.stderr.write(f"mocapella: {note}\n")
        sys.exit(2)
    # What takes any time to import comes here, so that Ctrl-C finds a handler.
    import typer

    from mocapella.errors import MocapellaError
    from mocapella.supervision import printable

    try:
        _command()(list(arguments), prog_name="mocapella")
    except MocapellaError as error:
        typer.secho(f"mocapella: {printable(str(error), LONGEST_ERROR)}", fg=typer.colors.RED, err=True)
        sys.exit(1)


@cache
def _command() -> Callable[..., object]:
    """Return the command line with all commands, made once in a process."""
    import typer.main

    import_commands()
    from mocapella.cli.app import app

    return typer.main.get_command(app)


def import_commands() -> None:
    """Import the modules of all commands, which registers them."""
    from mocapella.cli import (  # noqa: F401
        align,
        arm,
        calibrate,
        calibrate_people,
        colours,
        compare,
        demo,
        depth,
        depth_lines,
        doctor,
        evaluate,
        evaluate_founding,
        evaluate_hand_solvers,
        evaluate_jitter,
        evaluate_keypoints,
        evaluate_markers,
        evaluate_rgbd,
        evaluate_rig_from_people,
        evaluate_silhouettes,
        evaluate_webcam_hands,
        evaluate_webcams,
        evaluate_wrong_frame,
        hand,
        people,
        plan,
        record,
        replay,
        serve,
        session,
        silhouettes,
        status,
        study,
        study_protocol,
        study_session,
        take,
        train,
        triangulate,
        triangulate_people,
        tune,
        view,
    )


def _end_at_once_on_signals(status: int) -> None:
    """From now on Ctrl-C and SIGTERM end this process silently; use it while nothing is open that must be closed.

    An exception would not do: raised while modules are imported, it ends as a traceback or is swallowed.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: os._exit(status))
