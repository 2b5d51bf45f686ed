"""``mocapella serve``: track live with any number of sensors."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocapella.cli.app import LIVE, app
from mocapella.cli.command_settings import KeySpec, SettingsFile, read_settings, set_option
from mocapella.cli.common import (
    DEFAULT_PORT,
    DEFAULT_TAKES,
    DEFAULT_VIEW_PORT,
    LAYOUT,
    RIG_HELP,
    SECONDS_HELP,
    SESSION_SECONDS,
    START_FORM,
    START_HELP,
    BusPort,
    Host,
    JsonOut,
    Method,
    RecordTo,
    SensorsExpected,
    View,
    exit_by,
    method_keys,
    method_setting_names,
    record_file,
    say,
    write_json,
)
from mocapella.cli.live_session import LiveSession, check_bus_port, finish, live_session, wait_while
from mocapella.errors import InputError, MocapellaError, SettingsError
from mocapella.settings import merged

if TYPE_CHECKING:
    from mocapella.calibration.sensor_layout import SensorLayout
    from mocapella.live.server import Server
    from mocapella.live.study_service import StudyStore

FEW_NODES = 2
"""Largest number of commands for nodes that are named at the start; `mocapella node --help` lists all."""
_INVITE = (
    "sensors and readers on other machines need a key: `mocapella session invite sensor` here writes it, and "
    "`mocapella session join` there takes it (port {port} must be open to them)"
)


@dataclass(frozen=True)
class ServeKeys:
    """Settings of the command `serve`, for ``--set``."""

    seconds: Annotated[float | None, KeySpec(f"{SECONDS_HELP} {SESSION_SECONDS}", "s", above=0)] = None
    view_port: Annotated[int, KeySpec("TCP port of the live view.", "port", 1, 65535)] = DEFAULT_VIEW_PORT
    session: Annotated[
        str | None,
        KeySpec("Name of the session, whose key admits nodes and readers; by default MOCAPELLA_SESSION, or default."),
    ] = None
    wait: Annotated[bool, KeySpec("Begin stopped; tracking begins with Start in the view.")] = False
    takes: Annotated[Path, KeySpec("Folder of the takes.", "folder")] = DEFAULT_TAKES
    reserve_gib: Annotated[float, KeySpec("Free disk space that a recording leaves.", "GiB", least=0)] = 1.0
    layout: Annotated[Path | None, LAYOUT] = None
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
    """Saves a server's sensor layout, the estimated poses of the sensors, to the file ``path``, which it replaces.

    A file that cannot be written is reported to the user, and raises nothing.
    """

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
    sensors: SensorsExpected = 1,
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
    run_server(
        port=port, host=host, sensors=sensors, method=method, record=record, view=view,
        files=lambda: {"rig": rig, "start": list(map(Path, start or ())), **_named_files(file)},
        settings_file=settings_file, settings=settings, json=json,
    )  # fmt: skip


def run_server(
    *,
    port: int,
    host: str,
    sensors: int,
    method: str,
    view: bool,
    settings_file: Path | None,
    settings: list[str] | None,
    json: str | None,
    record: str | None = None,
    files: Callable[[], dict[str, Any]] = dict,
    store: Callable[[], StudyStore | None] = lambda: None,
) -> None:
    """Serve a session until it is stopped: `serve`, and `study run`.

    Args:
        port, host, sensors, method, record, view, settings_file, settings, json: options of `serve`.
        files: returns the method's files by name.
        store: returns where a study's session is kept; None without a study.
    """
    from mocapella.live.signals import stop_on_signals
    from mocapella.wire.address import Address, parse_address
    from mocapella.wire.server import ServerLink

    def read() -> tuple[ServeKeys, dict[str, Any]]:
        return read_settings(ServeKeys, settings_file, settings, method_setting_names(method))

    named = _session_of(settings) if settings_file is None else read()[0].session
    address = parse_address(str(Address(named or "", host, port)))
    check_bus_port(address)
    # It listens before the tracker is imported, which takes seconds: the nodes of a killed server connect meanwhile.
    with stop_on_signals() as stop, closing(ServerLink(str(address), on_nonsense=say)) as link:
        from mocapella.live.server import ServerSettings
        from mocapella.model.session import Setup
        from mocapella.recording.disk import GIB
        from mocapella.tracker.method_files import settings_of_files

        keys, method_settings = read()
        keys.check(method)
        take = None if record is None else record_file(record, keys.takes)
        server_settings = ServerSettings(
            listen=str(address),
            takes=keys.takes,
            setup=Setup(method=method, sensors_expected=sensors),
            running=not keys.wait,
            method_settings=merged(method_settings, settings_of_files(method, files())),
            reserve_bytes=round(keys.reserve_gib * GIB),
            layout=None if keys.layout is None else load_layout_option(keys.layout),
            record=take,
            study=store(),
        )
        view_port = keys.view_port if view else None
        with live_session(server_settings, stop, view_port=view_port, link=link) as session:
            if take is not None:
                say(f"recording {take}")
            say(f"waiting for sensors at {server_settings.listen} (Ctrl-C ends)")
            if hint := nodes_hint(method):
                say(hint)
            if not address.local:
                say(_INVITE.format(port=port))
            summary = _run_until_end(session, keys)
        write_json(json, summary)
    exit_by(summary["recording"])


def nodes_hint(method: str) -> str:
    """Return a line with the commands that send a method's main frames; empty if there are none or many."""
    from mocapella.model.frame_types import FRAME_TYPES
    from mocapella.sources.source import SOURCES
    from mocapella.tracker.method import METHODS

    main = METHODS.find(method).frame_types[0]
    taken = {name for name, one in FRAME_TYPES.items() if one.type is main}
    verbs = [name for name, source in SOURCES.items() if taken.intersection(source.frame_types)]
    if not 0 < len(verbs) <= FEW_NODES:
        return ""
    commands = " or ".join(f"mocapella node {verb} --help" for verb in verbs)
    return f"start a node for each sensor, in a terminal of its own: {commands}"


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


def _session_of(settings: Sequence[str] | None) -> str | None:
    """Return the session's name of ``--set``, without importing the method's settings."""
    named = [text.partition("=")[2] for text in settings or () if text.startswith("session=")]
    return named[-1] if named else None


def _named_files(pairs: Sequence[str] | None) -> dict[str, list[Path]]:
    """Return the paths of ``--file NAME=PATH`` by name."""
    found: dict[str, list[Path]] = {}
    for pair in pairs or ():
        name, equals, path = pair.partition("=")
        if not (name and equals and path):
            raise SettingsError(f"--file {pair!r} cannot be used; write it as NAME=PATH")
        found.setdefault(name, []).append(Path(path))
    return found
