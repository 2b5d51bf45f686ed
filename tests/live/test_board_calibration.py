"""Two cameras' nodes see a board that is carried about: calibrated on the command line, and in the view."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.board_pictures import BASELINE_M, BOARD, FPS, Pictures, board_pictures, off_mm
from support.browser import DRAW_NOTHING, FLAGS, page_url
from support.programs import Program, free_port, result_here, run, wait_until

from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.session import SessionStatus
from mocapella.tracker import warm_up
from mocapella.wire.reader import send_command
from mocapella.wire.session import open_reader

CHROMIUM = shutil.which("chromium")
ARTIFACTS = Path(__file__).resolve().parents[2] / "artifacts"
FILMED_S = 9.0


class Room:
    """A server with its view, and the nodes of two cameras that show pictures again and again."""

    def __init__(self, folder: Path, pictures: Pictures) -> None:
        for method in ("default", "hands"):  # the server begins with the first, and calibrates once it is compiled
            warm_up(method)
        self.folder, self.pictures = folder, pictures
        self.port, self.page_port = free_port(), free_port()
        self.address = f"tcp/127.0.0.1:{self.port}"
        self.server = Program(
            folder, "serve", "serve", "--port", str(self.port), "--set", f"view_port={self.page_port}"
        )  # fmt: skip
        epoch = str(time.time())
        self.nodes = [
            Program(folder, name, "node", "markers", str(path), "--name", name, "--connect", self.address,
                    "--set", "loop=true", "--fps", str(FPS), "--epoch", epoch)
            for name, path in pictures.folders.items()
        ]  # fmt: skip
        wait_until("the view", self.server.said("live view: http"), timeout=120.0)
        self.session = open_reader(self.address, timeout=30.0)
        wait_until("both cameras", lambda: sum(row.pictures for row in self.status().sensors) == 2, timeout=120.0)

    def status(self) -> SessionStatus:
        status = send_command(self.session, "status").status
        assert status is not None
        return status

    def is_right(self, rig: CameraRig, sd_mm: float) -> None:
        """The cameras are where they were rendered, within some standard deviations and the board's own pixels."""
        left, right = (rig.cameras[name] for name in ("left", "right"))
        assert off_mm(right.T_camera_world, left.T_camera_world, self.pictures) < 5 * sd_mm + 0.2

    def close(self) -> None:
        self.session.close()  # type: ignore[no-untyped-call]
        for program in (*self.nodes, self.server):
            with program:
                assert program.end() == 0, program.output


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Room]:
    """For tests that leave the view's calibration as it is."""
    yield from _room(tmp_path_factory.mktemp("room"))


@pytest.fixture
def own_room(tmp_path: Path) -> Iterator[Room]:
    """For one attempt of one test: the view's calibration is idle.

    If the test fails, its calibration goes on. The next attempt would find it there, and could not start one.
    """
    yield from _room(tmp_path)


def _room(folder: Path) -> Iterator[Room]:
    made = Room(folder, board_pictures(folder))
    yield made
    made.close()


@pytest.mark.slow
def test_running_nodes_are_calibrated_on_the_command_line(room: Room) -> None:
    arguments = ("--board", "board.toml", "--out", "cli.toml", "--connect", room.address, "--json", "-")
    done = run(room.folder, "calibrate", "cameras", "node:left", "node:right", *arguments, "--seconds", str(FILMED_S))
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    assert list(found["cameras"]) == ["left", "right"]
    assert found["shared_instants"] >= 4
    assert found["cameras"]["right"]["distance_to_first_m"] == pytest.approx(BASELINE_M, abs=0.003)
    assert "go on filming" in done.stderr
    assert "ms apart (median)" in done.stderr
    room.is_right(load_camera_rig(room.folder / "cli.toml"), found["cameras"]["right"]["position_sd_mm"])


@pytest.mark.slow
def test_a_node_that_is_not_there_is_named_with_those_that_are(room: Room) -> None:
    arguments = ("--board", "board.toml", "--out", "no.toml", "--connect", room.address)
    done = run(room.folder, "calibrate", "cameras", "node:left", "node:middle", *arguments)
    assert done.returncode == 1
    assert "node:middle is not there; cameras at this server: left, right" in done.stderr
    assert not (room.folder / "no.toml").exists()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH")
def test_cameras_are_calibrated_in_the_view_and_used_and_stand_in_the_next_take(own_room: Room) -> None:
    from playwright.sync_api import TimeoutError, sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = chromium.new_page(viewport={"width": 640, "height": 480})
        page.add_init_script(DRAW_NOTHING)
        page.set_default_timeout(120_000)
        page.goto(page_url(own_room.page_port))
        headline = page.locator(".mocapella-board-headline")

        def field(label: str) -> Any:
            row = page.locator("label", has_text=label).locator("xpath=../../..")
            return row.locator("input:not([type=hidden])")

        def press(name: str) -> None:
            page.get_by_role("button", name=name, exact=True).click()

        try:
            page.get_by_text("press Start calibration").wait_for()
        except TimeoutError as error:
            raise AssertionError(f"the page shows {page.inner_text('body')[:2000]!r}") from error

        def fill(label: str, value: float, says: str) -> None:
            """A browser sends one of two fields that are filled within 50 ms, so it is waited for each."""
            field(label).fill(f"{value:g}")
            page.locator(".mocapella-board", has_text=says).wait_for()

        fill("Rows", 2, "× 2 squares")
        press("Start calibration")
        page.get_by_text("it must be 3 to 100 squares").wait_for()
        fill("Columns", BOARD.columns, "6 ×")
        fill("Rows", BOARD.rows, "× 5 squares")
        fill("Square, mm", 1e3 * BOARD.square_m, "of 40 mm")
        fill("Marker, mm", 1e3 * BOARD.square_m * BOARD.marker_ratio, "6 × 5 squares of 40 mm, markers of 30 mm")
        press("Start calibration")
        headline.get_by_text("go on filming").wait_for()
        page.get_by_text("6 × 5 squares of 40 mm, markers of 30 mm").wait_for()
        page.locator(".mocapella-board-camera circle").first.wait_for()
        page.get_by_text("seen by two cameras or more at once: 5 times").wait_for()
        press("Finish")
        headline.get_by_text("Calibrated").wait_for()
        quality = page.locator(".mocapella-board-quality")
        assert "place, ± mm" in quality.inner_text()
        page.get_by_text("compare with a tape measure: left – right 0.1").wait_for()
        _shoot(page, "calibrate-done")
        assert send_command(own_room.session, "record", {"name": "across"}).ok
        wait_until("a recording", lambda: own_room.status().recording.frames > 5)
        press("Use it")
        headline.get_by_text("In use").wait_for()
        chromium.close()
    rig = load_camera_rig(own_room.folder / "rig.toml")
    own_room.is_right(rig, 1.0)
    status = own_room.status()
    assert (status.setup.method, status.setup.sensors_expected) == ("hands", 2)
    count = status.recording.frames
    wait_until("more of the recording", lambda: own_room.status().recording.frames > count + 5)
    assert send_command(own_room.session, "record-stop", timeout=60.0).ok
    (row,) = result_here(own_room.folder, "replay", "across")
    assert (row["recorded_scenes"] > 10, row["differing_scenes"]) == (True, 0)


def _shoot(page: Any, name: str) -> None:
    """The panel as a user sees it, unrolled."""
    ARTIFACTS.mkdir(exist_ok=True)
    page.set_viewport_size({"width": 640, "height": 1100})
    page.wait_for_timeout(300)
    page.screenshot(path=ARTIFACTS / f"{name}.png")
    page.set_viewport_size({"width": 640, "height": 480})
