"""Start and end child processes of Mocapella, with this Python interpreter."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from functools import partial
from types import TracebackType

from mocapella.errors import AddressInUseError, BusError
from mocapella.live.signals import STARTED_BY_US
from mocapella.supervision import Boundary


class Children:
    """Child processes, started by `start`, that end with the ``with`` block, or when this process is killed.

    At the end of the block, `close` terminates them. If this process is killed, their standard input is closed, and
    each child must then end by itself, as Mocapella's programs do.
    """

    def __init__(self) -> None:
        self._running: list[subprocess.Popen[str]] = []
        self._listeners: list[threading.Thread] = []

    def start(
        self, arguments: list[str], on_line: Callable[[str], None] = lambda line: None, *, module: str = "mocapella"
    ) -> None:
        """Start ``mocapella <arguments>``, or another module.

        Args:
            arguments: arguments of the command line.
            on_line: called with each line of output and errors, without its end, on a thread of its own.
            module: the Python module to run.
        """
        process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="backslashreplace",
            env={**os.environ, STARTED_BY_US: "1"},
        )
        self._running.append(process)
        listener = threading.Thread(target=_listen, args=(process, on_line), name="child output", daemon=True)
        listener.start()
        self._listeners.append(listener)

    def tell(self, line: str) -> None:
        """Write a line and a line end to the standard input of each process that still runs."""
        for process in self._running:
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(f"{line}\n")
                process.stdin.flush()

    def any_ended(self) -> bool:
        """Whether any process has ended; False without processes."""
        return any(process.poll() is not None for process in self._running)

    def all_ended(self) -> bool:
        """Whether every process has ended; True without processes."""
        return all(process.poll() is not None for process in self._running)

    def close(self, patience_s: float = 5.0) -> None:
        """Terminate all processes, wait up to ``patience_s`` seconds for each, and kill those that still run."""
        for process in self._running:
            if process.poll() is None:
                process.terminate()
        for process in self._running:
            try:
                process.wait(patience_s)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
        for listener in self._listeners:
            listener.join()

    def __enter__(self) -> Children:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _listen(process: subprocess.Popen[str], on_line: Callable[[str], None]) -> None:
    assert process.stdout is not None
    errors = Boundary()
    with process.stdout as lines:
        for line in lines:
            errors.run("output of a process", partial(on_line, line.rstrip("\n")))


def check_port_free(host: str, port: int, option: str) -> None:
    """Check that this program can listen on a TCP port.

    Args:
        host: IPv4 address or name to listen at.
        port: the port.
        option: command line option that sets the port, named in errors.

    Raises:
        AddressInUseError: another program uses it; names the port and the option for another.
        BusError: this program may not listen there, or this machine does not have the address.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise AddressInUseError(
                    f"port {port} on {host} is in use by another program; stop it, or choose another with {option}"
                ) from error
            raise BusError(
                f"cannot listen at port {port} on {host}: {error.strerror}; choose another with {option}"
            ) from error


def free_port() -> int:
    """Return a port of the loopback that no program listens on at present."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
