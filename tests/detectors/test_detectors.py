"""Arm methods by name: each is made for a camera, with settings that are checked."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.model.camera import Camera
from mocapella.tracker.arm_methods import ARM_METHODS, arm_method

CAMERA = Camera("depth", (64, 48), np.array([48.0, 48.0, 31.5, 23.5, 0, 0, 0, 0, 0]))
MODULES = {"default": "mocapella.tracker.depth_arms", "line-skeleton": "mocapella.sensing.line_skeleton"}


@pytest.mark.parametrize("name", ARM_METHODS)
def test_a_method_is_made_by_its_name_and_refuses_settings_that_there_are_not(name: str) -> None:
    pytest.importorskip(MODULES[name], reason="comes with the method")
    made = arm_method(name, CAMERA)
    assert made.name == name
    with pytest.raises(SettingsError, match=f"settings of {name}: unknown key 'nonsense'"):
        arm_method(name, CAMERA, {"nonsense": 1})


def test_an_unknown_name_is_refused_with_those_there_are() -> None:
    with pytest.raises(SettingsError, match=r"unknown arm method 'defualt'; known: .*did you mean default"):
        arm_method("defualt", CAMERA)
