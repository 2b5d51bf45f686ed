"""How Debian's chromium is started where there is no screen, no GPU and no internet."""

from __future__ import annotations

import os
from typing import Any

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--webgl-antialiasing-mode=none",  # smooth edges are a third of what drawing costs
    "--webgl-msaa-sample-count=0",
]


def page_url(port: int) -> str:
    """Return the address of a view with the token of all tests."""
    return f"http://127.0.0.1:{port}/?token={os.environ['MOCAPELLA_VIEW_TOKEN']}"


def new_page(browser: Any, width: int, height: int) -> Any:
    """Return an empty page that draws at most `DRAWN_HZ` times a second.

    The view draws as often as the browser lets it. In software that takes all of a core, also while a test waits.
    """
    page = browser.new_page(viewport={"width": width, "height": height})
    page.add_init_script(DRAW_SELDOM)
    return page


DRAWN_HZ = 8
DRAW_SELDOM = f"""
window.requestAnimationFrame = (callback) => setTimeout(() => callback(performance.now()), {1000 // DRAWN_HZ});
window.cancelAnimationFrame = clearTimeout;
"""
