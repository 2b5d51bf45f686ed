"""Makes silhouettes-view.png: `mocapella demo silhouettes` in a browser, in the middle of the run.

    python docs/images/silhouettes_view.py [FILE.png] [SEED]

Needs chromium on the PATH, and playwright.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

FLAGS = ["--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
HERE = Path(__file__).parent


def main(file: Path, seed: str) -> None:
    """Take the picture."""
    from playwright.sync_api import sync_playwright

    command = [
        sys.executable,
        "-m",
        "mocapella",
        "demo",
        "silhouettes",
        "--no-browser",
        "--seconds",
        "240",
        "--seed",
        seed,
    ]
    demo = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert demo.stdout is not None
        url = next(m[1] for line in demo.stdout if (m := re.search(r"live view: (http\S+)", line)))
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            page = browser.new_page(viewport={"width": 1500, "height": 820})
            page.set_default_timeout(120_000)
            page.goto(url)
            page.locator("button[aria-label=Close]").or_(page.locator(".mantine-CloseButton-root")).first.click()
            page.locator(".mocapella-status", has_text="End").wait_for()
            frame = (
                page.locator("label", has_text="Frame").locator("xpath=../../..").locator("input:not([type=hidden])")
            )
            frame.fill("70")
            page.keyboard.press("Enter")
            page.locator(".mocapella-status", has_text="Paused").wait_for()
            page.wait_for_timeout(6000)  # a browser that draws slowly catches up
            page.screenshot(path=file)
            browser.close()
    finally:
        demo.terminate()
        demo.wait()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "silhouettes-view.png", *(sys.argv[2:3] or ["0"]))
