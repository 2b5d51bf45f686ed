"""The panel folder for the calibration of cameras with a calibration board, in one browser."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import viser

from mocapella.errors import SettingsError
from mocapella.model.board import DICTIONARIES, Board
from mocapella.model.board_progress import BoardProgress
from mocapella.model.session import SessionStatus
from mocapella.viewer.board_html import board_html
from mocapella.viewer.inputs import set_value
from mocapella.viewer.palette import SensorColours

CHARUCO, CHESSBOARD, FILE = "ChArUco", "chessboard", "a file"
KINDS: Final = (CHARUCO, CHESSBOARD, FILE)
_USUAL: Final = Board("charuco", 5, 7, 0.0352, dictionary="DICT_4X4_50")
_MM: Final = 1e3
_TYPED_S: Final = 0.3
"""Delay from a click on Start until the inputs are read [s]: a browser may send typed text after a later click."""

Send = Callable[[str, dict[str, Any]], None]


@dataclass(frozen=True)
class BoardFields:
    """Values of the panel's inputs that describe the calibration board.

    Attributes:
        kind: one of `KINDS`.
        file: name of a TOML file that describes the board, for the kind `FILE`.
        columns, rows: number of squares in a row and in a column.
        square_mm: side of a square [mm].
        marker_mm: side of a ChArUco board's marker [mm].
        dictionary: name of the markers' ArUco dictionary, such as ``DICT_4X4_50``.
    """

    kind: str
    file: str
    columns: float
    rows: float
    square_mm: float
    marker_mm: float
    dictionary: str

    @property
    def words(self) -> str:
        """Description of the board, such as ``chessboard, 9 × 6 squares of 25 mm``."""
        if self.kind == FILE:
            return f"the board of {self.file.strip()}"
        squares = f"{self.columns:g} × {self.rows:g} squares of {self.square_mm:g} mm"
        if self.kind == CHESSBOARD:
            return f"chessboard, {squares}"
        return f"ChArUco board ({self.dictionary}), {squares}, markers of {self.marker_mm:g} mm"

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of the server's command ``calibrate``: ``file``, or ``board`` with lengths in metres.

        Raises:
            SettingsError: a field is invalid; the message names it and the valid values.
        """
        if self.kind == FILE:
            if not self.file.strip():
                raise SettingsError("the board's file is empty; write a name such as board.toml")
            return {"file": self.file.strip()}
        for name, value in (("columns", self.columns), ("rows", self.rows)):
            if value != int(value):
                raise SettingsError(f"{name} is {value:g}; it must be a whole number of squares")
        values: dict[str, Any] = {
            "kind": "charuco" if self.kind == CHARUCO else "chessboard",
            "columns": int(self.columns),
            "rows": int(self.rows),
            "square_m": round(self.square_mm / _MM, 9),
        }
        if self.kind == CHARUCO:
            if not 0 < self.marker_mm < self.square_mm:
                wanted = f"above 0 and smaller than a square, {self.square_mm:g} mm"
                raise SettingsError(f"marker is {self.marker_mm:g} mm; it must be {wanted}")
            values |= {"marker_ratio": self.marker_mm / self.square_mm, "dictionary": self.dictionary}
        Board(**values)
        return {"board": values}


class BoardPanel:
    """The folder for the calibration of cameras with a board: inputs, buttons and progress.

    Args:
        gui: controls of the browser.
        colours: colours of the cameras.
        send: sends a command with its arguments to the server, without waiting for the reply.
        refuse: shows a title and a message in the browser; called in place of ``send`` when the inputs are invalid.
        order: position among the panel's folders.
        expanded: whether the folder is unfolded at first.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        colours: SensorColours,
        send: Send,
        refuse: Callable[[str, str], None],
        *,
        order: float,
        expanded: bool,
    ) -> None:
        self._colours, self._send, self._refuse = colours, send, refuse
        self._progress: BoardProgress | None = None
        self._shown: BoardFields | None = None
        with gui.add_folder("Calibrate cameras", order=order, expand_by_default=expanded):
            self._html = gui.add_html("")
            self._name = gui.add_text("Save as", "rig.toml", hint="Nothing is ever overwritten")
            self._use = gui.add_button("Use it", icon=viser.Icon.CHECK, color="teal", hint="Track with it; saves it")
            self._save = gui.add_button("Save", icon=viser.Icon.DEVICE_FLOPPY, color="gray")
            self._kind = gui.add_dropdown("Board", KINDS, hint="As printed; a file holds the same as text")
            self._file = gui.add_text("Board file", "board.toml", hint="In the folder where the view was started")
            self._columns = gui.add_number("Columns", _USUAL.columns, step=1, hint="Squares in a row, not corners")
            self._rows = gui.add_number("Rows", _USUAL.rows, step=1, hint="Squares in a column, not corners")
            self._square = gui.add_number(
                "Square, mm", round(_MM * _USUAL.square_m, 3), step=0.01, hint="Measured: the scale of all comes of it"
            )
            self._marker = gui.add_number(
                "Marker, mm", round(_MM * _USUAL.square_m * _USUAL.marker_ratio, 3), step=0.01, hint="Measured likewise"
            )
            self._dictionary = gui.add_dropdown("Dictionary", DICTIONARIES, initial_value=_USUAL.dictionary)
            self._start = gui.add_button("Start calibration", icon=viser.Icon.PLAYER_PLAY, color="teal")
            self._finish = gui.add_button("Finish", icon=viser.Icon.CHECK, color="teal")
            self._cancel = gui.add_button("Cancel", icon=viser.Icon.X, color="gray")
        self._on(self._start, self._begin, _TYPED_S)
        self._on(self._finish, lambda: self._send("finish-calibration", {}))
        self._on(self._cancel, lambda: self._send("cancel-calibration", {}))
        self._on(self._use, lambda: self._send("use-this-rig", {"name": self._name.value}))
        self._on(self._save, lambda: self._send("save-rig", {"name": self._name.value}))

    @property
    def fields(self) -> BoardFields:
        """Present values of the inputs that describe the board."""
        return BoardFields(
            self._kind.value, self._file.value, self._columns.value, self._rows.value, self._square.value,
            self._marker.value, self._dictionary.value,
        )  # fmt: skip

    def show(self, progress: BoardProgress) -> None:
        """Show the progress of the calibration, and the inputs and buttons that its phase allows.

        It does nothing if ``progress`` is the same object as before and no input has changed.
        """
        fields = self.fields
        if progress is self._progress and fields == self._shown:
            return
        before, self._progress, self._shown = self._progress, progress, fields
        self._html.content = board_html(progress, self._colours, fields.words)
        running = progress.phase in ("filming", "calibrating")
        self._start.visible = self._kind.visible = not running
        kind = fields.kind
        self._file.visible = not running and kind == FILE
        for field in (self._columns, self._rows, self._square):
            field.visible = not running and kind != FILE
        self._marker.visible = self._dictionary.visible = not running and kind == CHARUCO
        self._finish.visible = self._cancel.visible = running
        self._finish.disabled = progress.phase != "filming"
        done = progress.phase == "done"
        self._name.visible = self._save.visible = done
        self._use.visible = done
        self._name.disabled = self._save.disabled = progress.saved
        self._use.disabled = progress.used or bool(progress.busy)
        if before is None or before.file != progress.file:
            set_value(self._name, progress.file)

    def _begin(self) -> None:
        try:
            arguments = self.fields.arguments()
        except SettingsError as error:
            self._refuse("Calibration: not started", str(error))
            return
        self._send("calibrate", arguments)

    @staticmethod
    def _on(button: viser.GuiButtonHandle, do: Callable[[], None], after_s: float = 0.0) -> None:
        @button.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            await asyncio.sleep(after_s)
            do()


class BoardPlace:
    """Creates the `BoardPanel` once the session has a camera, if the server can calibrate.

    Args:
        make: makes the panel; its argument is whether the folder is unfolded at first.
    """

    def __init__(self, make: Callable[[bool], BoardPanel]) -> None:
        self._make = make
        self._panel: BoardPanel | None = None

    def show(self, status: SessionStatus | None, progress: BoardProgress | None) -> None:
        """Show the progress of the calibration; create the panel first, once a sensor of the session has images.

        Args:
            status: status of the session, with its sensors; None if no server gives one.
            progress: progress of the calibration; None if the server cannot calibrate, which changes nothing.
        """
        if progress is None:
            return
        if self._panel is None:
            if status is None or not any(row.pictures for row in status.sensors):
                return
            self._panel = self._make(not progress.has_rig)
        self._panel.show(progress)
