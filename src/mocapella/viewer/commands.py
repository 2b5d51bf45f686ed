"""Send commands to the server, and show its answers, without blocking the drawing."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final, NamedTuple

import viser

from mocapella.errors import MocapellaError
from mocapella.model.session import CommandReply

SendCommand = Callable[[str, dict[str, Any]], CommandReply]
"""Sends a command with its arguments to the server and returns the reply; may block."""

MOST_WAITING: Final = 8
"""Largest number of waiting commands of one browser."""
_SECONDS_SHOWN = 8.0


class _Waiting(NamedTuple):
    verb: str
    arguments: dict[str, Any]


class Commander:
    """Sends the commands of all browsers to the server, one at a time, on its own thread.

    Browsers take turns; each browser's commands keep their order. At most `MOST_WAITING` commands of a browser wait;
    further ones, and repetitions of a waiting one, are dropped.

    Args:
        command: sends a command with its arguments to the server and returns the reply; may block. A `MocapellaError`
            is shown as a failed command.
    """

    def __init__(self, command: SendCommand) -> None:
        self._command = command
        self._waiting: dict[viser.ClientHandle, deque[_Waiting]] = {}  # in the order of the turns
        self._lock = threading.Lock()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="view-command")

    def send(self, verb: str, arguments: dict[str, Any], client: viser.ClientHandle) -> None:
        """Queue a command without blocking, unless it is dropped (see `Commander`); the browser shows the reply later.

        Args:
            verb: the command, such as ``finish-calibration``.
            arguments: its arguments by name.
            client: viser's connection to the browser that sends it. A success without a message shows nothing.
        """
        with self._lock:
            own = self._waiting.get(client, deque())
            if _Waiting(verb, arguments) in own or len(own) >= MOST_WAITING:
                return
            self._waiting.setdefault(client, own).append(_Waiting(verb, arguments))
        self._worker.submit(self._next).add_done_callback(_raise_again)

    def forget(self, client: viser.ClientHandle) -> None:
        """Drop the waiting commands of a browser that has disconnected."""
        with self._lock:
            self._waiting.pop(client, None)

    def close(self) -> None:
        """Send no more commands; drop the waiting ones, without waiting for the one under way."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _next(self) -> None:
        with self._lock:
            if not self._waiting:  # the command was dropped with its browser
                return
            client = next(iter(self._waiting))
            own = self._waiting.pop(client)
            command = own.popleft()
            if own:
                self._waiting[client] = own
        self._carry_out(*command, client)

    def _carry_out(self, verb: str, arguments: dict[str, Any], client: viser.ClientHandle) -> None:
        try:
            reply = self._command(verb, arguments)
        except MocapellaError as error:
            reply = CommandReply(ok=False, message=str(error))
        if not reply.ok or reply.message:
            notify(client, f"{_title(verb)}{'' if reply.ok else ': not done'}", reply.message, ok=reply.ok)


def notify(client: viser.ClientHandle, title: str, message: str, *, ok: bool) -> None:
    """Show a short notice in one browser; ``ok`` is False for an error."""
    client.add_notification(
        title, message, auto_close_seconds=_SECONDS_SHOWN, color="teal" if ok else "red", with_close_button=True
    )


def _title(verb: str) -> str:
    return verb.replace("-", " ").capitalize()


def _raise_again(done: Future[None]) -> None:
    """Raise an unexpected error of a task, so that it is logged."""
    if not done.cancelled():
        done.result()
