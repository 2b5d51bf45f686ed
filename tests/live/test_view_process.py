"""The whole program with its view in a real browser: seen, recorded, and not hurt when the browser goes."""

from __future__ import annotations

import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from support.browser import DRAW_NOTHING, FLAGS, page_url
from support.programs import Program, free_port, result_here, wait_until

from mocapella.cli.common import PAGE_DRAWN
from mocapella.recording.take_reader import read_take
from mocapella.wire.reader import send_command
from mocapella.wire.session import open_reader

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CHROMIUM = shutil.which("chromium")
LONGER_THAN_THE_BUS_WAITS_S = 6.0
"""Between two attempts to reach a server that is gone, the bus waits up to 4 s."""
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


def open_page(browser: Browser, port: int) -> Page:
    page = browser.new_page(viewport={"width": 640, "height": 480})
    page.add_init_script(DRAW_NOTHING)
    page.set_default_timeout(120_000)
    page.goto(page_url(port))
    return page


def expect_state(page: Page, state: str) -> None:
    """Wait until the headline says it, on a page that is not cut off."""
    page.locator(".mocapella-status", has_text=re.compile(rf"^\s*{state}")).wait_for()  # not "the tracking method"
    page.locator(".mocapella-lost").wait_for(state="hidden")


def test_a_view_without_a_server_says_what_it_waits_for_and_ends_on_ctrl_c(tmp_path: Path) -> None:
    address = f"tls/127.0.0.1:{free_port()}"
    with Program(tmp_path, "view", "view", "--connect", address, "--view-port", str(free_port())) as view:
        wait_until("its words", view.said(f"no server at {address} yet: start one with `mocapella serve`"), timeout=120)
        assert view.end() == 0
    assert "Traceback" not in view.output


@pytest.mark.slow
@needs_browser
def test_an_open_page_says_that_there_is_no_server_and_goes_on_with_the_next_one(
    tmp_path: Path, browser: Browser
) -> None:
    port, page_port = free_port(), free_port()
    serve = ("serve", "--no-view", "--port", str(port))
    with Program(tmp_path, "view", "view", "--connect", f"tcp/127.0.0.1:{port}", "--view-port", str(page_port)) as view:
        wait_until("its URL", view.said(f"view: http://127.0.0.1:{page_port}"), timeout=120)
        assert PAGE_DRAWN not in view.output
        page = open_page(browser, page_port)
        expect_state(page, "No server")
        wait_until("it knows of the page", view.said(PAGE_DRAWN))
        with Program(tmp_path, "first", *serve) as first:
            expect_state(page, "Waiting for sensors")
            first.end(signal.SIGKILL)
        expect_state(page, "No server")
        page.wait_for_timeout(1000 * LONGER_THAN_THE_BUS_WAITS_S)
        with Program(tmp_path, "second", *serve) as second:
            expect_state(page, "Waiting for sensors")
            assert second.end() == 0
        expect_state(page, "No server")
        page.close()
        assert view.end() == 0
    assert "Traceback" not in view.output
    assert view.output.count(PAGE_DRAWN) == 1


@pytest.mark.slow
@needs_browser
def test_a_page_whose_view_ended_says_so_until_it_is_loaded_from_the_next_one(tmp_path: Path, browser: Browser) -> None:
    port, page_port = free_port(), free_port()
    serve = ("serve", "--port", str(port), "--set", f"view_port={page_port}")
    with Program(tmp_path, "first", *serve) as first:
        wait_until("its URL", first.said(f"live view: http://127.0.0.1:{page_port}"), timeout=120)
        page = open_page(browser, page_port)
        expect_state(page, "Waiting for sensors")
        assert first.end() == 0
    page.locator(".mocapella-lost").wait_for(state="visible")
    with Program(tmp_path, "second", *serve) as second:
        wait_until("its URL", second.said(f"live view: http://127.0.0.1:{page_port}"), timeout=120)
        # The page would go on by itself, but a browser that is very slow gives up each attempt before it has succeeded.
        page.reload()
        expect_state(page, "Waiting for sensors")
        page.close()
        assert second.end() == 0


@pytest.mark.slow
@needs_browser
def test_the_demo_is_shown_recorded_and_not_hurt_by_a_closed_browser(tmp_path: Path, browser: Browser) -> None:
    port, page_port = free_port(), free_port()
    with Program(tmp_path, "demo", "demo", "--no-browser", "--scene", "stand", "--port", str(port), "--view-port",
                 str(page_port)) as demo:  # fmt: skip
        wait_until("its URL", demo.said(f"live view: http://127.0.0.1:{page_port}"), timeout=120.0)
        session = open_reader(f"tcp/127.0.0.1:{port}")
        try:
            page = open_page(browser, page_port)
            expect_state(page, "Tracking")
            page.locator(".mocapella-people", has_text="Person 0").wait_for()
            page.get_by_role("button", name="Record", exact=True).click()
            wait_until("the recording", lambda: _recording(session) > 0, timeout=120.0)
            page.locator("label", has_text="Name").locator("xpath=../../..").locator("input").fill("Ada")
            wait_until("the name in the view", lambda: _set_name(page), timeout=120.0)
            page.close()
            count = _recording(session)
            wait_until("it goes on without the browser", lambda: _recording(session) > count + 30, timeout=120.0)
        finally:
            session.close()
        assert demo.end() == 0, demo.output
    (take,) = (tmp_path / "takes").glob("*.mcap")
    assert read_take(take).clean
    last = [scene for _, scene in read_take(take).scenes()][-1]
    assert "Ada" in [person.name for person in last.people]
    (row,) = result_here(tmp_path, "replay", str(take))
    assert row["differing_scenes"] == 0


@pytest.mark.slow
@needs_browser
def test_the_demo_of_an_arm_shows_it_with_its_figures(tmp_path: Path, browser: Browser) -> None:
    port, page_port = free_port(), free_port()
    with Program(tmp_path, "arm", "demo", "arm", "--no-browser", "--port", str(port), "--view-port",
                 str(page_port)) as demo:  # fmt: skip
        wait_until("its URL", demo.said(f"live view: http://127.0.0.1:{page_port}"), timeout=120.0)
        page = open_page(browser, page_port)
        expect_state(page, "Tracking")
        figures = page.locator(".mocapella-arms")
        figures.filter(has_text="little tip").filter(has_text="a minute").filter(has_text=" arm ·").wait_for()
        page.close()
        assert demo.end() == 0, demo.output


def _set_name(page: Page) -> bool:
    """Press the button, until what was typed has reached the view before it."""
    page.get_by_role("button", name="Set name", exact=True).click()
    page.wait_for_timeout(500)
    return page.locator(".mocapella-people", has_text="Ada").is_visible()


def _recording(session: object) -> int:
    status = send_command(session, "status").status  # type: ignore[arg-type]
    assert status is not None
    return status.recording.frames if status.recording.active else 0
