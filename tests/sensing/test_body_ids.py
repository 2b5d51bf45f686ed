"""Ids of one sensor's bodies from frame to frame."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing.body_ids import KEPT_IN_STALLS_S, KEPT_S, BodyIds


def body(x: float) -> np.ndarray:
    joints = np.tile(np.array([x, 0.0, 3.0]), (4, 1))
    joints[:, 1] = np.arange(4) * 0.4
    return joints


@given(st.permutations([0.0, 1.0, 2.0]), st.floats(-0.05, 0.05))
def test_bodies_keep_their_ids_in_any_order(order: list[float], step: float) -> None:
    ids = BodyIds()
    first = ids.update(np.stack([body(x) for x in (0.0, 1.0, 2.0)]), 0.0)
    second = ids.update(np.stack([body(x + step) for x in order]), 1 / 30)
    assert second.tolist() == [first[int(x)] for x in order]


def test_a_body_that_was_gone_for_long_is_a_new_one_and_a_short_gap_is_bridged() -> None:
    ids = BodyIds()
    (first,) = ids.update(body(0.0)[None], 0.0)
    assert ids.update(np.zeros((0, 4, 3)), 0.1).tolist() == []
    assert ids.update(body(0.1)[None], 0.2).tolist() == [first]
    ids.update(np.zeros((0, 4, 3)), 0.3)
    assert ids.update(body(0.1)[None], 0.3 + KEPT_S).tolist() == [first + 1]


@given(st.floats(0.01, KEPT_IN_STALLS_S - 0.01))
def test_a_pause_between_frames_is_not_an_absence(pause_s: float) -> None:
    ids = BodyIds()
    (first,) = ids.update(body(0.0)[None], 0.0)
    assert ids.update(body(0.1)[None], pause_s).tolist() == [first]
    assert ids.update(body(0.1)[None], pause_s + KEPT_IN_STALLS_S + 0.01).tolist() == [first + 1]


def test_a_body_far_away_is_another_one_and_missing_joints_do_not_matter() -> None:
    ids = BodyIds()
    (first,) = ids.update(body(0.0)[None], 0.0)
    hidden = body(0.02)
    hidden[:3] = np.nan
    assert ids.update(np.stack([body(3.0), hidden]), 0.03).tolist() == [first + 1, first]
    ids.reset()
    assert ids.update(body(3.0)[None], 0.06).tolist() == [first + 2]
