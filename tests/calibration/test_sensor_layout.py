from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_people import ONE, two, walks

from mocapella.calibration.pair_memory import COST_WEIGHT
from mocapella.calibration.people import PeopleCalibration
from mocapella.calibration.sensor_layout import (
    SensorLayout,
    decode_layout,
    encode_layout,
    is_layout,
    load_layout,
    save_layout,
)
from mocapella.errors import InputError


@pytest.fixture(scope="module")
def layout() -> SensorLayout:
    calibration = PeopleCalibration()
    walks(calibration, two(), ONE, 8)
    return calibration.layout_now()


def test_what_is_written_is_what_is_read(layout: SensorLayout, tmp_path: Path) -> None:
    path = tmp_path / "hall.json"
    save_layout(path, layout)
    assert load_layout(path) == layout
    assert encode_layout(load_layout(path)) == path.read_bytes()
    assert sorted(layout.sensors) == ["a", "b"]
    assert layout.pairs[0].quality.startswith("a–b: ")
    assert [file.name for file in tmp_path.iterdir()] == ["hall.json"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data.update(version=99), "version"),
        (lambda data: data["sensors"].pop("a"), r"pairs\[0\]"),
        (lambda data: data["sensors"]["a"]["T_world_sensor"][0].__setitem__(0, 2.0), "no rigid motion"),
        (lambda data: data["sensors"]["a"].update(T_world_sensor=[[1.0]]), r"sensors.a.T_world_sensor"),
        (lambda data: data["pairs"][0]["moments"].pop(), r"pairs\[0\].moments"),
        (lambda data: data["pairs"][0]["moments"].__setitem__(0, 0.0), "no weight"),
        (lambda data: data["pairs"][0]["scalars"].__setitem__(COST_WEIGHT, 0.0), "no weight"),
        (lambda data: data["pairs"][0]["T_a_b"][3].__setitem__(3, 2.0), "no rigid motion"),
        (lambda data: data["sensors"].update({"a b/": data["sensors"]["a"]}), "a b/"),
        (lambda data: data.pop("pairs"), "is no sensor layout"),
    ],
)
def test_a_file_that_is_no_layout_is_refused_with_its_name_and_the_field(
    layout: SensorLayout, tmp_path: Path, change: Any, said: str
) -> None:
    data = json.loads(encode_layout(layout))
    change(data)
    path = tmp_path / "hall.json"
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=said) as caught:
        load_layout(path)
    assert "hall.json" in str(caught.value)


def test_no_file_no_json_and_no_folder_are_said(layout: SensorLayout, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_layout(tmp_path / "none.json")
    with pytest.raises(InputError, match="is no sensor layout"):
        decode_layout(b"not json")
    with pytest.raises(InputError, match="cannot be written"):
        save_layout(tmp_path / "no" / "hall.json", layout)


def test_a_layout_of_places_alone_is_enough_to_begin(layout: SensorLayout) -> None:
    places = SensorLayout(layout.version, layout.floor_known, layout.sensors, [])
    state = walks(PeopleCalibration(layout=places), two(), ONE, 0.2)
    assert state.sensors["b"].trusted
    np.testing.assert_allclose(
        np.linalg.norm(state.sensors["b"].T_world_sensor[:3, 3] - state.sensors["a"].T_world_sensor[:3, 3]),
        np.linalg.norm(np.subtract(*(np.array(layout.sensors[name].T_world_sensor)[:3, 3] for name in "ab"))),
        atol=0.15,
    )


@pytest.mark.parametrize(
    ("data", "is_one"),
    [(b'{"sensors": 3}', True), (b'{"version": 1, "sensors": {}}', True), (b'{"cameras": {}}', False), (b"[", False)],
)
def test_what_has_sensors_is_a_layout_valid_or_not(data: bytes, is_one: bool) -> None:
    assert is_layout(data) is is_one
