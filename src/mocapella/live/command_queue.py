"""Queue of commands between the bus's threads and the tracker's: bounded, for each client and together.

Commands change the session, such as ``start`` or ``recalibrate``; the tracker's thread carries them out between frames.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from mocapella.model.limits import COMMANDS_A_SECOND, COMMANDS_AT_ONCE, MOST_COMMANDS, MOST_COMMANDS_OF_A_CLIENT

_EVERY_NS: Final = round(1e9 / COMMANDS_A_SECOND)
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
    Those of a client that has sent many wait longer (`COMMANDS_A_SECOND`), and other clients overtake them. Any thread
    may use it.

    Args:
        clock_ns: the monotonic clock [ns].

    Attributes:
        refused: number of commands beyond the limits.
    """

    def __init__(self, *, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.refused = 0
        self._clock_ns = clock_ns
        self._waiting: deque[WaitingCommand] = deque()
        self._due_ns: dict[str, int] = {}
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
        """Remove and return the oldest command of a client that need not wait; None if there is none."""
        with self._lock:
            now_ns = self._clock_ns()
            for place, command in enumerate(self._waiting):
                client = client_of(command.answers[0])
                due_ns = max(self._due_ns.get(client, now_ns), now_ns)
                if due_ns - now_ns <= (COMMANDS_AT_ONCE - 1) * _EVERY_NS:
                    del self._waiting[place]
                    self._of -= Counter(map(client_of, command.answers))
                    self._due_ns = {name: at_ns for name, at_ns in self._due_ns.items() if at_ns > now_ns}
                    self._due_ns[client] = due_ns + _EVERY_NS
                    return command
            return None

    def _refusal(self, client: str) -> str:
        if self._of[client] >= MOST_COMMANDS_OF_A_CLIENT:
            return f"{MOST_COMMANDS_OF_A_CLIENT} commands of this program wait already; send this one again later"
        if self._of.total() >= MOST_COMMANDS:
            return f"{MOST_COMMANDS} commands wait already; send this one again later"
        return ""
