"""Queue of commands between the bus's threads and the tracker's: bounded, for each client and together.

Commands change the session, such as ``start`` or ``recalibrate``; the tracker's thread carries them out between frames.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from mocapella.model.limits import MOST_COMMANDS, MOST_COMMANDS_OF_A_CLIENT

Answer = Callable[[bytes], None]
"""Sends the reply to a command; called once. A `mocapella.wire.server.Answer` also has ``client`` and ``sender``."""


@dataclass
class WaitingCommand:
    """A command that waits for the tracker.

    Attributes:
        verb: name of the command.
        arguments: its arguments, by name.
        answers: functions that answer it; several if a client sent the same command several times.
    """

    verb: str
    arguments: dict[str, Any]
    answers: list[Answer] = field(default_factory=list)

    def answer(self, data: bytes) -> None:
        """Send the encoded reply to all who sent the command."""
        for answer in self.answers:
            answer(data)

    @property
    def sender(self) -> str:
        """Program, user and machine that first sent the command, as stated by the program; empty if not stated."""
        return str(getattr(self.answers[0], "sender", "")) if self.answers else ""


def client_of(answer: Answer) -> str:
    """Return the identity that a command's sender claims, from the function that answers it; empty if none."""
    return str(getattr(answer, "client", ""))


class CommandQueue:
    """Commands in the order of their arrival, at most `MOST_COMMANDS`, and `MOST_COMMANDS_OF_A_CLIENT` of one client.

    A command that equals the last waiting one, of the same named client, is carried out once, and both are answered.
    Any thread may use it.

    Attributes:
        refused: number of commands beyond the limits.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._waiting: deque[WaitingCommand] = deque()
        self._of: Counter[str] = Counter()
        self._lock = threading.Lock()

    def put(self, verb: str, arguments: dict[str, Any], answer: Answer) -> str:
        """Add a command; return why it was refused, or an empty text.

        Args:
            verb: name of the command.
            arguments: its arguments, by name.
            answer: sends the encoded reply; its client counts for the limit of a client.
        """
        client = client_of(answer)
        with self._lock:
            refusal = self._refusal(client)
            if refusal:
                self.refused += 1
                return refusal
            last = self._waiting[-1] if self._waiting and client else None
            if last is None or (last.verb, last.arguments, client_of(last.answers[0])) != (verb, arguments, client):
                last = WaitingCommand(verb, arguments)
                self._waiting.append(last)
            last.answers.append(answer)
            self._of[client] += 1
            return ""

    def take(self) -> WaitingCommand | None:
        """Remove and return the oldest command; None if none waits."""
        with self._lock:
            if not self._waiting:
                return None
            command = self._waiting.popleft()
            self._of -= Counter(map(client_of, command.answers))
            return command

    def _refusal(self, client: str) -> str:
        if self._of[client] >= MOST_COMMANDS_OF_A_CLIENT:
            return f"{MOST_COMMANDS_OF_A_CLIENT} commands of this program wait already; send this one again later"
        if self._of.total() >= MOST_COMMANDS:
            return f"{MOST_COMMANDS} commands wait already; send this one again later"
        return ""
