"""Pictures of one instant from cameras that are not in step: laws of what is put together, whatever comes and when."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.sources.newest_instant import FEWEST, LATEST_S, LONGEST, NEARER, NewestInstant
from mocapella.sources.picture_source import Picture

PERIOD_NS = 33_000_000
IMAGE = np.zeros((2, 2, 3), np.uint8)
STEP_S = PERIOD_NS / 1e9 / 20


@dataclass(frozen=True)
class Comes:
    """A camera's picture: which, of when, and when it is there [s]."""

    camera: str
    number: int
    time_ns: int
    ready_s: float


def camera(name, count, *, phase=0.0, rate=1.0, late=0.0, jitter=(), gone=()):
    """Pictures of a camera: phase, lateness and jitter in periods; the numbers in ``gone`` never come."""
    found, before_ns = [], 0
    for k in range(count):
        shift = jitter[k % len(jitter)] if jitter else 0.0
        before_ns = max(round((10 + phase + k / rate + shift) * PERIOD_NS), before_ns + 1)
        found.append(Comes(name, k, before_ns, before_ns / 1e9 + late * PERIOD_NS / 1e9))
    return [one for one in found if one.number not in gone]


@dataclass(frozen=True)
class Taken:
    """What was taken, when [s], the newest that had come of each camera by then, and that was to be given by then."""

    now_s: float
    period_ns: float
    instant: object
    newest: dict[str, int]
    given: dict[str, int]


def run(cameras, busy_s=()):
    """Everything comes when it is there; whoever takes looks often, and is busy for some time after each."""
    coming = sorted((one for camera in cameras for one in camera), key=lambda one: one.ready_s)
    together = NewestInstant(dict.fromkeys(one.camera for one in coming), PERIOD_NS)
    taken, came, at, free_s = [], {}, 0, 0.0
    for now_s in np.arange(coming[0].ready_s, coming[-1].ready_s + 5 * PERIOD_NS / 1e9, STEP_S).tolist():
        while at < len(coming) and coming[at].ready_s <= now_s:
            one, at = coming[at], at + 1
            together.add(one.camera, Picture(IMAGE, one.time_ns, one.number, one.ready_s, 0.0))
            came.setdefault(one.camera, []).append(one)
        if now_s >= free_s and (found := together.take(now_s)) is not None:
            newest = {name: ones[-1].number for name, ones in came.items()}
            late_s = 0.0 if together.held_ns is None else together.held_ns / 1e9
            given = {
                name: max((one.number for one in ones if one.time_ns / 1e9 + late_s <= now_s - STEP_S), default=-1)
                for name, ones in came.items()
            }
            taken.append(Taken(now_s, together.period_ns, found, newest, given if late_s else newest))
            free_s = now_s + (busy_s[len(taken) % len(busy_s)] if busy_s else 0.0)
    return together, taken, coming


shifts = st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=7)
any_camera = st.builds(
    lambda count, **how: (count, how),
    st.integers(1, 60),
    phase=st.floats(0, 5),
    rate=st.floats(0.2, 3),
    late=st.floats(0, 2),
    jitter=shifts,
    gone=st.sets(st.integers(0, 60)),
)
busy = st.lists(st.floats(0, 0.15), max_size=5)


@pytest.mark.slow
@settings(max_examples=25)
@given(st.lists(any_camera, min_size=1, max_size=5), busy)
def test_whatever_comes_pictures_of_a_frame_are_near_new_and_used_once(cameras, busy_s):
    made = [camera(f"c{k}", count, **how) for k, (count, how) in enumerate(cameras)]
    assume(any(made))
    together, taken, coming = run(made, busy_s)
    used = [(name, one.number) for frame in taken for name, one in frame.instant.pictures.items()]
    assert len(used) == len(set(used))
    for frame in taken:
        assert frame.instant.pictures
        for name, one in frame.instant.pictures.items():
            assert abs(one.time_ns - frame.instant.time_ns) <= frame.period_ns / 2 + 1
            assert frame.given[name] <= one.number <= frame.newest[name]  # the newest wins, of those not held back
    for before, after in pairwise(taken):
        assert after.instant.time_ns - before.instant.time_ns >= after.period_ns / 2
    came = dict.fromkeys(together.dropped, 0)
    for one in coming:
        came[one.camera] += 1
    for name, count in together.dropped.items():
        left = came[name] - count - sum(camera == name for camera, _ in used)
        assert left >= 0
        assert left <= 1 or together.held_ns is not None  # one may be there that nobody took


@settings(max_examples=25)
@given(st.lists(any_camera, min_size=1, max_size=5))
def test_nothing_that_could_be_taken_waits_for_long(cameras):
    made = [camera(f"c{k}", count, **{**how, "late": 0.0}) for k, (count, how) in enumerate(cameras)]
    assume(any(made))
    _, taken, _ = run(made)
    for before, after in pairwise(taken):
        # Times rise by half a period; what is of a later instant than that waits no longer than `LONGEST`.
        later_s = [
            one.ready_s
            for camera in made
            for one in camera
            if one.time_ns >= before.instant.time_ns + after.period_ns and one.ready_s > before.now_s
        ]
        allowed_s = min(later_s, default=np.inf)
        longest_ns = max(before.period_ns, after.period_ns, PERIOD_NS)  # it is measured on the way
        assert after.now_s <= allowed_s + (LONGEST * longest_ns + PERIOD_NS) / 1e9


def steady(phases, jitter=(0.0,), late=(0.0,)):
    return [
        camera(f"c{k}", 40, phase=phase, jitter=jitter[k % len(jitter) :], late=late[k % len(late)])
        for k, phase in enumerate(phases)
    ]


@given(st.lists(st.floats(0, 1), min_size=2, max_size=6), busy)
def test_of_steady_cameras_every_frame_has_all(phases, busy_s):
    _, taken, _ = run(steady(phases), busy_s)
    assert taken
    inner = [frame for frame in taken if all(number < 39 for number in frame.newest.values())]
    assert all(len(frame.instant.pictures) == len(phases) for frame in inner)


@pytest.mark.slow
@settings(max_examples=25)
@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 14)), min_size=2, max_size=5), st.floats(0, 0.1))
def test_of_cameras_that_are_steadily_late_every_frame_has_all_and_none_waits_for_longer_than_that(cameras, jitter):
    jitters = (0.0, jitter, -jitter)
    made = [camera(f"c{k}", 80, phase=phase, late=late, jitter=jitters) for k, (phase, late) in enumerate(cameras)]
    _, taken, _ = run(made)
    latest = max(late for _, late in cameras)
    known = [frame for frame in taken if 60 * PERIOD_NS < frame.instant.time_ns < 80 * PERIOD_NS]
    assert len(known) >= 18
    for frame in known:
        assert len(frame.instant.pictures) == len(cameras)
        assert frame.now_s - frame.instant.time_ns / 1e9 <= (latest + LONGEST + 1) * PERIOD_NS / 1e9


def test_a_camera_that_is_late_is_told_by_how_much_and_nobody_waits_once_it_is_gone_or_for_one_that_is_too_late():
    late = camera("c1", 120, late=4.0, gone=range(60, 120))
    together, taken, _ = run([camera("c0", 120), late])
    with_both = [frame for frame in taken if 30 * PERIOD_NS < frame.instant.time_ns < 65 * PERIOD_NS]
    assert all(len(frame.instant.pictures) == 2 for frame in with_both)
    after = [frame for frame in taken if frame.instant.time_ns > 100 * PERIOD_NS]
    assert all(frame.now_s - frame.instant.time_ns / 1e9 < 2 * PERIOD_NS / 1e9 for frame in after)
    assert together.held_ns is None
    assert together.late_ns() == pytest.approx({"c0": 0.0, "c1": 4 * PERIOD_NS}, abs=1000)
    too_late = 1.1 * LATEST_S * 1e9 / PERIOD_NS
    together, taken, _ = run([camera("c0", 120), camera("c1", 120, late=too_late)])
    assert together.held_ns is None
    inner = [frame for frame in taken if 50 * PERIOD_NS < frame.instant.time_ns < 100 * PERIOD_NS]
    assert all(set(frame.instant.pictures) == {"c0"} for frame in inner)
    assert together.late_ns()["c1"] == pytest.approx(too_late * PERIOD_NS, abs=1000)


@given(st.lists(st.floats(0, 1), min_size=2, max_size=5))
def test_of_steady_cameras_the_nearest_pictures_are_taken(phases):
    _, taken, _ = run(steady(phases))
    around = sorted(phase % 1.0 for phase in phases)
    gaps = [after - before for before, after in pairwise([*around, around[0] + 1.0])]
    tightest = 1.0 - max(gaps)  # all phases, begun after the widest gap
    for frame in taken[3:-3]:
        times = [one.time_ns for one in frame.instant.pictures.values()]
        assert (max(times) - min(times)) / PERIOD_NS <= tightest + NEARER + 1e-6


def test_a_frame_a_period_where_nobody_is_busy():
    _, taken, _ = run(steady([0.0, 0.4, 0.7]))
    gaps = [after.instant.time_ns - before.instant.time_ns for before, after in pairwise(taken[2:-2])]
    assert len(gaps) > 30
    assert gaps == pytest.approx([PERIOD_NS] * len(gaps), abs=2)


def test_a_camera_that_stops_is_missing_and_holds_nobody_up():
    stops = camera("c1", 60, phase=0.3, gone=range(20, 40))
    together, taken, _ = run([camera("c0", 60), stops, camera("c2", 60, phase=0.5)])
    missing = [frame for frame in taken if 10 * PERIOD_NS + 22 * PERIOD_NS < frame.instant.time_ns < 49 * PERIOD_NS]
    assert len(missing) >= 15  # at the others' rate
    assert all(set(frame.instant.pictures) == {"c0", "c2"} for frame in missing)
    later = [frame for frame in taken if 52 * PERIOD_NS < frame.instant.time_ns < 68 * PERIOD_NS]
    assert all(set(frame.instant.pictures) == {"c0", "c1", "c2"} for frame in later)
    assert len(later) >= 14
    assert together.dropped["c0"] <= 3


def test_at_first_all_are_waited_for_unless_nothing_more_will_come():
    for now_s, there in ((0.01, False), (LONGEST * PERIOD_NS / 1e9 + 0.02, True), (np.inf, True)):
        together = NewestInstant(("a", "b"), PERIOD_NS)
        together.add("a", Picture(IMAGE, PERIOD_NS, 0, 0.0, 0.0))
        assert now_s == np.inf or together.take(0.0) is None
        assert (together.take(now_s) is not None) == there


def test_the_period_is_that_of_most_cameras_and_counts_what_nobody_had():
    together = NewestInstant(("a", "b", "c"), 1.0)
    for name, period, step in (("a", 10, 1), ("b", 20, 3), ("c", 50, 1)):
        for k in range(8):
            together.add(name, Picture(IMAGE, k * step * period + 1, k * step, 0.0, 0.0))
    assert together.period_ns == 20
    assert together.dropped == {"a": 7, "b": 7, "c": 7}
    together.begin()
    assert together.dropped == {"a": 0, "b": 0, "c": 0}
    assert not together.pending
    assert together.take(1e9) is None


def test_a_period_is_above_zero():
    with pytest.raises(SettingsError, match="period_ns"):
        NewestInstant(("a",), 0.0)


def test_at_the_end_images_too_near_the_last_frame_are_dropped_and_counted():
    together = NewestInstant(["a", "b"], PERIOD_NS)
    for name, k in (("a", 10), ("b", 10)):
        together.add(name, Picture(IMAGE, k * PERIOD_NS, 0, k * PERIOD_NS / 1e9, 0.0))
    assert together.take(float("inf")) is not None
    late_ns = round(10.3 * PERIOD_NS)
    together.add("a", Picture(IMAGE, late_ns, 1, late_ns / 1e9, 0.0))
    assert together.take(float("inf")) is None
    assert together.dropped == {"a": 0, "b": 0}
    together.drop_rest()
    assert together.dropped == {"a": 1, "b": 0}
    assert not together.pending


LONG_S = 0.25
"""A period whose multiples are exact in seconds, so that latencies may be exactly at a limit."""
BOTH_NS = 100_000_000
"""Latency that both cameras have."""


def with_latency(together, first, latency_ns, count=20):
    """Two cameras' next images; "b" has so much more latency than "a"."""
    for number in range(first, first + count):
        ready_s = 100 + LONG_S * number
        for name, late_ns in (("a", 0), ("b", latency_ns)):
            together.add(name, Picture(IMAGE, round(1e9 * ready_s) - BOTH_NS - late_ns, number, ready_s, 0.0))
        together.take(ready_s)


def test_a_camera_is_late_from_more_than_one_period_until_it_is_no_more_than_half_of_one():
    period_ns = round(1e9 * LONG_S)
    for before, latency_ns, late in (
        (0, period_ns, False),
        (0, period_ns + 1, True),
        (period_ns + 1, period_ns, True),
        (period_ns + 1, period_ns // 2 + 1, True),
        (period_ns + 1, period_ns // 2, False),
    ):
        together = NewestInstant(("a", "b"), period_ns)
        with_latency(together, 0, before)
        with_latency(together, 20, latency_ns)
        assert together.period_ns == period_ns
        assert together.held_ns == (BOTH_NS + latency_ns if late else None)


def test_others_wait_for_the_longest_latency_that_is_allowed_and_for_no_longer():
    most_ns = round(1e9 * LATEST_S)
    for latency_ns, held_ns in ((most_ns, BOTH_NS + most_ns), (most_ns + 1, None)):
        together = NewestInstant(("a", "b"), 1e9 * LONG_S)
        with_latency(together, 0, latency_ns)
        assert together.late_ns() == {"a": 0.0, "b": latency_ns}
        assert together.held_ns == held_ns


def test_a_held_image_is_given_as_soon_as_it_is_as_old_as_those_of_the_late_camera():
    together = NewestInstant(("a", "b"), 1e9 * LONG_S)
    with_latency(together, 0, round(2e9 * LONG_S))
    camera = together._cameras["a"]
    held = camera.held[0]
    due_s = (held.time_ns + BOTH_NS) / 1e9 + 2 * LONG_S
    together.take(due_s - 1e-6)
    assert camera.held[0] is held
    together.take(due_s)
    assert camera.last is held


def test_period_and_latency_are_known_after_so_few_intervals_and_no_fewer():
    together = NewestInstant(["a"], PERIOD_NS)
    for intervals in range(2 * FEWEST):
        time_ns = 2 * PERIOD_NS * intervals
        together.add("a", Picture(IMAGE, time_ns, intervals, time_ns / 1e9, 0.0))
        known = intervals >= FEWEST
        assert together.period_ns == (2 * PERIOD_NS if known else PERIOD_NS)
        assert list(together.late_ns()) == (["a"] if known else [])
