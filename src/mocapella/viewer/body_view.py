"""The view of followed bodies: what was followed so far can be played, stopped and looked at frame by frame."""

from __future__ import annotations

import bisect
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.twist_tree import TreePose
from mocapella.viewer.body_browser import BodyBrowser
from mocapella.viewer.body_panel import ALL, WINDOW_S, BodyPanel, BodyViewFrame
from mocapella.viewer.body_stage import BodyStage, ShownBody, stage_space
from mocapella.viewer.page import open_page, tolerated, unprinted
from mocapella.viewer.picture_plane import Encoded

Float64 = NDArray[np.float64]

PANEL_PX: Final = 360
UP: Final = (0.0, 1.0, 0.0)
KEPT_BYTES: Final = 300_000_000
"""Of pictures; beyond, the oldest are let go."""
KEPT_FRAMES: Final = 36_000
"""Beyond, the oldest are let go, so many at once:"""
LET_GO: Final = 1_000
LATEST_S: Final = 0.5
"""A camera that gave no picture in a frame has its last one shown, where that is no older."""
CHARTS_EVERY_S: Final = 0.2


class BodyView:
    """Serves it on one address. Its methods belong to one loop.

    Args:
        host: the interface to serve on, and no other.
        port: its port; 0 takes a free one.
        meshes: of the bodies, by name.
        rig: the cameras.
        starts: the bodies' first poses.
        up: (3,) of the world.

    Attributes:
        frames: all so far, or the last `KEPT_FRAMES` of them.
        place: of the frame among them that is shown.
        panel: its controls.

    Raises:
        AddressInUseError: somebody else listens there.
        SettingsError: an address that this machine cannot listen at.
    """

    def __init__(
        self, host: str, port: int, meshes: Mapping[str, RiggedMesh], rig: CameraRig, *,
        starts: Mapping[str, TreePose], up: Float64,
    ) -> None:  # fmt: skip
        self._server = open_page(host, port, PANEL_PX)
        self._cameras = list(rig.cameras)
        bodies = {name: (mesh, starts[name]) for name, mesh in meshes.items()}
        self._stage = BodyStage(self._server.scene, meshes, rig, stage_space(list(bodies.values()), up), starts)
        begin, home = self._server.initial_camera, self._stage.home
        begin.fov, begin.up, begin.position, begin.look_at = home.fov, UP, home.position, home.target
        names = {name: mesh.joint_names for name, mesh in meshes.items()}
        self.panel = BodyPanel(self._server.gui, names, self._cameras)
        self.frames: list[BodyViewFrame] = []
        self._at_s: list[float] = []
        self._angles: dict[str, list[Float64]] = {name: [] for name in meshes}
        self._bytes, self._oldest = 0, 0
        self.place = 0
        self._shown: tuple[int, int, bool] | None = None
        self._charted_s = -CHARTS_EVERY_S
        self._played_s: float | None = None
        self._browsers: dict[int, BodyBrowser] = {}
        self._done = self._rested = False

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        return self._server.url

    def add(self, frame: BodyViewFrame) -> None:
        """The next frame; it is shown where nobody looks at another."""
        follows = self.place >= len(self.frames) - 1 and self.panel.playing
        self.frames.append(frame)
        self._at_s.append(frame.time_s)
        for name, body in frame.bodies.items():
            self._angles[name].append(body.pose.angles)
        self._bytes += sum(len(picture.image) for picture in frame.pictures.values())
        while self._bytes > KEPT_BYTES and self._oldest < len(self.frames) - 1:
            old = self.frames[self._oldest]
            self._bytes -= sum(len(picture.image) for picture in old.pictures.values())
            self.frames[self._oldest] = BodyViewFrame(old.frame, old.time_s, old.bodies, {})
            self._oldest += 1
        if len(self.frames) >= KEPT_FRAMES + LET_GO:
            self._let_go(LET_GO)
        if follows:
            self.place = len(self.frames) - 1

    def end(self) -> None:
        """No more frames come."""
        self._done = True

    def show(self, now_s: float) -> None:
        """Bring all browsers up to the newest, or to what somebody chose; call it steadily, up to 30 times a second."""
        if self.frames:
            self._go_on(now_s)
            self._draw(now_s)
        with tolerated(), self._server.atomic():
            self._stage.settle(now_s)
            self._stage.name_cameras(named=self.panel.aim.value == ALL)
        self._show_browsers(now_s)

    def close(self) -> None:
        """Serve no more."""
        with unprinted():
            self._server.stop()

    def _draw(self, now_s: float) -> None:
        """What all browsers see of the frame that is shown."""
        what = (self.place, len(self.frames), self.panel.playing)
        if what == self._shown and now_s - self._charted_s < CHARTS_EVERY_S:
            return
        with tolerated(), self._server.atomic():
            shown = self.frames[self.place]
            if what != self._shown:
                self._stage.draw(shown.bodies, {name: _words(name, shown) for name in self._cameras})
                self.panel.draw(self._headline(), shown, self.place, len(self.frames), self._cameras)
            if now_s - self._charted_s >= CHARTS_EVERY_S:
                self._charted_s = now_s
                self.panel.draw_charts(*self._lately())
            self._shown = what

    def _let_go(self, count: int) -> None:
        """Forget the oldest frames."""
        for old in self.frames[self._oldest : count]:
            self._bytes -= sum(len(picture.image) for picture in old.pictures.values())
        del self.frames[:count], self._at_s[:count]
        for angles in self._angles.values():
            del angles[:count]
        self._oldest, self.place = max(0, self._oldest - count), max(0, self.place - count)

    def _headline(self) -> str:
        if self.place == len(self.frames) - 1 and self._done:
            return "End"
        if not self.panel.playing:
            return "Paused"
        return "Following" if not self._done else "Playing"

    def _go_on(self, now_s: float) -> None:
        """Take the place that somebody chose; or play what is there, as fast as it was filmed."""
        wish, self.panel.wish = self.panel.wish, None
        if wish is not None:
            self.place = min(max(wish, 0), len(self.frames) - 1)
        if not self.panel.playing:
            self._played_s, self._rested = None, True
            return
        rested, self._rested = self._rested, False
        if self.place >= len(self.frames) - 1:
            self._played_s = None
            if self._done and rested:  # Play was pressed at the end
                self.place, self._played_s = 0, now_s
            elif self._done:
                self.panel.playing = False
            return
        if self._played_s is not None:
            due_s = self._at_s[self.place] + (now_s - self._played_s)
            self.place = max(self.place, bisect.bisect_right(self._at_s, due_s) - 1)
            now_s -= max(0.0, due_s - self._at_s[self.place])  # what is left of this beat counts at the next
        self._played_s = now_s

    def _lately(self) -> tuple[Float64, Float64]:
        """What the charts show: up to the frame that is shown."""
        end = self.place + 1
        begin = bisect.bisect_left(self._at_s, self._at_s[self.place] - WINDOW_S)
        return np.array(self._at_s[begin:end]), np.array(self._angles[self.panel.whose][begin:end])

    def _pictures(self) -> dict[str, Encoded]:
        """Of the frame that is shown, and of cameras that gave none the last one, where that is not old."""
        found: dict[str, Encoded] = {}
        if not self.frames:
            return found
        for k in range(self.place, -1, -1):
            if len(found) == len(self._cameras) or self._at_s[self.place] - self._at_s[k] > LATEST_S:
                break
            found = {**self.frames[k].pictures, **found}
        return found

    def _show_browsers(self, now_s: float) -> None:
        """Each browser's own: its pictures, and its camera."""
        clients = self._server.get_clients()
        self._browsers = {number: one for number, one in self._browsers.items() if number in clients}
        if not clients:
            return
        aim, pictures = str(self.panel.aim.value), self._pictures()
        for number, client in clients.items():
            if number not in self._browsers:
                self._browsers[number] = BodyBrowser(client, self._stage, now_s)
            with tolerated():
                self._browsers[number].show("" if aim == ALL else aim, pictures, now_s)


def _words(camera: str, shown: BodyViewFrame) -> str:
    told = [f"{name} {_said(body, camera)}".strip() for name, body in shown.bodies.items()]
    return f"{camera} · {' · '.join(dict.fromkeys(told))}"


def _said(body: ShownBody, camera: str) -> str:
    if camera in body.left_out:
        return "left out"
    return f"{body.overlap[camera]:.0%}" if camera in body.overlap else "not in the image"
