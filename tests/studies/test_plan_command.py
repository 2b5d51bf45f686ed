"""`mocapella plan` as a user runs it: the proposal, its files, and what it refuses before the work."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.programs import run_here

from mocapella.calibration.sensor_layout import load_layout
from mocapella.errors import InputError
from mocapella.sources.simulate import SimulatedSensor, build_room, load_scene, scene_settings
from mocapella.sources.simulate.scenery import scenery_of
from mocapella.sources.simulate.scenes import read_scene
from mocapella.studies.planner.placement_search import score_poses
from mocapella.studies.planner.placement_table import ComparedPlacement, simulated_rows
from mocapella.studies.planner.plan_files import layout_json, proposal_lines, scene_toml, table_lines, walk_stops
from mocapella.studies.planner.plan_maps import draw_maps, field_of_view
from mocapella.studies.planner.planned_room import PlannedPeople, PlannedRoom, SensorSites, example_room
from mocapella.studies.planner.room_views import PlannedPose, RoomViews
from mocapella.studies.planner.simulated_check import PlacementCheck, check_placement, summarise

SMALL = """
width = 4.0
depth = 4.0
height = 2.5
area = [[1.0, 1.6], [3.0, 1.6], [3.0, 3.4], [1.0, 3.4]]
cell_m = 0.6
[people]
facings = 4
[[sites]]
points = [[0.3, 0.3], [3.7, 0.3], [2.0, 0.2]]
heights_m = [1.0]
tilts_deg = [0]
"""


@pytest.fixture(scope="module")
def views() -> RoomViews:
    sites = (SensorSites(points=((0.3, 0.3), (3.7, 0.3)), heights_m=(1.0,), tilts_deg=(0.0,)),)
    area = ((1.0, 1.6), (3.0, 1.6), (3.0, 3.4), (1.0, 3.4))
    return RoomViews(PlannedRoom(4.0, 4.0, 2.5, sites, area=area, people=PlannedPeople(facings=4), cell_m=0.6))


@pytest.fixture(scope="module")
def score(views: RoomViews) -> Any:
    return score_poses(views, [PlannedPose(0.3, 1.0, 0.3, 45.0, 0.0), PlannedPose(3.7, 1.0, 0.3, -45.0, -5.0)])


@pytest.fixture(scope="module")
def scene(views: RoomViews, score: Any) -> bytes:
    return scene_toml(views, score)


def test_the_example_is_printed_as_it_ships(tmp_path: Path) -> None:
    done = run_here(tmp_path, "plan", "--example")
    assert (done.returncode, done.stdout) == (0, example_room())


@pytest.mark.slow
def test_a_room_is_planned_and_its_files_are_read_by_the_simulator_and_the_server(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    (tmp_path / "room.toml").write_text(SMALL)
    words = ("plan", "room.toml", "--sensors", "2", "--sensor", "azure-kinect", "--out", "new/plan", "--json", "-")
    done = run_here(tmp_path, *words)
    assert done.returncode == 0, done.stderr
    made = json.loads(done.stdout)
    folder = tmp_path / "new" / "plan"
    assert {path.name for path in folder.iterdir()} == {
        "plan.txt", "plan.png", "plan.svg", "scene.toml", "layout.json",
    }  # fmt: skip
    proposal = made["proposal"]
    text = (folder / "plan.txt").read_text("utf-8")
    assert text.startswith("2 azure-kinect sensors, in metres and degrees:\n  sensor-1: x ")
    assert [row["name"] for row in made["placements"]][:4] == ["proposal", "parallel", "45°", "90°"]
    settings = scene_settings(str(folder / "scene.toml"))
    layout = load_layout(folder / "layout.json")
    for sensor, planned in zip(settings.sensors, proposal["sensors"], strict=True):
        assert sensor.position == (planned["x"], planned["height"], planned["z"])
        assert (sensor.yaw_deg, sensor.tilt_deg, sensor.fov_deg) == (planned["yaw_deg"], planned["tilt_deg"], (75, 65))
        assert np.allclose(layout.sensors[sensor.name].T_world_sensor, sensor.T_world_sensor)
    assert (folder / "plan.png").read_bytes()[1:4] == b"PNG"


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (("plan",), 1, "no room to plan; name a file, which `mocapella plan --example > room.toml` begins"),
        (("plan", "none.toml"), 1, "none.toml: cannot be read"),
        (("plan", "room.toml", "--sensors", "0"), 2, "0 is not in the range x>=1"),
        (("plan", "room.toml", "--sensors", "99"), 1, "sensor.count is 99; it must be from 1 to 16"),
        (("plan", "room.toml", "--sensor", "kinnect-v2"), 1, "did you mean kinect-v2"),
        (("plan", "room.toml", "--seeds", "a"), 1, "--seeds 'a' cannot be used"),
        (("plan", "room.toml", "--out", "room.toml"), 1, "--out room.toml: "),
    ],
)
def test_what_cannot_be_used_is_refused_before_the_work(
    tmp_path: Path, words: tuple[str, ...], status: int, message: str
) -> None:
    (tmp_path / "room.toml").write_text(SMALL)
    done = run_here(tmp_path, *words)
    assert done.returncode == status
    assert message in " ".join(done.stderr.split())


def test_a_scene_file_is_a_scene(views: RoomViews, score: Any, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(scene_toml(views, score))
    room = load_scene(str(path), seed=4)
    assert (room.name, room.sensor_names, room.settings.seed) == ("plan", ("sensor-1", "sensor-2"), 4)
    assert set(scenery_of(str(path)).T_room_sensor) == set(room.sensor_names)
    assert run_here(tmp_path, "node", "simulate", "--scene", "none.toml").returncode == 1
    frame = next(iter(SimulatedSensor(room, "sensor-2").frames(1.0, 2.0))).frame
    assert frame.positions.shape == (1, 25, 3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"[scenes.plan]", b"[scenes.other]\nsensors = []\n[scenes.plan]", "has 2 scenes; a scene file has one"),
        (b'"sensor-2"', b'"sensor-9"', "is no list of the names in the table sensors"),
        (b"yaw_deg = 45.0", b'yaw_deg = "x"', "scene plan: Expected `float`"),
        (b"yaw_deg = 45.0", b"yaw = 45.0", "unknown key 'yaw'"),
        (b"[sensors.sensor-1]", b"[nodes.a]\n[sensors.sensor-1]", "is no scene file"),
        (b"[sensors.sensor-1]", b"[sensors.sensor-1", "is no TOML"),
    ],
)
def test_a_scene_file_that_cannot_be_used_is_named_with_the_remedy(
    scene: bytes, tmp_path: Path, old: bytes, new: bytes, message: str
) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(scene.replace(old, new, 1))
    with pytest.raises(InputError, match="mocapella plan") as raised:
        read_scene(path)
    assert message in str(raised.value)


def test_the_walk_of_the_scene_crosses_the_area(views: RoomViews) -> None:
    stops = np.array(walk_stops(views))
    assert np.ptp(stops, axis=0) == pytest.approx(np.ptp(views.cells, axis=0))


def test_words_name_what_is_wrong_with_a_placement(views: RoomViews, score: Any) -> None:
    away = score_poses(views, [score.poses[0], PlannedPose(3.7, 1.0, 0.3, 90.0, 0.0)])
    assert any(line.startswith("WARNING: the sensors are 2 groups") for line in proposal_lines(views, away))
    lines = table_lines([ComparedPlacement("proposal", score), ComparedPlacement("none", None)])
    assert "does not fit into the room" in lines[3]
    assert len({line.index("covered") for line in lines if "covered" in line}) == 1
    assert b"sensor-2" in layout_json(views, score)


def test_a_simulation_is_of_what_has_several_sensors(views: RoomViews, score: Any) -> None:
    one = score_poses(views, score.poses[:1])
    rows = [ComparedPlacement(name, one if name == "one" else score) for name in ("one", "two", "tilt 0°")]
    assert [name for name, _ in simulated_rows([*rows, ComparedPlacement("none", None)])] == ["two"]


def test_a_map_shows_what_the_sensor_sees(views: RoomViews, score: Any) -> None:
    outline = field_of_view(score.poses[0], 70.6, (0.5, 4.5))
    sensor = views.sensor(score.poses[0])
    T = sensor.T_world_sensor
    points = np.stack([outline[:, 0], np.full(len(outline), 1.0), outline[:, 1]], axis=-1)
    camera = (points - T[:3, 3]) @ T[:3, :3]
    assert (np.abs(np.degrees(np.arctan2(camera[:, 0], camera[:, 2]))) <= 35.3 + 1e-6).all()
    assert sorted({round(float(z), 6) for z in camera[:, 2]}) == [0.5, 4.5]


@pytest.mark.slow
def test_maps_are_drawn(views: RoomViews, score: Any, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    draw_maps(views, score, (tmp_path / "a.png", tmp_path / "a.svg"))
    assert "<svg" in (tmp_path / "a.svg").read_text("utf-8")
    assert (tmp_path / "a.png").read_bytes()[1:4] == b"PNG"


@pytest.mark.slow
def test_a_simulated_session_agrees_with_its_prediction(views: RoomViews, score: Any) -> None:
    check = check_placement(views, score, 3)
    summary = summarise([[check]])
    assert summary.stays == len(check.predicted_cm) == 12
    assert summary.missing <= 1
    assert summary.covered_percent >= 90
    assert 0.5 < summary.ratio < 2.0


def test_agreement_is_of_all_stays() -> None:
    def check(predicted: list[float], simulated: list[float]) -> PlacementCheck:
        known = np.array([[True], [False], [True]])
        return PlacementCheck(np.array(predicted), np.array(simulated), known, known)

    summary = summarise([[check([1, 2, 3], [2, 4, 6])], [check([2, 3, 4], [4, np.nan, 8])], [check([5] * 3, [9] * 3)]])
    assert (summary.sessions, summary.stays, summary.missing) == (3, 9, 1)
    assert summary.rank_of_placements == 1.0
    assert summary.rank_of_stays == pytest.approx(1.0, abs=0.02)
    assert (summary.covered_percent, summary.also_seen_percent) == (100.0, 0.0)
    assert summary.ratio == pytest.approx((2 + 4 + 6 + 4 + 8 + 27) / (1 + 2 + 3 + 2 + 4 + 15))


def test_the_room_of_a_scene_file_can_be_built(views: RoomViews, score: Any, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(scene_toml(views, score))
    assert build_room(read_scene(path)).duration_s > 10
