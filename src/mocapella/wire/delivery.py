"""Messages of the record path: a recording server's requests for lost frames, and the nodes' answers, as JSON.

A query carries a `FrameRequest`: what is on the disk, and which frames are missing. The node answers with those frames
in order, and then with a `FrameAnswer`. Frames are identified by their sequence numbers, called numbers here.
"""

from __future__ import annotations

from typing import Annotated, Final, TypeVar

import msgspec

from mocapella.decoding import convert, decode_json
from mocapella.errors import InputError, WireError

MOST_GAPS: Final = 32
"""Largest number of gaps in one request; further ones are in the next."""
MOST_FRAMES: Final = 256
"""Largest number of frames in one answer."""
MOST_ANSWER_BYTES: Final = 4 * 1024 * 1024
"""An answer has no further frame once it has this many bytes."""

T = TypeVar("T")
_Number = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]
_Gaps = Annotated[list[tuple[_Number, _Number]], msgspec.Meta(max_length=MOST_GAPS)]


class FrameRequest(msgspec.Struct, frozen=True, omit_defaults=True):
    """A recording server's request to a node: acknowledges stored frames, and lists the missing ones.

    Attributes:
        take: identity of the take.
        stored: every frame below this number that belongs to the take is on the disk, or lost; None before the first
            number is agreed.
        age_ns: time since the take began [ns]; while ``stored`` is None, the node finds its first frame of the take by
            it, and answers with the frame's number (`FrameAnswer.first`).
        end: number after the last frame that belongs to the take; None while it goes on.
        closed: whether the take is closed, so that no more frames are requested.
        wanted: (first, last) of each range of frames to send.
    """

    take: Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
    stored: _Number | None = None
    age_ns: _Number = 0
    end: _Number | None = None
    closed: bool = False
    wanted: _Gaps = []


class FrameAnswer(msgspec.Struct, frozen=True, omit_defaults=True):
    """A node's answer to a `FrameRequest`, after the frames: which frames it still has, and whether more will come.

    Attributes:
        next: number of the next frame that the node will send.
        oldest: number of the oldest frame that it still has; equal to ``next`` if it has none.
        first: number of its first frame since the take began.
        leaving: whether the node sends no more frames.
        gone: (first, last) of wanted frames that the node cannot read any more, such as from a damaged file.
    """

    next: _Number
    oldest: _Number
    first: _Number = 0
    leaving: bool = False
    gone: Annotated[list[tuple[_Number, _Number]], msgspec.Meta(max_length=MOST_FRAMES)] = []


def check_number(value: object) -> int:
    """Return a value decoded from JSON unchanged if it is a valid sequence number.

    Raises:
        WireError: it is no whole number from 0 to below 2**62.
    """
    try:
        return convert(value, _Number, what="number of a frame")
    except InputError:
        raise WireError(f"next is {str(value)[:40]}; it is the number after the node's last frame, 0 or more") from None


def read_request(data: bytes) -> FrameRequest:
    """Decode a recording server's request to a node: acknowledged frames, and the numbers of missing ones.

    Raises:
        WireError: it is invalid; names the fault.
    """
    return _read(data, FrameRequest, "request for frames")


def read_answer(data: bytes) -> FrameAnswer:
    """Decode a node's answer to a frame request: the number of its next frame, and the oldest that it still has.

    Raises:
        WireError: it is invalid; names the fault.
    """
    return _read(data, FrameAnswer, "answer about frames")


def _read(data: bytes, kind: type[T], what: str) -> T:
    try:
        return decode_json(data, kind, what=what, fix="docs/wire.md has its fields")
    except InputError as error:
        raise WireError(str(error)) from None
