"""Films without a rig: their people calibrate the cameras, and are tracked from the first image; or it is refused."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from support.keypoint_people import filmed, ring, standing, walking

from mocapella.calibration.people_rig import RigScale
from mocapella.cli.recordings import open_take
from mocapella.errors import CalibrationError, InputError
from mocapella.library.film_calibration import calibrate_films, keep_frames, track_films
from mocapella.library.people_calibration import calibrate_people, take_frames
from mocapella.model.keypoints import KeypointFrame
from mocapella.sources.simulate.motion import Ensemble

pytestmark = pytest.mark.slow


def films(people: Ensemble, seconds: float) -> dict[str, list[KeypointFrame]]:
    """The frames of three cameras."""
    frames: dict[str, list[KeypointFrame]] = {}
    for frame in filmed(ring(3, 0), people, seconds, seed=0, hz=12):
        of = frames.setdefault(frame.sensor, [])
        of.append(msgspec.structs.replace(frame, sequence=len(of)))
    return frames


def test_people_in_films_calibrate_the_cameras_and_are_tracked(tmp_path: Path) -> None:
    found_in = films(walking(25, [(-0.8, 0.0), (0.8, 0.3)], [1.75, 1.65]), 9.0)
    found = calibrate_films(found_in, {"height_m": 1.7})
    assert not found.guessed
    counts, report = track_films(found_in, found, tmp_path / "walk.mcap", {"height_m": 1.7})
    assert counts.most_people == 2
    assert len(report.people) >= 2
    assert all(camera.used > 0.5 * camera.detections for camera in report.cameras.values())
    assert counts.tracked > 0.8 * counts.instants
    assert "rig" in open_take(tmp_path / "walk.mcap").info.method_settings
    clocks_ns = {name: round(1e9 * placed.clock_s) for name, placed in found.rig.cameras.items()}
    assert any(clocks_ns.values())
    common = [frame.time_ns - clocks_ns[name] for name, some in sorted(found_in.items()) for frame in some]
    assert [frame.time_ns for frame in take_frames([tmp_path / "walk.mcap"])] == common


def test_kept_keypoints_calibrate_the_cameras_as_those_in_memory(tmp_path: Path) -> None:
    found_in = films(walking(25, [(-0.8, 0.0), (0.8, 0.3)], [1.75, 1.65]), 9.0)
    keep_frames(found_in, tmp_path / "walk.mcap", {"height_m": 1.7})
    assert open_take(tmp_path / "walk.mcap").info.method_settings == {"height_m": 1.7}
    read = take_frames([tmp_path / "walk.mcap"])
    assert [(one.sensor, one.time_ns) for one in read] == sorted(
        (frame.sensor, frame.time_ns) for some in found_in.values() for frame in some
    )
    again = calibrate_people(tmp_path / "walk.mcap", scale=RigScale(stature_m=1.7))
    found = calibrate_films(found_in, {"height_m": 1.7})
    for name, placed in found.rig.cameras.items():
        assert placed.T_camera_world == pytest.approx(again.rig.cameras[name].T_camera_world, abs=1e-9)
    with pytest.raises(InputError, match="give one take alone"):
        take_frames([tmp_path / "walk.mcap", tmp_path / "other"])


def test_films_of_a_person_who_stands_still_are_refused() -> None:
    with pytest.raises(CalibrationError, match="give a rig with --rig"):
        calibrate_films(films(standing(20), 5.0), {})
