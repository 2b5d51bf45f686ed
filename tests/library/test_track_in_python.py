"""`mocapella.track`: of a path, a loaded recording, or frames in memory."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.take_making import small_take

import mocapella
from mocapella.errors import InputError, PluginError, SettingsError, TakeExistsError
from mocapella.geometry.rigid import rigid
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import encode_camera_rig, load_camera_rig, save_camera_rig
from mocapella.model.depth import IMAGES_SUFFIX, depth_frame
from mocapella.model.markers import marker_frame
from mocapella.model.observations import Arrival
from mocapella.model.sensor_frame import SensorFrame
from mocapella.recording.take_reader import read_take
from mocapella.schema import encode_scene
from mocapella.sources.simulate import SimulatedSensor, load_scene, merge


@cache
def arrivals() -> list[Arrival]:
    """Two people before two sensors, who stand, are calibrated, and begin to walk."""
    room = load_scene("obstacle")
    sensors = [SimulatedSensor(room, name) for name in room.sensor_names[:2]]
    return [Arrival(item.frame, item.truth.room_ns) for item in merge(sensors, 0.0, 3.0)]


def tracked(**more: Any) -> mocapella.Recording:
    return mocapella.track(arrivals(), "stand-still", frames=30, **more)


def scenes(recording: mocapella.Recording) -> list[bytes]:
    return [encode_scene(scene) for scene in recording.scenes()]


def test_frames_in_memory_become_people_views_and_tables() -> None:
    found = tracked()
    assert found.people is not None
    assert set(found.people.individuals) == {"person_0", "person_1"}
    assert found.views is not None
    assert len(found.sensors) == 2
    assert found.seconds == pytest.approx(3.0, abs=0.1)
    assert found.labels[0]["method"] == "stand-still"
    assert len(found.people.to_pandas())
    assert repr(found).startswith("<Recording frames: 3.0 s, sensors: ")
    assert len(scenes(found)) == len(arrivals())


def test_a_recorded_result_is_that_in_memory_and_is_tracked_again_alike(tmp_path: Path) -> None:
    recorded = tracked(record=tmp_path / "a")
    assert recorded.path == tmp_path / "a.mcap"
    assert recorded.take is not None
    assert recorded.take.info.origin is None  # they are frames of no recording
    assert scenes(recorded) == scenes(tracked())
    for same in (recorded, recorded.path, str(recorded.path), recorded.path.with_suffix("")):
        assert scenes(mocapella.track(same)) == scenes(recorded)
    again = mocapella.track(recorded, frames=15, placement="parallel", record=tmp_path / "b.mcap")
    assert again.take is not None
    assert again.take.info.origin is not None
    assert again.take.info.origin.changes == {"settings": {"frames": 15}, "placement": "parallel"}
    assert again.labels[0]["placement"] == "parallel"
    assert scenes(mocapella.track(recorded, frames=15)) == scenes(again)
    assert scenes(again) != scenes(recorded)
    with pytest.raises(TakeExistsError):
        mocapella.track(recorded, record=tmp_path / "b")


def test_results_in_memory_know_the_file_that_can_be_tracked_again(tmp_path: Path) -> None:
    tracked(record=tmp_path / "a.mcap")
    found = mocapella.track(tmp_path / "a.mcap", frames=15)
    assert found.take is None
    assert scenes(mocapella.track(found)) == scenes(mocapella.load(tmp_path / "a.mcap"))
    with pytest.raises(SettingsError, match="no sensors' frames to track"):
        mocapella.track(tracked())


def test_frames_alone_are_tracked_at_their_own_times_and_numbered_if_they_are_not(tmp_path: Path) -> None:
    import msgspec

    frames: list[SensorFrame] = [msgspec.structs.replace(one.frame, sequence=0) for one in arrivals()[:40]]
    found = mocapella.track(iter(frames), "stand-still", record=tmp_path / "a.mcap")
    assert [scene.at_ns for scene in found.scenes()] == [frame.time_ns for frame in frames]
    take = read_take(tmp_path / "a.mcap")
    assert take.frame_count == 40
    assert all(node.missing == () for node in take.complete())


def test_a_mistake_is_named_before_any_work(tmp_path: Path) -> None:
    path = small_take(tmp_path / "a.mcap")
    for arguments, error, words in (
        ({"method": "stand-stil"}, SettingsError, "did you mean stand-still"),
        ({"framse": 3}, SettingsError, "unknown key 'framse'"),
        ({"placement": "right-91"}, SettingsError, "placement"),
        ({"method": "arms"}, InputError, "it sends skeletons, which the method arms does not use"),
        ({"method": "hands", "rig": Path("gone.toml")}, InputError, "gone.toml"),
        ({"rig": Path("gone.toml")}, InputError, "gone.toml"),
        ({"layout": "gone.json"}, InputError, "gone.json"),
        ({"layout": "gone.json", "recalibrate": True}, InputError, "gone.json"),
    ):
        with pytest.raises(error, match=words):  # type: ignore[call-overload]
            mocapella.track(path, **arguments, record=tmp_path / "b.mcap")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="there are no frames to track"):
        mocapella.track([])
    with pytest.raises(InputError, match="the frames cannot be tracked: it sends skeletons"):
        mocapella.track(arrivals()[:3], "arms")
    with pytest.raises(InputError, match="no such file"):
        mocapella.track(tmp_path / "gone.mcap")
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]


def test_a_file_of_the_method_is_read_into_its_setting(tmp_path: Path) -> None:
    lens = np.array([600.0, 600, 320, 240, 0, 0, 0, 0, 0])
    placed = {
        name: PlacedCamera(Camera(name, (640, 480), lens), rigid(np.eye(3), [-0.1 * k, 0, 0]), np.eye(6))
        for k, name in enumerate(("left", "right"))
    }
    save_camera_rig(tmp_path / "rig.toml", CameraRig(placed))
    frames = [
        marker_frame("left", ["red"], time_ns=k + 1, size_px=(640, 480), positions_px=[[320, 240]]) for k in range(3)
    ]
    found = mocapella.track(frames, "hands", rig=tmp_path / "rig.toml", record=tmp_path / "a.mcap")
    assert found.take is not None
    told = found.take.info.method_settings["rig"]
    assert told == encode_camera_rig(load_camera_rig(tmp_path / "rig.toml"))
    with pytest.raises(SettingsError, match="rig"):
        mocapella.track(frames, "hands")


@pytest.mark.parametrize("sensor", ["front", "front" + IMAGES_SUFFIX])
def test_images_that_no_method_tracks_are_refused_with_their_use(sensor: str) -> None:
    lens = [20.0, 20.0, 10.0, 10.0]
    frames = [depth_frame(sensor, np.ones((20, 20), np.uint16), unit_m=0.001, lens=lens, time_ns=k) for k in range(3)]
    with pytest.raises(InputError, match="it sends depth, which no method uses; `mocapella node arm` finds the arms"):
        mocapella.track(frames, "arms")


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = small_take(tmp_path / "a.mcap")
    monkeypatch.setattr("mocapella.live.recorded_take.missing_of", lambda take: ["it was made with heat 1.0"])
    with pytest.raises(PluginError, match=r"cannot be tracked: it was made with heat 1\.0"):
        mocapella.track(path)


def test_positions_are_those_of_the_take_in_every_way(tmp_path: Path) -> None:
    recorded, memory = tracked(record=tmp_path / "a.mcap"), tracked()
    assert recorded.people is not None
    assert memory.people is not None
    for name in ("positions", "states", "times_s", "runs"):
        np.testing.assert_array_equal(getattr(recorded.people, name), getattr(memory.people, name))
