"""Decode the messages of pages: only those that the view uses, and only in their form and range.

viser decodes any of its messages, with any value in any field. A camera's position of NaN, or of two numbers, would
make all later drawing fail.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta
from viser import _messages

from mocapella.decoding import convert, decode_msgpack
from mocapella.errors import InputError
from mocapella.viewer.page_refusals import PageRefusals

FARTHEST: Final = 1e6
"""Largest coordinate of a camera or a ray [m], and largest number of pixels along a side of a canvas."""
SHORTEST: Final = 1e-6
"""Shortest distance between a camera and its target [m], and smallest length of its upward vector."""
LARGEST: Final = 1e9
"""Largest absolute value of a control's number."""
LONGEST_TEXT: Final = 1000
MOST_VALUES: Final = 16
"""Largest number of elements in a control's value."""
MESSAGES_HZ: Final = 200.0
"""Largest mean rate of a page's messages [Hz]; viser's own page sends at most a fifth as many."""
MOST_AT_ONCE: Final = 1000
"""Largest burst of a page's messages, as a number of messages."""
_LONGEST_ID: Final = 100
_LONGEST_REASON: Final = 200

_Number = Annotated[float, Meta(ge=-FARTHEST, le=FARTHEST)]  # NaN is neither
_Vector = tuple[_Number, _Number, _Number]
_Distance = Annotated[float, Meta(ge=0.0, le=FARTHEST)]
_Size = Annotated[int, Meta(ge=0, le=int(FARTHEST))]


class _PageMessage(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="type", tag=True):
    """A message of a page; its class is named like viser's, and has its fields."""


class ViewerCameraMessage(_PageMessage, frozen=True):
    """The browser's camera has moved, or its canvas has another size.

    Attributes:
        wxyz: orientation of the camera in the view's space, a quaternion.
        position: position of the camera in the view's space [m].
        fov: vertical field of view [rad].
        near, far: distances of the clipping planes [m].
        image_height, image_width: size of the canvas [px].
        look_at: point that the camera looks at, in the view's space [m].
        up_direction: upward direction of the camera, of any length above 0.
    """

    wxyz: tuple[_Number, _Number, _Number, _Number]
    position: _Vector
    fov: Annotated[float, Meta(gt=0.0, lt=math.pi)]
    near: _Distance
    far: _Distance
    image_height: _Size
    image_width: _Size
    look_at: _Vector
    up_direction: _Vector

    def __post_init__(self) -> None:
        if math.dist(self.position, self.look_at) < SHORTEST or math.hypot(*self.up_direction) < SHORTEST:
            raise ValueError("the camera looks nowhere")


class GuiUpdateMessage(_PageMessage, frozen=True):
    """A control has been used; `mocapella.viewer.gui_guard` checks whether it may take the value.

    Attributes:
        uuid: viser's id of the control.
        updates: the new value under the only key ``value``.
    """

    uuid: Annotated[str, Meta(max_length=_LONGEST_ID)]
    updates: dict[str, Any]

    def __post_init__(self) -> None:
        if self.updates.keys() != {"value"}:
            raise ValueError("only the value of a control can change")
        if not _is_value(self.updates["value"]):
            raise ValueError(
                f"a value is a number up to {LARGEST:.0f}, a text of up to {LONGEST_TEXT} characters, a yes or no, or "
                f"a list of up to {MOST_VALUES} of these"
            )


class ScenePointerMessage(_PageMessage, frozen=True):
    """The 3D scene was clicked.

    Attributes:
        event_type: always ``click``.
        ray_origin, ray_direction: the ray through the clicked point, in the view's space [m].
        screen_pos: position of the click on the canvas, in viser's coordinates; not used.
        modifier: modifier keys that were held, such as ``shift``; None for none.
    """

    event_type: Literal["click"]
    ray_origin: _Vector
    ray_direction: _Vector
    screen_pos: tuple[tuple[_Number, _Number]]
    modifier: Annotated[str, Meta(max_length=_LONGEST_ID)] | None


USED: Final = (ViewerCameraMessage, GuiUpdateMessage, ScenePointerMessage)
"""Types of the messages that the view accepts."""
_Used = ViewerCameraMessage | GuiUpdateMessage | ScenePointerMessage


class Refused:
    """Result of decoding a message that the view does not accept; viser has no handler for it."""


def decode_page_message(data: bytes) -> _messages.Message:
    """Return viser's message that a page has sent as MessagePack.

    Raises:
        InputError: it is not one of `USED`, or a field is missing, unknown, of another type or out of its range.
    """
    message = convert(decode_msgpack(data), _Used, what="message of the view's page")
    made: _messages.Message = getattr(_messages, type(message).__name__)(**msgspec.structs.asdict(message))
    return made


class PageInbox:
    """Decodes the messages of all pages for viser's web server, and counts those that are refused.

    Args:
        refusals: counts them as ``message``.
    """

    def __init__(self, refusals: PageRefusals) -> None:
        self._refusals = refusals

    def deserialize(self, data: bytes) -> _messages.Message | Refused:
        """Return the decoded message, or a `Refused`; viser calls this method by its name."""
        try:
            return decode_page_message(data)
        except InputError as error:
            reason = f"a page's message cannot be used: {error}"
            self._refusals.add("message", reason[:_LONGEST_REASON])
            return Refused()


class MessageQuota:
    """Token bucket for the messages of one page: `MESSAGES_HZ` on average, and bursts of up to `MOST_AT_ONCE`."""

    def __init__(self) -> None:
        self._left, self._at_s = float(MOST_AT_ONCE), -math.inf

    def take(self, now_s: float) -> bool:
        """Return whether a message is within the quota, and count it.

        Args:
            now_s: the present time on a monotonic clock [s].
        """
        self._left = min(self._left + MESSAGES_HZ * (now_s - self._at_s), MOST_AT_ONCE) - 1
        self._at_s = now_s
        return self._left >= 0


def _is_value(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= LONGEST_TEXT
    if isinstance(value, list | tuple):
        return len(value) <= MOST_VALUES and all(not isinstance(one, list | tuple) and _is_value(one) for one in value)
    return isinstance(value, int | float) and abs(value) <= LARGEST  # NaN is not
