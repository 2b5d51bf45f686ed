"""Cameras that observe a calibration board: camera nodes on the bus, or cameras of this machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, Protocol

import msgspec
import numpy as np

from mocapella.calibration.board_run import BoardLook, BoardRun
from mocapella.conventions import NS_PER_S
from mocapella.decoding import convert
from mocapella.errors import BusError, InputError, SettingsError, WireError
from mocapella.model.board import Board, BoardView, encode_board
from mocapella.model.session import SensorHealth
from mocapella.wire.questions import AskBoard, NodeAnswer, Question

INTERVAL_S: Final = 0.5
"""Time between observations, in which the board moves on [s]."""
ANSWER_S: Final = 3.0
"""Longest wait for a node's answer [s]."""
EXPLAIN_EVERY: Final = 6
"""Interval, in observations, at which a camera that has never seen the board is asked for the reason."""
EXPLAIN_S: Final = 10.0
"""Longest wait for that explanation [s]."""


class BoardCameras(Protocol):
    """Cameras that look for a calibration board all at once, so that `film` can collect views of it."""

    def look(self) -> dict[str, BoardLook]:
        """Return an observation for each camera, by name; a camera that fails has one with its ``problem``."""
        ...

    def wait(self, seconds: float) -> None:
        """Wait for ``seconds`` [s] before the next observation; return at once if it is zero or less."""
        ...

    def close(self) -> None:
        """Release the cameras."""
        ...


class _Corners(msgspec.Struct, frozen=True):
    ids: list[int]
    corners_px: list[tuple[float, float]]
    edge_px: float | None = None


class NodeCameras:
    """Cameras of running nodes for a board calibration; `look` queries all nodes at once for the board.

    Args:
        ask: sends a query to a camera's node and returns the answer (`mocapella.wire.questions.ask_node`); called with
            the camera's name, the query, and the longest wait [s].
        sensors: returns the server's newest sensor health, whose clock offsets bring captures to one clock.
        cameras: names of the cameras.
        board: the board to detect.
    """

    def __init__(
        self,
        ask: Callable[[str, Question, float], NodeAnswer],
        sensors: Callable[[], Iterable[SensorHealth]],
        cameras: Sequence[str],
        board: Board,
    ) -> None:
        self._ask, self._sensors, self._cameras = ask, sensors, tuple(cameras)
        self._text, self._corners = encode_board(board), board.corners
        self._blind: dict[str, int] = dict.fromkeys(cameras, 0)
        self._why: dict[str, str] = {}
        self._seen: set[str] = set()
        self._workers = ThreadPoolExecutor(max(len(self._cameras), 1), thread_name_prefix="ask for board")

    def look(self) -> dict[str, BoardLook]:
        """Query all nodes, and return an observation for each camera, by name.

        A camera whose node does not answer, or whose clock the server does not know, has one with its ``problem``.
        """
        asked = {name: self._workers.submit(self._one, name) for name in self._cameras}
        answers = {name: future.result() for name, future in asked.items()}
        rows = {row.name: row for row in self._sensors()}
        return {
            name: BoardLook(problem=answer) if isinstance(answer, str) else self._look(name, answer, rows.get(name))
            for name, answer in answers.items()
        }

    def wait(self, seconds: float) -> None:
        """Sleep for ``seconds`` [s] before the next observation; return at once if it is zero or less."""
        time.sleep(max(seconds, 0.0))

    def close(self) -> None:
        """Discard waiting queries; a query that is under way is not waited for."""
        self._workers.shutdown(wait=False, cancel_futures=True)

    def _one(self, name: str) -> NodeAnswer | str:
        explain = self._explains(name)
        try:
            return self._ask(name, AskBoard(self._text, explain), EXPLAIN_S if explain else ANSWER_S)
        except (BusError, WireError):
            return f"camera {name} does not answer: check that its node (mocapella node markers) runs"

    def _look(self, name: str, answer: NodeAnswer, row: SensorHealth | None) -> BoardLook:
        if not answer.ok or answer.corners is None or answer.size_px is None:
            return BoardLook(problem=f"camera {name}: {answer.message or 'its answer has no corners'}")
        if row is None or row.capture_offset is None:
            return BoardLook(problem=f"camera {name}: the server does not know its clock yet; it has sent no frame")
        at_s = answer.time_ns / NS_PER_S + row.capture_offset
        try:
            seen = convert(answer.corners, _Corners, what="list of corners")
        except InputError as error:
            return BoardLook(problem=f"camera {name} answers what cannot be used ({error}); is it of this version?")
        if not (seen.ids or seen.corners_px):
            return BoardLook(at_s, None, self._unseen(name, answer.message))
        view = self._view(name, seen, answer.size_px)
        if view is None:
            return BoardLook(problem=f"camera {name} answers corners that this board cannot have; is it this version?")
        self._seen.add(name)
        self._why.pop(name, None)
        return BoardLook(at_s, view)

    def _view(self, name: str, seen: _Corners, size_px: tuple[int, int]) -> BoardView | None:
        if len(seen.ids) != len(seen.corners_px) or not 0 <= min(seen.ids) <= max(seen.ids) < self._corners:
            return None
        ids, corners = np.array(seen.ids, dtype=np.int64), np.array(seen.corners_px, dtype=np.float64)
        inside = (corners >= -1) & (corners <= np.array(size_px))
        if (np.diff(ids) <= 0).any() or not inside.all():
            return None
        return BoardView(name, 0, size_px, ids, corners, float("nan") if seen.edge_px is None else seen.edge_px)

    def _explains(self, name: str) -> bool:
        """Whether to ask a camera that has never seen the board for the reason now, which takes long."""
        return name not in self._seen and self._blind[name] % EXPLAIN_EVERY == EXPLAIN_EVERY - 1

    def _unseen(self, name: str, said: str) -> str:
        if self._explains(name):
            self._why[name] = f"camera {name}: {said}"
        self._blind[name] += 1
        return self._why.get(name, "")


class LocalCameras:
    """Cameras of this machine, opened by the constructor and read together.

    Args:
        numbers: device numbers by camera name.
        board: the board to detect.
        clock: measures the waits between observations; the monotonic clock, in seconds.

    Raises:
        InputError: a camera cannot be opened.
    """

    def __init__(
        self, numbers: Mapping[str, int], board: Board, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        from mocapella.sensing.boards import BoardDetector
        from mocapella.sources.video import LiveCameras

        self._clock = clock
        self._cameras = LiveCameras(numbers)
        self._detectors = {name: BoardDetector(board) for name in numbers}

    def look(self) -> dict[str, BoardLook]:
        """Read an image of each camera, and return an observation for each, by name.

        A camera that gives no image has one with its ``problem``.
        """
        seen = self._cameras.read()
        lost = {
            name: BoardLook(problem=f"camera {name} gave no picture {count} times")
            for name, count in self._cameras.lost.items()
            if name not in seen
        }
        found = {name: self._detectors[name].update(image, name, 0) for name, (_, image) in seen.items()}
        return lost | {name: BoardLook(seen[name][0], view) for name, view in found.items()}

    def wait(self, seconds: float) -> None:
        """Read and discard images for ``seconds`` [s], so that the next observation is of a new image."""
        end = self._clock() + seconds
        while self._clock() < end:
            self._cameras.read()

    def close(self) -> None:
        """Release the cameras."""
        self._cameras.close()


def film(
    cameras: BoardCameras,
    run: BoardRun,
    until: Callable[[], bool],
    on_look: Callable[[], None] = lambda: None,
    *,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Observe the board every `INTERVAL_S` until ``until`` holds, and add each observation to ``run``.

    Args:
        cameras: look for the board; stay open.
        run: collects the observations.
        until: returns whether to end; called before and after each observation.
        on_look: called after each observation.
        clock: the monotonic clock, in seconds.
    """
    while not until():
        began = clock()
        run.add(cameras.look())
        on_look()
        if not until():
            cameras.wait(began + INTERVAL_S - clock())


def urgent(run: BoardRun) -> list[str]:
    """Return instructions, the most urgent first: problems of cameras, then hints about missing observations."""
    problems = [look.problem for look in run.newest.values() if look.problem]
    blind = {name for name, look in run.newest.items() if look.problem}
    hints = [hint.text for hint in run.hints() if not (hint.cause == "not seen" and hint.camera in blind)]
    return [*problems, *hints]


def node_names(texts: Sequence[str], prefix: str, known: Iterable[SensorHealth]) -> list[str]:
    """Return the names of the nodes that texts such as ``node:left`` refer to, in the order of the texts.

    Args:
        texts: names of camera nodes, each with or without the prefix.
        prefix: what precedes a name, such as ``node:``.
        known: the sensors at the server.

    Raises:
        SettingsError: no such node is connected, or it is no camera.
    """
    rows = {row.name: row for row in known if row.connected}
    cameras = [name for name, row in rows.items() if row.pictures]
    names = [text.removeprefix(prefix) for text in texts]
    for name in names:
        if name not in cameras:
            what = "is no camera" if name in rows else "is not there"
            there = ", ".join(cameras) or "none; start one: mocapella node markers camera:0 --name left"
            raise SettingsError(f"{prefix}{name} {what}; cameras at this server: {there}")
    return names
