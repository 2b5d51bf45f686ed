"""Queries to a camera's node, such as for an image, and its answers; JSON with images in base64 (docs/wire.md)."""

from __future__ import annotations

from typing import Any, Final, Literal

import msgspec
import zenoh

from mocapella.decoding import decode_json
from mocapella.errors import BusError, InputError, WireError
from mocapella.model.camera_controls import ControlDescription
from mocapella.wire import keys

MAX_QUESTION_BYTES: Final = 64 * 1024
MAX_ANSWER_BYTES: Final = 8 * 1024 * 1024


class AskPicture(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="picture"):
    """Query for the newest image.

    Attributes:
        scale: size of the image in the answer, relative to the camera's, 0.05 to 2.
        format: format of the image in the answer.
        keep: whether the node keeps the image, so that a later `AskLearn` can refer to it by its ``time_ns``.
    """

    scale: float = 1.0
    format: Literal["jpeg", "png"] = "jpeg"
    keep: bool = True


class AskMask(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="mask"):
    """Query for the newest image as the colour detection sees it, and for the detected markers.

    Classified pixels have their marker's colour; the rest is dimmed and gray. A node without learnt colours refuses.

    Attributes:
        scale: size of the image in the answer, relative to the camera's, 0.05 to 2.
        format: format of the image in the answer.
    """

    scale: float = 1.0
    format: Literal["jpeg", "png"] = "png"


class AskControls(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="controls"):
    """Query for the camera's controls as read back, for their ranges, and for its frame rate and image size."""


class AskSet(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="set"):
    """Query to set the camera's controls, at once. It is refused as a whole if any part of it is invalid.

    Attributes:
        values: requested values, by name of the control.
        automatic: automatic modes to switch on or off before, by name of the mode.
    """

    values: dict[str, float] = {}
    automatic: dict[str, bool] = {}


class AskSaveControls(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="save_controls"):
    """Query to write the present values of the camera's controls to the node's profile, beside its saved colours."""


class AskReport(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="report"):
    """Query for the node's counts, and for the present faults in sentences."""


class Clicks(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Clicks in an image that the node keeps.

    Attributes:
        time_ns: capture time of the image, on the camera's clock.
        points: x, y in the camera's image before scaling [px], by the marker's name; ``skin`` for skin.
    """

    time_ns: int
    points: dict[str, tuple[float, float]]


class AskLearn(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="learn"):
    """Query to learn the colours again from images that the node keeps, and to use them at once.

    Attributes:
        clicks: images with clicks in them.
        backgrounds: capture times of images without markers, on the camera's clock [ns].
    """

    clicks: list[Clicks]
    backgrounds: list[int] = []


class AskSave(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="save"):
    """Query to write the present colours, and the present values of the controls, to the node's profile."""


class AskDiscard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="discard"):
    """Query to discard unsaved colours, and to use the previous ones."""


class AskBoard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="board"):
    """Query to detect a calibration board's corners in the newest image.

    Attributes:
        board: the text of its TOML file.
        explain: whether the answer's ``message`` explains why no board is detected, which takes long.
    """

    board: str
    explain: bool = False


Question = (
    AskPicture
    | AskMask
    | AskControls
    | AskSet
    | AskSaveControls
    | AskReport
    | AskLearn
    | AskSave
    | AskDiscard
    | AskBoard
)


class NodeAnswer(msgspec.Struct, frozen=True, omit_defaults=True):
    """The answer of a camera's node to a query; the query decides which fields are set; the others are empty,
    0 or None.

    Attributes:
        ok: whether the query was carried out.
        message: the effect, or the fault and its remedy.
        time_ns: capture time of the image, on the camera's clock.
        size_px: (width, height) of the camera's image, before scaling.
        image: the encoded image.
        format: format of ``image``: jpeg or png.
        names: names of the markers.
        positions_px: x, y of each marker in the camera's image; null if it is not seen.
        controls: exposure, gain, white_balance, white_balance_red, white_balance_blue, saturation, contrast,
            brightness, automatic; ``saved``, the saved values of these; and fps, asked_fps, size_px, problems, times
            (how capture times are obtained) and source.
        descriptions: the controls that can be set now, with their ranges; empty if there are none.
        report: counts, and ``problems`` in sentences.
        separability: separability of the learnt colours, as `mocapella.sensing.colour_table.Separability`.
        corners: corners of the board: ``ids``, ``corners_px`` (x, y of each), and ``edge_px``, the median width of the
            edges [px], null if unknown; the lists are empty if the board is not detected.
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
    descriptions: list[ControlDescription] | None = None
    report: dict[str, Any] | None = None
    separability: dict[str, Any] | None = None
    corners: dict[str, Any] | None = None


def read_question(data: bytes) -> Question:
    """Decode a query to a camera's node from JSON.

    Raises:
        WireError: it is invalid; names the fault.
    """
    if len(data) > MAX_QUESTION_BYTES:
        raise WireError(f"the question has {len(data)} bytes; at most {MAX_QUESTION_BYTES} are read")
    try:
        question: Question = decode_json(data, Question)
    except InputError as error:
        known = "picture, mask, controls, set, save_controls, report, learn, save, discard, board"
        raise WireError(f'this is no question: {error}; write {{"ask": …}} with one of {known}') from None
    return question


def write_question(question: Question) -> bytes:
    """Encode a query to a camera's node as JSON."""
    return msgspec.json.encode(question)


def read_answer(data: bytes) -> NodeAnswer:
    """Decode a camera node's answer to a query from JSON.

    Raises:
        WireError: it is invalid.
    """
    if len(data) > MAX_ANSWER_BYTES:
        raise WireError(f"the answer has {len(data)} bytes; at most {MAX_ANSWER_BYTES} are read")
    try:
        return decode_json(data, NodeAnswer)
    except InputError as error:
        raise WireError(f"{len(data)} bytes that are no answer of a node ({error})") from None


def write_answer(answer: NodeAnswer) -> bytes:
    """Encode a camera node's answer to a query as JSON; if it is too large, a refusal instead."""
    data = msgspec.json.encode(answer)
    if len(data) <= MAX_ANSWER_BYTES:
        return data
    refusal = f"the answer has {len(data)} bytes, more than {MAX_ANSWER_BYTES}: ask for jpeg, or with a smaller scale"
    return msgspec.json.encode(NodeAnswer(False, refusal))


def ask_node(session: zenoh.Session, sensor: str, question: Question, timeout: float = 10.0) -> NodeAnswer:
    """Query the node that serves a camera, and wait for its answer; a refusal has ``ok`` False.

    Args:
        session: zenoh session of the server, or of a program that reads results (`mocapella.wire.session.open_reader`).
        sensor: the camera's name.
        question: the query.
        timeout: longest wait for the answer [s]; learning takes seconds.

    Raises:
        BusError: no node answers.
        WireError: the answer is invalid.
    """
    for reply in session.get(keys.asking(sensor), payload=write_question(question), timeout=timeout):
        if reply.ok is not None:
            return read_answer(reply.ok.payload.to_bytes())
    raise BusError(f"{sensor}: no answer within {timeout:g} s; only camera nodes answer (mocapella node markers)")
