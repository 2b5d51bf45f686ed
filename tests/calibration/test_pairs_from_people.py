"""Pairs of sensors that people calibrate: which sensor was moved, as far as the other pairs tell."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.pair_calibration import PairCalibration
from mocapella.calibration.pair_memory import SensorTracks
from mocapella.calibration.people import PeopleCalibration
from mocapella.calibration.sensor_pair import PairOfSensors

LASTS_S = PeopleCalibration().settings.moved_after_s


def confirmed(agreed_at: float) -> PairOfSensors:
    """A pair that somebody calibrated who walked, and last agreed with at that time."""
    calibration = PairCalibration()
    calibration.scalars[at.BLOCKS_CLOSED] = 1000.0
    return PairOfSensors(calibration, ColdStart(calibration.settings), shown=True, agreed_at=agreed_at)


def watching(**sensors: tuple[float, list[int]]) -> PeopleCalibration:
    """Sensors by the time since when their bodies are frozen and their bodies; the newest frame of each is at 0 s."""
    people = PeopleCalibration()
    for name, (frozen, bodies) in sensors.items():
        people._tracks[name] = SimpleNamespace(frozen=frozen, bodies=bodies)  # type: ignore[assignment]
        people._newest[name] = 0.0
    return people


FROZEN_S = PeopleCalibration().settings.frozen_after_s


@given(newest=st.floats(0, 1e6))
@pytest.mark.parametrize(
    ("ago_s", "frozen"),
    [(0.0, False), (FROZEN_S - 0.1, False), (FROZEN_S + 0.1, True), (np.inf, True), (np.nan, False)],
)
def test_a_stream_is_frozen_if_nothing_has_changed_for_long(ago_s: float, frozen: bool, newest: float) -> None:
    people = watching(a=(newest - ago_s, [1]))
    people._newest["a"] = newest
    assert people._frozen("a") == frozen


def test_a_stream_is_frozen_from_the_limit_on() -> None:
    assert watching(a=(-FROZEN_S, [1]))._frozen("a")
    assert not watching(a=(np.nextafter(-FROZEN_S, 0.0), [1]))._frozen("a")


@pytest.mark.parametrize("one", [(np.nan, [1]), (np.nan, []), (-np.inf, [1])])
@pytest.mark.parametrize("other", [(np.nan, [2]), (np.nan, []), (-np.inf, [2])])
def test_both_sensors_see_somebody_if_both_have_bodies_that_move(
    one: tuple[float, list[int]], other: tuple[float, list[int]]
) -> None:
    lively = (one, other) == ((np.nan, [1]), (np.nan, [2]))
    assert watching(a=one, b=other)._both_see(("a", "b")) == lively


@pytest.mark.parametrize("since", ["agreed_at", "seen_since"])
def test_a_pair_is_doubtful_once_both_have_seen_bodies_for_long_without_any_agreeing(since: str) -> None:
    pair = PairOfSensors(None, ColdStart(PairCalibration().settings), agreed_at=-1e9)
    pair.seen_since = -1e9
    setattr(pair, since, 64.0)
    people, limit = PeopleCalibration(), 64.0 + LASTS_S
    assert [people._doubtful(pair, now) for now in (64.0, limit, np.nextafter(limit, 1e9))] == [False, False, True]


def test_pairs_agree_until_they_have_not_for_long() -> None:
    people = PeopleCalibration()
    people._pairs = {("a", "b"): confirmed(0.0)}
    assert list(people._agreeing(np.nextafter(LASTS_S, 0.0))) == [("a", "b")]
    assert list(people._agreeing(LASTS_S)) == []


@given(now=st.floats(0, 1e6))
@pytest.mark.parametrize(("ago_s", "moved"), [(0.0, "a"), (LASTS_S - 0.1, "a"), (LASTS_S + 0.1, "b"), (np.inf, "b")])
def test_of_two_sensors_that_contradict_the_one_was_moved_with_which_no_third_agrees(
    ago_s: float, moved: str, now: float
) -> None:
    """If no third agrees with either, it is the last."""
    people = PeopleCalibration()
    people._tracks = {name: SensorTracks.empty(25) for name in "abc"}
    people._pairs = {("a", "b"): confirmed(-np.inf), ("b", "c"): confirmed(now - ago_s)}
    people._believe(("a", "b"), PairCalibration(), now)
    assert people._moved == {moved: now}
