"""Detectors by name: each is made for a camera, with settings that are checked; listing them is quick."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocapella.detectors import DETECTORS, RENAMED, Detector, arm_detectors, make_detector
from mocapella.errors import SettingsError
from mocapella.model.camera import Camera

CAMERA = Camera("depth", (64, 48), np.array([48.0, 48.0, 31.5, 23.5, 0, 0, 0, 0, 0]))
DOCS = Path(__file__).resolve().parents[2] / "docs" / "detectors"
HEAVY = {"cv2", "numba", "numpy", "scipy"}
"""Libraries that take long to import."""


def of_ours(name: str) -> Detector:
    if name != "kinematic-arm":
        pytest.importorskip("cv2", reason="its image processing needs OpenCV")
    return DETECTORS[name]


@pytest.mark.parametrize("name", DETECTORS)
def test_a_descriptor_describes_what_it_makes(name: str) -> None:
    detector = of_ours(name)
    assert (detector.interface, detector.name, detector.frame_type) == (1, name, "arms")
    assert detector.summary.endswith(".")
    assert "\n" not in detector.summary
    settings = detector.settings()
    assert is_dataclass(settings)
    assert fields(settings)
    assert detector.make(CAMERA, settings()).name == name
    assert (DOCS / f"{name}.md").is_file()


@pytest.mark.parametrize("name", DETECTORS)
def test_a_detector_is_made_by_its_name_and_refuses_unknown_settings(name: str) -> None:
    of_ours(name)
    assert make_detector(name, CAMERA).name == name
    with pytest.raises(SettingsError, match=f"settings of {name}: unknown key 'nonsense'"):
        make_detector(name, CAMERA, {"nonsense": 1})


def test_a_default_of_independence_is_for_detectors_that_have_it_and_yields_to_the_user() -> None:
    def made(name: str, **settings: float) -> Any:
        return make_detector(name, CAMERA, settings, independent_s=7.0).detector.settings

    assert made("kinematic-arm").independent_s == 7.0
    assert made("kinematic-arm", independent_s=2.0).independent_s == 2.0
    assert not hasattr(made("line-skeleton"), "independent_s")


def test_pictures_of_stages_are_those_of_the_detector() -> None:
    of_ours("line-skeleton")
    stages = make_detector("line-skeleton", CAMERA).stages
    assert stages is not None
    assert all(picture.dtype == np.uint8 for picture in stages(np.full((48, 64), 0.7, np.float32)).values())
    assert make_detector("kinematic-arm", CAMERA).stages is None


def test_an_unknown_name_is_refused_with_those_there_are() -> None:
    with pytest.raises(SettingsError, match=r"unknown arm detector 'kinematic-am'; .*did you mean kinematic-arm"):
        make_detector("kinematic-am", CAMERA)


def test_a_former_name_is_refused_with_the_present_one() -> None:
    with pytest.raises(SettingsError, match="the detector 'default' is called kinematic-arm now"):
        make_detector("default", CAMERA)
    assert set(RENAMED.values()) <= set(DETECTORS)
    assert not set(RENAMED) & set(DETECTORS)


def test_a_detector_of_other_frames_finds_no_arms(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DETECTORS, "paint", replace(DETECTORS["kinematic-arm"], name="paint", frame_type="markers"))
    assert set(arm_detectors()) == set(DETECTORS) - {"paint"}
    with pytest.raises(SettingsError, match="unknown arm detector 'paint'"):
        make_detector("paint", CAMERA)


def test_detectors_are_listed_without_what_takes_long_to_import() -> None:
    listing = "from mocapella.detectors import DETECTORS as d; [(x.name, x.summary) for x in d.values()]"
    assert not imported_by(listing) & HEAVY
    assert "numpy" in imported_by(f"{listing}; d['kinematic-arm'].settings()")


def imported_by(code: str) -> set[str]:
    """The modules that are there after a program ran in a new process."""
    code += "; import sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())
