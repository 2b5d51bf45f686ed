"""A control's grid, and which requests to a camera are refused as a whole."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.model.camera_controls import CONTROLS, ControlDescription, checked
from mocapella.sensing.colour_profile import CameraControls

EXPOSURE = ControlDescription("exposure", "100 µs", 1, 500, 1, 60, 60, "exposure")
GAIN = ControlDescription("gain", "dB", 0, 24, 0.5, 0, 3)


@st.composite
def controls(draw: st.DrawFn) -> ControlDescription:
    least = draw(st.integers(-1000, 1000))
    most, step = least + draw(st.integers(0, 500)), draw(st.sampled_from((0.01, 0.25, 0.5, 1, 3, 7, 1000)))
    return ControlDescription("gain", "", least, most, step, least, least)


@given(controls(), st.floats(0, 1))
def test_a_value_in_range_is_moved_to_the_nearest_one_on_the_grid(control: ControlDescription, part: float) -> None:
    value = control.least + part * (control.most - control.least)
    got = control.accepted(value)
    assert control.least <= got <= control.most
    assert control.accepted(got) == got
    steps = (got - control.least) / control.step
    assert math.isclose(steps, round(steps), abs_tol=1e-6)
    last = control.least + math.floor((control.most - control.least) / control.step + 1e-9) * control.step
    assert abs(got - min(value, last)) <= 0.5 * control.step + 1e-6


@given(controls(), st.floats(1e-3, 1e6), st.booleans())
def test_a_value_out_of_range_is_refused_with_the_range(control: ControlDescription, by: float, above: bool) -> None:
    with pytest.raises(SettingsError, match=f"must be from {control.least:g} to {control.most:g}"):
        control.accepted(control.most + by if above else control.least - by)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(SettingsError, match="exposure is"):
        EXPOSURE.accepted(value)


@pytest.mark.parametrize(
    ("values", "automatic", "says"),
    [
        ({"exposur": 5.0}, {}, "no control 'exposur'; it has exposure, gain .did you mean exposure"),
        ({"gain": 25.0}, {}, r"gain is 25.0; it must be from 0 to 24 \(dB\)"),
        ({}, {"gain": True}, "no automatic 'gain'; it has exposure"),
        ({"exposure": 50.0}, {"exposure": True}, "switch that off first"),
        ({"gain": 1.0, "exposure": 0.0}, {}, "exposure is 0.0"),
    ],
)
def test_a_request_with_one_bad_part_is_refused(values: Any, automatic: Any, says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        checked((EXPOSURE, GAIN), values, automatic)


def test_an_automatic_mode_and_a_read_only_control_refuse_values() -> None:
    on = dataclasses.replace(EXPOSURE, automatic=True)
    with pytest.raises(SettingsError, match="set by the automatic exposure"):
        checked((on, GAIN), {"exposure": 50.0}, {})
    assert checked((on, GAIN), {"exposure": 50.4}, {"exposure": False}) == {"exposure": 50.0}
    with pytest.raises(SettingsError, match="read-only in this camera; it is 3"):
        checked((dataclasses.replace(GAIN, read_only=True),), {"gain": 1.0}, {})
    with pytest.raises(SettingsError, match="it has none"):
        checked((), {"gain": 1.0}, {})


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"name": ""}, "name"),
        ({"unit": "x" * 81}, "unit"),
        ({"mode": "x" * 81}, "mode"),
        ({"value": math.nan}, "value"),
        ({"least": 501}, "least"),
        ({"step": 0}, "step"),
        ({"most": 1e11}, "most"),
        ({"mode": "", "automatic": True}, "automatic"),
    ],
)
def test_descriptions_that_no_control_has_are_refused(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(SettingsError, match=f"^{says} is"):
        dataclasses.replace(EXPOSURE, **wrong)


def test_a_profile_has_a_place_for_every_control() -> None:
    values = {name: float(k) for k, name in enumerate(CONTROLS)}
    assert CameraControls(**values).values == values
    assert CameraControls(gain=2.0).values == {"gain": 2.0}
