"""One connected browser: its panel, its Tracking stage, its camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import viser

from mocapella.model.session import SessionStatus
from mocapella.viewer import layout
from mocapella.viewer.commands import Commander
from mocapella.viewer.layout import Look
from mocapella.viewer.palette import SensorColours
from mocapella.viewer.panel import Aim, Panel
from mocapella.viewer.perspective import Floors
from mocapella.viewer.readout import stage_text
from mocapella.viewer.stages import TrackingDrawing, TrackingStage

_FOV = np.radians(36.0)
_SENSOR_FOV = np.radians(60.0)
_ELEVATION = np.radians(13.0)
_SETTLED = 30
"""Calls after a move of ours in which the browser may still report where its camera was before."""


class Browser:
    """What one client sees. Owned by the loop that draws; the client's callbacks only leave a wish."""

    def __init__(
        self, client: viser.ClientHandle, commander: Commander, methods: Sequence[str], colours: SensorColours
    ) -> None:
        self._client, self._colours = client, colours
        self._wish: Aim | None = Aim.BOTH
        self._aim = Aim.BOTH
        self._framed: tuple[int, float] | None = None
        self._look: Look | None = None
        self._calls_since_move = 0
        self._stage = TrackingStage(client.scene, colours)
        self._panel = Panel(client, commander, methods, colours, self._want)

    def show(self, draw: Callable[[str], TrackingDrawing], status: SessionStatus | None, floors: Floors) -> None:
        """Show the newest: ``draw`` makes the Tracking stage of a perspective."""
        with self._client.atomic():
            self._panel.show(status)
            perspective = self._panel.perspective
            eyes = self._aim is Aim.EYES
            self._stage.draw(draw(perspective), perspective, stage_text(status), eyes=eyes)
            self._move_camera(perspective, floors)

    def _want(self, aim: Aim) -> None:
        self._wish = aim

    def _move_camera(self, perspective: str, floors: Floors) -> None:
        self._calls_since_move += 1
        camera = self._client.camera
        width, tall = max(camera.image_width, 1), max(camera.image_height, 1)
        lanes = len(self._colours.sensors)
        fits = (lanes, width / tall)
        wish, self._wish = self._wish, None
        if wish is None and (fits == self._framed or self._touched() or self._aim is Aim.EYES):
            return
        self._aim = wish or self._aim
        self._framed = fits
        if self._aim is Aim.EYES:
            self._put(layout.eyes(floors.tilt(perspective), floors.height(perspective), _SENSOR_FOV))
            return
        tracking, sensors = layout.tracking_box().corners, layout.sensors_box(lanes).corners
        seen = {Aim.TRACKING: tracking, Aim.SENSORS: sensors}.get(self._aim, np.concatenate([tracking, sensors]))
        self._put(layout.frame(seen, fov=_FOV, aspect=width / tall, elevation=_ELEVATION))

    def _touched(self) -> bool:
        """Whether a person moved the camera since we did."""
        if self._look is None or self._calls_since_move <= _SETTLED:
            return False
        return not np.allclose(self._client.camera.position, self._look.position, atol=0.02)

    def _put(self, look: Look) -> None:
        self._look, self._calls_since_move = look, 0
        camera = self._client.camera
        camera.fov = look.fov
        camera.up_direction = (0.0, 1.0, 0.0)
        camera.position = look.position
        camera.look_at = look.target
