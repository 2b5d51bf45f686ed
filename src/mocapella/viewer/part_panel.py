"""Interface of a folder in the live view's panel, with readouts and controls for one type of part, or one stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import viser

from mocapella.model.scene import Scene


@dataclass(frozen=True, eq=False)
class PanelPlace:
    """Place of a new folder in one browser's panel, and the connection to the server.

    Attributes:
        gui: controls of the browser.
        order: position among the other folders.
        send: sends a command with its arguments to the server; None without a server, or if the browser only watches.
    """

    gui: viser.GuiApi
    order: float
    send: Callable[[str, dict[str, Any]], None] | None = None


@dataclass(frozen=True, eq=False)
class PanelState:
    """State that a folder shows.

    Attributes:
        scene: the scene that this browser shows; None before the first.
        parts: the scene's parts of the folder's type; empty for the folder of a stage.
        shown: value that the memory of the presently shown stage derived from the scene
            (`mocapella.viewer.stage.StageMemory.update`). While a stage's own folder is not visible, it is the value of
            another stage, which may have another type.
        visible: whether the folder is shown, because the tracking method can make such parts, or the stage is shown.
        can_name: whether a person can be given a name now.
        changed: whether the session's status, the notices, or the choice of live or replay has changed since the last
            call of `PartPanel.show`. A new scene alone sets it only in a replay and in a run on files.
        now_s: the present time on this process's monotonic clock [s].
        lately: function of a duration [s]; it returns the times [s] on the scenes' common clock and the scenes of that
            duration up to the shown scene.
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
    """Interface of a folder in one browser's panel."""

    def show(self, state: PanelState) -> None:
        """Update the folder's content; called in every update of the view."""


MakePanel = Callable[[PanelPlace], PartPanel]
"""Creates a folder in one browser's panel, once for each browser."""
