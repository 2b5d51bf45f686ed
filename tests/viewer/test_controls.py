"""What can be used now, and what is proposed."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st
from walkers import health, status

from mocapella.model.session import RecordingHealth
from mocapella.viewer.controls import allowed, default_perspective, next_name, perspectives, progress_percent
from mocapella.viewer.perspective import FREE


@given(st.booleans(), st.booleans())
def test_of_every_pair_of_opposites_exactly_one_can_be_used(running, recording):
    can = allowed(status(running=running, recording=RecordingHealth(active=recording)))
    assert can.start == (not running)
    assert can.stop == running
    assert can.recalibrate == running
    assert can.record == (not recording)
    assert can.record_stop == recording
    assert can.setup


def test_without_a_server_nothing_can_be_used():
    assert not any(dataclasses.astuple(allowed(None)))


def test_progress_is_shown_while_calibrating_only():
    assert progress_percent(None) is None
    assert progress_percent(status()) is None
    assert progress_percent(status(phase="calibrating", frames_remaining=30, frames_wanted=120)) == 75.0


@given(st.integers(1, 500), st.integers(1, 500))
def test_progress_is_a_percentage(remaining, wanted):
    assert 0 <= progress_percent(status(frames_remaining=remaining, frames_wanted=wanted)) <= 100


def test_the_default_perspective_is_the_servers_own_sensor_else_the_first_else_free():
    assert default_perspective(None, ()) == FREE
    assert default_perspective(None, ("b", "a")) == "a"
    assert default_perspective(status(sensors=(health("b"), health("a"))), ()) == "a"
    assert default_perspective(status(sensors=(health("a"), health("b", local=True))), ("0",)) == "b"


def test_a_perspective_once_offered_stays_when_its_sensor_leaves():
    assert perspectives(status(sensors=(health("left"),)), ("front",)) == (FREE, "front", "left")


@pytest.mark.parametrize(
    ("take", "following"),
    [
        ("take-1", "take-2"),
        ("walk-009", "walk-010"),
        ("/takes/p7.mcap", "p8"),
        ("square", "square-2"),
        ("v1.2", "v1.3"),
    ],
)
def test_the_next_take_has_the_next_number(take, following):
    assert next_name(take) == following


@given(st.from_regex(r"[a-z]{1,5}[0-9]{0,4}", fullmatch=True))
def test_no_take_proposes_its_own_name(take):
    assert next_name(take) != take
