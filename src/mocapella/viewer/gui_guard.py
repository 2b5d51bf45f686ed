"""Security filter for the controls of the view: browsers may change only the values of visible, enabled ones.

Without it, viser sets the values of disabled and hidden controls, too, and calls their callbacks. The form of a value
is checked before, in `mocapella.viewer.page_messages`.
"""

from __future__ import annotations

from typing import Any

import viser
from viser import _messages


def guard_controls(client: viser.ClientHandle) -> None:
    """Ignore a browser's changes of controls that `may_change` forbids.

    Call it once for each connected browser, before its controls are added.
    """
    gui: Any = client.gui
    theirs = gui._handle_gui_updates
    messages = gui._websock_interface

    async def guarded(client_id: int, message: _messages.GuiUpdateMessage) -> None:
        handle = gui._gui_input_handle_from_uuid.get(message.uuid)
        if handle is not None and may_change(handle, message.updates["value"]):
            await theirs(client_id, message)

    messages.unregister_handler(_messages.GuiUpdateMessage, theirs)
    messages.register_handler(_messages.GuiUpdateMessage, guarded)


def may_change(handle: Any, value: Any) -> bool:
    """Return whether a browser may give a control a value.

    The control must be visible and enabled, and the value of its type and range: one of the options of a menu, or a
    number within its limits.

    Args:
        handle: viser's handle of the control.
        value: the new value.
    """
    if handle.disabled or not handle.visible:
        return False
    options = getattr(handle, "options", None)
    if options is not None:
        return isinstance(value, str) and value in options
    return _fits(value, handle)


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
