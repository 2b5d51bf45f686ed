"""Frames of free-running cameras become instants: each frame once, one a camera, and nobody waits for who is silent."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.topology import topology
from mocapella.tracker.instants import CameraInstant, Instants

MS = 1_000_000


def frame(name: str, at_ms: float) -> KeypointFrame:
    return keypoint_frame(name, topology("halpe_26"), time_ns=round(at_ms * MS), size_px=(640, 480), positions_px=[])


def collected(events: list[tuple[str, float]], cameras: int = 0) -> list[list[CameraInstant]]:
    """The instants that each event (camera, capture time [ms]) completes."""
    instants = Instants(0.3, cameras)
    return [instants.update(frame(name, at_ms), round(at_ms * MS)) for name, at_ms in events]


def names(instants: list[list[CameraInstant]]) -> list[str]:
    return ["".join(one.frames) for some in instants for one in some]


def test_synchronised_cameras_complete_an_instant_with_the_last_frame() -> None:
    events = [(name, 33.0 * k) for k in range(1, 6) for name in "abc"]
    found = collected(events, cameras=3)
    assert names(found) == ["abc"] * 5
    assert [bool(some) for some in found] == [False, False, True] * 5
    assert [one.at_ns for some in found for one in some] == [round(33.0 * k * MS) for k in range(1, 6)]


def test_second_frames_are_together_at_rates_above_that_of_a_camera_nobody_knows() -> None:
    events = [(name, 1000.0 / 60.0 * k) for k in range(1, 5) for name in "abcd"]
    assert names(collected(events, cameras=4)) == ["abcd"] * 4


def test_a_camera_that_stops_delays_the_others_by_one_frame_and_then_not_at_all() -> None:
    events = [(name, 33.0 * k) for k in range(1, 5) for name in "abc"]
    events += [(name, 33.0 * k) for k in range(5, 30) for name in "ab"]
    found = collected(events, cameras=3)
    assert names(found[:12]) == ["abc"] * 4
    assert set(names(found[12:])) == {"ab"}
    assert [bool(some) for some in found[-8:]] == [False, True] * 4
    waited = [k for k in range(12, len(events)) if found[k] and events[k][0] == "a"]
    assert max(waited) < 12 + 2 * 10  # 0.3 s


def test_a_late_frame_joins_the_next_instant() -> None:
    events = [("a", 33), ("b", 33), ("a", 66), ("b", 66), ("a", 99), ("a", 132), ("b", 99), ("a", 165), ("b", 165)]
    instants = [one for some in collected([(name, float(at)) for name, at in events], 2) for one in some]
    late = next(one for one in instants if one.at_ns == 132 * MS)
    assert late.frames["b"].at_ns == 99 * MS
    assert late.frames["a"].at_ns == 132 * MS


def test_a_camera_whose_late_frame_came_is_waited_for_until_its_newer_one() -> None:
    events = [("a", 33), ("b", 33), ("a", 66), ("b", 66), ("a", 99), ("a", 132), ("b", 99), ("b", 132)]
    instants = [one for some in collected([(name, float(at)) for name, at in events], 2) for one in some]
    assert {name: one.at_ns // MS for name, one in instants[-1].frames.items()} == {"a": 132, "b": 132}


def test_a_slow_camera_is_waited_for_only_when_it_is_due() -> None:
    fast = [("a", 20.0 * k) for k in range(1, 60)]
    slow = [("b", 100.0 * k + 5.0) for k in range(1, 12)]
    events = sorted(fast + slow, key=lambda event: event[1])
    found = collected(events)
    at_once = [bool(some) for some, (name, _) in list(zip(found, events, strict=True))[20:] if name == "a"]
    assert sum(at_once) >= 0.7 * len(at_once)


def test_of_the_late_frames_of_a_burst_the_newest_joins_the_next_instant() -> None:
    """A burst after a stall makes no instants of the past, which would correct people by old rays again and again."""
    events = [(name, 33.0 * k) for k in range(1, 4) for name in "ab"] + [("a", 33.0 * k) for k in range(4, 9)]
    events += [("b", 33.0 * k) for k in range(4, 8)]
    instants = [one for some in collected([*events, ("a", 297.0), ("b", 264.0), ("b", 297.0)], 2) for one in some]
    times = [one.at_ns for one in instants]
    assert times == sorted(set(times))
    assert {one.at_ns // MS for instant in instants for one in instant.frames.values() if one.frame.sensor == "b"} == {
        33, 66, 99, 231, 297,
    }  # fmt: skip


@given(st.integers(1, 4), st.permutations(range(4)))
def test_synchronised_cameras_are_together_again_after_an_instant_without_one(stall: int, order: list[int]) -> None:
    """A camera whose frame came after its instant is not one frame behind from then on."""
    events = [("abcd"[i], 33.0 * k) for k in range(1, 5) for i in order]
    late = [(name, at) for name, at in events if name == "d" and at > 33.0 * (4 - stall)]
    events = [one for one in events if one not in late] + [("a", 165.0), ("b", 165.0)] + late
    events += [("c", 165.0), ("d", 165.0)] + [("abcd"[i], 33.0 * k) for k in range(6, 12) for i in order]
    instants = [one for some in collected(events, cameras=4) for one in some]
    for one in instants[-5:]:
        assert len(one.frames) == 4
        assert {frame.at_ns for frame in one.frames.values()} == {one.at_ns}


def test_a_camera_is_present_for_longer_than_it_is_active() -> None:
    instants = Instants(0.3)
    for k in range(40):
        instants.update(frame("a", 33.0 * k), round(33.0 * k * MS))
        if k == 10:
            instants.update(frame("b", 33.0 * k), round(33.0 * k * MS))
    assert (instants.active(), instants.present(2.0), instants.present(0.5)) == (["a"], ["a", "b"], ["a"])


@given(
    periods=st.lists(st.floats(8, 120), min_size=1, max_size=5),
    phases=st.lists(st.floats(0, 100), min_size=5, max_size=5),
    lags=st.lists(st.floats(0, 150), min_size=5, max_size=5),
)
def test_frames_are_in_one_instant_at_most_and_only_late_ones_in_none(
    periods: list[float], phases: list[float], lags: list[float]
) -> None:
    events = []
    for i, period in enumerate(periods):
        events += [(phases[i] + k * period + lags[i], "abcde"[i], phases[i] + k * period) for k in range(1, 20)]
    arrivals = [(name, at_ms) for _, name, at_ms in sorted(events)]
    instants = Instants(0.3, len(periods))
    done, late = [], set()
    for name, at_ms in arrivals:
        at_ns = round(at_ms * MS)
        if instants.newest_ns is not None and at_ns <= instants.newest_ns:
            late.add((name, at_ns))
        done += instants.update(frame(name, at_ms), at_ns)
    used = [(name, one.at_ns) for instant in done for name, one in instant.frames.items()]
    assert len(used) == len(set(used))
    unused = {(name, round(at_ms * MS)) for name, at_ms in arrivals} - set(used)
    assert len(unused - late) <= len(periods)  # the last instant is open
    times = [one.at_ns for one in done]
    assert times == sorted(times)
    assert all(one.at_ns >= max(frame.at_ns for frame in one.frames.values()) for one in done)
    assert all(list(one.frames) == sorted(one.frames) for one in done)
