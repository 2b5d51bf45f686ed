"""What a browser may change of its controls: the value of one that is shown and enabled, and nothing else.

The library sets whatever attribute a browser names, of disabled and hidden controls too, and calls their callbacks.
"""

from __future__ import annotations

import math
from typing import Any, Final

import viser
from viser._messages import GuiUpdateMessage

LONGEST_TEXT: Final = 1000
MOST_VALUES: Final = 16
"""Most numbers or texts of one control's value."""


def guard_controls(client: viser.ClientHandle) -> None:
    """Let a browser change only what `may_change` allows; call it before controls are added."""
    gui: Any = client.gui
    theirs = gui._handle_gui_updates
    messages = gui._websock_interface

    async def guarded(client_id: int, message: GuiUpdateMessage) -> None:
        handle = gui._gui_input_handle_from_uuid.get(message.uuid)
        if handle is not None and may_change(handle, message.updates):
            await theirs(client_id, message)

    messages.unregister_handler(GuiUpdateMessage, theirs)
    messages.register_handler(GuiUpdateMessage, guarded)


def may_change(handle: Any, updates: dict[str, Any]) -> bool:
    """Return whether a browser may change a control so.

    Args:
        handle: of the control.
        updates: new values by attribute.
    """
    return not handle.disabled and handle.visible and updates.keys() == {"value"} and _is_value(updates["value"])


def _is_value(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= LONGEST_TEXT
    if isinstance(value, list | tuple):
        return len(value) <= MOST_VALUES and all(not isinstance(one, list | tuple) and _is_value(one) for one in value)
    return isinstance(value, bool | int) or (isinstance(value, float) and math.isfinite(value))
