"""A page has a motion within its steps, names that cannot break out, and is played by a real browser."""

from __future__ import annotations

import base64
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.browser import FLAGS

from mocapella.errors import SettingsError
from mocapella.exports.motion_page import MOST_BYTES, page_of, write_page
from mocapella.library.motion_tracks import MotionTracks
from mocapella.model.resampling import resampled
from mocapella.model.trajectories import Trajectories


def motion(seed: int = 0, frames: int = 9, reach_m: float = 2.0, names: tuple[str, ...] = ("anna", "ben")) -> Any:
    rng = np.random.default_rng(seed)
    states = rng.integers(0, 3, (frames, len(names), 4)).astype(np.uint8)
    states[:, 0, 0] = 2
    positions = np.where(states[..., None] > 0, rng.uniform(-reach_m, reach_m, (*states.shape, 3)), np.nan)
    return Trajectories(
        "people", np.arange(frames) / 30.0, np.zeros(frames, np.int64), names, ("Head", "Neck", "Spine", "Hip"),
        positions, states, np.full(states.shape, np.nan, np.float32), ((3, 2), (2, 1), (1, 0)), rate_hz=30.0,
    )  # fmt: skip


def content(page: str) -> dict[str, Any]:
    return json.loads(page.partition('type="application/json">')[2].partition("</script>")[0])  # type: ignore[no-any-return]


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach_m=st.floats(0.01, 500.0))
def test_positions_are_there_within_half_a_step(seed: int, reach_m: float) -> None:
    given_ = motion(seed, reach_m=reach_m)
    own, found = resampled(given_), content(page_of(given_))
    shape = (found["frames"], len(found["individuals"]), len(found["keypoints"]))
    steps = np.frombuffer(base64.b64decode(found["positions"]), "<i2").reshape(*shape, 3)
    states = np.frombuffer(base64.b64decode(found["states"]), np.uint8).reshape(shape)
    np.testing.assert_array_equal(states, own.states)
    places = own.positions[own.states > 0]
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    error = steps[own.states > 0] * found["unit_m"] + middle - places
    assert np.abs(error).max() <= found["unit_m"] * 0.5001
    assert found["unit_m"] <= max(1e-3, reach_m / 30_000)


@pytest.fixture(scope="module")
def scripts() -> int:
    """Number of scripts of a page whose names are plain."""
    return page_of(motion(names=("a",))).count("<script")


@example(name="</script><script>alert(1)")
@given(name=st.text(max_size=20))
def test_a_name_stays_a_name(name: str, scripts: int) -> None:
    page = page_of(motion(names=(name,)), title=name)
    assert content(page)["individuals"] == [name]
    assert page.count("<script") == scripts
    assert "<script>alert(1)" not in page


def test_a_fast_motion_has_thirty_frames_a_second() -> None:
    own = motion(frames=61)
    fast = replace(own, times_s=np.arange(61) / 120.0, rate_hz=120.0)
    assert (content(page_of(fast))["rate_hz"], content(page_of(fast))["frames"]) == (30.0, 16)


def test_nothing_and_too_much_are_refused() -> None:
    own = motion()
    with pytest.raises(SettingsError, match="nothing to show"):
        page_of(replace(own, positions=np.full_like(own.positions, np.nan)))
    with pytest.raises(SettingsError, match="minutes is too long"):
        page_of(replace(own, times_s=np.linspace(0.0, MOST_BYTES, 9)))
    with pytest.raises(SettingsError, match="nothing to show"):
        page_of(own.at(slice(0, 0)))


def test_a_notebook_shows_it_apart_from_its_own_page(tmp_path: Path) -> None:
    view = MotionTracks.of_file(motion(names=('a"b',)), "walk").show(300)
    cell = view._repr_html_()
    assert cell.startswith("<iframe sandbox=")
    assert cell.count('"') == 6  # nothing within srcdoc ends it
    assert "300px" in cell
    view.save(tmp_path / "a.html")
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == view.page
    assert "save" in repr(view)


@pytest.mark.slow
def test_a_browser_plays_it(tmp_path: Path) -> None:
    write_page(motion(frames=61), tmp_path / "walk.html")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        played(chromium.new_page(), tmp_path / "walk.html")
        chromium.close()


def played(page: Any, path: Path) -> None:
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(path.as_uri())
    page.wait_for_function("Number(document.body.dataset.frame) > 2")
    assert "● anna" in page.inner_text("#legend")
    page.locator("#play").click()
    stopped = page.evaluate("document.body.dataset.frame")
    page.keyboard.press("ArrowRight")
    page.locator("#at").fill("7")
    assert page.evaluate("document.body.dataset.frame") == "7" != stopped
    before = page.locator("canvas").screenshot()
    page.mouse.move(200, 200)
    page.mouse.down()
    page.mouse.move(320, 240)
    page.mouse.up()
    assert page.locator("canvas").screenshot() != before
    reds = "Array.from(pen.getImageData(0, 0, canvas.width, canvas.height).data).filter((_, i) => i % 4 === 0)"
    assert page.evaluate(f"new Set({reds}).size") > 3
    assert not faults
