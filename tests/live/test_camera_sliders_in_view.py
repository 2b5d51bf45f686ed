"""The sliders of a rendered camera in a real browser: its picture gets darker, and the next start has it so."""

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
from mocapella.wire.questions import AskPicture, ask_node
from mocapella.wire.session import open_reader

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH")


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        opened = chromium.new_page(viewport={"width": 900, "height": 2200})
        opened.set_default_timeout(120_000)
        yield opened
        chromium.close()


def row(page: Page, label: str) -> Locator:
    return page.locator("label", has_text=re.compile(rf"^{label}$")).first.locator("xpath=../../..")


@pytest.mark.slow
def test_a_cameras_exposure_is_set_by_its_slider_and_saved(tmp_path: Path, page: Page) -> None:
    port, page_port = free_port(), free_port()
    address = f"tcp/127.0.0.1:{port}"
    words = ("node", "markers", "rendered:demo/left", "--profile", "left.json", "--connect", address)
    with (
        Program(tmp_path, "serve", "serve", "--port", str(port), "--set", f"view_port={page_port}") as serve,
        Program(tmp_path, "node", *words) as node,
    ):
        wait_until("its URL", serve.said(f"http://127.0.0.1:{page_port}"), timeout=120)
        reader = open_reader(address)

        def brightness() -> float:
            time.sleep(0.2)  # the node answers 20 questions a second, also the page's
            answer = ask_node(reader, "left", AskPicture(scale=0.25, keep=False), timeout=60.0)
            image = cv2.imdecode(np.frombuffer(answer.image, np.uint8), cv2.IMREAD_COLOR)
            assert image is not None
            return float(image.mean())

        page.goto(page_url(page_port))
        page.get_by_text("Camera settings", exact=True).first.wait_for()
        row(page, "Show").locator("input:not([type=hidden])").click()
        page.get_by_role("option", name="picture", exact=True).click()
        row(page, "Camera settings").locator("input[type=checkbox]").click()
        exposure = row(page, "Exposure, 100 µs")
        exposure.wait_for()
        for label in ("Gain, dB", "Red balance, ×", "Blue balance, ×", "Saturation, ×", "Contrast, ×",
                      "Brightness, levels", "Auto exposure", "Auto white balance"):  # fmt: skip
            assert row(page, label).count() == 1, label
        before = brightness()
        exposure.locator("input:not([type=hidden])").last.fill("20")
        exposure.locator("input:not([type=hidden])").last.press("Enter")
        page.locator(".mocapella-camera-settings", has_text="Changed, and not saved yet").wait_for()
        wait_until("the picture is darker", lambda: brightness() < 0.75 * before, timeout=60)
        page.screenshot(path=str(tmp_path / "sliders.png"))
        page.get_by_role("button", name="Save settings", exact=True).click()
        page.get_by_text("camera settings saved to left.json").wait_for()
        assert load_profile(tmp_path / "left.json").controls.exposure == 20.0
        dark = brightness()
        row(page, "Auto exposure").locator("input[type=checkbox]").click()
        wait_until("the camera brightens it", lambda: brightness() > 1.2 * dark, timeout=120)
        reader.close()
        assert node.end() == 0, node.output
        assert serve.end() == 0, serve.output
    assert "Traceback" not in serve.output + node.output
