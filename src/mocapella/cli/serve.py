"""``mocapella serve``, and the session that `demo` and `replay --live` share with it."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocapella.cli.app import LIVE, app
from mocapella.cli.common import (
    DEFAULT_PORT,
    DEFAULT_VIEW_PORT,
    BusPort,
    JsonOut,
    Method,
    MethodSettings,
    NoView,
    RecordTo,
    Seconds,
    ViewPort,
    console,
    exit_by,
    get_ready,
    most_of,
    recording_row,
    say,
    say_if_never_tracked,
    take_file,
    warn_if_open,
    write_json,
)
from mocapella.cli.nodes import READY
from mocapella.errors import InputError, MocapellaError, SettingsError
from mocapella.settings import merged, settings_of_pairs

if TYPE_CHECKING:
    from mocapella.calibration.sensor_layout import SensorLayout
    from mocapella.live.compilation import Compilation
    from mocapella.live.launch import Children
    from mocapella.live.server import Server, ServerSettings


VIEW_HOST = "127.0.0.1"
"""`view --host` opens another interface, for who wants that."""


COMPILING = "compiling the tracking method; tracking begins by itself"
BEGIN_IN_S = 2.0
"""From the moment that every node is ready until their sources begin: they join the bus meanwhile."""


@dataclass
class LiveSession:
    """A server with its view and the nodes that were started with it.

    Attributes:
        server: of the session.
        view: its process.
        nodes: their processes.
        stop: ends the session.
        compilation: of the method's kernels; tracking begins after it. None if they are compiled.
        begins: whether tracking begins by itself then.
    """

    server: Server
    view: Children
    nodes: Children
    stop: threading.Event
    compilation: Compilation | None = None
    begins: bool = True

    def begin_if_compiled(self) -> None:
        """Start tracking as soon as the method's kernels are compiled."""
        from mocapella.tracker import warm_up

        if self.compilation is not None and self.compilation.done:
            self.compilation = None
            warm_up(self.server.status().setup.method)
            if self.begins:
                self.server.begin()


def say_url(url: str) -> None:
    """Where the live view is, as a line for a person."""
    say(f"live view: {url}")


@contextmanager
def live_session(
    settings: ServerSettings,
    stop: threading.Event,
    *,
    view_port: int | None,
    on_url: Callable[[str], None] = say_url,
    view_words: Sequence[str] = (),
    track_at_once: bool = False,
) -> Iterator[LiveSession]:
    """A server and its view (unless ``view_port`` is None), which ``stop`` ends; all closed at the end.

    On the first start, the method's kernels are compiled while sensors connect and the view shows them; tracking begins
    afterwards (`wait_while`).

    Args:
        settings: of the server.
        stop: ends the session.
        view_port: of the view; None without a view.
        on_url: is called with the view's URL.
        view_words: further options of ``mocapella view``.
        track_at_once: compile before the server listens, so that every frame is tracked.
    """
    from mocapella.live.compilation import Compilation
    from mocapella.live.launch import Children, check_port_free
    from mocapella.live.server import Server
    from mocapella.live.session import Session
    from mocapella.tracker import is_compiled

    if view_port is not None:
        check_port_free(VIEW_HOST, view_port, "--view-port")
    host, _, port = settings.listen.removeprefix("tcp/").rpartition(":")
    if ":" not in host:  # IPv6: the server says it, a little later
        check_port_free(host, int(port), "--port")
    Session(settings.setup, settings.method_settings, layout=settings.layout)  # refuses what cannot be used
    compiled = is_compiled(settings.setup.method)
    if track_at_once and not compiled:
        get_ready(settings.setup.method)
        compiled = True
    # Two threads that compute (the tracker's and the recorder's) share one interpreter; the default of 5 ms between
    # switches would be half of the latency that a result may have.
    sys.setswitchinterval(0.0005)
    with ExitStack() as stack:
        compilation, begins = None, settings.running
        if not compiled:
            say(f"compiling the method {settings.setup.method} for this machine, this once; tracking begins afterwards")
            compilation = stack.enter_context(Compilation(settings.setup.method))
            if begins:
                settings = replace(settings, running=False, waiting_for=COMPILING)
        server = Server(settings, say=say)
        stack.callback(server.close)
        view = stack.enter_context(Children())
        if view_port is not None:
            arguments = ["view", "--connect", settings.listen, "--port", str(view_port), "--host", VIEW_HOST]
            view.start([*arguments, *view_words], lambda line: _pass_on(line, on_url))
        nodes = stack.enter_context(Children())
        yield LiveSession(server, view, nodes, stop, compilation, begins)


def _pass_on(line: str, on_url: Callable[[str], None]) -> None:
    if line.startswith("view: http"):
        on_url(line.removeprefix("view: "))
    elif line:
        say(line)


def _check_save_layout(path: Path | None) -> Path | None:
    """Refuse, before anything is done, a file that could not be written at the end."""
    if path is not None and (path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK)):
        raise SettingsError(
            f"--save-layout {path}: cannot be written there; name a file in a folder that you may write to"
        )
    return path


class LayoutKeeper:
    """Saves a server's sensor layout to a file."""

    def __init__(self, server: Server, path: Path) -> None:
        self._server = server
        self._path = path
        self._placed: set[str] = set()

    def watch(self) -> bool:
        """Save where there is a sensor that was not placed before; False, for it ends nothing."""
        layout = self._server.layout()
        if layout is not None and not layout.sensors.keys() <= self._placed:
            self._save(layout)
        return False

    def save(self) -> None:
        """Save the layout known now; without one, the file is left unchanged."""
        layout = self._server.layout()
        if layout is None:
            say(f"no sensor layout saved to {self._path}: no two sensors have been placed; walk where both see you")
        else:
            self._save(layout)

    def _save(self, layout: SensorLayout) -> None:
        from mocapella.calibration.sensor_layout import save_layout

        self._placed = set(layout.sensors)
        try:
            save_layout(self._path, layout)
        except MocapellaError as error:
            say(str(error))
        else:
            say(f"sensor layout saved to {self._path}: {', '.join(layout.sensors)}")


@app.command(rich_help_panel=LIVE)
def serve(
    port: BusPort = DEFAULT_PORT,
    view_port: ViewPort = DEFAULT_VIEW_PORT,
    no_view: NoView = False,
    interface: Annotated[
        str,
        typer.Option(
            "--interface",
            "--host",
            metavar="HOST",
            help="Interface that sensors connect to; others than 127.0.0.1 are open to your network.",
        ),
    ] = "127.0.0.1",
    sensors: Annotated[
        int, typer.Option(metavar="NUMBER", min=1, help="How many sensors to wait for before calibrating.")
    ] = 1,
    method: Method = "default",
    settings: MethodSettings = None,
    record: RecordTo = None,
    takes: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Where the takes go that the view or `mocapella record` begin.")
    ] = Path("takes"),
    wait: Annotated[
        bool, typer.Option("--wait", help="Begin stopped; track when Start is pressed in the view.")
    ] = False,
    reserve_gib: Annotated[
        float, typer.Option(metavar="GIB", min=0, help="Free disk space that a recording leaves, in GiB.")
    ] = 1.0,
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Camera rig: lenses and poses of the cameras (TOML), as `mocapella calibrate cameras` found them. For "
            "--method hands, which needs one, and arms.",
        ),
    ] = None,
    layout: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Begin from a sensor layout: poses of the sensors (JSON), as --save-layout saved them. For --method "
            "default, which checks them against people's motion and finds those anew that do not fit, and arms.",
        ),
    ] = None,
    hand: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Whose hand it is, for --method hands (JSON); an average one where left out."
        ),
    ] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PERSON=]FILE[:FRAME]",
            help="Where people are at first, for --method silhouettes: JSON of named joints in metres, or an earlier "
            "result of `mocapella track silhouettes`; may be repeated.",
        ),
    ] = None,
    alignment: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Another tracker's space, as `mocapella calibrate space` found it, for --method hands; repeatable.",
        ),
    ] = None,
    file: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=PATH", help="Another file that the method wants; may be repeated."),
    ] = None,
    save_layout: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Save the sensor layout to this file (JSON) whenever another sensor is placed, and at the end. May be "
            "the file of --layout. For --method default and arms.",
            callback=_check_save_layout,
        ),
    ] = None,
    save_rig: Annotated[
        Path | None, typer.Option(metavar="FILE", hidden=True, help="Former name of --save-layout.")
    ] = None,
    seconds: Seconds = None,
    json: JsonOut = None,
) -> None:
    """Wait for any number of sensors, track the people, and show them.

    Sensors may come before or after the server, and leave and return. Ctrl-C closes a take properly; a take that was
    cut off (kill -9, power) is continued by the same command.

    Example:  mocapella serve --sensors 2 --record walk-1
    """
    from mocapella.live.server import ServerSettings
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.session import Setup
    from mocapella.recording.disk import GIB
    from mocapella.tracker.method import METHODS

    if save_rig is not None:
        raise SettingsError(f"--save-rig is now called --save-layout: write --save-layout {save_rig}")
    if save_layout is not None and not METHODS.find(method).keeps_layout:
        keep = [one.name for one in METHODS.values() if one.keeps_layout]
        raise SettingsError(
            f"--save-layout: the method {method} finds no sensor layout; methods that do: {', '.join(keep)}"
        )
    files = {
        "rig": rig,
        "hand": hand,
        "alignment": alignment,
        "start": list(map(Path, start or ())),
        **_named_files(file),
    }
    take = None if record is None else take_file(record)
    warn_if_open("sensors, results and commands are", interface, port)
    server_settings = ServerSettings(
        listen=f"tcp/{interface}:{port}",
        takes=takes,
        setup=Setup(method=method, sensors_expected=sensors),
        running=not wait,
        method_settings=merged(settings_of_pairs(settings), settings_of_files(method, files)),
        reserve_bytes=round(reserve_gib * GIB),
        layout=None if layout is None else load_layout_option(layout),
    )
    with stop_on_signals() as stop:
        with live_session(server_settings, stop, view_port=None if no_view else view_port) as session:
            if take is not None:
                say(session.server.record_to(take, resume=True))
            say(f"waiting for sensors at {server_settings.listen} (Ctrl-C ends)")
            if save_layout is None:
                wait_while(session, seconds)
            else:
                keeper = LayoutKeeper(session.server, save_layout)
                wait_while(session, seconds, until=keeper.watch)
                keeper.save()
            summary = finish(session.server)
        write_json(json, summary)
    exit_by(summary["recording"])


def load_layout_option(path: Path) -> SensorLayout:
    """Read the sensor layout of ``--layout``.

    Raises:
        InputError: the file cannot be read, or is no layout; of a camera rig, it names ``--rig``.
    """
    from mocapella.calibration.sensor_layout import load_layout
    from mocapella.model.camera_rig_file import is_camera_rig

    try:
        return load_layout(path)
    except InputError:
        if is_camera_rig(_text(path)):
            raise InputError("is a camera rig", file=path, fix="use --rig") from None
        raise


def _text(path: Path) -> str:
    """The text of a file; empty where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


def settings_of_files(method: str, files: Mapping[str, Path | Sequence[Path] | None]) -> dict[str, Any]:
    """Read the files given to a method into settings, which a take stores for its replay.

    Args:
        method: name of the tracking method.
        files: one or several, by option; None or none where it is not given.

    Raises:
        SettingsError: the method wants no such file; says which methods do.
        InputError: a file cannot be used.
    """
    from mocapella.registry import load
    from mocapella.tracker.method import METHODS

    told: dict[str, Any] = {}
    for option, given in files.items():
        paths = [given] if isinstance(given, Path) else list(given or ())
        if not paths:
            continue
        readers = METHODS.find(method).files
        if option not in readers:
            able = [one.name for one in METHODS.values() if option in one.files]
            for other in able[:1]:
                load(METHODS[other].files[option])(paths)  # a fault of the file itself is raised first
            wanted = f"methods that do: {', '.join(able)}" if able else "no method does"
            raise SettingsError(f"--{option} {paths[0]}: the method {method} wants no such file; {wanted}")
        told = merged(told, load(readers[option])(paths))
    return told


def _named_files(pairs: Sequence[str] | None) -> dict[str, list[Path]]:
    """Of ``--file NAME=PATH``, by name."""
    found: dict[str, list[Path]] = {}
    for pair in pairs or ():
        name, equals, path = pair.partition("=")
        if not (name and equals and path):
            raise SettingsError(f"--file {pair!r} cannot be used; write it as NAME=PATH")
        found.setdefault(name, []).append(Path(path))
    return found


def finish(server: Server) -> dict[str, Any]:
    """Close the server and say what the session came to; returns that, and how its take ended, as for ``--json``."""
    server.halt()  # or the take could have a result more than the summary
    summary = _summary(server)
    recording = recording_row(server.close())
    say(
        f"{summary['seconds']:.0f} s, sensors: {len(summary['sensors'])}, frames in: {summary['frames_in']}, "
        f"dropped: {summary['drops']}, scenes out: {summary['frames_out']}, " + most_of(summary)
    )
    say_if_never_tracked(summary)
    return {**summary, "recording": recording}


def _summary(server: Server) -> dict[str, Any]:
    from mocapella.model.scene import Phase, TrackerState

    status = server.status()
    rows = [
        {
            "name": sensor.name,
            "rate_hz": sensor.rate_hz,
            "frames": sensor.frames,
            "drops": sensor.dropped,
            "rejected": sensor.rejected,
            "clock_offset_ms": None if sensor.clock_offset is None else round(sensor.clock_offset * 1e3, 4),
            "clock_bound_ms": None if sensor.clock_bound is None else round(sensor.clock_bound * 1e3, 4),
            "bodies": sensor.bodies,
        }
        for sensor in status.sensors
    ]
    last = TrackerState(
        Phase(status.phase), status.sensors_missing, status.frames_remaining, status.frames_wanted, status.reason
    )
    return {
        "seconds": status.uptime,
        "sensors": rows,
        "drops": sum(row["drops"] for row in rows),
        **server.summary.as_json(last),
    }


def start_together(session: LiveSession, nodes: list[list[str]]) -> None:
    """Start ``mocapella node`` processes, and let their sources begin at one time, when the slowest is ready.

    Raises:
        MocapellaError: the server has failed.
    """
    ready: list[str] = []

    def hear(line: str) -> None:
        if line == READY:
            ready.append(line)
        else:
            say(line)

    with console.status("starting the sensors …"):
        for words in nodes:
            session.nodes.start(["node", *words, "--epoch-from-input"], hear)
        wait_while(session, None, until=lambda: len(ready) == len(nodes) or session.nodes.any_ended())
    session.nodes.tell(str(time.time() + BEGIN_IN_S))


def wait_while(session: LiveSession, seconds: float | None, until: Callable[[], bool] = lambda: False) -> None:
    """Wait for Ctrl-C, ``until``, or the end of the time, which begins when the method is compiled.

    A view that ends by itself is reported; the session goes on.

    Raises:
        MocapellaError: the server has failed.
    """
    deadline: float | None = None
    view_is_there = True
    while not session.stop.wait(0.1):
        session.begin_if_compiled()
        if deadline is None and seconds is not None and session.compilation is None:
            deadline = time.monotonic() + seconds
        if view_is_there and session.view.any_ended():
            view_is_there = False
            say("the live view has ended; the session goes on, and `mocapella view` shows it again")
        if session.server.failed.is_set():
            raise MocapellaError("the server failed (see above); what was recorded is safe")
        if until() or (deadline is not None and time.monotonic() >= deadline):
            return
