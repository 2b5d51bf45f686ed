"""A frame whose number leaps neither cuts its node off nor counts all numbers between as lost."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.take_making import SECOND, STEP, frame, info

from mocapella.errors import WireError
from mocapella.live.recorder import Recorder
from mocapella.live.sensor_registry import SensorRegistry
from mocapella.live.sequence_leaps import ALWAYS, MOST_HZ, LeapGuard, check_leap
from mocapella.model.session import Setup
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame
from mocapella.wire.keys import NodeKey

FRONT = NodeKey("front", 1)


@given(last=st.integers(0, 2**60), skipped=st.integers(0, ALWAYS), away_s=st.floats(0, 1e6))
def test_what_a_sensor_can_count_is_taken_after_any_outage(last: int, skipped: int, away_s: float) -> None:
    check_leap(last + skipped, last, 0.0)
    check_leap(last + skipped + int(MOST_HZ * away_s), last, away_s)
    check_leap(max(0, last - skipped), last, -away_s)


@given(last=st.integers(0, 2**60), away_s=st.floats(-1e6, 1e6))
def test_a_leap_beyond_that_is_refused(last: int, away_s: float) -> None:
    with pytest.raises(WireError, match=r"count the frames 0, 1, 2, …"):
        check_leap(last + ALWAYS + int(MOST_HZ * max(0.0, away_s)) + 1, last, away_s)


def test_a_leap_does_not_cut_the_real_node_off() -> None:
    registry = SensorRegistry()
    registry.set_connected(FRONT, True, 0)
    registry.arrived(frame("front", 7), FRONT, SECOND)
    with pytest.raises(WireError, match="after 7 skips"):
        registry.arrived(frame("front", 2**62), FRONT, SECOND + STEP)
    registry.arrived(frame("front", 8), FRONT, SECOND + 2 * STEP)
    (health,) = registry.health(SECOND + 3 * STEP, Setup(), {}, {})
    assert (health.frames, health.dropped) == (2, 0)


def test_a_leap_is_not_recorded_and_nothing_counts_as_lost(tmp_path: Path) -> None:
    said: list[str] = []
    recorder = Recorder(TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0), said.append)
    for number in (0, 1, 2**62, 2, 4):
        data = encode_frame(msgspec.structs.replace(frame("front", 1), sequence=number))
        recorder.frame(FRONT, data, SECOND + STEP * min(number, 9))
    health = recorder.close()
    assert (health.frames, health.lost) == (4, 1)
    assert [text for text in said if "front are not recorded" in text and "skips more than" in text]


def test_each_node_has_its_own_numbers_and_late_frames_are_no_leaps() -> None:
    guard = LeapGuard()
    guard.check(FRONT, 2**40, 0)
    guard.check(NodeKey("front", 2), 0, 0)
    guard.check(FRONT, 5, 0)
    guard.check(FRONT, 2**40 + ALWAYS, 0)
    with pytest.raises(WireError):
        guard.check(FRONT, 2**40 + 3 * ALWAYS, 0)
    guard.check(FRONT, 2**40 + 3 * ALWAYS, 20 * SECOND)
