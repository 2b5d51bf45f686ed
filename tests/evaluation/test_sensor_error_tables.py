"""The tables of the measured sensor errors: each figure is the one that the views were made with."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.evaluation_sessions import body

from mocapella.evaluation.facing_sessions import AlignedViews
from mocapella.evaluation.labelled_views import LabelledViews
from mocapella.evaluation.sensor_errors import (
    SHARPER,
    _alpha_share,
    _by_distance,
    _joint_lost,
    _lengths,
    _losses,
    _statement,
    _weights,
    _yaw_tables,
    told_apart,
)
from mocapella.geometry.angles import wrap
from mocapella.model.session import SCENARIOS
from mocapella.sources.simulate.body import BODY

STATIONARY, STEPS, WALK = (SCENARIOS[name] for name in ("stationary", "steps", "walk"))
MIDDLES_DEG = np.arange(7.5, 180, 15)


def views(
    task: Any = WALK,
    alpha: Any = 0.0,
    reported: Any = 0.0,
    mirrored: Any = False,
    *,
    positions: Any = None,
    places: Any = ((0, 0, 0), (0, 0, 0)),
    frames: int = 100,
) -> LabelledViews:
    """Two views of a person at 30 Hz; what is given for one frame or view is so in all."""
    shape = (frames, 2)
    seen = np.broadcast_to(body() if positions is None else positions, (*shape, 25, 3))
    zeros, at_s = np.zeros(shape), np.arange(frames)[:, None] / 30 + np.zeros(shape)
    raw = AlignedViews(at_s, np.broadcast_to(task, frames), seen, seen, np.array(places, dtype=np.float64), zeros)
    of_frame = (np.broadcast_to(values, shape) for values in (alpha, reported, mirrored))
    return LabelledViews("45", 3, raw, *of_frame, seen, np.zeros((*shape, 25), dtype=bool))


def turning(side: Any, share: Any, sd_deg: float, each: int = 400) -> LabelledViews:
    """As often at each of the facings `MIDDLES_DEG`, whose labels are mirrored so often and whose yaw scatters so."""
    alpha = np.radians(np.repeat(MIDDLES_DEG, each)) * side
    order = np.random.default_rng(0).permutation(each)
    mirrored = np.concatenate([order < part * each for part in share])
    yaw = alpha + np.where(mirrored, np.pi, 0.0) + np.random.default_rng(1).normal(0, np.radians(sd_deg), len(alpha))
    given = (np.stack([values] * 2, axis=1) for values in (alpha, wrap(yaw), mirrored))
    return views(WALK, *given, frames=len(alpha))


def test_reported_yaws_scatter_about_the_facing_as_they_were_made_on_either_side() -> None:
    share = np.full(12, 0.5)
    table = _yaw_tables([turning(1, share, 1.0), turning(-1, share, 1.0)])
    assert table["alpha_deg"] == [0.0, *MIDDLES_DEG, 180.0]
    assert table["yaw_deg"] == pytest.approx([0.0, *MIDDLES_DEG, MIDDLES_DEG[-1]], abs=1.0)
    mirrored = np.array([MIDDLES_DEG[0], *MIDDLES_DEG, 180.0]) - 180
    assert table["mirrored_yaw_deg"] == pytest.approx(mirrored, abs=1.0)
    for name in ("yaw_sd_deg", "mirrored_yaw_sd_deg"):
        assert table[name] == pytest.approx(np.full(14, 1.0), rel=0.25)


def test_shares_of_mirrored_labels_are_sharpened_about_one_half_and_alike_both_ways() -> None:
    share = np.array([0.0, 0.02, 0.16, 0.2, 0.3, 0.5, 0.5, 0.7, 0.8, 0.84, 0.98, 1.0])
    found = np.array(_yaw_tables([turning(1, share, 1.0)])["mirrored"])
    assert (found[0], found[-1]) == (found[1], found[-2]) == (0.0, 1.0)
    assert found[6] == found[7] == 0.5
    assert found == pytest.approx(1 - found[::-1], abs=1e-9)
    assert (np.diff(found[1:-1]) >= 0).all()
    # One standard deviation of a normal distribution, 84.1 %, becomes two, 97.7 %.
    assert SHARPER == 2
    assert found[10] == pytest.approx(0.977, abs=0.002)


@pytest.mark.parametrize(("count", "own"), [(29, False), (30, True)])
def test_thirty_frames_at_a_facing_are_enough_for_a_yaw_of_its_own(count: int, own: bool) -> None:
    """With fewer, it is between its neighbours'."""
    many = turning(1, np.zeros(12), 0.0, each=60)
    there = np.radians(MIDDLES_DEG[4])
    few = views(WALK, [there, 0.2], [there + np.radians(5), 0.2], frames=count)
    without = msgspec.structs.replace(many, raw=msgspec.structs.replace(many.raw, task=_but(many, 4)))
    mirrored = views(WALK, 2.0, wrap(2.0 + np.pi), True, frames=30)
    found = _yaw_tables([without, few, mirrored])["yaw_deg"][1 + 4]
    assert found == pytest.approx(MIDDLES_DEG[4] + (5 if own else 0), abs=0.2)


def _but(view: LabelledViews, which: int) -> np.ndarray:
    """The tasks, with another one where the facing is that of `MIDDLES_DEG`."""
    there = np.isclose(np.degrees(view.alpha[:, 0]), MIDDLES_DEG[which])
    return np.where(there, STATIONARY, view.raw.task)


facings = st.lists(st.floats(-179, 179), min_size=1, max_size=40).map(np.radians)


@given(facings)
def test_frames_weigh_together_what_their_facing_should_count(alpha: np.ndarray) -> None:
    wanted = _alpha_share([np.radians(np.arange(-165.0, 180, 30) + 1.0), np.radians([10.0, 20.0])])
    assert wanted == pytest.approx(np.full(12, 0.5 / 12) + np.where(np.arange(12) == 6, 0.5, 0.0))
    there = _alpha_share([alpha])
    assert there.sum() == pytest.approx(1)
    weight = _weights(alpha, wanted.tolist())
    assert weight.sum() / len(alpha) == pytest.approx(wanted[there > 0].sum())
    assert _weights(alpha, there.tolist()) == pytest.approx(np.ones(len(alpha)))


def session(gap_s: float, others: int, *, two_people: bool = False) -> Any:
    """A minute of two sensors at 20 Hz; the second pauses, between two frames of the first, which has so many then."""
    first = np.arange(0, 60, 0.05)
    second = np.r_[np.arange(0, 30 + 0.01, 0.05), np.arange(30 + gap_s, 60, 0.05)]
    between = 30 + gap_s * np.arange(1, others + 1) / (others + 1)
    first = np.r_[first[first < 30 + 1e-6], between, first[first > 30 + gap_s - 1e-6]]
    at_s, sensor = np.r_[first, second], np.repeat([0, 1], [len(first), len(second)])
    return SimpleNamespace(
        two_people=two_people, at_s=at_s, sensor=sensor, replay=SimpleNamespace(sensors=("front", "side"))
    )


def test_a_sensor_loses_whom_the_other_one_sees_meanwhile_at_least_thrice() -> None:
    for others, lost in ((2, []), (3, [0.5])):
        gaps, _ = _losses([session(0.5, others)])
        assert [gap for gap in gaps if gap > 0.4] == pytest.approx(lost)
    assert _losses([session(0.1, 9)])[0] == []
    assert _losses([session(0.5, 9, two_people=True)]) == ([], 0.0)


def test_minutes_are_those_of_both_sensors_of_which_a_gap_counts_a_second() -> None:
    for gap_s, missing_s in ((0.5, 0.0), (6.0, 5.0)):
        of = session(gap_s, 60)
        _, minutes = _losses([of, of])
        assert 60 * minutes == pytest.approx(2 * (2 * 60 - missing_s), abs=0.5)


def test_the_share_of_lost_joints_is_of_sessions_with_two_people() -> None:
    def of(lost: int, two_people: bool) -> Any:
        positions = np.zeros((4, 25, 3))
        positions.reshape(-1, 3)[:lost] = np.nan
        return SimpleNamespace(two_people=two_people, log=SimpleNamespace(positions=positions))

    assert _joint_lost([of(7, True), of(99, False), of(3, True)]) == pytest.approx(10 / 200)
    assert _joint_lost([of(99, False)]) == 0


def shaking(frames: int, by_m: float, away_m: float) -> np.ndarray:
    """(frames, 1, 25, 3) a person so far along x, whose joints jump to and fro: the second difference is twice that."""
    turns = np.where(np.arange(frames) % 2, 0.5, -0.5)[:, None, None, None]
    middle = body().mean(axis=0) * [1, 0, 1]
    return np.asarray(body() - middle + [away_m, 0.5, 0.0] + turns * [0.0, 0.0, by_m])


def test_jitter_by_distance_is_of_those_who_face_the_sensor_and_do_not_walk() -> None:
    """The distance is along the floor, from the sensor's own place; only the first sensor is faced."""
    faced = {"alpha": [0.7, 0.9], "places": [(1.0, 2.0, 0.0), (9.0, 0.0, 0.0)], "frames": 700}
    near = views(STEPS, positions=shaking(700, 0.002, 2.6), **faced)
    far = views(STATIONARY, positions=shaking(700, 0.003, 3.4), **faced)
    walks = views(WALK, positions=shaking(700, 0.004, 4.2), **faced)
    assert _by_distance([near, far, walks]) == {"1.4-1.8": 4.0, "2.2-2.6": 6.0}


@pytest.mark.parametrize(("frames", "told"), [(501, False), (502, True)])
def test_jitter_at_a_distance_is_told_from_five_hundred_frames_on(frames: int, told: bool) -> None:
    """The first and the last have no second difference."""
    positions = shaking(frames, 0.002, 1.6)
    found = _by_distance([views(STEPS, [0.0, 2.0], positions=positions, frames=frames)])
    assert found == ({"1.4-1.8": 4.0} if told else {})


def test_label_swaps_are_counted_per_minute_of_a_sensor_in_walk() -> None:
    frames = 2 * 30 * 15 + 1  # a quarter of a minute stands, a quarter walks
    task = np.where(np.arange(frames) < frames // 2, STATIONARY, WALK)
    mirrored = np.zeros((frames, 2), bool)
    mirrored[frames // 4 : frames // 3] = True  # while standing
    mirrored[600:620, 0] = mirrored[700:, 1] = True
    told = _statement([views(task, mirrored=mirrored, frames=frames)], [np.zeros((frames, 25, 3))], [0.3], 4.26, [])
    assert told["label_swaps_per_min"] == pytest.approx(3 / (2 * 0.25), abs=0.02)
    assert (told["walk_frames"], told["sessions"], told["participants"]) == (frames - frames // 2, 1, [3])
    assert (told["sensor_minutes"], told["losses"], told["two_person_sessions"]) == (4.3, 1, 0)


def test_jitter_by_joint_is_of_those_who_stand() -> None:
    frames = 60
    positions = np.broadcast_to(body(), (frames, 1, 25, 3)).copy()
    turns = np.where(np.arange(frames) % 2, 0.5, -0.5)[:, None]
    positions[:, 0, :, 1] += turns * 0.001 * np.arange(25)
    task = np.where(np.arange(frames) < 30, STATIONARY, WALK)
    positions[30:] += np.random.default_rng(0).normal(size=positions[30:].shape)
    told = _statement([views(task, positions=positions, frames=frames)], [np.zeros((frames, 25, 3))], [], 1.0, [])
    assert told["jitter_mm_by_joint"] == pytest.approx(dict(zip(BODY.joints, 2.0 * np.arange(25), strict=True)))


def lengths(*sizes: tuple[int, float]) -> np.ndarray:
    """(frames, 2, 6) lengths of a person whose size changes: so many frames of each."""
    return np.concatenate([np.full((count, 2, 6), 0.25 * size) for count, size in sizes])


def test_lengths_are_of_those_who_move() -> None:
    task = np.where(np.arange(60) < 30, STATIONARY, np.where(np.arange(60) < 45, STEPS, WALK))
    positions = np.where(task == STATIONARY, 1.0, 1.2)[:, None, None, None] * body()
    found = _lengths(views(task, positions=positions, frames=60))
    still = _lengths(views(STEPS, positions=np.tile(body(), (30, 1, 1, 1)), frames=30))
    assert found.shape[:2] == (30, 2)
    np.testing.assert_allclose(found, 1.2 * still)


def test_another_session_of_a_person_is_compared_with_other_people_and_not_with_itself() -> None:
    """Here the stranger's size is between those of the person's two sessions."""
    sizes = [(0, lengths((40, 1.0))), (1, lengths((40, 1.25))), (0, lengths((40, 1.75)))]
    told = told_apart(sizes, near=0.0)
    assert (told["same_nearer_percent"], told["other_session_nearer_percent"]) == (100.0, 0.0)
    assert (told["same_near_percent"], told["other_session_near_percent"]) == (100.0, 0.0)


def test_every_third_whole_window_of_half_a_minutes_frames_is_compared() -> None:
    """What is between the windows, and the rest at the end, would be taken for the stranger."""
    changing = lengths((30, 1.0), (60, 1.3), (30, 1.0), (60, 1.3), (20, 1.3))
    mean = changing.mean() / 0.25
    assert 1.0 < mean < 1.25
    told = told_apart([(0, changing), (1, lengths((31, 1.31)))], near=1e9)
    assert told["same_nearer_percent"] == 100
    later = told_apart([(0, changing[31:]), (1, lengths((31, 1.31)))], near=1e9)
    assert later["same_nearer_percent"] < 100


def test_nobody_is_nearer_to_who_is_exactly_alike_and_who_is_just_as_near_is_near() -> None:
    same = lengths((40, 1.0))
    told = told_apart([(0, same), (0, same), (1, same)], near=0.0)
    assert told == {
        "same_nearer_percent": 0.0, "other_session_nearer_percent": 0.0, "same_near_percent": 100.0,
        "other_session_near_percent": 100.0, "other_person_near_percent": 100.0,
    }  # fmt: skip
