"""Answer a node's queries one after another in a thread of their own, so that frames are not delayed."""

from __future__ import annotations

import contextlib
import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from types import TracebackType
from typing import Self

from mocapella.errors import MocapellaError
from mocapella.supervision import Boundary
from mocapella.wire.questions import NodeAnswer, write_answer

Reply = Callable[[bytes], None]


class QuestionThread(ABC):
    """Base of services that answer queries (`mocapella.wire.questions`); the constructor starts the thread.

    A context manager; leaving it ends the thread. An unexpected error costs its query only: the answer states it.

    Args:
        waiting: largest number of waiting queries.
        say: receives messages about unexpected errors.
    """

    def __init__(self, waiting: int, say: Callable[[str], None] = lambda text: None) -> None:
        self._errors = Boundary(say)
        self._waiting: queue.Queue[tuple[bytes, Reply] | None] = queue.Queue(waiting)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="questions", daemon=True)
        self._thread.start()

    def answer(self, question: bytes) -> NodeAnswer:
        """Answer a query, given as JSON, on the caller's thread; if it is refused, the answer gives the reason."""
        try:
            return self._answers(question)
        except MocapellaError as error:
            return NodeAnswer(False, str(error))

    def close(self) -> None:
        """End the thread after its current answer."""
        self._ended.set()
        with contextlib.suppress(queue.Full):  # then the thread is awake
            self._waiting.put_nowait(None)
        self._thread.join(1.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def _answers(self, question: bytes) -> NodeAnswer:
        """Return the answer to a query.

        Raises:
            MocapellaError: the query is refused; gives the reason.
        """

    def _queue(self, question: bytes, reply: Reply) -> bool:
        """Queue a query, and return whether there was room."""
        try:
            self._waiting.put_nowait((question, reply))
        except queue.Full:
            return False
        return True

    def _run(self) -> None:
        while (waiting := self._waiting.get()) is not None and not self._ended.is_set():
            question, reply = waiting
            problem = self._errors.run("question", lambda: reply(write_answer(self.answer(question))))  # noqa: B023
            if problem:
                self._errors.run("answer", lambda: reply(write_answer(NodeAnswer(False, problem))))  # noqa: B023
