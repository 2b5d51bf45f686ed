"""Frames of several cameras brought to sets of one instant: laws of what is put together, whatever comes and when."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.model.images import REMEMBERED as IMAGES
from mocapella.model.images import image_frame
from mocapella.model.memory import pack, unpack
from mocapella.model.observations import Arrival
from mocapella.tracker.frame_sync import (
    CLOSED,
    NEARER,
    NOT_NEAREST,
    NOT_RISING,
    REMEMBERED,
    WITHIN,
    FrameSync,
    FrameSyncSettings,
)

PERIOD_NS = 33_000_000
SETTINGS = FrameSyncSettings(period_s=PERIOD_NS / 1e9)
NAMES = ("a", "b", "c")


def comes(camera, at_ns, sequence=0, node_id=0):
    frame = image_frame(camera, None, time_ns=at_ns, sequence=sequence, node_id=node_id)
    return Arrival(frame, at_ns)


def camera(name, count, *, phase=0.0, rate=1.0, late=0.0, jitter=(0.0,), gone=()):
    """(when it comes, the arrival): phase, lateness and jitter in periods; the numbers in ``gone`` never come."""
    found, before_ns = [], 0
    for k in range(count):
        before_ns = max(round((10 + phase + k / rate + jitter[k % len(jitter)]) * PERIOD_NS), before_ns + 1)
        if k not in gone:
            found.append((before_ns + late * PERIOD_NS, comes(name, before_ns, k)))
    return found


def run(cameras, sync=None):
    """All that comes, in its order; (sync, sets, the arrival with which each closed)."""
    coming = [arrival for _, arrival in sorted((one for some in cameras for one in some), key=lambda one: one[0])]
    names = sorted({arrival.frame.sensor for arrival in coming})
    sync = sync or FrameSync(names, SETTINGS)
    found = [(instant, arrival) for arrival in coming for instant in sync.update(arrival)]
    return sync, [instant for instant, _ in found], [arrival for _, arrival in found], coming


def members(instant):
    return {name: arrival.at_ns for name, arrival in instant.frames.items()}


shifts = st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=7)
any_camera = st.builds(
    lambda count, **how: (count, how),
    st.integers(1, 60), phase=st.floats(0, 5), rate=st.floats(0.2, 3), late=st.floats(0, 20), jitter=shifts,
    gone=st.sets(st.integers(0, 60)),
)  # fmt: skip


@given(st.lists(any_camera, min_size=1, max_size=5))
def test_whatever_comes_each_frame_is_used_once_or_dropped_for_a_reason_and_times_rise(cameras):
    sync, sets, _, coming = run([camera(f"c{k}", count, **how) for k, (count, how) in enumerate(cameras)])
    assert sync.used + sync.dropped.total() + sync.waiting == len(coming)
    sets += sync.flush()
    assert sync.waiting == 0
    assert sync.used + sync.dropped.total() == len(coming)
    assert set(sync.dropped) <= {NOT_RISING, CLOSED, NOT_NEAREST}
    used = [arrival.frame.key for instant in sets for arrival in instant.frames.values()]
    assert len(used) == len(set(used)) == sync.used
    assert set(used) <= {arrival.frame.key for arrival in coming}
    for instant in sets:
        times = members(instant).values()
        assert all(name == arrival.frame.sensor for name, arrival in instant.frames.items())
        assert min(times) <= instant.time_ns <= max(times)
    for before, after in pairwise(sets):
        assert after.time_ns > before.time_ns
        for name in before.frames.keys() & after.frames.keys():
            assert after.frames[name].at_ns > before.frames[name].at_ns


presence = st.lists(st.sets(st.sampled_from(NAMES), min_size=1), min_size=1, max_size=30)


@given(presence, st.randoms(use_true_random=False))
def test_cameras_in_step_make_a_set_of_each_instant_in_whatever_order_its_frames_come(instants, rng):
    wanted = [(k * PERIOD_NS, there) for k, there in enumerate(instants)]
    found = []
    for shuffle in (False, True):
        coming = []
        for at_ns, there in wanted:
            order = sorted(there)
            if shuffle:
                rng.shuffle(order)
            coming += [comes(name, at_ns, at_ns // PERIOD_NS) for name in order]
        sync = FrameSync(NAMES, SETTINGS)
        sets = [instant for arrival in coming for instant in sync.update(arrival)] + sync.flush()
        assert not sync.dropped
        found.append([(instant.time_ns, set(instant.frames)) for instant in sets])
    assert found[0] == found[1] == wanted


@given(st.integers(1, 6), st.permutations(NAMES))
def test_a_set_closes_with_the_last_frame_of_cameras_in_step(count, order):
    sync = FrameSync(NAMES, SETTINGS)
    for k in range(count):
        sets = [sync.update(comes(name, k * PERIOD_NS, k)) for name in order]
        assert [len(some) for some in sets] == [0, 0, 1]
        assert members(sets[-1][0]) == dict.fromkeys(NAMES, k * PERIOD_NS)
    assert sync.waiting == 0


def test_a_frame_that_is_missing_is_waited_for_until_the_cameras_next_one_shows_that_it_will_not_come():
    sync = FrameSync(NAMES, SETTINGS)
    assert not any(sync.update(comes(name, 0)) for name in ("a", "b"))
    assert not any(sync.update(comes(name, PERIOD_NS, 1)) for name in ("a", "b"))
    first, second = sync.update(comes("c", PERIOD_NS, 1))
    assert (set(first.frames), set(second.frames)) == ({"a", "b"}, set(NAMES))


@given(st.integers(1, 3 * PERIOD_NS))
@example(3 * PERIOD_NS // 2)
@example(3 * PERIOD_NS // 2 + 1)
def test_a_frame_that_may_be_late_is_waited_for_one_period_and_a_half(passed_ns):
    sync = FrameSync(("a", "b"), SETTINGS)
    assert not sync.update(comes("a", 0))
    sets = sync.update(comes("a", passed_ns, 1))
    assert [members(one) for one in sets] == ([{"a": 0}] if passed_ns > 1.5 * PERIOD_NS else [])


def test_a_camera_that_is_silent_is_missed_for_a_while_and_then_not_waited_for():
    sync, sets, with_which, coming = run([camera("a", 90), camera("b", 90), camera("c", 90, gone=range(20, 60))])
    by_time = {instant.time_ns: (instant, arrival) for instant, arrival in zip(sets, with_which, strict=True)}
    assert sync.dropped == {CLOSED: 1}  # the first after the silence: nobody waited for it
    for arrival in coming:
        instant, closed_by = by_time[arrival.at_ns]
        k = arrival.frame.sequence
        assert set(instant.frames) == ({"a", "b"} if 20 <= k < 61 else set(NAMES))
        # Two periods as long as it may only be late; once it is silent, none.
        waited = (closed_by.at_ns - arrival.at_ns) / PERIOD_NS
        assert waited <= 2
        if not 20 <= k < 20 + 31:
            assert waited == 0
    assert sync.silent == ()
    sync, *_ = run([camera("a", 60), camera("c", 20)])
    assert (sync.silent, sync.heard) == (("c",), ("a",))


@given(st.integers(1, 14))
def test_a_camera_that_comes_late_is_waited_for_once_that_is_known(late):
    late = min(late, int(0.5e9 // PERIOD_NS))
    sync, sets, _, _ = run([camera("a", 80), camera("b", 80, late=late + 0.25)])
    known = [instant for instant in sets if 10 + late + 12 < instant.time_ns / PERIOD_NS < 80]
    assert len(known) > 30
    assert all(set(instant.frames) == {"a", "b"} for instant in known)
    assert set(sync.dropped) <= {CLOSED}


def test_nobody_waits_for_a_camera_that_is_far_too_late():
    far = 0.7e9 / PERIOD_NS
    sync, sets, _, _ = run([camera("a", 80), camera("b", 80, late=far)])
    inner = [instant for instant in sets if 30 < instant.time_ns / PERIOD_NS < 60]
    assert all(set(instant.frames) == {"a"} for instant in inner)
    assert sync.dropped[CLOSED] > 40


@given(st.lists(st.floats(0, 0.999), min_size=2, max_size=6))
def test_cameras_that_are_not_in_step_make_sets_of_the_nearest_frames_of_all(phases):
    sync, sets, _, _ = run([camera(f"c{k}", 60, phase=phase) for k, phase in enumerate(phases)])
    around = sorted(phases)
    gaps = [after - before for before, after in pairwise([*around, around[0] + 1.0])]
    tightest = 1.0 - max(gaps)  # all phases, begun after the widest gap
    for instant in sets[10:]:
        times = members(instant).values()
        span = (max(times) - min(times)) / PERIOD_NS
        if tightest <= WITHIN:
            assert len(times) == len(phases)
            assert span <= tightest + NEARER + 1e-6
        else:
            assert span <= WITHIN + 1e-6
    assert len(sets) >= 45
    assert sync.waiting <= 3 * len(phases)


def test_a_frame_whose_time_does_not_rise_is_dropped_as_is_one_of_a_set_that_is_closed():
    sync = FrameSync(("a", "b"), SETTINGS)
    sync.update(comes("a", 0))
    sync.update(comes("a", 0))
    assert sync.dropped == {NOT_RISING: 1}
    sync.update(comes("a", 2 * PERIOD_NS))
    sync.update(comes("b", 3 * PERIOD_NS))
    sync.update(comes("a", 4 * PERIOD_NS))
    sync.flush()
    sync.update(comes("b", 3 * PERIOD_NS + 5))
    assert sync.dropped == {NOT_RISING: 1, CLOSED: 1}


def test_another_process_of_a_camera_teaches_no_interval_between_both():
    sync = FrameSync(("a",), SETTINGS)
    for k in range(12):
        sync.update(comes("a", k * PERIOD_NS + (k >= 6) * 40 * PERIOD_NS, k % 6, node_id=k // 6))
    assert sync.period_ns == PERIOD_NS


@given(st.lists(any_camera, min_size=2, max_size=4), st.integers(0, 200))
def test_what_a_memory_holds_goes_on_alike(cameras, split):
    made = [camera(f"c{k}", count, **how) for k, (count, how) in enumerate(cameras)]
    whole, _, _, coming = run(made)
    first, second = FrameSync(whole._names, SETTINGS), FrameSync(whole._names, SETTINGS)
    for arrival in coming[:split]:
        first.update(arrival)
    kinds = (*REMEMBERED, *IMAGES)
    second.recall(unpack(pack(first.memory(), kinds), kinds))
    for arrival in coming[split:]:
        told = [[(instant.time_ns, members(instant)) for instant in sync.update(arrival)] for sync in (first, second)]
        assert told[0] == told[1]
    assert (first.used, first.dropped, first.waiting) == (second.used, second.dropped, second.waiting)


def test_images_that_wait_are_the_arrays_that_came():
    image = np.zeros((4, 6, 3), np.uint8)
    sync = FrameSync(("a",))
    (instant,) = sync.update(Arrival(image_frame("a", image, time_ns=1), 1))
    assert instant.frames["a"].frame.data is image


@pytest.mark.parametrize("wrong", [{"period_s": 0.0}, {"silent_after_s": -1.0}])
def test_settings_of_no_sense_are_refused(wrong):
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        FrameSyncSettings(**wrong)
