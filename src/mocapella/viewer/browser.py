"""One connected browser: its panel, its Tracking stage, its camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import viser

from mocapella.model.board_progress import BoardProgress
from mocapella.model.observations import BodyFrame
from mocapella.model.scene import Person, Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import SessionStatus
from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG
from mocapella.viewer import layout
from mocapella.viewer.arms import ArmsShown
from mocapella.viewer.camera_feed import CameraFeed
from mocapella.viewer.commands import Commander
from mocapella.viewer.layout import Look
from mocapella.viewer.palette import SensorColours
from mocapella.viewer.panel import Aim, Panel
from mocapella.viewer.perspective import Float64, Floors, Perspectives
from mocapella.viewer.picture_stage import PictureStage
from mocapella.viewer.readout import condition_lines, stage_text
from mocapella.viewer.stages import TrackingDrawing, TrackingStage
from mocapella.viewer.trails import TrailChoice, Trails

FOV = np.radians(36.0)
_ELEVATION = np.radians(13.0)
_ELEVATION_OF_ARMS = np.radians(7.0)
_ASIDE = 1e-3
"""[m]."""
ROUND = 1.2
"""How much wider than the large picture the browser's own is, which has words over it."""
_SETTLED = 30
"""Calls after a move of ours in which the browser may still report where its camera was before."""


@dataclass(frozen=True)
class Known:
    """What the view remembers of sensors and people, the same for all browsers; only the loop that draws changes it."""

    colours: SensorColours = field(default_factory=SensorColours)
    fields: dict[str, tuple[float, float]] = field(default_factory=dict)
    floors: Floors = field(default_factory=Floors)
    seen: Perspectives = field(default_factory=Perspectives)
    trails: Trails = field(default_factory=Trails)

    def learn(self, scene: Scene | None, frames: Mapping[str, SensorFrame], status: SessionStatus | None) -> None:
        """Take up the newest."""
        self.colours.learn({row.name for row in status.sensors} if status else set())
        self.colours.learn(set(frames))
        if scene is not None:
            self.seen.learn(scene)
            self.floors.learn_scene(scene)
            self.trails.learn(scene, self.seen.world)
        poses = status.setup.sensors if status else {}
        for name, frame in frames.items():
            self.fields[name] = frame.field_of_view_deg
            if not isinstance(frame, BodyFrame):
                continue
            self.floors.learn_frame(frame, poses.get(name))


class Browser:
    """What one client sees. Owned by the loop that draws; the client's callbacks only leave a wish."""

    def __init__(
        self,
        client: viser.ClientHandle,
        commander: Commander,
        methods: Sequence[str],
        known: Known,
        feed: CameraFeed,
    ) -> None:
        self._client, self._known, self._colours = client, known, known.colours
        self._wish: Aim | None = Aim.BOTH
        self._aim = Aim.BOTH
        self._framed: tuple[object, ...] | None = None
        self._look: Look | None = None
        self._calls_since_move = 0
        self._arms = False
        self._stage = TrackingStage(client.scene, known.colours, known.fields)
        self._pictures = PictureStage(client.scene)
        self._hears_clicks = self._before_picture = False
        self._panel = Panel(client, commander, methods, known.colours, aim=self._want, feed=feed)

    def show(
        self,
        draw: Callable[[str], TrackingDrawing],
        scene: Scene | None,
        status: SessionStatus | None,
        board: BoardProgress | None = None,
        arms: ArmsShown | None = None,
    ) -> None:
        """Show the newest: ``draw`` makes the Tracking stage of a perspective."""
        with self._client.atomic():
            self._panel.show(status, scene, board, arms)
            if (arms is not None) != self._arms:  # the stages change, and the camera with them, unless it was moved
                self._arms = arms is not None
                if self._wish in (None, Aim.BOTH) and not self._touched():
                    self._wish = Aim.TRACKING if self._arms else Aim.BOTH
            wish, self._wish = self._wish, None  # before the perspective: a callback sets it first, and then the wish
            perspective = self._panel.perspective
            self._stage.draw(
                draw(perspective),
                perspective,
                stage_text(status),
                condition_lines(status),
                eyes=self._aim is Aim.EYES,
                fields=self._panel.fields,
            )
            self._draw_pictures()
            self._draw_trails(perspective, self._panel.trails if scene is not None else TrailChoice())
            self._move_camera(perspective, self._known.floors, wish)

    def _draw_pictures(self) -> None:
        cameras = self._panel.cameras
        self._pictures.draw(cameras.large)
        if cameras.wants_clicks != self._hears_clicks:
            self._hears_clicks = cameras.wants_clicks
            if self._hears_clicks:
                self._client.scene.on_click()(self._clicked)
            else:
                self._client.scene.remove_click_callback()

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        plane = self._pictures.plane
        at = None if plane is None else plane.pixel(np.array(event.ray_origin), np.array(event.ray_direction))
        if at is not None:
            self._panel.cameras.click(at)

    def _draw_trails(self, perspective: str, shown: TrailChoice) -> None:
        seen, T_stage = self._known.seen, self._known.floors.level(perspective)

        def to_stage(person: Person) -> Float64 | None:
            T = seen.from_world(person, perspective)
            return None if T is None else T_stage @ T

        self._stage.draw_trails(self._known.trails, shown, perspective, to_stage)

    def _want(self, aim: Aim) -> None:
        self._wish = aim

    def _move_camera(self, perspective: str, floors: Floors, wish: Aim | None) -> None:
        self._calls_since_move += 1
        camera, plane = self._client.camera, self._pictures.plane
        width, tall = max(camera.image_width, 1), max(camera.image_height, 1)
        lanes = len(self._colours.sensors)
        fits: tuple[object, ...] = (lanes if plane is None else plane.size_px, width / tall)
        if plane is not None and wish is None:
            if self._framed is None or not self._before_picture or (fits != self._framed and not self._touched()):
                self._framed, self._before_picture = fits, True
                self._put(layout.frame(plane.corners, fov=FOV, aspect=width / tall, elevation=0.0, margin=ROUND))
            return
        if self._before_picture:
            self._before_picture, wish = False, wish or self._aim
            self._panel.cameras.leave()
        if wish is None and (fits == self._framed or self._touched() or self._aim is Aim.EYES):
            return
        self._aim = wish or self._aim
        self._framed = fits
        if self._aim is Aim.EYES:
            _, high = self._known.fields.get(perspective, UNKNOWN_FIELD_OF_VIEW_DEG)
            self._put(layout.eyes(floors.tilt(perspective), floors.height(perspective), np.radians(high)))
            return
        tracking = layout.arms_box().corners if self._arms else layout.tracking_box().corners
        sensors = layout.sensors_box(lanes).corners
        seen = {Aim.TRACKING: tracking, Aim.SENSORS: sensors}.get(self._aim, np.concatenate([tracking, sensors]))
        elevation = _ELEVATION_OF_ARMS if self._arms and self._aim is Aim.TRACKING else _ELEVATION
        self._put(layout.frame(seen, fov=FOV, aspect=width / tall, elevation=elevation))

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
        # What the camera is at already is not sent; but what is known of it is the browser's last report, from before
        # moves that are on their way. So it is put beside its place first: then the place itself is always sent.
        for aside in (_ASIDE, 0.0):
            camera.position = np.asarray(look.position) + aside
            camera.look_at = np.asarray(look.target) + aside
