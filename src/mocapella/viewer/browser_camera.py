"""The camera of one browser: it stands still or follows the tracked parts, until the user moves it by hand."""

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
"""Offset of a pose that is sent first, so that the pose itself always counts as changed [m]."""
_SETTLED: Final = 30
"""Number of `BrowserCamera.beat` calls after a pose was sent, while the browser may report its previous position."""
_ELSEWHERE_M: Final = 0.02
REMEMBERED: Final = 600
"""Number of remembered positions sent to the browser, because a slow browser reports its camera's position late."""
OURS_M: Final = 0.004
"""A reported position this near to a sent one counts as the sent one [m]; rotating by one pixel moves it ten times as
far."""
MOVED_M: Final = 0.001
"""A camera that follows is sent only if its position or target has changed by more than this [m]."""


class BrowserCamera:
    """Moves the camera of one browser, until its user does. Call the methods from the drawing loop only.

    Args:
        client: viser's connection to the browser.

    Attributes:
        home: (3,) camera position of the button "Reset View" [m]; None if unknown.
        answered_s: time on this process's monotonic clock at which the browser first reported a camera position that
            was sent to it [s]; infinite before.
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
        # An asynchronous callback runs on the server's loop, so reports arrive in order.
        client.camera.on_update(self._hear)

    @property
    def aspect(self) -> float:
        """Width of the browser's canvas over its height; 1 before the browser's first report."""
        return max(self._camera.image_width, 1) / max(self._camera.image_height, 1)

    @property
    def ready(self) -> bool:
        """Whether the browser has reported the size of its canvas."""
        return bool(self._camera.image_width)

    @property
    def labels(self) -> LabelCamera | None:
        """Camera as last reported by the browser, for the layout of labels; None before the first report."""
        if not self.ready:
            return None
        camera = self._camera
        return LabelCamera.looking(
            np.asarray(camera.position), np.asarray(camera.look_at), np.asarray(camera.up_direction),
            float(camera.fov), camera.image_height,
        )  # fmt: skip

    @property
    def touched(self) -> bool:
        """Whether the user has moved the camera since `put` or `follow` last placed it."""
        if self._follows:
            return self._by_hand
        if self._look is None or self._calls_since_move <= _SETTLED:
            return False
        return not np.allclose(self._camera.position, self._look.position, atol=_ELSEWHERE_M)

    def beat(self, now_s: float | None = None) -> None:
        """Process the camera positions that the browser has reported; call it in every update.

        Once the browser has reported a position that was sent to it, any other position is a move by the user: `follow`
        has no effect from then on, until the browser reports `home` or `put` is called. Earlier reports of other
        positions are ignored. Positions count as equal within `OURS_M`.

        Args:
            now_s: the present time on this process's monotonic clock [s]; None reads the clock.
        """
        self._calls_since_move += 1
        while self._reported:
            at = self._reported.popleft()
            passed = next((k for k, sent in enumerate(self._sent) if _near(at, sent)), None)
            if passed is not None:
                for _ in range(passed):  # the browser does not report earlier positions any more
                    self._sent.popleft()
                self._heard = True
                self.answered_s = min(self.answered_s, time.monotonic() if now_s is None else now_s)
            if self.home is not None and _near(at, self.home):
                self._by_hand = False
            elif passed is None and self._heard:  # before, the browser may not have received a sent position
                self._by_hand = True

    def put(self, look: Look) -> None:
        """Place the camera at once, even if the user has moved it; it stays there until `put` or `follow` is called."""
        self._follows = self._by_hand = False
        self._place(look)

    def follow(self, look: Look) -> None:
        """Move the camera with a moving target; call it in every update.

        The first call after `put` always places the camera. Later calls have no effect once the user has moved it.
        """
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
