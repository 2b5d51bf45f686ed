"""Makes demo-arm.png: `mocapella demo arm` in a browser, at an instant at which the hand holds the cloth.

    python docs/images/demo_arm.py [FILE.png] [SEED]

Needs chromium on the PATH, and playwright.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

FLAGS = ["--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
HERE = Path(__file__).parent


def main(file: Path, seed: str) -> None:
    """Take the picture."""
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "mocapella", "demo", "arm", "--no-browser", "--seconds", "240", "--seed", seed]
    demo = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                            start_new_session=True)  # fmt: skip
    try:
        assert demo.stdout is not None
        url = next(m[1] for line in demo.stdout if (m := re.search(r"live view: (http\S+)", line)))
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            page = browser.new_page(viewport={"width": 1500, "height": 780})
            page.set_default_timeout(120_000)
            page.goto(url)
            page.locator(".mocapella-arms").wait_for()
            page.locator("button[aria-label=Close]").or_(page.locator(".mantine-CloseButton-root")).first.click()
            time.sleep(20)  # the first pictures are drawn
            # A fist is closed, too, and takes hold of nothing: the cloth is grabbed where the scene says so.
            page.locator(".mocapella-arms", has_not_text="· grabbing").wait_for()
            page.locator(".mocapella-arms", has_text=re.compile(r"grab \d+ % · grabbing")).wait_for()
            time.sleep(2.0)  # it is pulled
            os.killpg(demo.pid, signal.SIGSTOP)  # a browser that draws slowly catches up
            time.sleep(0.8)  # not so long that the page says that nothing comes any more
            page.screenshot(path=file)
            os.killpg(demo.pid, signal.SIGCONT)
            browser.close()
    finally:
        os.killpg(demo.pid, signal.SIGCONT)
        demo.terminate()
        demo.wait()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "demo-arm.png", sys.argv[2] if len(sys.argv) > 2 else "0")
