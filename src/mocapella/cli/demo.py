"""``mocapella demo``: the main job on a simulated room, with real processes over a real bus."""

from __future__ import annotations

import webbrowser
from typing import Annotated

import typer

from mocapella.cli.app import app
from mocapella.cli.common import (
    DEFAULT_PORT,
    DEFAULT_VIEW_PORT,
    JsonOut,
    Method,
    NoView,
    RecordTo,
    SceneName,
    Seconds,
    Seed,
    exit_by,
    say,
    take_file,
    working,
    write_json,
)


@app.command()
def demo(
    scene: SceneName = "obstacle",
    method: Method = "default",
    seconds: Seconds = None,
    no_view: NoView = False,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the view's URL, open no browser.")] = False,
    record: RecordTo = None,
    port: Annotated[
        int | None, typer.Option(metavar="PORT", min=1, max=65535, help="Bus port; by default 7447, or a free one.")
    ] = None,
    view_port: Annotated[
        int | None, typer.Option(metavar="PORT", min=1, max=65535, help="View port; by default 7448, or a free one.")
    ] = None,
    seed: Seed = 0,
    json: JsonOut = None,
) -> None:
    """Simulate a room with three sensors, two people and an obstacle, track the people live, and open the view.

    Needs no hardware and downloads nothing. Every sensor is a process of its own, as real ones are.

    Example:  mocapella demo --scene walk --seconds 30 --record walk-1
    """
    from mocapella.cli.serve import finish, live_session, say_url, start_together, wait_while
    from mocapella.live.launch import check_port_free
    from mocapella.live.server import ServerSettings
    from mocapella.live.stopping import stop_on_signals
    from mocapella.model.session import Setup
    from mocapella.sources.simulate import SimulatedSensor, load_scene

    take = None if record is None else take_file(record)
    room = load_scene(scene, seed=seed)
    names = room.sensor_names
    with working("making the room …", status=0):
        next(SimulatedSensor(room, 1).frames())  # compiles once a machine, and not in every sensor at once
    bus_port = _choose(port, DEFAULT_PORT)
    if port is not None:
        check_port_free("127.0.0.1", port, "--port")
    page_port = None if no_view else _choose(view_port, DEFAULT_VIEW_PORT)
    setup = Setup(method=method, sensors_expected=len(names))
    settings = ServerSettings(listen=f"tcp/127.0.0.1:{bus_port}", setup=setup)

    def show(url: str) -> None:
        say_url(url)
        if not no_browser:
            webbrowser.open(url)

    with stop_on_signals() as stop:
        with live_session(settings, stop, view_port=page_port, on_url=show) as session:
            if take is not None:
                say(session.server.record_to(take))
            room_words = ["--scene", scene, "--seed", str(seed), "--connect", settings.listen]
            start_together(session, [["simulate", "--sensor", name, *room_words] for name in names])
            say(f"simulating {scene}: sensors {', '.join(names)} (Ctrl-C ends)")
            wait_while(session, seconds)
            summary = finish(session.server)
        write_json(json, summary)
    exit_by(summary["recording"])


def _choose(wanted: int | None, default: int) -> int:
    from mocapella.errors import BusError
    from mocapella.live.launch import check_port_free, free_port

    if wanted is not None:
        return wanted
    try:
        check_port_free("127.0.0.1", default, "")
    except BusError:
        return free_port()
    return default
