"""A page of Debian's chromium, which draws in software, for benchmarks of the view."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from typing import Any

from tests.support.browser import FLAGS


@contextlib.contextmanager
def open_page() -> Iterator[Any]:
    """An empty page of 1280 × 720 pixels; None where there is no chromium."""
    chromium = shutil.which("chromium")
    if chromium is None:
        yield None
        return
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        yield browser.new_page(viewport={"width": 1280, "height": 720})
        browser.close()
