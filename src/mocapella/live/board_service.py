"""Camera calibration with a board for the view: a thread that commands start, guide and finish.

It runs in the view's process, so that neither corner detection nor bundle adjustment slows the tracker; the server
receives only the rig.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from msgspec.structs import replace

from mocapella.calibration.board_guidance import field_counts
from mocapella.calibration.board_run import BoardRun
from mocapella.calibration.cameras import CameraCalibration
from mocapella.calibration.rig_report import HEADINGS, sentences, table, tape_measure
from mocapella.errors import InputError, MocapellaError, NotNowError, SettingsError
from mocapella.live.board_cameras import BoardCameras, NodeCameras, film, urgent
from mocapella.model.board import Board, load_board
from mocapella.model.board_progress import BoardProgress, CameraProgress, RigQuality
from mocapella.model.camera_rig_file import encode_camera_rig, save_camera_rig
from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.session import CommandReply, SensorHealth, SessionStatus
from mocapella.settings import parse
from mocapella.supervision import Boundary
from mocapella.tracker.method import METHODS
from mocapella.wire.questions import NodeAnswer, Question

Send = Callable[[str, dict[str, Any]], CommandReply]
Ask = Callable[[str, dict[str, Any], float], NodeAnswer]

_NAME: Final = re.compile(r"[\w\-][\w\-. ]{0,80}")


@dataclass(frozen=True)
class _Start:
    """Arguments of ``calibrate``: a board as a file in the folder, or its values."""

    file: str = ""
    board: dict[str, Any] | None = None


@dataclass(frozen=True)
class _Named:
    name: str


class BoardService:
    """Runs at most one calibration at a time, whichever browser starts and ends it.

    Args:
        ask: queries a camera's node and waits for its answer; called with the camera's name, the query as a dictionary,
            and the longest wait [s].
        send: sends a command to the server: the verb and its arguments.
        folder: folder of boards to read and rigs to save; no file outside of it is used.
        warm_up: called with a method's name before the server tracks with it, to compile its kernels beforehand.
    """

    def __init__(
        self, ask: Ask, send: Send, folder: Path, *, warm_up: Callable[[str], object] = lambda method: None
    ) -> None:
        self._send, self._folder, self._warm_up = send, folder, warm_up
        self._ask: Callable[[str, Question, float], NodeAnswer] = lambda camera, question, timeout_s: ask(
            camera, msgspec.to_builtins(question), timeout_s
        )
        self._errors = Boundary()
        self._lock = threading.Lock()
        self._sensors: tuple[SensorHealth, ...] = ()
        self._has_rig = False
        self._progress = BoardProgress(file=self._free_name())
        self._rig: CameraCalibration | None = None
        self._thread: threading.Thread | None = None
        self._end, self._cancelled = threading.Event(), False
        self._verbs: dict[str, Callable[[Mapping[str, Any]], str]] = {
            "calibrate": self._start,
            "finish-calibration": self._finish,
            "cancel-calibration": self._cancel,
            "save-rig": self._save,
            "use-this-rig": self._use,
        }

    @property
    def progress(self) -> BoardProgress:
        """Progress of the rig calibration with the board, as shown to users."""
        return self._progress

    def update(self, status: SessionStatus | None) -> None:
        """Use the newest sensor health and setup, to know the connected cameras; None changes nothing."""
        if status is None:
            return
        self._sensors = status.sensors
        method = METHODS.get(status.setup.method)
        has_rig = method is not None and method.camera_rig == "required"
        if has_rig != self._has_rig:
            self._has_rig = has_rig
            self._progress = replace(self._progress, has_rig=has_rig)

    def command(self, verb: str, arguments: dict[str, Any]) -> CommandReply:
        """Carry out a command of the calibration, or pass any other on to the server; return the reply.

        The verbs are ``calibrate``, ``finish-calibration``, ``cancel-calibration``, ``save-rig`` and ``use-this-rig``.
        The first three return at once; `progress` has the result. A refusal is a reply with ``ok`` False.
        """
        if verb not in self._verbs:
            return self._send(verb, arguments)
        try:
            return CommandReply(True, self._verbs[verb](arguments))
        except MocapellaError as error:
            return CommandReply(False, str(error))

    def close(self) -> None:
        """End the calibration, if one runs, discard its observations, and wait for its thread."""
        with self._lock:
            self._cancelled = True
            self._end.set()
        if self._thread is not None:
            self._thread.join()

    def _start(self, arguments: Mapping[str, Any]) -> str:
        start = parse(_Start, arguments, where="calibrate")
        board = parse(Board, start.board, where="board") if start.board is not None else self._board(start.file)
        with self._lock:
            if self._running():
                raise NotNowError("a calibration is already running; finish or cancel it first")
            cameras = sorted(row.name for row in self._sensors if row.pictures and row.connected)
            if not cameras:
                raise NotNowError("no camera is connected; start one: mocapella node markers camera:0 --name left")
            if self._thread is not None:
                self._thread.join()
            run = BoardRun(board, cameras)
            board_cameras = NodeCameras(self._ask, lambda: self._sensors, cameras, board)
            self._end, self._cancelled, self._rig = threading.Event(), False, None
            self._progress = BoardProgress(
                "filming", _words(board), _cameras(run), file=self._free_name(), has_rig=self._has_rig
            )
            work = self._errors.wrap("calibration", self._work)
            self._thread = threading.Thread(target=work, args=(run, board_cameras), name="calibrate cameras")
            self._thread.start()
        return f"show the board to {', '.join(cameras)}"

    def _finish(self, _: Mapping[str, Any]) -> str:
        self._stop(cancel=False)
        return ""

    def _cancel(self, _: Mapping[str, Any]) -> str:
        self._stop(cancel=True)
        return ""

    def _stop(self, *, cancel: bool) -> None:
        with self._lock:
            if not self._running():
                raise NotNowError("no calibration is running; start one first")
            self._cancelled = self._cancelled or cancel
            self._end.set()

    def _save(self, arguments: Mapping[str, Any]) -> str:
        name = parse(_Named, arguments, where="save-rig").name.strip()
        found = self._found()
        if not _NAME.fullmatch(name):
            raise SettingsError(f"name {name[:80]!r} cannot be used; write the name of a file, such as rig.toml")
        name = name if name.endswith(".toml") else f"{name}.toml"
        path = self._folder / name
        if path.exists():
            raise SettingsError(f"{name} exists, and files are never overwritten; use {self._free_name()}")
        save_camera_rig(path, found.rig)
        self._progress = replace(self._progress, file=name, saved=True)
        return f"saved to {path}"

    def _use(self, arguments: Mapping[str, Any]) -> str:
        found = self._found()
        if not self._progress.saved:
            self._save(arguments)
        cameras = set(found.rig.cameras)
        method = method_of_rig([row.sends for row in self._sensors if row.name in cameras])
        busy = f"compiling the method {method}; the first time on a machine, that takes minutes"
        self._progress = replace(self._progress, busy=busy)
        try:
            self._warm_up(method)
            reply = self._send("use-rig", {"rig": encode_camera_rig(found.rig), "method": method})
        finally:
            self._progress = replace(self._progress, busy="")
        if not reply.ok:
            raise NotNowError(reply.message)
        self._progress = replace(self._progress, used=True)
        return f"{reply.message}; the rig is {self._folder / self._progress.file}"

    def _found(self) -> CameraCalibration:
        if self._rig is None:
            raise NotNowError("there is no rig yet; start a calibration, and finish it")
        return self._rig

    def _running(self) -> bool:
        return self._progress.phase in ("filming", "calibrating")

    def _board(self, file: str) -> Board:
        path = (self._folder / file).resolve()
        if not file.strip() or not path.is_relative_to(self._folder.resolve()):
            fix = "mocapella calibrate board draws one"
            called = file.strip() or "the board's file"
            raise InputError(f"is no file below {self._folder}", file=called, fix=fix)
        return load_board(path)

    def _free_name(self) -> str:
        names = ("rig.toml", *(f"rig-{k}.toml" for k in range(2, 10_000)))
        return next((name for name in names if not (self._folder / name).exists()), names[-1])

    def _work(self, run: BoardRun, cameras: BoardCameras) -> None:
        try:
            while self._rig is None and not self._cancelled:
                film(cameras, run, self._end.is_set, partial(self._report, run))
                if not self._cancelled:
                    self._calibrate(run)
        finally:
            cameras.close()
            if self._rig is None:
                why = "" if self._cancelled else "it ended with an unexpected error; the view has printed it"
                self._progress = BoardProgress(problem=why, file=self._free_name(), has_rig=self._has_rig)

    def _report(self, run: BoardRun) -> None:
        self._progress = replace(
            self._progress,
            cameras=_cameras(run),
            shared=run.shared,
            hints=tuple(urgent(run)),
        )

    def _calibrate(self, run: BoardRun) -> None:
        self._progress = replace(self._progress, phase="calibrating", problem="", hints=())
        try:
            found = run.calibrate()
        except MocapellaError as error:
            self._end.clear()
            self._progress = replace(self._progress, phase="filming", problem=str(error))
            return
        words = run.report.words()
        quality = RigQuality(
            HEADINGS,
            tuple(table(found)),
            (*sentences(found), *([words] if words else [])),
            tape_measure(found),
            tuple(hint.text for hint in found.hints),
        )
        self._rig = found
        self._progress = replace(self._progress, phase="done", quality=quality)


def method_of_rig(sends: Collection[str]) -> str:
    """Return the name of the first method that requires a rig and takes at least one of the cameras' frame types.

    Args:
        sends: names of the cameras' frame types.

    Raises:
        NotNowError: no installed method does; names the frame types.
    """
    types = {FRAME_TYPES[name].type for name in sends if name in FRAME_TYPES}
    for name, method in METHODS.items():
        if method.camera_rig == "required" and types & set(method.frame_types):
            return name
    types_sent = ", ".join(sorted(set(sends))) or "nothing"
    raise NotNowError(f"the rig is saved, and no installed method tracks with cameras that send {types_sent}")


def _words(board: Board) -> str:
    squares = f"{board.columns} × {board.rows} squares of {1e3 * board.square_m:g} mm"
    if board.kind == "chessboard":
        return f"chessboard, {squares}"
    return f"ChArUco board ({board.dictionary}), {squares}, markers of {1e3 * board.square_m * board.marker_ratio:g} mm"


def _cameras(run: BoardRun) -> tuple[CameraProgress, ...]:
    views = run.views
    of = {name: [view for view in views if view.camera == name] for name in run.cameras}
    return tuple(_camera(name, run, mine) for name, mine in of.items())


def _camera(name: str, run: BoardRun, mine: list[Any]) -> CameraProgress:
    look = run.newest.get(name)
    now = None if look is None else look.view
    size = now.size_px if now is not None else mine[-1].size_px if mine else None
    corners = np.zeros((0, 2)) if now is None else now.corners_px.round(1)
    return CameraProgress(
        name,
        len(mine),
        tuple(tuple(int(count) for count in row) for row in field_counts(mine)),
        size,
        tuple((float(x), float(y)) for x, y in corners),
        "" if look is None else look.problem,
    )
