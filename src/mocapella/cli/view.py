"""``mocapella view``: show a server's session in the browser."""

from __future__ import annotations

import os
from typing import Annotated, Final

import typer

from mocapella.cli.app import LIVE, app
from mocapella.cli.common import (
    DEFAULT_ADDRESS,
    DEFAULT_VIEW_PORT,
    PAGE_DRAWN,
    WATCH_URL,
    Connect,
    Host,
    ViewPort,
    say,
    warn_if_open,
)

NICENESS: Final = 5
"""The view has a lower priority than the programs that capture, track and record, on a machine that runs both."""


@app.command(rich_help_panel=LIVE)
def view(
    connect: Connect = DEFAULT_ADDRESS,
    view_port: ViewPort = DEFAULT_VIEW_PORT,
    host: Host = "127.0.0.1",
    cloth: Annotated[
        bool, typer.Option("--cloth", help="Hang a simulated cloth in front of the first tracked hand.")
    ] = False,
    scenery: Annotated[
        str | None,
        typer.Option("--scenery", metavar="SCENE", help="Draw the obstacles of this simulated scene."),
    ] = None,
) -> None:
    """Show a server's session in the browser; wait for the server if it is not running yet.

    `serve` and `demo` start a view by themselves.

    Example:  mocapella view --connect tls/127.0.0.1:7447 --view-port 7449
    """
    from mocapella.live.signals import stop_on_signals
    from mocapella.live.view import run_view

    def tell(url: str, watch_url: str) -> None:
        say(f"view: {url}")
        say(f"{WATCH_URL}{watch_url}")

    def tell_study(url: str, participant_url: str) -> None:
        say(f"study: {url}")
        say(f"study, the participant's screen: {participant_url}")

    warn_if_open("the view is", host, view_port)
    if hasattr(os, "nice"):  # not on Windows
        os.nice(NICENESS)
    with stop_on_signals() as stop:
        run_view(
            connect,
            host,
            view_port,
            stop,
            cloth=cloth,
            scenery=scenery,
            on_ready=tell,
            on_page=lambda: say(PAGE_DRAWN),
            on_study=tell_study,
            on_waiting=lambda reason: say(f"{reason}; waiting for it (Ctrl-C ends)"),
        )
