"""Who serves which sensor, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.errors import WireError
from mocapella.live.sensor_registry import SensorRegistry
from mocapella.model.arms import ArmFrame
from mocapella.model.depth import depth_frame
from mocapella.model.observations import BodyFrame, body_frame
from mocapella.model.session import SensorHealth, SensorPose, Setup
from mocapella.model.topology import topology
from mocapella.wire.clock import ClockEstimate
from mocapella.wire.keys import NodeKey

A, B = NodeKey("front", 1), NodeKey("front", 2)
S = 1_000_000_000


def frame(sequence: int, time_ns: int = 0, sent_ns: int = 0) -> BodyFrame:
    kind = topology("kinect_v2")
    return body_frame("front", kind, time_ns=time_ns, positions=np.zeros((2, 25, 3)), sequence=sequence,
                      node_id=1, sent_ns=sent_ns, tilt=0.1, height=1.2)  # fmt: skip


def row(roster: SensorRegistry, now_ns: int, setup: Setup | None = None) -> SensorHealth:
    (health,) = roster.health(now_ns, setup or Setup(), {"front": 5}, {"front": 1})
    return health


def test_the_first_node_holds_the_name_and_a_second_is_refused_once_in_words() -> None:
    roster = SensorRegistry()
    assert roster.admit(A, 0) == ""
    roster.set_connected(A, True, 0)
    assert "another node serves the sensor front" in roster.admit(B, S)
    assert roster.admit(B, 100 * S)
    assert [n for n in roster.take_notices() if "refused" in n] == [
        "a second node under the name front was refused (0000000000000002)"
    ]
    assert roster.holds(A)
    assert not roster.holds(B)


def test_a_name_is_free_again_when_its_node_has_left() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    roster.arrived(frame(0), A, 0)
    roster.set_connected(A, False, S)
    assert roster.admit(B, S + 1) == ""  # although it was heard a moment ago: a program that is started again is back
    assert roster.holds(B)
    assert roster.admit(A, S + 2)  # what it had sent before


def test_a_node_whose_link_was_down_for_a_moment_holds_its_name() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    roster.set_connected(A, False, S)
    roster.set_connected(A, True, 20 * S)
    assert roster.admit(B, 20 * S + 1)
    assert roster.admit(B, 40 * S)
    assert roster.holds(A)


def test_a_program_without_a_liveliness_token_holds_its_name_while_it_speaks() -> None:
    roster = SensorRegistry()
    assert roster.admit(A, 0) == ""
    assert roster.admit(B, S)
    assert roster.admit(B, 3 * S) == ""


def test_gaps_are_drops_and_the_rate_is_that_of_late() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    for k in (0, 1, 2, 5, 6):
        roster.arrived(frame(k, k * S // 30), A, k * S // 30)
    health = row(roster, 6 * S // 30)
    assert (health.frames, health.dropped, health.bodies) == (5, 2, 2)
    assert health.rate_hz == pytest.approx(4 / 6 * 30)
    assert (health.stored, health.lost) == (5, 1)
    assert (health.tilt, health.height) == (pytest.approx(0.1), pytest.approx(1.2))


def test_a_number_that_came_before_is_refused_because_a_take_tells_frames_apart_by_it() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    roster.arrived(frame(7), A, 0)
    for again in (7, 3):
        with pytest.raises(WireError, match=f"sequence is {again} after 7"):
            roster.arrived(frame(again, S), A, S)
    roster.arrived(frame(8, S), A, S)
    assert (row(roster, S).frames, row(roster, S).dropped) == (2, 0)


def test_silence_is_noticed_once_and_so_is_the_return() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    roster.arrived(frame(0), A, 0)
    roster.take_notices()
    roster.notice_silence(int(1.9 * S))
    assert roster.take_notices() == []
    assert not row(roster, int(1.9 * S)).silent
    roster.notice_silence(int(2.1 * S))
    roster.notice_silence(int(2.3 * S))
    assert roster.take_notices() == ['sensor "front" has sent nothing for 2 s']
    assert row(roster, int(2.3 * S)).silent
    assert row(roster, int(2.3 * S)).problem == "silent for 2 s"
    roster.arrived(frame(1), A, 3 * S)
    assert roster.take_notices() == ['sensor "front" is back']


def test_latency_is_reckoned_on_one_clock() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    roster.arrived(frame(0), A, 0)
    assert roster.finished(A, sent_ns=5 * S, now_ns=S) is None
    roster.set_clock(A, ClockEstimate(offset_ns=5 * S, bound_ns=100))
    assert roster.finished(A, sent_ns=5 * S + 1, now_ns=3_000_001) == pytest.approx(0.003)
    assert row(roster, 0).latency == pytest.approx(0.003)
    assert row(roster, 0).clock_offset == 5.0


def test_a_rejected_message_is_counted_and_told_once() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    roster.take_notices()
    roster.rejected(A, "of schema version 9")
    roster.rejected(A, "of schema version 9")
    assert row(roster, 0).rejected == 2
    assert row(roster, 0).problem == "of schema version 9"
    assert roster.take_notices() == ['sensor "front": of schema version 9']
    roster.arrived(frame(0), A, 0)
    assert row(roster, 0).problem == ""
    roster.rejected(A, "of schema version 9")
    assert roster.take_notices() == []
    for k in range(100):
        roster.rejected(A, f"nonsense {k}")
    assert len(roster.take_notices()) < 50


def test_the_setup_overrides_what_the_frames_say() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    roster.arrived(frame(0), A, 0)
    setup = Setup(sensors={"front": SensorPose(tilt=-0.2, height=2.0)})
    assert (row(roster, 0, setup).tilt, row(roster, 0, setup).height) == (-0.2, 2.0)


def test_what_a_sensor_sends_is_told() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    assert row(roster, 0).sends == "skeletons"
    image = depth_frame("front", np.ones((2, 2), np.uint16), unit_m=0.001, lens=[2, 2, 1, 1], time_ns=1, node_id=1)
    arms = ArmFrame("front", 1, 1, 2, 2, (2, 2), np.ones(9), "default", ())
    for sent, name in ((image, "depth"), (arms, "arms")):
        roster.arrived(sent, A, 5)
        health = row(roster, 6)
        assert (health.sends, health.bodies, health.pictures) == (name, 0, False)


def test_captures_can_be_brought_to_the_servers_clock_by_what_is_told_of_the_sensor() -> None:
    roster = SensorRegistry()
    roster.set_connected(A, True, 0)
    assert row(roster, 0).capture_offset is None
    for k, latency_ns in enumerate((30_000_000, 10_000_000, 20_000_000)):
        at_ns = roster.arrived(frame(k, time_ns=(k + 1) * S), A, 50 * S + (k + 1) * S + latency_ns)
    offset = row(roster, 60 * S).capture_offset
    assert offset == pytest.approx(50.01, abs=1e-9)
    assert at_ns == pytest.approx(3 * S + 1e9 * offset, abs=2)
