"""Notice live that the images of cameras are exchanged, such as by swapped names of nodes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

from mocapella.association.exchanged_cameras import exchange_text, exchanged_cameras
from mocapella.association.ray_agreement import INSTANTS
from mocapella.conventions import NS_PER_S
from mocapella.model.camera import PlacedCamera
from mocapella.model.keypoints import KeypointFrame
from mocapella.tracker.instants import CameraInstant

LOOK_S: Final = 0.25
"""Time from one kept instant to the next [s]."""
AGAIN_S: Final = 10.0
"""Time from one comparison to the next, because one takes as long as several instants [s]."""


class ExchangeWatch:
    """Keeps some instants while cameras disagree, and compares them in other orders of the cameras."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._kept: list[dict[str, KeypointFrame]] = []
        self._looked_s, self._compared_s = math.nan, math.nan
        self._found: tuple[dict[str, str], ...] = ()

    def memory(self) -> dict[str, Any]:
        """Return all state, for a tracker's snapshot; its mutable values are shared, not copied."""
        return {name: getattr(self, name) for name in MEMORY}

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras that seem exchanged."""
        return tuple(name for one in self._found for name in one)

    @property
    def text(self) -> str:
        """What is exchanged, with the remedy; empty if nothing is."""
        text = exchange_text(self._found)
        return text and f"{text}: exchange the names of their nodes, or their names in the rig"

    def update(self, instant: CameraInstant, cameras: Mapping[str, PlacedCamera], disagree: Callable[[], bool]) -> None:
        """Consider an instant.

        Args:
            instant: the frames.
            cameras: the rig's cameras.
            disagree: tells whether cameras disagree about people; nothing is kept while they do not.
        """
        at_s = instant.at_ns / NS_PER_S
        if at_s - self._looked_s < LOOK_S:
            return
        self._looked_s = at_s
        if not disagree():
            self._kept, self._found = [], ()
            return
        if at_s - self._compared_s < AGAIN_S:
            return
        seen = {name: one.frame for name, one in instant.frames.items() if len(one.frame.ids)}
        if len(seen) > 1:
            self._kept.append(seen)
        if len(self._kept) >= INSTANTS:
            self._found = exchanged_cameras(self._kept, cameras)
            self._kept, self._compared_s = [], at_s


MEMORY: Final = ("_kept", "_looked_s", "_compared_s", "_found")
"""Attributes of `ExchangeWatch` that are its state."""
