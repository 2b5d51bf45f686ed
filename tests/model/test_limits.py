"""The table of limits, and the settings that use it."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mocapella.conventions import NOT_AVAILABLE
from mocapella.errors import SettingsError
from mocapella.model.limits import MOST_SENSORS, PARTICIPANT, SENSOR_HEIGHT, TILT, Range
from mocapella.model.session import SensorPose, Setup
from mocapella.settings import parse


def test_a_range_has_both_ends_and_nothing_that_is_no_number() -> None:
    for value in (-2, -2.0, 0, 3, 3.0):
        assert value in Range(-2, 3)
    for value in (-2.01, 4, math.nan, math.inf, 10**30, "0", None):
        assert value not in Range(-2, 3)
    assert str(Range(0, 999_999)) == "from 0 to 999999"
    assert str(TILT) == "from -3.14159 to 3.14159 rad"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            {"participant": 10**30},
            "participant is 10+; it must be from -2147483648 to 2147483647; -9999 if there is none",
        ),
        ({"participant": 2**31}, "participant is 2147483648"),
        ({"sensors_expected": 10**25}, "sensors_expected is 10+; it must be from 1 to 64"),
        ({"sensors_expected": 0}, "sensors_expected is 0"),
        ({"sensors": {"a": {"tilt": 3.2}}}, "tilt is 3.2; it must be from -3.14159 to 3.14159 rad"),
        ({"sensors": {"a": {"height": 1001}}}, "height is 1001.0; it must be from 0 to 1000 m"),
        ({"sensors": {"\x1b[31m": {}}}, "sensor name"),
        ({"sensors": {f"s{k}": {} for k in range(MOST_SENSORS + 1)}}, "number of sensors is 65"),
    ],
)
def test_numbers_of_a_setup_are_checked_at_the_door(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        parse(Setup, arguments, where="setup")


def test_what_is_at_the_limits_is_taken() -> None:
    SensorPose(TILT.low, SENSOR_HEIGHT.high)
    SensorPose(TILT.high, SENSOR_HEIGHT.low)
    Setup(participant=int(PARTICIPANT.high), sensors_expected=MOST_SENSORS)
    Setup(participant=NOT_AVAILABLE, sensors_expected=1)
