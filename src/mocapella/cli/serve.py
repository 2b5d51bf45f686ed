"""``mocapella serve``, and the live session that `demo` and `replay --live` share with it."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocapella.cli.app import LIVE, app
from mocapella.cli.command_settings import KeySpec, SettingsFile, read_settings, set_option
from mocapella.cli.common import (
    DEFAULT_PORT,
    DEFAULT_TAKES,
    DEFAULT_VIEW_PORT,
    PAGE_DRAWN,
    RIG_HELP,
    START_FORM,
    START_HELP,
    BusPort,
    Host,
    JsonOut,
    Method,
    RecordTo,
    View,
    console,
    exit_by,
    get_ready,
    method_keys,
    method_setting_names,
    most_of,
    record_file,
    recording_row,
    say,
    say_if_never_tracked,
    show,
    write_json,
)
from mocapella.cli.nodes import READY
from mocapella.errors import InputError, MocapellaError, SettingsError
from mocapella.settings import merged

if TYPE_CHECKING:
    from mocapella.calibration.sensor_layout import SensorLayout
    from mocapella.live.compilation import Compilation
    from mocapella.live.launch import Children
    from mocapella.live.server import Server, ServerSettings
    from mocapella.wire.address import Address
    from mocapella.wire.server import ServerLink


VIEW_HOST = "127.0.0.1"
"""Network interface of the view that a session starts; `mocapella view --host` can serve on another."""


COMPILING = "compiling the tracking method; tracking begins by itself"
COMPILING_STOPPED = "compiling the tracking method; then press Start"
_INVITE = (
    "sensors and readers on other machines need a key: `mocapella session invite sensor` here writes it, and "
    "`mocapella session join` there takes it (port {port} must be open to them)"
)
PAGE_WAIT_S = 10.0
"""Longest time for which a compilation waits for a browser to draw the view, from the view's URL on [s]."""
BEGIN_IN_S = 1.0
"""Time from the moment when every node is ready until their sources begin, so that they can join the bus [s]."""


@dataclass
class LiveSession:
    """A server, its view, and the nodes started with it.

    Attributes:
        server: server of the session.
        view: process of the view.
        nodes: processes of the nodes.
        stop: event that ends the session.
        compilation: compilation of the method's kernels, which must end before tracking can begin; None if they are
            compiled.
        begins: whether tracking begins by itself after the compilation.
        shown: event that is set when a browser draws the view, or `PAGE_WAIT_S` after the view has printed its URL;
            without a view, it is set from the beginning.
    """

    server: Server
    view: Children
    nodes: Children
    stop: threading.Event
    compilation: Compilation | None = None
    begins: bool = True
    shown: threading.Event = field(default_factory=threading.Event)

    def begin_if_compiled(self) -> None:
        """Start the compilation once the view is shown; when it is complete, allow tracking.

        If ``begins``, tracking starts then as well. Call this method repeatedly. A compilation takes all cores, so an
        earlier one would delay the view.
        """
        from mocapella.tracker import warm_up

        if self.compilation is None:
            return
        if self.shown.is_set() or self.view.any_ended():
            self.compilation.start()
        if self.compilation.done:
            self.compilation = None
            warm_up(self.server.status().setup.method)
            self.server.ready(begin=self.begins)


def say_url(url: str) -> None:
    """Print the live view's URL as a line for the user."""
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
    link: ServerLink | None = None,
) -> Iterator[LiveSession]:
    """Run a server and its view (unless ``view_port`` is None) within this context, and close them at its end.

    On the first start, the method's kernels are compiled while sensors connect and the view shows them; tracking begins
    afterwards (`wait_while`).

    Args:
        settings: settings of the server.
        stop: event that ends the session.
        view_port: TCP port of the view; None for no view.
        on_url: is called with the view's URL.
        view_words: further options of ``mocapella view``.
        track_at_once: whether kernels are compiled before the server listens, so that every frame is tracked.
        link: link of the server that listens already; None to make one.

    Raises:
        AddressInUseError, BusError: a port cannot be used.
        SettingsError: the setup or the method's settings are invalid.
    """
    from mocapella.live.compilation import Compilation
    from mocapella.live.launch import Children, check_port_free
    from mocapella.live.run_log import log_in_use
    from mocapella.live.server import Server
    from mocapella.live.session import Session
    from mocapella.tracker import is_compiled
    from mocapella.wire.address import parse_address
    from mocapella.wire.session_key import session_name

    if view_port is not None:
        check_port_free(VIEW_HOST, view_port, "--view-port")
    address = parse_address(settings.listen)
    if link is None:
        _check_bus_port(address)
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
            settings = replace(settings, running=False, waiting_for=COMPILING if begins else COMPILING_STOPPED)
        server = Server(replace(settings, log=log_in_use()), say=show, link=link)  # it logs its notices itself
        stack.callback(server.close)
        view = stack.enter_context(Children())
        shown = threading.Event()

        wait_for_page = threading.Timer(PAGE_WAIT_S, shown.set)
        wait_for_page.daemon = True
        stack.callback(wait_for_page.cancel)

        def show_url(url: str) -> None:
            on_url(url)
            wait_for_page.start()

        if view_port is None:
            shown.set()
        else:
            own = str(address._replace(session=session_name(address.session)))  # not a key that was paired
            arguments = ["view", "--connect", own, "--view-port", str(view_port), "--host", VIEW_HOST]
            view.start([*arguments, *view_words], lambda line: _pass_on(line, show_url, shown.set))
        nodes = stack.enter_context(Children())
        yield LiveSession(server, view, nodes, stop, compilation, begins, shown)


def _check_bus_port(address: Address) -> None:
    from mocapella.live.launch import check_port_free

    if ":" not in address.host:  # IPv6: the server says it, a little later
        check_port_free(address.host, address.port, "--port")


def _pass_on(line: str, on_url: Callable[[str], None], on_page: Callable[[], None]) -> None:
    if line.startswith("view: http"):
        on_url(line.removeprefix("view: "))
    elif line == PAGE_DRAWN:
        on_page()
    elif line:
        say(line)


@dataclass(frozen=True)
class ServeKeys:
    """Settings of the command `serve`, for ``--set``."""

    seconds: Annotated[float | None, KeySpec("Stop after this time; without it, at Ctrl-C.", "s", least=0)] = None
    view_port: Annotated[int, KeySpec("TCP port of the live view.", "port", 1, 65535)] = DEFAULT_VIEW_PORT
    session: Annotated[
        str | None,
        KeySpec("Name of the session, whose key admits nodes and readers; by default MOCAPELLA_SESSION, or default."),
    ] = None
    wait: Annotated[bool, KeySpec("Begin stopped; tracking begins with Start in the view.")] = False
    takes: Annotated[Path, KeySpec("Folder of the takes.", "folder")] = DEFAULT_TAKES
    reserve_gib: Annotated[float, KeySpec("Free disk space that a recording leaves.", "GiB", least=0)] = 1.0
    layout: Annotated[
        Path | None,
        KeySpec(
            "Begin from this sensor layout (JSON), which is checked against people's motion; default, arms.", "file"
        ),
    ] = None
    save_layout: Annotated[
        Path | None,
        KeySpec("Save the sensor layout here whenever a sensor is placed, and at the end; default, arms.", "file"),
    ] = None

    def check(self, method: str) -> None:
        """Check that ``save_layout`` can be written, and that the tracking method ``method`` has a sensor layout.

        Raises:
            SettingsError: the method has no sensor layout, or the file cannot be written.
        """
        from mocapella.tracker.method import METHODS

        path = self.save_layout
        if path is None:
            return
        if path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
            raise SettingsError(
                f"save_layout {path}: cannot be written there; name a file in a folder that you may write to"
            )
        if not METHODS.find(method).keeps_layout:
            keep = [one.name for one in METHODS.values() if one.keeps_layout]
            raise SettingsError(
                f"save_layout: the method {method} finds no sensor layout; methods that do: {', '.join(keep)}"
            )


class LayoutKeeper:
    """Saves a server's sensor layout, the estimated poses of the sensors, to the file ``path``."""

    def __init__(self, server: Server, path: Path) -> None:
        self._server = server
        self._path = path
        self._placed: set[str] = set()

    def watch(self) -> bool:
        """Save the layout if it has a sensor that was not saved before.

        Returns:
            False, so that it can be the argument ``until`` of `wait_while`.
        """
        layout = self._server.layout()
        if layout is not None and not layout.sensors.keys() <= self._placed:
            self._save(layout)
        return False

    def save(self) -> None:
        """Save the present layout; if there is none, print a note and leave the file unchanged."""
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
    host: Host = "127.0.0.1",
    sensors: Annotated[
        int, typer.Option(metavar="NUMBER", min=1, help="Number of sensors to wait for before calibrating.")
    ] = 1,
    method: Method = "default",
    record: RecordTo = None,
    view: View = True,
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} The method hands needs it.")
    ] = None,
    start: Annotated[list[str] | None, typer.Option("--start", metavar=START_FORM, help=START_HELP)] = None,
    file: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=PATH",
            help="Another file for the method: hand=FILE of `mocapella calibrate hand`, alignment=FILE of `mocapella "
            "calibrate space`, or a plug-in's. Repeatable.",
        ),
    ] = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(ServeKeys, method_keys)] = None,
    json: JsonOut = None,
) -> None:
    """Track people live with any number of sensors, and show them.

    Sensors may start before or after the server, and leave and return. Ctrl-C closes a take. The same command continues
    a take that was interrupted (kill -9, power failure).

    Example:  mocapella serve --sensors 2 --record walk-1
    """
    from mocapella.live.signals import stop_on_signals
    from mocapella.wire.address import Address, parse_address
    from mocapella.wire.server import ServerLink

    def read() -> tuple[ServeKeys, dict[str, Any]]:
        return read_settings(ServeKeys, settings_file, settings, method_setting_names(method))

    named = _session_of(settings) if settings_file is None else read()[0].session
    address = parse_address(str(Address(named or "", host, port)))
    _check_bus_port(address)
    # It listens before the tracker is imported, which takes seconds: the nodes of a killed server connect meanwhile.
    with stop_on_signals() as stop, closing(ServerLink(str(address), on_nonsense=say)) as link:
        from mocapella.live.server import ServerSettings
        from mocapella.model.session import Setup
        from mocapella.recording.disk import GIB

        keys, method_settings = read()
        keys.check(method)
        files = {"rig": rig, "start": list(map(Path, start or ())), **_named_files(file)}
        take = None if record is None else record_file(record, keys.takes)
        server_settings = ServerSettings(
            listen=str(address),
            takes=keys.takes,
            setup=Setup(method=method, sensors_expected=sensors),
            running=not keys.wait,
            method_settings=merged(method_settings, settings_of_files(method, files)),
            reserve_bytes=round(keys.reserve_gib * GIB),
            layout=None if keys.layout is None else load_layout_option(keys.layout),
        )
        view_port = keys.view_port if view else None
        with live_session(server_settings, stop, view_port=view_port, link=link) as session:
            if take is not None:
                say(session.server.record_to(take, resume=True))
            say(f"waiting for sensors at {server_settings.listen} (Ctrl-C ends)")
            if not address.local:
                say(_INVITE.format(port=port))
            summary = _run_until_end(session, keys)
        write_json(json, summary)
    exit_by(summary["recording"])


def _run_until_end(session: LiveSession, keys: ServeKeys) -> dict[str, Any]:
    if keys.save_layout is None:
        wait_while(session, keys.seconds)
        return finish(session.server)
    keeper = LayoutKeeper(session.server, keys.save_layout)
    wait_while(session, keys.seconds, until=keeper.watch)
    keeper.save()
    return finish(session.server)


def load_layout_option(path: Path) -> SensorLayout:
    """Read the sensor layout from the JSON file of the setting ``layout``.

    Raises:
        InputError: the file cannot be read, or is no sensor layout; for a camera rig, the message names ``--rig``.
    """
    from mocapella.calibration.sensor_layout import load_layout

    try:
        return load_layout(path)
    except InputError:
        if _is_rig(path):
            raise InputError("is a camera rig", file=path, fix="use --rig") from None
        raise


def _is_rig(path: Path) -> bool:
    from mocapella.decoding import read_whole
    from mocapella.model.camera_rig_file import is_camera_rig

    try:
        return is_camera_rig(read_whole(path, fix=""))
    except InputError:
        return False


def settings_of_files(method: str, files: Mapping[str, Path | Sequence[Path] | None]) -> dict[str, Any]:
    """Read a tracking method's files, such as a camera rig, into settings, which a take stores for its replay.

    Args:
        method: name of the tracking method.
        files: one or several paths by the option's name, such as ``rig``; None or empty for options not given.

    Raises:
        SettingsError: the method does not use such a file; names the methods that do.
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
            name = f"--{option} {paths[0]}" if option in ("rig", "start") else f"--file {option}={paths[0]}"
            raise SettingsError(f"{name}: the method {method} wants no such file; {wanted}")
        told = merged(told, load(readers[option])(paths))
    return told


def _session_of(settings: Sequence[str] | None) -> str | None:
    """Return the session's name of ``--set``, without importing the method's settings."""
    named = [text.partition("=")[2] for text in settings or () if text.startswith("session=")]
    return named[-1] if named else None


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
    """Stop and close the server; print a summary of the session.

    Returns:
        The summary as a JSON object for ``--json``, with the take's final state (`recording_row`) as ``recording``.
    """
    server.halt()  # or the take could have a result more than the summary
    summary = _summary(server)
    recording = recording_row(server.close())
    say(
        f"{summary['seconds']:.0f} s, sensors: {len(summary['sensors'])}, frames in: {summary['frames_in']}, "
        f"dropped: {summary['drops']}, scenes out: {summary['frames_out']}, " + most_of(summary)
    )
    for problem in server.server_health().problems():
        say(problem)
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
            "behind": sensor.behind,
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
        "turned_away": status.health.turned_away,
        **server.summary.as_json(last),
    }


def start_together(session: LiveSession, nodes: list[list[str]]) -> None:
    """Start nodes, and let their sources begin at the same time once all are ready.

    Args:
        session: the session; its ``nodes`` get the processes.
        nodes: arguments of ``mocapella node`` for each node.

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
    """Wait until the session is stopped, such as by Ctrl-C, until a condition is true, or until a time has passed.

    If the view ends by itself, this is reported, and the session continues.

    Args:
        session: the session; `LiveSession.begin_if_compiled` is called repeatedly.
        seconds: time from the end of the compilation until the return [s]; None for no limit.
        until: condition that ends the waiting, called ten times a second.

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
            session.server.part_ended("view")
            say("the live view has ended; the session goes on, and `mocapella view` shows it again")
        if until() or (deadline is not None and time.monotonic() >= deadline):
            break
        if session.server.failed.is_set():
            break
    if session.server.failed.is_set():  # a thread died, and has set `stop`
        raise MocapellaError("the server failed, as its log says; the take is closed; start it again to continue it")
