"""The Setup form: what is typed stays, what the server changes comes in, and what is sent is a `Setup`."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.walkers import health, status

from mocapella.conventions import NOT_AVAILABLE
from mocapella.errors import SettingsError
from mocapella.model.session import PLACEMENTS, SCENARIOS, SensorPose, Setup
from mocapella.settings import parse
from mocapella.viewer.setup_form import (
    HEIGHT_M,
    NONE,
    TILT_DEG,
    PoseField,
    SetupFields,
    fields_of,
    merge,
    setup_arguments,
)

POSES = st.builds(PoseField, st.floats(-45, 45), st.floats(0, 3))
FIELDS = st.builds(
    SetupFields,
    method=st.sampled_from(["stand-still", "other"]),
    sensors_expected=st.integers(1, 6),
    participant=st.sampled_from(["", "7", "12"]),
    placement=st.sampled_from([NONE, *PLACEMENTS]),
    scenario=st.sampled_from([NONE, *SCENARIOS]),
    poses=st.fixed_dictionaries({"front": POSES, "left": POSES}),
)


@given(FIELDS, FIELDS)
def test_an_untouched_form_follows_the_server(before, now):
    assert merge(before, before, now) == now


@given(FIELDS, FIELDS)
def test_where_the_server_changed_nothing_all_edits_stay(shown, before):
    assert merge(shown, before, before) == shown


@given(FIELDS, FIELDS, FIELDS)
def test_an_edited_field_stays_and_any_other_follows(shown, before, now):
    merged = merge(shown, before, now)
    for name in ("method", "sensors_expected", "participant", "placement", "scenario"):
        mine, old, new = (getattr(fields, name) for fields in (shown, before, now))
        assert getattr(merged, name) == (new if mine == old else mine)


def test_a_sensor_that_joins_brings_its_pose_and_one_that_leaves_takes_it_away():
    shown = SetupFields(poses={"front": PoseField(1, 1), "left": PoseField(2, 2)})
    now = SetupFields(poses={"left": PoseField(2, 2), "right": PoseField(3, 3)})
    assert dict(merge(shown, shown, now).poses) == {"left": PoseField(2, 2), "right": PoseField(3, 3)}


def test_a_pose_that_was_set_up_goes_before_what_the_sensor_says():
    session = status(
        sensors=(health("front", tilt=0.1, height=1.0), health("left", tilt=0.0, height=0.7)),
        setup=Setup(participant=7, sensors={"front": SensorPose(math.radians(-5), 1.5)}),
    )
    fields = fields_of(session)
    assert dict(fields.poses) == {"front": PoseField(-5.0, 1.5), "left": PoseField(0.0, 0.7)}
    assert (fields.participant, fields.placement, fields.scenario) == ("7", NONE, NONE)


@given(FIELDS)
def test_what_is_sent_parses_as_the_setup_that_was_typed(shown):
    setup = parse(Setup, setup_arguments(shown, SetupFields(), Setup()))
    assert setup.method == shown.method
    assert setup.participant == (int(shown.participant) if shown.participant else NOT_AVAILABLE)
    assert setup.placement == ("" if shown.placement == NONE else shown.placement)
    assert math.degrees(setup.sensors["front"].tilt) == pytest.approx(shown.poses["front"].tilt_deg)


def test_only_poses_that_were_edited_or_set_up_before_are_sent():
    session = status(sensors=(health("front"), health("left")), setup=Setup())
    applied = fields_of(session)
    assert setup_arguments(applied, applied, session.setup)["sensors"] == {}
    edited = dataclasses.replace(applied, poses={**applied.poses, "left": PoseField(10.0, 1.2)})
    assert set(setup_arguments(edited, applied, session.setup)["sensors"]) == {"left"}
    before = Setup(sensors={"front": SensorPose()})
    assert set(setup_arguments(applied, applied, before)["sensors"]) == {"front"}


def test_a_participant_that_is_no_number_is_refused_by_name():
    with pytest.raises(SettingsError, match=r"participant is 'Ada'; it must be a whole number"):
        setup_arguments(SetupFields(participant="Ada"), SetupFields(), Setup())


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (PoseField(200.0, 1.0), 'tilt of sensor "left" is 200°; it must be from -180 to 180°'),
        (PoseField(-180.5, 1.0), 'tilt of sensor "left" is -180.5°; it must be from -180 to 180°'),
        (PoseField(0.0, 1200.0), 'height of sensor "left" is 1200 m; it must be from 0 to 1000 m'),
        (PoseField(0.0, -0.1), 'height of sensor "left" is -0.1 m; it must be from 0 to 1000 m'),
    ],
)
def test_a_pose_out_of_range_is_refused_in_the_units_in_which_it_was_typed(pose, words):
    with pytest.raises(SettingsError, match=f"^{words}$"):
        setup_arguments(SetupFields(poses={"left": pose}), SetupFields(), Setup())


def test_every_pose_of_the_form_is_one_of_a_setup():
    for tilt in TILT_DEG:
        for height in HEIGHT_M:
            parse(Setup, setup_arguments(SetupFields(poses={"a": PoseField(tilt, height)}), SetupFields(), Setup()))


def test_to_wait_for_no_sensor_is_refused():
    with pytest.raises(SettingsError, match="sensors to wait for is 0; it must be from 1 to 64"):
        setup_arguments(SetupFields(sensors_expected=0), SetupFields(), Setup())
