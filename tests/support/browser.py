"""How Debian's chromium is started where there is no screen, no GPU and no internet."""

from __future__ import annotations

import os

FLAGS = [
    "--headless",
    "--disable-gpu-compositing",
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

DRAW_NOTHING = """
for (const context of [WebGLRenderingContext, WebGL2RenderingContext])
  for (const call of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced", "clear"])
    if (call in context.prototype) context.prototype[call] = () => {};
"""
"""Script for pages of which a test reads texts and uses controls. Most of what such a browser costs is to compile
shaders for the processor, and to draw what nobody looks at. All else of the page runs as it does for users."""

FEW_FRAMES = """
window.requestAnimationFrame = (call) => setTimeout(() => call(performance.now()), 200);
window.cancelAnimationFrame = clearTimeout;
"""
"""Script for pages that draw five times a second, where a test looks at what is drawn, but not at how it moves."""

COARSE = "&fixedDpr=0.5"
"""End of the URL of a page that draws a quarter of the pixels, enlarged: a parameter of viser."""


def page_url(port: int) -> str:
    """Return the address of a view with the token of all tests."""
    return f"http://127.0.0.1:{port}/?token={os.environ['MOCAPELLA_VIEW_TOKEN']}"
