"""Readouts and controls of one type of scene part, or of one stage, beside the 3D scene of one browser."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import viser

from mocapella.model.scene import Scene


@dataclass(frozen=True, eq=False)
class PanelPlace:
    """Where a panel goes.

    Attributes:
        gui: of the browser.
        order: among the other folders.
        send: sends a command to the server; None where there is no server.
    """

    gui: viser.GuiApi
    order: float
    send: Callable[[str, dict[str, Any]], None] | None = None


@dataclass(frozen=True, eq=False)
class PanelState:
    """What a panel is to show.

    Attributes:
        scene: that this browser shows; None where it shows none.
        parts: of the panel's type in it.
        shown: what the memory of the stage made of it.
        visible: whether there can be such parts at all.
        can_name: whether a person can be given a name now.
        changed: whether the scene or the session's status is another one than at the last call.
        now_s: of a monotonic clock [s].
        lately: scenes of the last seconds up to the shown scene, and the time of each [s].
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
    """A folder of the panel."""

    def show(self, state: PanelState) -> None:
        """Bring it up to the newest."""


MakePanel = Callable[[PanelPlace], PartPanel]
