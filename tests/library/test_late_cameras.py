"""Cameras whose images show other moments are named, with the difference; those of one moment are not."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.library.late_cameras import FEWEST, LEAST_S, MOST_INSTANTS, PERIODS, MomentsOfCameras
from mocapella.library.people_report import PeopleReport, alarms
from mocapella.library.people_triangulation import triangulate_people
from mocapella.tracker.webcams_warmup import circle_of_cameras

FOUR = circle_of_cameras(4)
CLIP = Path(__file__).resolve().parents[3] / "shared" / "data" / "pose2sim_two_people"
FRAMES = 90


def compared(rate_hz: float, ahead: dict[str, int], *, moves_m: float, noise_px: float = 2.0) -> MomentsOfCameras:
    """A person who walks in a circle before cameras, of which some see other moments."""
    random = np.random.default_rng(1)
    body = random.uniform((-0.3, 0.0, -0.3), (0.3, 1.8, 0.3), (17, 3))
    found = MomentsOfCameras()
    for k in range(FRAMES):
        found.begin(k / rate_hz, {"person_0": place(body, k / rate_hz, moves_m)})
        for name, placed in FOUR.cameras.items():
            seen = place(body, (k + ahead.get(name, 0)) / rate_hz, moves_m)
            pixels = project(apply(placed.T_camera_world, seen), placed.camera.lens)
            found.see(name, "person_0", pixels + random.normal(0, noise_px, pixels.shape), 200.0)
    return found


def place(body: np.ndarray, at_s: float, radius_m: float) -> np.ndarray:
    return body + radius_m * np.array([np.cos(2 * at_s), 0.0, np.sin(2 * at_s)])


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 3), st.integers(3, 12), st.booleans(), st.sampled_from([15.0, 30.0, 60.0]))
def test_the_difference_is_found(camera: int, images: int, earlier: bool, rate_hz: float) -> None:
    name, ahead = list(FOUR.cameras)[camera], -images if earlier else images
    found = compared(rate_hz, {name: ahead}, moves_m=0.6).found(FOUR.cameras)
    if images / rate_hz < LEAST_S:
        assert not found
        return
    assert list(found) == [name]
    seconds, count = found[name]
    assert abs(count - images) <= 1
    assert abs(seconds - ahead / rate_hz) <= 1.01 / rate_hz


@pytest.mark.parametrize(
    ("ahead", "moves_m"), [({}, 0.6), ({"cam-1": int(PERIODS)}, 0.6), ({"cam-1": 8}, 0.0)], ids=["none", "one", "still"]
)
def test_no_camera_is_named(ahead: dict[str, int], moves_m: float) -> None:
    assert set(ahead) <= set(FOUR.cameras)
    assert compared(30.0, ahead, moves_m=moves_m).found(FOUR.cameras) == {}


def test_few_instants_tell_nothing() -> None:
    found = MomentsOfCameras()
    for k in range(FEWEST - 1):
        found.begin(k / 30, {"person_0": np.zeros((17, 3))})
    assert found.found(FOUR.cameras) == {}


def test_the_number_of_instants_is_limited() -> None:
    found = MomentsOfCameras()
    for k in range(MOST_INSTANTS):
        assert not found.full
        found.begin(k / 30, {})
    assert found.full


@pytest.mark.parametrize(("seconds", "which"), [(0.25, "the others' files"), (-0.25, "its file")])
def test_the_remedy_names_the_images(seconds: float, which: str) -> None:
    (text,) = alarms(PeopleReport(10, {"person_0": None}, {}, 1.0, late={"left": (seconds, 15)}))  # type: ignore[dict-item]
    assert text.startswith("camera left: ")
    assert "0.25 s" in text
    assert text.endswith(f"leave out the first 15 images of {which}")


@pytest.mark.slow
@pytest.mark.skipif(not CLIP.is_dir(), reason="the recording is not here")
@pytest.mark.parametrize("ahead", [0, 15, -15])
def test_a_camera_of_a_real_recording_that_began_at_another_time_is_named(ahead: int, tmp_path: Path) -> None:
    for folder in sorted((CLIP / "pose").iterdir()):
        files = sorted(folder.glob("*.json"))
        (tmp_path / folder.name).mkdir()
        for k, file in enumerate(files):
            other = k + ahead if folder.name == "cam02_json" else k
            if 0 <= other < len(files):
                shutil.copy(files[other], tmp_path / folder.name / file.name)
    found = triangulate_people(tmp_path, CLIP / "Calib_qualisys.toml", fps=60, up="z")
    assert list(found.report.late) == ([] if ahead == 0 else ["cam_02"])
    for seconds, _ in found.report.late.values():
        assert abs(seconds - ahead / 60) < 0.04
    assert any("leave out the first" in note for note in found.notes) is (ahead != 0)
