"""Values of the Setup form, and their conversion from a session's status and to a `Setup`.

The fields are merged three ways, like a text under version control: a field that the user has edited but not applied
keeps its value when the server's setup changes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from mocapella.conventions import NOT_AVAILABLE
from mocapella.errors import SettingsError
from mocapella.model.limits import SENSOR_HEIGHT, SENSORS_EXPECTED, TILT
from mocapella.model.session import SensorPose, SessionStatus, Setup
from mocapella.settings import parse

NONE = "–"
"""Text of a dropdown without a choice."""


TILT_DEG, HEIGHT_M = (math.degrees(TILT.low), math.degrees(TILT.high)), (SENSOR_HEIGHT.low, SENSOR_HEIGHT.high)
"""Smallest and largest valid tilt [°] and height [m] of a sensor."""


@dataclass(frozen=True)
class PoseField:
    """A sensor's pose in the form: upward tilt [°] and height above the floor [m]."""

    tilt_deg: float
    height_m: float

    def check(self, sensor: str) -> None:
        """Check that the pose is possible.

        Args:
            sensor: the sensor's name, for errors.

        Raises:
            SettingsError: a value is out of range; names the sensor, the field, and its range.
        """
        for name, value, (low, high), unit in (
            ("tilt", self.tilt_deg, TILT_DEG, "°"),
            ("height", self.height_m, HEIGHT_M, " m"),
        ):
            if not low <= value <= high:
                raise SettingsError(
                    f'{name} of sensor "{sensor}" is {value:g}{unit}; it must be from {low:g} to {high:g}{unit}'
                )


@dataclass(frozen=True)
class SetupFields:
    """Values of the form's fields, which become a `Setup`.

    Attributes:
        method: name of the tracking method.
        sensors_expected: number of sensors to wait for before calibrating.
        participant: number of the participant as typed; empty for none.
        placement, scenario: chosen options, or `NONE`.
        poses: pose of each sensor by name.
    """

    method: str = Setup.method
    sensors_expected: int = 1
    participant: str = ""
    placement: str = NONE
    scenario: str = NONE
    poses: Mapping[str, PoseField] = field(default_factory=dict)


def fields_of(status: SessionStatus) -> SetupFields:
    """Return the form's values for a session's status.

    A sensor without a configured pose shows the pose that it reports itself.
    """
    setup = status.setup
    said = {row.name: _pose_field(row.tilt, row.height) for row in status.sensors}
    chosen = {name: _pose_field(pose.tilt, pose.height) for name, pose in setup.sensors.items()}
    return SetupFields(
        method=setup.method,
        sensors_expected=setup.sensors_expected,
        participant="" if setup.participant == NOT_AVAILABLE else str(setup.participant),
        placement=setup.placement or NONE,
        scenario=setup.scenario or NONE,
        poses=dict(sorted({**said, **chosen}.items())),
    )


def merge(shown: SetupFields, before: SetupFields, now: SetupFields) -> SetupFields:
    """Return the form's values after a change of the server's setup; fields that the user has edited keep theirs.

    A sensor that is not in ``now`` has no pose in the result.

    Args:
        shown: the form's present values.
        before: the form's values for the server's previous setup.
        now: the form's values for the server's new setup.
    """

    def pick(mine: Any, old: Any, new: Any) -> Any:
        return new if mine == old else mine

    poses = {
        name: pick(shown.poses.get(name, pose), before.poses.get(name, shown.poses.get(name, pose)), pose)
        for name, pose in now.poses.items()
    }
    return SetupFields(
        method=pick(shown.method, before.method, now.method),
        sensors_expected=pick(shown.sensors_expected, before.sensors_expected, now.sensors_expected),
        participant=pick(shown.participant, before.participant, now.participant),
        placement=pick(shown.placement, before.placement, now.placement),
        scenario=pick(shown.scenario, before.scenario, now.scenario),
        poses=poses,
    )


def setup_arguments(shown: SetupFields, applied: SetupFields, setup: Setup) -> dict[str, Any]:
    """Return the arguments of the server's command ``setup`` for the form's values.

    They include only the poses that were configured before or are edited now [rad, m]; other sensors report their own
    poses. A value for "none" in the form becomes the setup's empty value.

    Args:
        shown: the form's present values.
        applied: the form's values for the server's setup.
        setup: the server's setup.

    Raises:
        SettingsError: a field is invalid; the message names it and the valid values.
    """
    if shown.sensors_expected not in SENSORS_EXPECTED:
        raise SettingsError(f"sensors to wait for is {shown.sensors_expected}; it must be {SENSORS_EXPECTED}")
    for name, pose in shown.poses.items():
        pose.check(name)
    poses = {
        name: asdict(SensorPose(tilt=math.radians(pose.tilt_deg), height=pose.height_m))
        for name, pose in shown.poses.items()
        if name in setup.sensors or pose != applied.poses.get(name)
    }
    data = {
        "method": shown.method,
        "sensors_expected": shown.sensors_expected,
        "participant": _participant(shown.participant),
        "placement": "" if shown.placement == NONE else shown.placement,
        "scenario": "" if shown.scenario == NONE else shown.scenario,
        "sensors": poses,
    }
    parse(Setup, data, where="setup")
    return data


def _participant(text: str) -> int:
    if not text.strip():
        return NOT_AVAILABLE
    try:
        return int(text)
    except ValueError:
        raise SettingsError(f"participant is {text!r}; it must be a whole number, or empty") from None


def _pose_field(tilt: float, height: float) -> PoseField:
    return PoseField(tilt_deg=round(math.degrees(tilt), 2), height_m=round(max(0.0, height), 2))
