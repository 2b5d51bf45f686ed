"""Files of the command line become settings, or the error names what the file is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.marker_motion import pair

from mocapella.calibration.sensor_layout import VERSION, SensorLayout, save_layout
from mocapella.errors import InputError, SettingsError
from mocapella.model.camera_rig_file import decode_camera_rig, save_camera_rig
from mocapella.model.hand import hand_model
from mocapella.model.hand_file import decode_hand_shape, save_hand_shape
from mocapella.tracker.method_files import bodies_rig, camera_rig, hand_shape, spaces


def test_a_rig_is_the_setting_of_hands_and_of_bodies_beside_people(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    save_camera_rig(path, pair())
    values = camera_rig([path])
    assert list(values) == ["rig"]
    assert list(decode_camera_rig(values["rig"]).cameras) == list(pair().cameras)
    assert bodies_rig([path]) == {"bodies": {"silhouettes": values}}


def test_a_hand_is_the_one_of_the_file(tmp_path: Path) -> None:
    path, shape = tmp_path / "hand.json", hand_model().shape("left", person="Ada")
    save_hand_shape(path, shape)
    values = hand_shape([path])
    assert list(values) == ["hand"]
    found = decode_hand_shape(values["hand"].encode())
    assert (found.handedness, found.person) == ("left", "Ada")
    np.testing.assert_allclose(found.lengths, shape.lengths, atol=1e-6)


def test_only_a_sensor_layout_is_called_one(tmp_path: Path) -> None:
    layout, note, absent = tmp_path / "hall.json", tmp_path / "note.txt", tmp_path / "absent.toml"
    save_layout(layout, SensorLayout(VERSION, True, {}, []))
    note.write_text("a note", encoding="utf-8")
    with pytest.raises(InputError, match=r"hall\.json: is a sensor layout; use --set layout=FILE"):
        camera_rig([layout])
    for path, said in ((note, "is no TOML"), (absent, "is not there"), (tmp_path, "holds no cameras")):
        with pytest.raises(InputError, match=said) as caught:
            camera_rig([path])
        assert str(path) in str(caught.value)
        assert "--set layout" not in str(caught.value)


@pytest.mark.parametrize("read", [camera_rig, bodies_rig, hand_shape])
@pytest.mark.parametrize("count", [0, 2])
def test_one_file_is_wanted(read: Callable[[Sequence[Path]], dict[str, Any]], count: int, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=f"is given {count} times; give it once"):
        read([tmp_path / "file"] * count)


def test_any_number_of_spaces_is_fine() -> None:
    assert spaces([]) == {"spaces": []}
