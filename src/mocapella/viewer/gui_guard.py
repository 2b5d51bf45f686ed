"""Security filter for messages of browsers: they may change only the values of visible, enabled controls.

Without it, viser sets any attribute that a browser names, also of disabled and hidden controls, and calls their
callbacks.
"""

from __future__ import annotations

import math
from typing import Any, Final

import viser
from viser import _messages

LONGEST_TEXT: Final = 1000
MOST_VALUES: Final = 16
"""Largest number of elements in a control's value."""
_UNUSED: Final = (
    _messages.CommandTriggerMessage,
    _messages.FileTransferPart,
    _messages.FileTransferStartUpload,
    _messages.GuiButtonHoldMessage,
    _messages.GuiFormDirtyMessage,
    _messages.GuiFormSubmitMessage,
)
"""Messages of a browser about controls that the view does not have."""


def guard_controls(client: viser.ClientHandle) -> None:
    """Ignore a browser's changes of controls that `may_change` forbids, and all messages that the view does not use.

    Call it once for each connected browser, before its controls are added.
    """
    gui: Any = client.gui
    theirs = gui._handle_gui_updates
    messages = gui._websock_interface

    async def guarded(client_id: int, message: _messages.GuiUpdateMessage) -> None:
        handle = gui._gui_input_handle_from_uuid.get(message.uuid)
        if handle is not None and may_change(handle, message.updates):
            await theirs(client_id, message)

    hear_nothing_unused(gui)
    messages.unregister_handler(_messages.GuiUpdateMessage, theirs)
    messages.register_handler(_messages.GuiUpdateMessage, guarded)


def hear_nothing_unused(gui: viser.GuiApi) -> None:
    """Ignore browsers' messages about types of controls that the view does not have, such as uploads."""
    messages: Any = gui._websock_interface
    for kind in _UNUSED:
        messages.unregister_handler(kind)


def may_change(handle: Any, updates: dict[str, Any]) -> bool:
    """Return whether a browser may make a change to a control.

    The control must be visible and enabled, and the change a new value of its type and range: one of the options of a
    menu, at most `LONGEST_TEXT` characters, at most `MOST_VALUES` elements, and finite numbers within its limits.

    Args:
        handle: viser's handle of the control.
        updates: new values by the control's attribute.
    """
    if handle.disabled or not handle.visible or updates.keys() != {"value"}:
        return False
    value, options = updates["value"], getattr(handle, "options", None)
    if options is not None:
        return isinstance(value, str) and value in options
    return _is_value(value) and _fits(value, handle)


def _fits(value: Any, handle: Any) -> bool:
    """Whether a value is of the type and in the range of a control's."""
    now = getattr(handle, "value", value)
    if isinstance(now, str | bool):
        return type(value) is type(now)
    least, most = getattr(handle, "min", None), getattr(handle, "max", None)
    if isinstance(now, int | float):
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        return (least is None or value >= least) and (most is None or value <= most)
    return isinstance(now, list | tuple) == isinstance(value, list | tuple)


def _is_value(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= LONGEST_TEXT
    if isinstance(value, list | tuple):
        return len(value) <= MOST_VALUES and all(not isinstance(one, list | tuple) and _is_value(one) for one in value)
    return isinstance(value, bool | int) or (isinstance(value, float) and math.isfinite(value))
