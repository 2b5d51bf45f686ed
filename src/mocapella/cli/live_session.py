"""A live session, which `serve`, `demo` and `replay --live` share: a server with its view, and nodes beside it."""

from __future__ import annotations

import gc
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from mocapella.cli.common import (
    PAGE_DRAWN,
    WATCH_URL,
    console,
    get_ready,
    most_of,
    recording_row,
    say,
    say_if_never_tracked,
    show,
)
from mocapella.cli.nodes import READY
from mocapella.errors import MocapellaError

if TYPE_CHECKING:
    from mocapella.live.compilation import Compilation
    from mocapella.live.launch import Children
    from mocapella.live.server import Server, ServerSettings
    from mocapella.live.thread_deaths import StopEvent
    from mocapella.wire.address import Address
    from mocapella.wire.server import ServerLink

VIEW_HOST = "127.0.0.1"
"""Network interface of the view that a session starts; `mocapella view --host` can serve on another."""
PAGE_WAIT_S = 10.0
"""Longest time from the output of the view's URL for which a compilation waits for a browser to draw the view [s]."""
BEGIN_IN_S = 1.0
"""Delay between the readiness of all nodes and the common start of their sources [s]."""


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
    _progress: str = ""

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
        self._tell_progress(self.compilation.progress)
        if self.compilation.done:
            self.compilation = None
            warm_up(self.server.status().setup.method)
            gc.freeze()
            self.server.ready(begin=self.begins)

    def _tell_progress(self, progress: str) -> None:
        if progress != self._progress:
            self._progress = progress
            self.server.wait_for(compiling(progress, begins=self.begins))


def compiling(progress: str, *, begins: bool) -> str:
    """Return the reason why a session does not track while its method is compiled.

    Args:
        progress: number of compiled kernels (`Compilation.progress`); empty before the first.
        begins: whether tracking begins by itself afterwards.
    """
    then = "tracking begins by itself" if begins else "then press Start"
    return f"compiling the tracking method{f' ({progress})' if progress else ''}; {then}"


def say_url(url: str) -> None:
    """Print the live view's URL as a line for the user."""
    say(f"live view: {url}")


@contextmanager
def live_session(
    settings: ServerSettings,
    stop: StopEvent,
    *,
    view_port: int | None,
    on_url: Callable[[str], None] = say_url,
    tell_watch_url: bool = True,
    view_words: Sequence[str] = (),
    track_at_once: bool = False,
    link: ServerLink | None = None,
) -> Iterator[LiveSession]:
    """Run a server and its view (unless ``view_port`` is None) within this context, and close them at its end.

    If the method's kernels are not compiled yet, they are compiled while sensors connect and the view shows them;
    tracking begins afterwards. Call `wait_while` in the context, which controls this.

    Args:
        settings: settings of the server.
        stop: event that ends the session.
        view_port: TCP port of the view; None for no view.
        on_url: is called with the view's URL.
        tell_watch_url: whether the view's URL for watchers is printed.
        view_words: further options of ``mocapella view``.
        track_at_once: whether kernels are compiled before the server listens, so that every frame is tracked.
        link: the server's link, if it listens already; None to open one.

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
        check_bus_port(address)
    Session(settings.setup, settings.method_settings, layout=settings.layout)  # refuses what cannot be used
    compiled = is_compiled(settings.setup.method)
    if track_at_once and not compiled:
        get_ready(settings.setup.method)
        compiled = True
    # Two threads that compute (the tracker's and the recorder's) share one interpreter; the default of 5 ms between
    # switches would be half of the latency that a result may have.
    sys.setswitchinterval(0.0005)
    # Kernels and modules live until the end; a garbage collection that looks at them delays a frame by 0.1 s.
    gc.freeze()
    with ExitStack() as stack:
        compilation, begins = None, settings.running
        if not compiled:
            say(f"compiling the method {settings.setup.method} for this machine, this once; tracking begins afterwards")
            compilation = stack.enter_context(Compilation(settings.setup.method))
            settings = replace(settings, running=False, waiting_for=compiling("", begins=begins))
        settings = replace(settings, log=log_in_use())
        server = Server(settings, say=show, link=link, failed=stop.died)  # it logs its notices itself
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

            def hear(line: str) -> None:
                if tell_watch_url or not line.startswith(WATCH_URL):
                    _pass_on(line, show_url, shown.set)

            view.start([*arguments, *view_words], hear)
        nodes = stack.enter_context(Children())
        yield LiveSession(server, view, nodes, stop, compilation, begins, shown)


def check_bus_port(address: Address) -> None:
    """Check that a server can listen at an address of this machine.

    Raises:
        AddressInUseError, BusError: it cannot.
    """
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


def start_together(session: LiveSession, nodes: list[list[str]]) -> None:
    """Start nodes, and let their sources begin at the same time once all are ready.

    If a node ends or the session is stopped before, the other nodes' sources begin without waiting any longer.

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
        session.server.close()  # before view and nodes, which may take longer than this process has
        raise MocapellaError("the server failed, as its log says; its take is closed; start it again with another one")


def finish(server: Server) -> dict[str, Any]:
    """Stop and close the server; print a summary of the session.

    Returns:
        The summary as a JSON object for ``--json``, with the take's final state (`recording_row`) as ``recording``.
    """
    server.halt()  # or the take could have a result more than the summary
    summary = _summary(server)
    recording = recording_row(server.close())
    untracked = summary["frames_untracked"]
    stopped = f" ({untracked} while tracking was stopped)" if untracked else ""
    say(
        f"{summary['seconds']:.0f} s, sensors: {len(summary['sensors'])}, frames in: {summary['frames_in']}{stopped}, "
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
