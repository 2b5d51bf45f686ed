"""What can be used now, and what is proposed."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.walkers import Room, health, status

from mocapella.model.session import RecordingHealth, Setup
from mocapella.tracker import METHODS
from mocapella.viewer.controls import (
    allowed,
    default_perspective,
    part_names,
    perspectives,
    progress_percent,
    take_name,
)
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


def test_start_cannot_be_used_while_the_server_gets_ready():
    waiting = status(running=False, phase="stopped", reason="compiling the tracking method")
    assert not allowed(waiting).start
    assert allowed(waiting) == dataclasses.replace(allowed(dataclasses.replace(waiting, reason="")), start=False)


@pytest.mark.parametrize("method", METHODS)
def test_parts_can_be_there_that_the_method_makes_whether_or_not_there_are_any(method):
    counts = dict.fromkeys(METHODS[method].parts, 0)
    assert part_names(status(setup=Setup(method=method), counts=counts), None) == METHODS[method].parts


def test_without_a_server_parts_can_be_there_that_the_scene_has():
    scene = Room().scene(0.0, Room().frames(0.0))
    assert part_names(None, scene) == ("people",)
    assert part_names(None, None) == ()


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


PROPOSED = status(next_take="take-4")
RECORDING = status(next_take="take-5", recording=RecordingHealth(active=True, path="/takes/take-4.mcap"))
ENDED = status(next_take="take-5", recording=RecordingHealth(active=False, path="/takes/take-4.mcap"))


@pytest.mark.parametrize(
    ("typed", "before", "now", "shown"),
    [
        ("take-1", None, PROPOSED, "take-4"),
        ("take-4", PROPOSED, ENDED, "take-5"),
        ("take-4", RECORDING, ENDED, "take-5"),
        ("", PROPOSED, ENDED, ""),
        ("take-4", PROPOSED, RECORDING, "take-4"),
        ("walk-7", PROPOSED, ENDED, "walk-7"),
        ("walk-7", RECORDING, ENDED, "walk-7"),
        ("take-1", None, status(), "take-1"),
    ],
)
def test_the_servers_proposal_is_shown_unless_another_name_was_typed_that_is_not_used_up(typed, before, now, shown):
    assert take_name(typed, before, now) == shown
