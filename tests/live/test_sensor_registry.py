"""Who serves which sensor, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.errors import WireError
from mocapella.live.sensor_registry import STOOD_STILL_S, NodeStanding, SensorRegistry
from mocapella.model.arms import ArmFrame
from mocapella.model.depth import depth_frame
from mocapella.model.limits import MOST_SENSORS, MOST_UNPROVEN, UNPROVEN_S
from mocapella.model.observations import BodyFrame, body_frame
from mocapella.model.scene import SensorPlace
from mocapella.model.session import SensorHealth, SensorPose, Setup
from mocapella.model.topology import topology
from mocapella.wire.clock import ClockProbe
from mocapella.wire.keys import NodeKey

A, B = NodeKey("front", 1), NodeKey("front", 2)
S = 1_000_000_000


def frame(sequence: int, time_ns: int = 0, sent_ns: int = 0) -> BodyFrame:
    kind = topology("kinect_v2")
    return body_frame("front", kind, time_ns=time_ns, positions=np.zeros((2, 25, 3)), sequence=sequence,
                      node_id=1, sent_ns=sent_ns, tilt=0.1, height=1.2)  # fmt: skip


def row(registry: SensorRegistry, now_ns: int, setup: Setup | None = None) -> SensorHealth:
    (health,) = registry.health(now_ns, setup or Setup(), {"front": 5}, {"front": 1})
    return health


def test_the_first_node_holds_the_name_and_a_second_is_refused_once_in_words() -> None:
    registry = SensorRegistry()
    assert registry.admit(A, 0) == ""
    registry.set_connected(A, True, 0)
    assert "another node serves the sensor front" in registry.admit(B, S)
    assert registry.admit(B, 100 * S)
    assert [n for n in registry.take_notices() if "refused" in n] == [
        "a second node under the name front was refused (0000000000000002)"
    ]
    assert registry.holds(A)
    assert not registry.holds(B)


def test_a_name_is_free_again_when_its_node_has_left() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    registry.arrived(frame(0), A, 0)
    registry.set_connected(A, False, S)
    assert registry.admit(B, S + 1) == ""  # although it was heard a moment ago: a program that is started again is back
    assert registry.holds(B)
    assert registry.admit(A, S + 2)  # what it had sent before


def test_a_node_whose_link_was_down_for_a_moment_holds_its_name() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    registry.set_connected(A, False, S)
    registry.set_connected(A, True, 20 * S)
    assert registry.admit(B, 20 * S + 1)
    assert registry.admit(B, 40 * S)
    assert registry.holds(A)


def test_a_program_without_a_liveliness_token_holds_its_name_while_it_speaks() -> None:
    registry = SensorRegistry()
    assert registry.admit(A, 0) == ""
    assert registry.admit(B, S)
    assert registry.admit(B, 3 * S) == ""


def test_drops_before_tracking_began_are_counted_and_told_apart() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    for k in (0, 4):
        registry.arrived(frame(k), A, k)
    assert (row(registry, 5).frames_before, row(registry, 5).dropped_before) == (0, 0)
    registry.tracking_began()
    assert (row(registry, 5).frames_before, row(registry, 5).dropped_before) == (2, 3)
    registry.arrived(frame(7), A, 7)  # the gap before it is of the time before
    registry.arrived(frame(9), A, 9)
    health = row(registry, 9)
    assert (health.frames, health.dropped) == (4, 6)
    assert (health.frames_before, health.dropped_before) == (2, 5)


def test_gaps_are_drops_and_the_rate_is_that_of_late() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    for k in (0, 1, 2, 5, 6):
        registry.arrived(frame(k, k * S // 30), A, k * S // 30)
    health = row(registry, 6 * S // 30)
    assert (health.frames, health.dropped, health.bodies) == (5, 2, 2)
    assert health.rate_hz == pytest.approx(4 / 6 * 30)
    assert (health.stored, health.lost) == (5, 1)
    assert (health.tilt, health.height) == (pytest.approx(0.1), pytest.approx(1.2))


def test_a_number_that_came_before_is_refused_because_a_take_tells_frames_apart_by_it() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    registry.arrived(frame(7), A, 0)
    for again in (7, 3):
        with pytest.raises(WireError, match=f"sequence is {again} after 7"):
            registry.arrived(frame(again, S), A, S)
    registry.arrived(frame(8, S), A, S)
    assert (row(registry, S).frames, row(registry, S).dropped) == (2, 0)


def test_silence_is_noticed_once_and_so_is_the_return() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    registry.arrived(frame(0), A, 0)
    registry.take_notices()
    registry.notice_silence(int(1.9 * S))
    assert registry.take_notices() == []
    assert not row(registry, int(1.9 * S)).silent
    registry.notice_silence(int(2.1 * S))
    registry.notice_silence(int(2.3 * S))
    assert registry.take_notices() == ['sensor "front" has sent nothing for 2 s']
    assert row(registry, int(2.3 * S)).silent
    assert row(registry, int(2.3 * S)).problem == "silent for 2 s"
    registry.arrived(frame(1), A, 3 * S)
    assert registry.take_notices() == ['sensor "front" is back']


def test_a_sensor_is_stale_within_a_second_and_a_slow_one_after_three_intervals() -> None:
    registry = SensorRegistry()
    for node, interval in ((A, S // 30), (B._replace(sensor="side"), S)):
        registry.set_connected(node, True, 0)
        for k in range(10):
            registry.arrived(frame_of(node, k), node, 20 * S - (10 - k) * interval)
    registry.take_notices()
    for tenths in range(200, 240):
        registry.notice_silence(tenths * S // 10)
    assert registry.take_notices() == [
        'sensor "front" has sent nothing for 0.8 s', 'sensor "side" has sent nothing for 3 s'
    ]  # fmt: skip


def test_a_server_that_stood_still_itself_waits_for_its_sensors_again() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    for k in range(3):
        registry.arrived(frame(k), A, k * S // 30)
    registry.notice_silence(S // 10)
    registry.take_notices()
    registry.notice_silence(6 * S)
    assert registry.take_notices() == []
    for tenths in range(61, 70):
        registry.notice_silence(tenths * S // 10)
    assert registry.take_notices() == ['sensor "front" has sent nothing for 0.8 s']


@pytest.mark.parametrize("late_ns", [0, 1])
def test_a_server_stood_still_if_it_did_not_look_for_longer_than_half_a_second(late_ns: int) -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    for k in range(3):
        registry.arrived(frame(k), A, k * S // 30)
    registry.notice_silence(S // 2)
    registry.take_notices()
    registry.notice_silence(S + late_ns)
    assert STOOD_STILL_S == 0.5
    assert bool(registry.take_notices()) == (late_ns == 0)


def test_a_server_that_looks_for_the_first_time_has_not_stood_still() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    for k in range(3):
        registry.arrived(frame(k), A, k * S // 30)
    registry.take_notices()
    registry.notice_silence(5 * S)
    assert registry.take_notices() == ['sensor "front" has sent nothing for 0.8 s']


def test_only_a_sensor_without_a_frame_and_without_a_token_is_forgotten_and_not_too_soon() -> None:
    registry = SensorRegistry()
    quiet, connected, proven = nodes(3)
    for node in (quiet, connected, proven):
        registry.admit(node, S, proven=node is proven)
    registry.set_connected(connected, True, S)
    registry.arrived(frame_of(proven), proven, S)
    soon, late = (S + round(UNPROVEN_S * S) + ns for ns in (0, 1))
    registry.notice_silence(soon)
    assert [registry.holds(node) for node in (quiet, connected, proven)] == [True, True, True]
    registry.notice_silence(late)
    assert [registry.holds(node) for node in (quiet, connected, proven)] == [False, True, True]


def test_a_poorly_synchronised_clock_is_marked_and_told_of_once() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    registry.arrived(frame(0), A, 0)
    registry.take_notices()
    registry.compare_clock(A, [ClockProbe(0, S, 30_000_000)], 30_000_000)
    for k in range(3):
        registry.notice_silence(30_000_000 + k)
    said = "poorly synchronised: its clock is known to ±15 ms"
    assert registry.take_notices() == [f'sensor "front" is {said}']
    assert (row(registry, 30_000_000).clock_poor, row(registry, 30_000_000).problem) == (True, said)
    registry.compare_clock(A, [ClockProbe(40_000_000, S + 40_000_000, 41_000_000)], 41_000_000)
    registry.notice_silence(41_000_000)
    assert registry.take_notices() == ['sensor "front" is well synchronised again']
    assert (row(registry, 41_000_000).clock_poor, row(registry, 41_000_000).problem) == (False, "")


def test_latency_is_reckoned_on_one_clock() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    registry.arrived(frame(0), A, 0)
    assert registry.finished(A, sent_ns=5 * S, now_ns=S) is None
    assert registry.compare_clock(B, [ClockProbe(0, 9 * S, 200)], 200) is None  # it does not hold the name
    estimate = registry.compare_clock(A, [ClockProbe(0, 5 * S + 100, 200)], 200)
    assert estimate is not None
    assert estimate.offset == 5.0
    assert registry.finished(A, sent_ns=5 * S + 1, now_ns=3_000_001) == pytest.approx(0.003)
    assert row(registry, 0).latency == pytest.approx(0.003)
    assert row(registry, 200).clock_offset == 5.0
    assert row(registry, 200).clock_bound == pytest.approx(102e-9)  # half, a reading, and the drift
    assert row(registry, S).clock_bound == pytest.approx(1e-3, rel=1e-3)  # nobody asks it any more
    registry.take_notices()
    registry.compare_clock(A, [ClockProbe(S, 70 * S, S + 200)], S + 200)
    assert registry.take_notices() == ['sensor "front": its clock jumped against the server\'s']


def test_a_rejected_message_is_counted_and_told_once() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    registry.take_notices()
    registry.rejected(A, "of schema version 9")
    registry.rejected(A, "of schema version 9")
    assert row(registry, 0).rejected == 2
    assert row(registry, 0).problem == "of schema version 9"
    assert registry.take_notices() == ['sensor "front": of schema version 9']
    registry.arrived(frame(0), A, 0)
    assert row(registry, 0).problem == ""
    registry.rejected(A, "of schema version 9")
    assert registry.take_notices() == []
    for k in range(100):
        registry.rejected(A, f"nonsense {k}")
    assert len(registry.take_notices()) < 50


def test_the_setup_overrides_what_the_frames_say() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    registry.arrived(frame(0), A, 0)
    setup = Setup(sensors={"front": SensorPose(tilt=-0.2, height=2.0)})
    assert (row(registry, 0, setup).tilt, row(registry, 0, setup).height) == (-0.2, 2.0)


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (None, ""),
        (SensorPlace("side", np.eye(4), quality="3 mm, 0.1°", problem="was it moved?"), ""),
        (SensorPlace("front", None, problem="walk about"), "walk about"),
        (SensorPlace("front", np.eye(4), quality="3 mm, 0.1°"), "3 mm, 0.1°"),
        (SensorPlace("front", np.eye(4), quality="3 mm, 0.1°", problem="was it moved?"), "was it moved?"),
    ],
)
def test_what_is_wrong_with_a_calibration_is_told_before_how_good_it_is(place: SensorPlace | None, said: str) -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    (health,) = registry.health(0, Setup(), {}, {}, [] if place is None else [place])
    assert health.calibration == said


def test_what_a_sensor_sends_is_told() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    assert row(registry, 0).sends == "skeletons"
    image = depth_frame("front", np.ones((2, 2), np.uint16), unit_m=0.001, lens=[2, 2, 1, 1], time_ns=1, node_id=1)
    arms = ArmFrame("front", 1, 1, 2, 2, (2, 2), np.ones(9), "default", ())
    for sent, name in ((image, "depth"), (arms, "arms")):
        registry.arrived(sent, A, 5)
        health = row(registry, 6)
        assert (health.sends, health.bodies, health.pictures) == (name, 0, False)


def test_captures_can_be_brought_to_the_servers_clock_by_what_is_told_of_the_sensor() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    assert row(registry, 0).capture_offset is None
    for k, latency_ns in enumerate((30_000_000, 10_000_000, 20_000_000)):
        at_ns = registry.arrived(frame(k, time_ns=(k + 1) * S), A, 50 * S + (k + 1) * S + latency_ns)
    offset = row(registry, 60 * S).capture_offset
    assert offset == pytest.approx(50.01, abs=1e-9)
    assert at_ns == pytest.approx(3 * S + 1e9 * offset, abs=2)


def nodes(count: int) -> list[NodeKey]:
    return [NodeKey(f"x{k}", k + 1) for k in range(count)]


def frame_of(node: NodeKey, sequence: int = 0) -> BodyFrame:
    kind = topology("kinect_v2")
    return body_frame(node.sensor, kind, time_ns=sequence, positions=[], sequence=sequence, node_id=node.node_id)


def test_nothing_is_kept_of_a_stranger() -> None:
    registry = SensorRegistry()
    for node in nodes(20_000):
        assert registry.standing(node, 0) is NodeStanding.STRANGER
    assert registry.health(0, Setup(), {}, {}) == []
    assert registry.take_notices() == []


def test_sensors_without_a_valid_frame_are_few_and_are_forgotten_and_proven_ones_stay() -> None:
    registry = SensorRegistry()
    registry.admit(A, 0, proven=True)
    registry.arrived(frame(0), A, 0)
    for k, node in enumerate(nodes(1000)):
        assert registry.admit(node, k, quiet=True) == ""
    rows = registry.health(1000, Setup(), {}, {})
    assert len(rows) == 1 + MOST_UNPROVEN
    assert registry.take_notices() == ['sensor "front" is here']
    assert [health.name for health in registry.health(int((UNPROVEN_S + 1) * S), Setup(), {}, {})] == ["front"]


def test_a_node_finds_a_seat_by_its_first_valid_frame_though_tokens_have_taken_the_others() -> None:
    registry = SensorRegistry()
    for node in nodes(5000):
        registry.set_connected(node, True, 0)
    assert len(registry.health(0, Setup(), {}, {})) == MOST_UNPROVEN
    assert registry.turned_away == 5000 - MOST_UNPROVEN
    assert registry.join(A, 1) == ""
    assert not registry.holds(A)
    assert registry.admit(A, 2, proven=True) == ""
    registry.arrived(frame(0), A, 2)
    assert registry.holds(A)


def test_there_is_a_largest_number_of_sensors_and_only_one_that_is_gone_gives_way() -> None:
    registry = SensorRegistry()
    some = nodes(MOST_SENSORS + 1)
    for node in some:
        registry.set_connected(node, True, 0)
        registry.admit(node, 0, proven=True)
        if node is not some[-1]:
            registry.arrived(frame_of(node), node, 0)
    with pytest.raises(WireError, match="there are 64 sensors already"):
        registry.arrived(frame_of(some[-1]), some[-1], 0)
    registry.set_connected(some[3], False, 0)
    registry.arrived(frame_of(some[-1]), some[-1], 5 * S)
    assert registry.holds(some[-1])
    assert not registry.holds(some[3])


def test_frames_for_which_the_tracker_was_too_slow_are_told_apart() -> None:
    registry = SensorRegistry()
    registry.set_connected(A, True, 0)
    registry.arrived(frame(0), A, 0)
    registry.fell_behind(A, 3)
    registry.fell_behind(B, 9)
    assert row(registry, 0).behind == 3
