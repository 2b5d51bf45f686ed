"""What is requested of a camera: the options, else the profile's values, and which automatic modes stay on."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

pytest.importorskip("cv2")

from mocapella.cli.pictures import CameraKeys, wishes
from mocapella.sensing.colour_profile import CameraControls, ColourProfile, decode_profile, encode_profile
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import load_hand_scene

SAVED = CameraControls(60.0, 10.0, 4600.0, brightness=3.0, automatic=("exposure", "white_balance", "focus"))


@cache
def profile() -> ColourProfile:
    from dataclasses import replace

    return replace(pointed_at(load_hand_scene("demo", seed=3), "left"), controls=SAVED)


@pytest.mark.parametrize(
    ("given", "automatic"),
    [
        ({}, ("exposure", "white_balance", "focus")),
        ({"exposure": 90.0}, ("white_balance", "focus")),
        ({"gain": 5.0}, ("white_balance", "focus")),
        ({"white_balance_red": 1.5}, ("exposure", "focus")),
        ({"brightness": 1.0}, ("exposure", "white_balance", "focus")),
    ],
)
def test_a_given_value_goes_before_the_profiles_and_switches_its_mode_off(
    given: dict[str, Any], automatic: tuple[str, ...]
) -> None:
    wanted = wishes(None, 90.0, None, CameraKeys(**given).controls, profile())
    assert wanted.size_px == (320, 240)
    assert wanted.controls.values == SAVED.values | given
    assert wanted.controls.automatic == automatic


def test_a_profile_with_all_controls_survives_its_file_and_an_older_one_is_read() -> None:
    assert decode_profile(encode_profile(profile())) == profile()
    older = encode_profile(profile()).replace(
        b',"brightness":3.0,"white_balance_red":null,"white_balance_blue":null', b""
    )
    assert b"brightness" not in older
    assert decode_profile(older).controls.brightness is None
