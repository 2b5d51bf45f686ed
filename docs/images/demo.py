"""Makes demo.webp, the moving picture of the README, and view.png, the whole page of `mocapella demo`.

    python docs/images/demo.py [FOLDER]

The moving picture is the demo's room, tracked as fast as it is drawn, so that a slow computer makes the same picture.
The page is the one of several screenshots of a running demo in which the most joints are filled in from other sensors.
Needs chromium on the PATH, and playwright.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.sources.simulate import SimulatedSensor, load_scene
from mocapella.sources.simulate.scenery import scenery_of
from mocapella.sources.simulate.sensor import merge
from mocapella.tracker.default import DefaultTracker
from mocapella.viewer import Viewer

FLAGS = ["--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
HERE = Path(__file__).parent
SCENE, FROM_S, TO_S, RATE_HZ = "obstacle", 23.4, 29.0, 9.0
WIDTH, HEIGHT, PANEL = 900, 520, 340
QUALITY = 60
SCREENSHOTS, APART_S = 8, 1.5
READY = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"

Step = tuple[Scene, dict[str, SensorFrame]]


def tracked() -> list[Step]:
    """The scenes and newest frames of the demo's room, `RATE_HZ` a second."""
    room = load_scene(SCENE)
    latency_ns = {sensor.name: round(sensor.latency_s * NS_PER_S) for sensor in room.settings.sensors}
    tracker = DefaultTracker(sensors_expected=len(latency_ns))
    steps: list[Step] = []
    newest: dict[str, SensorFrame] = {}
    for item in merge([SimulatedSensor(room, name) for name in room.sensor_names], 0.0, TO_S):
        newest[item.frame.sensor] = item.frame
        scene = tracker.update(Arrival(item.frame, item.truth.room_ns + latency_ns[item.frame.sensor]))
        if item.truth.room_ns >= (FROM_S + len(steps) / RATE_HZ) * NS_PER_S:
            steps.append((scene, dict(newest)))
    return steps


class Shown:
    """Keeps a view up to date on a thread of its own, with the step that is set.

    Attributes:
        step: that is shown.
        beats: how often the view was brought up to date.
    """

    def __init__(self, viewer: Viewer, step: Step) -> None:
        self.step, self.beats, self._viewer = step, 0, viewer
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def change(self, step: Step) -> None:
        """Show another step, and wait until it is sent."""
        self.step = step
        after = self.beats + 3
        while self.beats < after:
            time.sleep(0.01)

    def close(self) -> None:
        """End the thread and the view."""
        self._stop.set()
        self._thread.join()
        self._viewer.close()

    def _run(self) -> None:
        while not self._stop.wait(0.03):
            scene, frames = self.step
            self._viewer.show(scene, frames, None, keep=False)
            self.beats += 1


def moving(chromium: Any) -> list[np.ndarray]:
    """The pictures of the 3D scene alone."""
    steps = tracked()
    viewer = Viewer("127.0.0.1", 0, command=None, props={"scenery": partial(scenery_of, SCENE)})
    shown = Shown(viewer, steps[0])
    try:
        page = chromium.new_page(viewport={"width": WIDTH + PANEL, "height": HEIGHT})
        page.set_default_timeout(120_000)
        page.goto(viewer.url)
        page.locator(".mantine-Notification-closeButton").first.click()
        time.sleep(15)  # the labels are drawn
        pictures = []
        for step in steps:
            shown.change(step)
            time.sleep(0.15)
            page.evaluate(READY)
            pictures.append(decoded(page.screenshot())[:, :WIDTH])
        page.close()
        return pictures
    finally:
        shown.close()


def whole_page(chromium: Any) -> np.ndarray:
    """The page of a running demo."""
    command = [sys.executable, "-m", "mocapella", "demo", "--no-browser", "--seconds", "240"]
    demo = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert demo.stdout is not None
        url = next(m[1] for line in demo.stdout if (m := re.search(r"live view: (http\S+)", line)))
        page = chromium.new_page(viewport={"width": 1500, "height": 860})
        page.set_default_timeout(120_000)
        page.goto(url)
        page.locator(".mocapella-status", has_text="Tracking").wait_for()
        page.locator(".mantine-Notification-closeButton").first.click()
        time.sleep(15)
        pictures = []
        for _ in range(SCREENSHOTS):
            pictures.append(decoded(page.screenshot()))
            time.sleep(APART_S)
        page.close()
        return max(pictures, key=filled)
    finally:
        demo.terminate()
        demo.wait()


def filled(picture: np.ndarray) -> int:
    """How many pixels of the Scene stage are green."""
    blue, green, red = (picture[200:650, :1100, k].astype(int) for k in range(3))
    return int(((green > 150) & (green > blue + 60) & (green > red + 60)).sum())


def decoded(screenshot: bytes) -> np.ndarray:
    """The screenshot as an image."""
    return cv2.imdecode(np.frombuffer(screenshot, np.uint8), cv2.IMREAD_COLOR)


def main(folder: Path) -> None:
    """Make both pictures."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        pictures = moving(chromium)
        film = cv2.Animation()
        film.frames, film.durations = pictures, np.full(len(pictures), round(1000 / RATE_HZ), np.int32)
        cv2.imwriteanimation(str(folder / "demo.webp"), film, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
        cv2.imwrite(str(folder / "view.png"), whole_page(chromium), [cv2.IMWRITE_PNG_COMPRESSION, 9])
        chromium.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
