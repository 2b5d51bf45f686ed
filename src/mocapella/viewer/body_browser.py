"""One browser before followed bodies: its camera, which goes along with them until somebody moves it, and its pictures.

Every browser has pictures of its own, for a browser that has just come is given time to show the first ones.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Final

import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.viewer.body_stage import BOARD, BodyStage
from mocapella.viewer.layout import Look
from mocapella.viewer.picture_plane import Encoded, PictureNode

Float64 = NDArray[np.float64]

REMEMBERED: Final = 600
"""So many places the camera was put at are known; what a slow browser says of its camera is of some time ago."""
OURS_M: Final = 0.004
"""A camera so near to one of them is where it was put; a pixel of turning by hand is ten times as far."""
MOVED_M: Final = 0.001
"""A look is sent where it has changed by more."""
STILL_S, LONGEST_STILL_S = 0.5, 5.0
"""The first pictures stay for so long once the browser answers, and no longer than this if it does not.

A browser drops a picture that it has not decoded when the next one comes: one that is busy would show none.
"""


class BodyBrowser:
    """What one browser sees of a stage. Its methods belong to the loop that draws.

    Args:
        client: the browser.
        stage: where the bodies are.
        now_s: when it came.

    Attributes:
        touched: whether somebody has moved its camera by hand; then it is left alone until `Look at` changes or the
            view is reset.
    """

    def __init__(self, client: viser.ClientHandle, stage: BodyStage, now_s: float) -> None:
        self._client, self._stage = client, stage
        self._nodes = {name: PictureNode(client.scene, f"{BOARD}/{name}/picture") for name in stage.planes}
        self._pictures: dict[str, Encoded] = {}
        self._came_s, self._answered_s = now_s, np.inf
        self._home = np.asarray(stage.home.position)
        self._sent: deque[Float64] = deque(maxlen=REMEMBERED)
        self._reported: deque[Float64] = deque(maxlen=REMEMBERED)
        self._look: Look | None = None
        self._aim = ""
        self.touched = False
        # What is waited for in the server's own loop comes in order.
        client.camera.on_update(self._hear)

    def show(self, aim: str, pictures: Mapping[str, Encoded], now_s: float) -> None:
        """Bring it up to the newest.

        Args:
            aim: the camera whose picture is to be looked at alone, or nothing.
            pictures: by camera; where there is none, its board is empty.
            now_s: now.
        """
        self._listen(now_s)
        with self._client.atomic():
            still_s = min(self._answered_s + STILL_S, self._came_s + LONGEST_STILL_S)
            for name, node in self._nodes.items():
                if name not in pictures:
                    self._pictures.pop(name, None)
                    node.hide()
                elif name not in self._pictures or now_s >= still_s:
                    self._pictures[name] = pictures[name]
                    node.draw(self._stage.planes[name].at_origin, pictures[name])
            self._move(aim)

    async def _hear(self, camera: viser.CameraHandle) -> None:
        self._reported.append(np.array(camera.position))

    def _listen(self, now_s: float) -> None:
        """Take in where the browser says that its camera was: where it was put, one place after the other, or not."""
        while self._reported:
            at = self._reported.popleft()
            home = _near(at, self._home)
            passed = next((k for k, sent in enumerate(self._sent) if _near(at, sent)), None)
            if passed is not None:
                for _ in range(passed):  # it does not go back there by itself
                    self._sent.popleft()
                self._answered_s = min(self._answered_s, now_s)
            if home:
                self.touched = False
            elif passed is None and self._answered_s < np.inf:  # until then it may not have heard of us
                self.touched = True

    def _move(self, aim: str) -> None:
        camera = self._client.camera
        if not camera.image_width:
            return
        if aim != self._aim:
            self._aim, self.touched, self._look = aim, False, None
        if self.touched:
            self._look = None
            return
        look, last = self._stage.look(camera.image_width / max(camera.image_height, 1), aim), self._look
        if last is not None:
            moved = np.abs([look.position - last.position, look.target - last.target]).max()
            if moved < MOVED_M:
                return
        self._look = look
        self._sent.append(np.asarray(look.position))
        camera.fov = look.fov
        camera.up_direction = (0.0, 1.0, 0.0)
        camera.position, camera.look_at = look.position, look.target


def _near(a: Float64, b: Float64) -> bool:
    return bool(np.abs(a - b).max() < OURS_M)
