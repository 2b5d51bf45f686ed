"""The named scenes and how their parts are asked for."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from mocapella.errors import InputError, SettingsError
from mocapella.sources.simulate import SimulatedSensor, build_room, load_scene, scene_names, scene_settings


def test_the_scenes_of_the_study_and_of_the_demo_are_there() -> None:
    wanted = {"stand", "steps", "walk", "obstacle", "around", "front-back", "exchange", "self-occlusion", "crowd"}
    wanted |= {"squats", "sit", "wave", "bend"}
    assert set(scene_names()) == wanted


def test_the_demo_has_three_sensors_two_people_and_an_obstacle() -> None:
    scene = scene_settings("obstacle")
    assert (len(scene.sensors), len(scene.people), len(scene.boxes) + len(scene.cylinders)) == (3, 2, 1)
    crowd = scene_settings("crowd")
    assert (len(crowd.sensors), len(crowd.people)) == (6, 6)


def test_an_unknown_scene_is_refused_with_a_suggestion() -> None:
    with pytest.raises(SettingsError, match=r"unknown scene 'obstacel'.*did you mean obstacle\?"):
        load_scene("obstacel")


def test_sensors_are_chosen_by_name_or_by_number_from_one() -> None:
    room = load_scene("obstacle")
    names = [SimulatedSensor(room, which).name for which in (1, "2", "left", 3)]
    assert names == ["front", "right", "left", "left"]


@pytest.mark.parametrize(
    ("which", "message"),
    [
        (0, "no sensor 0; give 1 to 3: front, right, left"),
        ("4", "no sensor 4"),
        (-1, "no sensor -1"),
        ("frnt", r"did you mean front\?"),
        ("²", "no sensor '²'"),
    ],
)
def test_a_sensor_that_is_not_there_is_refused(which: int | str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        SimulatedSensor(load_scene("obstacle"), which)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": -1}, "seed"),
        ({"seed": 2**63}, "seed"),
        ({"sensors": ()}, "sensors"),
        ({"people": ()}, "people"),
        ({"sensors": scene_settings("stand").sensors[:1] * 2}, "of different names"),
    ],
)
def test_a_room_that_cannot_be_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        dataclasses.replace(scene_settings("stand"), **change)  # type: ignore[arg-type]


def test_people_who_cannot_be_are_refused() -> None:
    person = scene_settings("stand").people[0]
    with pytest.raises(SettingsError, match="start"):
        dataclasses.replace(person, start=(1e9, 0))
    with pytest.raises(SettingsError, match="stature"):
        dataclasses.replace(person, stature=5.0)


def test_an_unknown_topology_or_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="unknown topology"):
        load_scene("stand", topology="kinect_v3")
    with pytest.raises(InputError, match="cannot be read"):
        load_scene("stand", bvh=tmp_path / "none.bvh")


def test_who_is_done_first_stands_and_waits_for_the_others() -> None:
    crowd = load_scene("crowd")
    alone = build_room(dataclasses.replace(crowd.settings, people=crowd.settings.people[:1]))
    assert alone.duration_s < crowd.duration_s
    before, end = (crowd.positions_at(ns)[0] for ns in (alone.duration_ns + 20_000_000, crowd.duration_ns - 20_000_000))
    assert (before == end).all()
