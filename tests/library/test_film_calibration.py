"""Films without a rig: their people calibrate the cameras, and are tracked from the first image; or it is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.keypoint_people import filmed, ring, standing, walking

from mocapella.cli.recordings import open_take
from mocapella.errors import CalibrationError
from mocapella.library.film_calibration import calibrate_films, track_films
from mocapella.model.keypoints import KeypointFrame
from mocapella.sources.simulate.motion import Ensemble

pytestmark = pytest.mark.slow


def films(people: Ensemble, seconds: float) -> dict[str, list[KeypointFrame]]:
    """The frames of three cameras."""
    frames: dict[str, list[KeypointFrame]] = {}
    for frame in filmed(ring(3, 0), people, seconds, seed=0, hz=12):
        frames.setdefault(frame.sensor, []).append(frame)
    return frames


def test_people_in_films_calibrate_the_cameras_and_are_tracked(tmp_path: Path) -> None:
    found_in = films(walking(25, [(-0.8, 0.0), (0.8, 0.3)], [1.75, 1.65]), 9.0)
    found = calibrate_films(found_in, {"height_m": 1.7})
    assert not found.guessed
    counts = track_films(found_in, found, tmp_path / "walk.mcap", {"height_m": 1.7})
    assert counts.most_people == 2
    assert counts.tracked > 0.8 * counts.instants
    assert "rig" in open_take(tmp_path / "walk.mcap").info.method_settings


def test_films_of_a_person_who_stands_still_are_refused() -> None:
    with pytest.raises(CalibrationError, match="give a rig with --rig"):
        calibrate_films(films(standing(20), 5.0), {})
