"""The pages of a study: the researcher's at ``/study``, and the participant's screen at ``/participant``.

Both show the instruction, large enough to read from four metres, and a map of the marked floor. The researcher's also
has the controls, the progress and the checks of the data. A socket pushes the state to them and takes the commands.
"""

from __future__ import annotations

import asyncio
import contextlib
from importlib.resources import files
from typing import Annotated, Any, Final, Protocol

import msgspec
from msgspec import Meta
from websockets.exceptions import ConnectionClosed

from mocapella.decoding import decode_json
from mocapella.errors import InputError, MocapellaError
from mocapella.model.session import CommandReply
from mocapella.model.study_status import LiveCheck, StudyStatus
from mocapella.viewer.commands import SendCommand
from mocapella.viewer.page_refusals import PageRefusals

PAGES: Final = {"/study": "researcher", "/participant": "participant"}
"""Class of the page's body by its path."""
SOCKET: Final = "/study/socket"
PUSH_EVERY_S: Final = 0.05
"""Interval at which a socket looks for a new state [s]."""
HEARTBEAT_S: Final = 0.5
"""Interval at which the state is sent again, so that a page knows that its server is there [s]."""


class _Command(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    verb: Annotated[str, Meta(pattern=r"^study-[a-z]{1,20}$")]
    arguments: dict[Annotated[str, Meta(max_length=40)], Annotated[str, Meta(max_length=500)]] = {}


class PageConnection(Protocol):
    """A page's open socket."""

    operates: bool

    async def send(self, message: str) -> None:
        """Send a text."""

    async def recv(self) -> Any:
        """Return the next message, as bytes."""


class StudyPages:
    """Serves the pages of a study; `show` is called on the drawing thread, the rest on the page's own.

    Args:
        send: sends a command with its arguments to the server and returns the reply; may block. None takes no commands.
        refusals: counts messages that are refused, as ``message``.
    """

    def __init__(self, send: SendCommand | None, refusals: PageRefusals) -> None:
        self._send, self._refusals = send, refusals
        self._shown: tuple[StudyStatus | None, LiveCheck | None] = (None, None)

    def show(self, study: StudyStatus | None, check: LiveCheck | None) -> None:
        """Show a state on all pages; None while the session runs no study."""
        if (study, check) != self._shown:  # else it is sent at the next heartbeat
            self._shown = (study, check)

    def page(self, path: str) -> bytes | None:
        """Return the HTML of a page by its path; None if there is none."""
        kind = PAGES.get(path)
        if kind is None:
            return None
        text = files("mocapella.viewer").joinpath("study.html").read_text(encoding="utf-8")
        return text.replace('class="MODE"', f'class="{kind}"', 1).encode()

    async def serve(self, connection: PageConnection) -> None:
        """Serve one page's socket until it is closed: push states, and carry out the commands of an operator."""
        pushing = asyncio.create_task(self._push(connection))
        try:
            with contextlib.suppress(ConnectionClosed):
                while True:
                    await self._take(connection, await connection.recv())
        finally:
            pushing.cancel()

    async def _push(self, connection: PageConnection) -> None:
        loop, sent, at_s = asyncio.get_running_loop(), None, 0.0
        with contextlib.suppress(ConnectionClosed):
            while True:
                shown, now_s = self._shown, loop.time()
                if shown is not sent or now_s - at_s >= HEARTBEAT_S:
                    state = {"study": shown[0], "check": shown[1], "operates": self._may(connection)}
                    await connection.send(_text({"state": state}))
                    sent, at_s = shown, now_s
                await asyncio.sleep(PUSH_EVERY_S)

    def _may(self, connection: PageConnection) -> bool:
        return connection.operates and self._send is not None

    async def _take(self, connection: PageConnection, data: bytes) -> None:
        try:
            command = decode_json(data, _Command, what="message of a study's page")
        except InputError as error:
            self._refusals.add("message", f"a page's message cannot be used: {error}"[:200])
            return
        if self._send is None or not connection.operates:
            reply = CommandReply(False, "this page only watches; open the address with the operator's token")
        else:
            reply = await asyncio.to_thread(_carried_out, self._send, command)
        await connection.send(_text({"reply": {"ok": reply.ok, "message": reply.message}}))


def _carried_out(send: SendCommand, command: _Command) -> CommandReply:
    try:
        return send(command.verb, dict(command.arguments))
    except MocapellaError as error:
        return CommandReply(False, str(error))


def _text(values: dict[str, Any]) -> str:
    return msgspec.json.encode(values).decode()
