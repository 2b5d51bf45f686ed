"""The whole program with its view in a real browser: seen, recorded, and not hurt when the browser goes."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from browser import FLAGS
from programs import Program, free_port, result, wait_until

from mocapella.recording.take_reader import read_take
from mocapella.wire.reader import send_command
from mocapella.wire.session import open_reader

CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH")


def test_the_demo_is_shown_recorded_and_not_hurt_by_a_closed_browser(tmp_path: Path) -> None:
    from playwright.sync_api import sync_playwright

    port, page_port = free_port(), free_port()
    with Program(tmp_path, "demo", "demo", "--no-browser", "--scene", "stand", "--port", str(port), "--view-port",
                 str(page_port)) as demo:  # fmt: skip
        wait_until("its URL", demo.said(f"live view: http://127.0.0.1:{page_port}"), timeout=120.0)
        session = open_reader(f"tcp/127.0.0.1:{port}")
        try:
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
                page = browser.new_page(viewport={"width": 1600, "height": 900})
                page.set_default_timeout(120_000)
                page.goto(f"http://127.0.0.1:{page_port}")
                page.locator(".mocapella-status", has_text="Tracking").wait_for()
                page.get_by_role("button", name="Record", exact=True).click()
                wait_until("the recording", lambda: _recording(session) > 0, timeout=120.0)
                browser.close()
            count = _recording(session)
            wait_until("it goes on without the browser", lambda: _recording(session) > count + 30, timeout=120.0)
        finally:
            session.close()
        assert demo.end() == 0, demo.output
    (take,) = (tmp_path / "takes").glob("*.mcap")
    assert read_take(take).clean
    (row,) = result(tmp_path, "replay", str(take))
    assert row["differing_scenes"] == 0


def _recording(session: object) -> int:
    status = send_command(session, "status").status  # type: ignore[arg-type]
    assert status is not None
    return status.recording.frames if status.recording.active else 0
