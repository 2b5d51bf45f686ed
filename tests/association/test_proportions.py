"""How large somebody is, and who comes back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.association.proportions import (
    LENGTHS,
    SD_M,
    known_size,
    size_difference,
    sizes,
    unknown_size,
)
from mocapella.association.track_kernels import learn_size
from mocapella.association.tracks import Tracks, TrackSettings
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.model.topology import topology

KINECT = topology("kinect_v2")
SPINE = np.array([[0.0, 0.9, 0.0], [0.0, 1.2, 0.0], [0.0, 1.6, 0.0]])
TALL = np.array([0.72, 0.52, 0.46, 0.46, 0.33, 0.28])
SHORT = np.array([0.62, 0.44, 0.38, 0.38, 0.28, 0.23])
DT = 1 / 30


@given(st.integers(0, 99), st.floats(-3, 3), st.floats(-1, 1))
def test_lengths_do_not_depend_on_place_turn_or_labels(seed: int, yaw: float, tilt: float) -> None:
    bodies = np.random.default_rng(seed).normal(size=(2, 25, 3))
    moved = apply(rigid(rotation_about_y(yaw) @ rotation_about_x(tilt), (1.0, 2.0, 3.0)), bodies)
    assert sizes(moved, KINECT) == pytest.approx(sizes(bodies, KINECT))
    assert sizes(bodies[:, list(KINECT.mirror)], KINECT) == pytest.approx(sizes(bodies, KINECT))
    assert sizes(1.1 * bodies, KINECT) == pytest.approx(1.1 * sizes(bodies, KINECT))


def test_a_topology_without_these_joints_has_no_lengths_and_a_missing_joint_only_its_own() -> None:
    other = topology("kinect_v1")
    assert np.isnan(sizes(np.zeros((1, len(other), 3)), other)).all()
    body = np.random.default_rng(0).normal(size=(1, 25, 3))
    body[0, KINECT.index("AnkleLeft")] = np.nan
    assert np.flatnonzero(np.isnan(sizes(body, KINECT)[0])).tolist() == [LENGTHS.index(("Knee", "Ankle"))]
    assert sizes(np.empty((0, 25, 3)), KINECT).shape == (0, len(LENGTHS))


def test_the_running_mean_is_the_mean_and_an_outlier_moves_it_little() -> None:
    rng = np.random.default_rng(1)
    assert not known_size(unknown_size())
    known = unknown_size().copy()
    for _ in range(200):
        learn_size(known, TALL + rng.normal(size=6) * SD_M)
    assert known_size(known)
    assert np.abs(known[0] - TALL).max() < 0.5 * SD_M.max()
    after = known.copy()
    learn_size(after, TALL + 5.0)
    assert 0 < (after[0] - known[0]).max() <= 3 * SD_M.max() / 200
    same = known.copy()
    learn_size(same, np.full(6, np.nan))
    np.testing.assert_array_equal(same, known)


def test_the_difference_counts_in_standard_deviations() -> None:
    assert size_difference(TALL, TALL) == 0
    assert size_difference(TALL, TALL + 2 * SD_M) == pytest.approx(4)


@pytest.mark.parametrize("measured", range(len(LENGTHS) + 1))
def test_sizes_are_compared_from_a_third_of_common_lengths_on(measured: int) -> None:
    part = np.where(np.arange(len(LENGTHS)) < measured, TALL, np.nan)
    enough = measured >= len(LENGTHS) / 3
    for one, other in ((TALL, part), (part, TALL)):
        assert size_difference(one, other) == (0.0 if enough else np.inf)


class Door:
    """People of known size, seen by one sensor wherever they are said to be."""

    def __init__(self, settings: TrackSettings | None = None) -> None:
        self.tracks, self.now_s, self.fresh = Tracks(settings), 0.0, 100

    def seen(self, seconds: float, *people: tuple[float, np.ndarray]) -> list[int | None]:
        """Numbers at the end of who stands at x, with such lengths, under new tracking ids; None who is not told of."""
        self.fresh += 10
        owners: list[int] = []
        for _ in range(round(seconds / DT)):
            middles = np.array([SPINE + np.array([x, 0.0, 3.0]) for x, _ in people]).reshape(-1, 3, 3)
            lengths = np.array([size for _, size in people]).reshape(-1, 6)
            ids = [self.fresh + i for i in range(len(people))]
            rows = self.tracks.update("front", ids, middles, None, self.now_s, lengths)
            owners = self.tracks.memory.person[rows].tolist()
            self.now_s += DT
        told = self.tracks.memory.person[self.tracks.memory.confirmed].tolist()
        return [owner if owner in told else None for owner in owners]


def test_who_comes_back_elsewhere_is_known_by_size_also_when_two_are_missing() -> None:
    door = Door()
    tall, short = door.seen(2.0, (-0.5, TALL), (0.5, SHORT))
    assert tall != short
    door.seen(8.0)
    assert door.seen(2.0, (4.0, SHORT)) == [short]
    assert door.seen(2.0, (4.0, SHORT), (-4.0, TALL)) == [short, tall]


def test_who_is_of_another_size_is_somebody_new_also_where_the_other_vanished() -> None:
    door = Door()
    (tall,) = door.seen(2.0, (0.0, TALL))
    door.seen(5.0)
    (new,) = door.seen(2.0, (0.0, SHORT))
    assert new not in (tall, None)


def test_nobody_comes_back_from_farther_than_they_can_have_walked() -> None:
    door = Door()
    (tall,) = door.seen(2.0, (-4.0, TALL))
    door.seen(0.5)
    (other,) = door.seen(2.0, (4.0, TALL))
    assert other not in (tall, None)


def test_a_newcomer_waits_only_while_somebody_is_missing_and_never_longer_than_set() -> None:
    settings = TrackSettings()
    door = Door()
    (tall,) = door.seen(2.0, (0.0, TALL))
    assert None not in door.seen(settings.confirm_after_s + 0.1, (0.0, TALL), (3.0, SHORT))
    door.seen(3.0)
    assert door.seen(settings.size_after_s - 0.2, (-5.0, 0.5 * (TALL + SHORT))) == [None]
    assert None not in door.seen(0.4, (-5.0, 0.5 * (TALL + SHORT)))
    assert tall is not None


def test_after_a_short_absence_the_place_is_enough_and_nobody_waits() -> None:
    door = Door()
    (tall,) = door.seen(2.0, (0.0, TALL))
    door.seen(1.0)
    assert door.seen(DT, (0.1, SHORT)) == [tall]


def test_without_lengths_who_comes_back_elsewhere_is_somebody_new() -> None:
    door = Door()
    unknown = np.full(6, np.nan)
    (one,) = door.seen(2.0, (0.0, unknown))
    door.seen(8.0)
    (other,) = door.seen(2.0, (4.0, unknown))
    assert other not in (one, None)


@pytest.mark.parametrize("measured", range(len(unknown_size()[0]) + 1))
def test_a_size_is_known_from_half_of_its_lengths_on(measured: int) -> None:
    size = unknown_size().copy()
    size[0, :measured], size[1, :measured] = 0.3, 1 + np.arange(measured)
    assert known_size(size) == (measured >= size.shape[1] / 2)
