"""``mocapella view``."""

from __future__ import annotations

from typing import Annotated

import typer

from mocapella.cli.app import LIVE, app
from mocapella.cli.common import DEFAULT_ADDRESS, DEFAULT_VIEW_PORT, Connect, say, warn_if_open


@app.command(rich_help_panel=LIVE)
def view(
    connect: Connect = DEFAULT_ADDRESS,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port of the page.")] = DEFAULT_VIEW_PORT,
    host: Annotated[
        str, typer.Option(help="Interface of the page; others than 127.0.0.1 are open to your network.")
    ] = "127.0.0.1",
    cloth: Annotated[bool, typer.Option("--cloth", help="Hang a cloth before the first hand that is tracked.")] = False,
    scenery: Annotated[
        str | None,
        typer.Option("--scenery", metavar="SCENE", help="Draw the obstacles of this simulated scene."),
    ] = None,
) -> None:
    """Show a server's session in the browser, and wait for the server if none is there yet.

    `serve` and `demo` start a view by themselves.

    Example:  mocapella view --connect tcp/127.0.0.1:7447 --port 7449
    """
    from mocapella.live.signals import stop_on_signals
    from mocapella.live.view import run_view

    warn_if_open("the view is", host, port)
    with stop_on_signals() as stop:
        run_view(
            connect,
            host,
            port,
            stop,
            cloth=cloth,
            scenery=scenery,
            on_ready=lambda url: say(f"view: {url}"),
            on_waiting=lambda address: say(
                f"no server at {address} yet: start one with `mocapella serve`; waiting for it (Ctrl-C ends)"
            ),
        )
