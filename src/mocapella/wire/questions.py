"""Questions to a camera's node and its answers: JSON, both ways; pictures are base64 in it. docs/wire.md lists them."""

from __future__ import annotations

from typing import Any, Final, Literal

import msgspec
import zenoh

from mocapella.errors import BusError, WireError
from mocapella.wire import keys

MAX_QUESTION_BYTES: Final = 64 * 1024
MAX_ANSWER_BYTES: Final = 8 * 1024 * 1024


class AskPicture(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="picture"):
    """The newest picture, ``scale`` times as large.

    Attributes:
        keep: whether the node keeps it for a while, so that one can point at it.
    """

    scale: float = 1.0
    format: Literal["jpeg", "png"] = "jpeg"
    keep: bool = True


class AskMask(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="mask"):
    """What the colours' look-up table makes of the newest picture, and the markers that were found in it."""

    scale: float = 1.0
    format: Literal["jpeg", "png"] = "png"


class AskControls(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="controls"):
    """How the camera is set."""


class AskReport(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="report"):
    """What was found, lost, dropped, and what is wrong."""


class Clicks(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where somebody pointed in a picture that was asked for: x, y by the marker's name, ``skin`` for skin [px]."""

    time_ns: int
    points: dict[str, tuple[float, float]]


class AskLearn(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="learn"):
    """Learn the colours anew, from pictures that were asked for, and use them at once.

    Attributes:
        clicks: pictures and where somebody pointed in them.
        backgrounds: times of pictures without markers.
    """

    clicks: list[Clicks]
    backgrounds: list[int] = []


class AskSave(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="save"):
    """Write the colours that are in use to the node's profile."""


class AskDiscard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="discard"):
    """Forget what was learnt and not saved: the colours are those again that were in use before."""


class AskBoard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="board"):
    """Where a calibration board's corners are in the newest picture.

    Attributes:
        board: the text of its TOML file.
        explain: whether to say what is seen instead where there is none, which takes long.
    """

    board: str
    explain: bool = False


Question = AskPicture | AskMask | AskControls | AskReport | AskLearn | AskSave | AskDiscard | AskBoard


class NodeAnswer(msgspec.Struct, frozen=True, omit_defaults=True):
    """An answer. What was not asked for is left out.

    Attributes:
        ok: whether it could be done.
        message: what was done, or what would have worked.
        time_ns: of the picture, on the camera's clock.
        size_px: (width, height) of the camera's picture, before it was scaled.
        image: the picture's file.
        format: of ``image``: jpeg or png.
        names: of the markers.
        positions_px: x, y of each in the camera's picture; null where it is not seen.
        controls: exposure, gain, white_balance, saturation, contrast, automatic; and fps, asked_fps, size_px, times.
        report: counts, and ``problems`` in sentences.
        separability: of what was learnt: ``kept`` and ``in_background`` by name, ``distances``, ``problems``.
        corners: of the board: ``ids``, ``corners_px``, ``edge_px``.
    """

    ok: bool
    message: str = ""
    time_ns: int = 0
    size_px: tuple[int, int] | None = None
    image: bytes = b""
    format: str = ""
    names: list[str] | None = None
    positions_px: list[tuple[float, float] | None] | None = None
    controls: dict[str, Any] | None = None
    report: dict[str, Any] | None = None
    separability: dict[str, Any] | None = None
    corners: dict[str, Any] | None = None


def read_question(data: bytes) -> Question:
    """A question of JSON.

    Raises:
        WireError: it is none; says what is wrong with it.
    """
    if len(data) > MAX_QUESTION_BYTES:
        raise WireError(f"the question has {len(data)} bytes; at most {MAX_QUESTION_BYTES} are read")
    try:
        return msgspec.json.decode(data, type=Question)  # type: ignore[no-any-return]
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        known = "picture, mask, controls, report, learn, save, discard, board"
        raise WireError(f'this is no question: {error}; write {{"ask": …}} with one of {known}') from None


def write_question(question: Question) -> bytes:
    """As JSON."""
    return msgspec.json.encode(question)


def read_answer(data: bytes) -> NodeAnswer:
    """An answer of JSON.

    Raises:
        WireError: it is none.
    """
    if len(data) > MAX_ANSWER_BYTES:
        raise WireError(f"the answer has {len(data)} bytes; at most {MAX_ANSWER_BYTES} are read")
    try:
        return msgspec.json.decode(data, type=NodeAnswer)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"{len(data)} bytes that are no answer of a node ({error})") from None


def write_answer(answer: NodeAnswer) -> bytes:
    """As JSON; one that is too large says so instead."""
    data = msgspec.json.encode(answer)
    if len(data) <= MAX_ANSWER_BYTES:
        return data
    said = f"the answer has {len(data)} bytes, more than {MAX_ANSWER_BYTES}: ask for jpeg, or with a smaller scale"
    return msgspec.json.encode(NodeAnswer(False, said))


def ask_node(session: zenoh.Session, sensor: str, question: Question, timeout: float = 10.0) -> NodeAnswer:
    """Ask the node that serves a camera, and wait for its answer; one that says no has ``ok`` False.

    Args:
        session: of the server, or of a program that reads results (`mocapella.wire.session.open_reader`).
        sensor: the camera's name.
        question: see above.
        timeout: to wait for the answer [s]; learning takes seconds.

    Raises:
        BusError: nobody answers.
        WireError: what comes is no answer.
    """
    for reply in session.get(keys.asking(sensor), payload=write_question(question), timeout=timeout):
        if reply.ok is not None:
            return read_answer(reply.ok.payload.to_bytes())
    raise BusError(f"{sensor}: nobody answered within {timeout:g} s; only nodes of cameras do (mocapella node markers)")
