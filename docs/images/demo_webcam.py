"""Makes demo-webcam.png: `mocapella demo webcam` in a browser, while both people are tracked.

    python docs/images/demo_webcam.py [FILE.png] [SEED]

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

    command = [sys.executable, "-m", "mocapella", "demo", "webcam", "--no-browser", "--seconds", "240", "--seed", seed,
               *sys.argv[3:]]  # fmt: skip
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
            page.locator("button[aria-label=Close]").or_(page.locator(".mantine-CloseButton-root")).first.click()
            page.get_by_text(re.compile("2 people")).first.wait_for()
            time.sleep(12)  # the first pictures are drawn
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
    main(
        Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "demo-webcam.png", sys.argv[2] if len(sys.argv) > 2 else "0"
    )
