"""The camera of one browser: placed, or following the tracked parts until the user moves it by hand."""

from __future__ import annotations

import time
from collections import deque
from typing import Final

import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.viewer.label_layout import LabelCamera
from mocapella.viewer.layout import Look

Float64 = NDArray[np.float64]

_ASIDE: Final = 1e-3
"""[m]."""
_SETTLED: Final = 30
"""Calls after a move of ours during which the browser may still report its camera's previous position."""
_ELSEWHERE_M: Final = 0.02
REMEMBERED: Final = 600
"""So many places the camera was put at are known; what a slow browser says of its camera is of some time ago."""
OURS_M: Final = 0.004
"""A camera so near to one of them is where it was put; a pixel of turning by hand is ten times as far."""
MOVED_M: Final = 0.001
"""While it goes along, a look is sent where it has changed by more."""


class BrowserCamera:
    """Moves the camera of one browser, until its user does. Call the methods from the drawing loop only.

    Args:
        client: the browser.

    Attributes:
        home: (3,) where "Reset View" puts the camera.
        answered_s: when the browser first said that its camera is where we put it, of a monotonic clock [s].
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._camera = client.camera
        self.home: Float64 | None = None
        self.answered_s = np.inf
        self._look: Look | None = None
        self._calls_since_move = 0
        self._follows = self._by_hand = self._heard = False
        self._sent: deque[Float64] = deque(maxlen=REMEMBERED)
        self._reported: deque[Float64] = deque(maxlen=REMEMBERED)
        # What is waited for in the server's own loop comes in order.
        client.camera.on_update(self._hear)

    @property
    def aspect(self) -> float:
        """Width of the browser's canvas over its height."""
        return max(self._camera.image_width, 1) / max(self._camera.image_height, 1)

    @property
    def ready(self) -> bool:
        """Whether the browser has reported the size of its canvas."""
        return bool(self._camera.image_width)

    @property
    def labels(self) -> LabelCamera | None:
        """The camera as the browser reported it last, for the layout of labels; None before the first report."""
        if not self.ready:
            return None
        camera = self._camera
        return LabelCamera.looking(
            np.asarray(camera.position), np.asarray(camera.look_at), np.asarray(camera.up_direction),
            float(camera.fov), camera.image_height,
        )  # fmt: skip

    @property
    def touched(self) -> bool:
        """Whether the user has moved the camera since the program last did."""
        if self._follows:
            return self._by_hand
        if self._look is None or self._calls_since_move <= _SETTLED:
            return False
        return not np.allclose(self._camera.position, self._look.position, atol=_ELSEWHERE_M)

    def beat(self, now_s: float | None = None) -> None:
        """Process the camera positions that the browser reported; one that was never sent to it is the user's move."""
        self._calls_since_move += 1
        while self._reported:
            at = self._reported.popleft()
            passed = next((k for k, sent in enumerate(self._sent) if _near(at, sent)), None)
            if passed is not None:
                for _ in range(passed):  # it does not go back there by itself
                    self._sent.popleft()
                self._heard = True
                self.answered_s = min(self.answered_s, time.monotonic() if now_s is None else now_s)
            if self.home is not None and _near(at, self.home):
                self._by_hand = False
            elif passed is None and self._heard:  # until then it may not have heard of us
                self._by_hand = True

    def put(self, look: Look) -> None:
        """Move the camera, even if the user has moved it."""
        self._follows = self._by_hand = False
        self._place(look)

    def follow(self, look: Look) -> None:
        """Move the camera along with its target, unless the user has moved it since the first such call."""
        if not self._follows:
            self._follows, self._by_hand, self._heard = True, False, False
            self._place(look)
            return
        if self._by_hand:
            self._look = None
            return
        last = self._look
        if last is not None and np.abs([look.position - last.position, look.target - last.target]).max() < MOVED_M:
            return
        self._look, self._calls_since_move = look, 0
        self._sent.append(np.asarray(look.position))
        self._camera.fov = look.fov
        self._camera.up_direction = (0.0, 1.0, 0.0)
        self._camera.position, self._camera.look_at = look.position, look.target

    def _place(self, look: Look) -> None:
        self._look, self._calls_since_move = look, 0
        camera = self._camera
        camera.fov = look.fov
        camera.up_direction = (0.0, 1.0, 0.0)
        # An unchanged pose is not sent, and the pose known here is the browser's last report, older than moves on their
        # way. So the camera is first put beside its target pose: then the target pose itself is always sent.
        for aside in (_ASIDE, 0.0):
            camera.position = np.asarray(look.position) + aside
            camera.look_at = np.asarray(look.target) + aside
        self._sent.append(np.asarray(look.position))

    async def _hear(self, camera: viser.CameraHandle) -> None:
        self._reported.append(np.array(camera.position))


def _near(a: Float64, b: Float64) -> bool:
    return bool(np.abs(a - b).max() < OURS_M)
