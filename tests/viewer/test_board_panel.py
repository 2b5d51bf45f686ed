"""A calibration in the view: what is typed, and the HTML that tells how it goes."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.model.board import Board
from mocapella.model.board_progress import BoardProgress, CameraProgress, RigQuality
from mocapella.settings import parse
from mocapella.viewer.board_html import board_html
from mocapella.viewer.board_panel import CHARUCO, CHESSBOARD, FILE, BoardFields
from mocapella.viewer.palette import SensorColours

TYPED = BoardFields(CHARUCO, "board.toml", 6, 5, 40.0, 30.0, "DICT_4X4_50")
LEFT = CameraProgress("left", 3, ((0, 2, 0, 0), (0, 5, 0, 0), (0, 0, 0, 0)), (640, 480), ((10.0, 20.0), (30.0, 20.0)))
RIGHT = CameraProgress("right", 1, ((0, 0, 0, 0), (0, 0, 1, 0), (0, 0, 0, 0)), None, (), "it does not answer")
QUALITY = RigQuality(
    (("camera", ""), ("place", "± mm")),
    (("left", "0.00"), ("right", "0.42")),
    ("turn camera right to the left by 3.1°",),
    "compare with a tape measure: left – right 0.120 m",
    ("camera right: tilt the board more",),
)


class Text(HTMLParser):
    """All text, and how many of each element."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.said, self.count, self.open = "", {}, 0
        self.feed(html)
        self.close()
        assert self.open == 0

    def handle_starttag(self, tag, attrs):
        self.count[tag] = self.count.get(tag, 0) + 1
        self.open += 1

    def handle_startendtag(self, tag, attrs):
        self.count[tag] = self.count.get(tag, 0) + 1

    def handle_endtag(self, tag):
        self.open -= 1

    def handle_data(self, data):
        self.said += data + "\n"


def shown(progress: BoardProgress) -> Text:
    return Text(board_html(progress, SensorColours(), TYPED.words))


def test_while_it_is_filmed_fields_corners_views_and_the_first_hint_are_there() -> None:
    text = shown(BoardProgress("filming", "a board", (LEFT, RIGHT), 1, ("tilt the board more", "second")))
    assert (text.count["rect"], text.count["circle"]) == (24, 2)
    for said in ("Tilt the board more", "a board; seen by two cameras or more at once: once", "3 views", "1 view"):
        assert f"{said}\n" in text.said
    assert "sees the board\n" in text.said
    assert "no board\n" in text.said
    filled = board_html(BoardProgress("filming", "", (LEFT,)), SensorColours(), "").count('fill-opacity="0.3"')
    assert filled == 2


def test_afterwards_the_quality_and_whether_it_is_saved_and_used_are_there() -> None:
    done = BoardProgress("done", "a board", (LEFT, RIGHT), 9, quality=QUALITY)
    text = shown(done)
    for said in ("Calibrated", "not saved yet, and not in use yet", "place, ± mm", "0.42", *QUALITY.sentences):
        assert f"{said}\n" in text.said
    assert QUALITY.tape in text.said
    assert QUALITY.hints[0] in text.said
    assert "saved as rig.toml\n" in shown(msgspec.structs.replace(done, saved=True)).said
    assert "In use\n" in shown(msgspec.structs.replace(done, saved=True, used=True)).said
    assert "It takes a minute\n" in shown(msgspec.structs.replace(done, busy="it takes a minute")).said


def test_before_it_the_board_that_was_typed_and_what_went_wrong_are_there() -> None:
    text = shown(BoardProgress(problem="no camera has seen the board"))
    assert "ChArUco board (DICT_4X4_50), 6 × 5 squares of 40 mm, markers of 30 mm\n" in text.said
    assert "no camera has seen the board\n" in text.said
    assert "All is seen: press Finish\n" in shown(BoardProgress("filming", "", (LEFT,))).said
    assert "Calibrating …\n" in shown(BoardProgress("calibrating", "", (LEFT,))).said


@settings(max_examples=25, deadline=None)
@given(st.text(max_size=30), st.sampled_from(["filming", "done", "calibrating", "idle"]))
def test_no_text_becomes_markup(text: str, phase) -> None:
    words = f"<script>{text}</script>"
    camera = msgspec.structs.replace(LEFT, name=words, problem=words)
    quality = RigQuality((("camera", ""), (words, words)), ((words, words),), (words,), words, (words,))
    progress = BoardProgress(phase, words, (camera,), 1, (words,) * 3, words, quality, words, saved=True)
    html = board_html(progress, SensorColours(), words)
    assert "<script" not in html


@given(
    st.builds(
        BoardFields,
        st.sampled_from([CHARUCO, CHESSBOARD]),
        st.text(max_size=5),
        st.integers(3, 100),
        st.integers(3, 100),
        st.floats(1.0, 1000.0),
        st.just(0.0),
        st.just("DICT_4X4_50"),
    ),
    st.floats(0.25, 0.95),
)
def test_what_is_typed_becomes_that_board(fields: BoardFields, ratio: float) -> None:
    fields = replace(fields, marker_mm=ratio * fields.square_mm)
    board = parse(Board, fields.arguments()["board"])
    assert (board.kind == "charuco") == (fields.kind == CHARUCO)
    assert (board.columns, board.rows) == (fields.columns, fields.rows)
    assert 1e3 * board.square_m == pytest.approx(fields.square_mm, abs=1e-5)
    if fields.kind == CHARUCO:
        assert board.marker_ratio == pytest.approx(ratio)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"columns": 6.5}, "columns is 6.5; it must be a whole number"),
        ({"rows": 2}, "rows is 2; it must be 3 to 100 squares"),
        ({"square_mm": 0.0}, "marker is 30 mm; it must be above 0 and smaller than a square, 0 mm"),
        ({"marker_mm": 40.0}, "marker is 40 mm"),
        ({"kind": CHESSBOARD, "square_mm": 0.1}, "square_m is 0.0001"),
        ({"kind": FILE, "file": "  "}, "the board's file is empty"),
    ],
)
def test_what_cannot_be_a_board_is_said_before_it_is_sent(wrong: dict[str, object], says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        replace(TYPED, **wrong).arguments()


def test_a_file_is_sent_by_its_name() -> None:
    typed = replace(TYPED, kind=FILE, file=" b.toml ")
    assert typed.arguments() == {"file": "b.toml"}
    assert typed.words == "the board of b.toml"
