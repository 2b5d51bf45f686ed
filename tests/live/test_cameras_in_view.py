"""A camera's node, a server and the view, in a real browser: its picture, and colours learnt by clicking on them."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from support.browser import FLAGS, page_url
from support.programs import Program, free_port, wait_until

from mocapella.sensing.colour_profile import load_profile
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.viewer import layout
from mocapella.viewer.browser import FOV, ROUND
from mocapella.viewer.picture_stage import large_plane

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

CHROMIUM = shutil.which("chromium")
WAIT_MS = 120_000

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH")


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        opened = chromium.new_page(viewport={"width": 640, "height": 480})
        opened.set_default_timeout(WAIT_MS)
        yield opened
        chromium.close()


def field(page: Page, label: str) -> Locator:
    rows = page.locator("label", has_text=re.compile(rf"^{label}$")).first.locator("xpath=../../..")
    return rows.locator("input:not([type=hidden])")


def on_screen(page: Page, size_px: tuple[int, int], points_px: np.ndarray) -> np.ndarray:
    """(n, 2) of points in the large picture where they are on the page, when the camera stands before it."""
    box = page.locator("canvas").first.bounding_box()
    assert box is not None
    plane = large_plane(size_px)
    look = layout.frame(plane.corners, fov=FOV, aspect=box["width"] / box["height"], elevation=0.0, margin=ROUND)
    off = plane.place(points_px) - look.position
    px = 0.5 * box["height"] / np.tan(0.5 * look.fov) * off[:, :2] / off[:, 2:]
    return np.array([box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]]) - px


def looks_red(page: Page, at: np.ndarray) -> bool:
    shot = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert shot is not None
    blue, green, red = (int(value) for value in shot[round(at[1]), round(at[0])])
    return red > 2 * max(green, blue)


@pytest.mark.slow
def test_colours_are_learnt_by_clicking_on_them_and_kept_and_a_node_that_goes_is_said(
    tmp_path: Path, page: Page
) -> None:
    port, page_port = free_port(), free_port()
    # One picture of one instant, again and again: every marker is in it, and where each is is known.
    scene = load_hand_scene("demo", seed=3)
    shot = scene.at("left", 0.2)
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures" / "0.png"), shot.image)
    centres = shot.centres_px
    source = ("pictures", "--set", "loop=true", "--fps", "10", "--epoch", str(time.time()))
    node_words = (*source, "--name", "left", "--profile", "left.json", "--set", "report=0")
    address = f"tcp/127.0.0.1:{port}"
    with (
        Program(tmp_path, "serve", "serve", "--port", str(port), "--set", f"view_port={page_port}") as serve,
        Program(tmp_path, "node", "node", "markers", *node_words, "--connect", address) as node,
    ):
        wait_until("its URL", serve.said(f"http://127.0.0.1:{page_port}"), timeout=120)
        page.goto(page_url(page_port))
        field(page, "Show").click()
        page.get_by_role("option", name="picture", exact=True).click()
        page.locator(".mocapella-camera img").wait_for()
        page.locator(".mocapella-camera", has_text="320 × 240 px · no colours are learnt yet").wait_for()
        page.get_by_role("button", name="Learn colours…", exact=True).click()
        asked = page.locator(".mocapella-pointing")
        asked.wait_for()
        spots = on_screen(page, (320, 240), centres)
        page.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(it => it.click())")
        wait_until("the picture is large", lambda: looks_red(page, spots[0]), timeout=120)
        for k, (name, (x, y)) in enumerate(zip(scene.names, spots, strict=True)):
            assert f"Click on {name}" in asked.inner_text()
            page.mouse.click(x, y)
            following = scene.names[k + 1] if k + 1 < len(scene.names) else "skin"
            page.locator(".mocapella-pointing", has_text=f"Click on {following}").wait_for()
        text = page.locator(".mocapella-camera", has=asked).inner_text()
        clicked = [[float(part) for part in found] for found in re.findall(r"(-?\d+), (-?\d+)", text)]
        assert np.abs(np.array(clicked) - centres).max() < 2.0
        page.get_by_role("button", name="Skip", exact=True).click()
        page.locator(".mocapella-pointing", has_text="press Learn").wait_for()
        page.get_by_role("button", name="Learn", exact=True).click()
        page.locator(".mocapella-learnt").wait_for()
        page.locator(".mocapella-camera", has_text=re.compile(r"6 of 6 markers found")).wait_for()
        page.get_by_role("button", name="Save", exact=True).click()
        page.get_by_text("saved to left.json").wait_for()
        saved = load_profile(tmp_path / "left.json")
        assert (saved.camera, saved.names, saved.size_px) == ("left", scene.names, (320, 240))
        assert node.end() == 0, node.output
        page.locator(".mocapella-camera", has_text=re.compile("its node is gone|no answer within")).wait_for()
        assert serve.end() == 0, serve.output
    assert "Traceback" not in serve.output + node.output
