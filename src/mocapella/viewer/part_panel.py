"""Interface of a folder in the live view's panel: readouts and controls of one type of part, or of one stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import viser

from mocapella.model.scene import Scene


@dataclass(frozen=True, eq=False)
class PanelPlace:
    """Place of a folder in a browser's panel.

    Attributes:
        gui: of the browser.
        order: position among the other folders.
        send: sends a command with its arguments to the server; None without a server.
    """

    gui: viser.GuiApi
    order: float
    send: Callable[[str, dict[str, Any]], None] | None = None


@dataclass(frozen=True, eq=False)
class PanelState:
    """State that a folder shows.

    Attributes:
        scene: shown in this browser; None before the first.
        parts: the scene's parts of the folder's type.
        shown: value that the stage's memory derived from the scene (`StageMemory.update`).
        visible: whether the method can make parts of this type.
        can_name: whether a person can be given a name now.
        changed: whether the scene or the session's status has changed since the last call.
        now_s: of a monotonic clock [s].
        lately: function of a duration [s] that returns the times [s] and scenes of that time before the shown scene.
    """

    scene: Scene | None
    parts: tuple[Any, ...]
    shown: Any
    visible: bool
    can_name: bool
    changed: bool
    now_s: float
    lately: Callable[[float], tuple[list[float], list[Scene]]]


class PartPanel(Protocol):
    """Interface of a folder in the panel."""

    def show(self, state: PanelState) -> None:
        """Update the folder."""


MakePanel = Callable[[PanelPlace], PartPanel]
