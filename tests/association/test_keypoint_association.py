"""Laws of the association of keypoints: optimal assignments, human proportions, and groups of detections."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hn
from scipy.optimize import linear_sum_assignment

from mocapella.association.keypoint_rays import BONES, MIRROR, SHARES, KeypointAssociationSettings, sources_of
from mocapella.errors import SettingsError
from mocapella.model.topology import topology
from mocapella.tracker.webcams_warmup import standing_person

pytestmark = pytest.mark.slow  # each kernel is compiled for these tests alone


def kernels() -> Any:
    from mocapella.association import keypoint_kernels

    return keypoint_kernels


def new_people() -> Any:
    from mocapella.association import new_people_kernels

    return new_people_kernels


@settings(deadline=None)
@given(hn.arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.floats(0, 10)))
def test_the_assignment_has_the_least_cost(cost: np.ndarray) -> None:
    rows, columns = cost.shape
    column_of = np.empty(rows, dtype=np.int64)
    kernels().optimal(cost, rows, columns, 4.0, column_of)
    made = column_of >= 0
    assert len(set(column_of[made])) == made.sum()
    assert (cost[np.flatnonzero(made), column_of[made]] < 4.0).all()
    own = cost[np.flatnonzero(made), column_of[made]].sum() + 4.0 * (~made).sum()
    wide = np.concatenate([cost, np.full((rows, rows), 4.0)], axis=1)
    assert own == pytest.approx(wide[linear_sum_assignment(wide)].sum())


@given(st.floats(0.5, 2.3), st.floats(-np.pi, np.pi))
@settings(deadline=None)
def test_people_of_all_sizes_and_poses_have_human_proportions(height_m: float, angle: float) -> None:
    c, s = np.cos(angle), np.sin(angle)
    body = standing_person() * height_m / 1.74 @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    assert new_people().plausible(body, np.full(26, 0.02), 0.5, 2.3)


@pytest.mark.parametrize("scale", [0.15, 2.5])
def test_a_body_of_another_size_than_a_person_is_a_phantom(scale: float) -> None:
    assert not new_people().plausible(standing_person() * scale, np.full(26, 0.01), 0.5, 2.3)


def test_a_body_whose_bones_do_not_fit_together_is_a_phantom() -> None:
    body = standing_person()
    halpe = topology("halpe_26")
    for name in ("LWrist", "RWrist", "LAnkle", "RAnkle", "LShoulder"):
        body[halpe.index(name)] += [1.2, 0.5, 0.0]
    assert not new_people().plausible(body, np.full(26, 0.01), 0.5, 2.3)


def test_too_few_bones_are_no_person() -> None:
    body = np.full((26, 3), np.nan)
    body[:2] = standing_person()[:2]
    assert not new_people().plausible(body, np.full(26, 0.01), 0.5, 2.3)


@given(hn.arrays(np.float64, (4, 3), elements=st.floats(-3, 3)))
@settings(deadline=None)
def test_rays_through_one_point_meet_there(values: np.ndarray) -> None:
    one, other, target = values[0], values[1] + [7.0, 0.0, 0.0], values[2]
    d1, d2 = target - one, target - other
    s1, s2 = np.linalg.norm(d1), np.linalg.norm(d2)
    if s1 < 0.1 or s2 < 0.1 or np.linalg.norm(np.cross(d1 / s1, d2 / s2)) < 0.05:
        return
    point = np.empty(3)
    distance, along1, along2, sine = new_people().meet(one, d1 / s1, other, d2 / s2, point)
    assert distance == pytest.approx(0.0, abs=1e-9)
    assert (along1, along2) == pytest.approx((s1, s2))
    assert point == pytest.approx(target, abs=1e-9)
    assert 0.0 < sine <= 1.0


def test_parallel_rays_tell_nothing() -> None:
    point, ahead = np.empty(3), np.array([0.0, 0.0, 1.0])
    assert np.isnan(new_people().meet(np.zeros(3), ahead, np.array([1.0, 0.0, 0.0]), ahead, point)[0])
    assert np.isnan(point).all()


def test_a_covered_detection_of_one_person_is_dropped_and_a_neighbour_is_not() -> None:
    rng = np.random.default_rng(3)
    one = rng.uniform(100, 300, (26, 2))
    pixels = np.stack([one, one + 1.0, one + np.array([80.0, 0.0]), one])
    confidences = np.stack([np.full(26, 0.9), np.full(26, 0.7), np.full(26, 0.8), np.full(26, 0.6)])
    camera = np.array([0, 0, 0, 1])
    assert kernels().drop_duplicates(pixels, confidences, camera, np.full(4, 200.0)) == 1
    assert (confidences.max(axis=1) > 0).tolist() == [True, False, True, True]


def test_tables_of_bones_fit_the_topology() -> None:
    assert BONES.shape == (len(SHARES), 2)
    assert (MIRROR[MIRROR] == np.arange(26)).all()
    lengths = np.linalg.norm(standing_person()[BONES[:, 0]] - standing_person()[BONES[:, 1]], axis=1)
    assert np.median(lengths / SHARES) == pytest.approx(1.74, rel=0.1)


def test_joints_are_taken_from_single_joints_of_another_topology() -> None:
    assert sources_of(topology("halpe_26")).tolist() == list(range(26))  # type: ignore[union-attr]
    assert sources_of(topology("kinect_v2")) is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"joint_sd": 0.0}, {"least_sd_px": 0.0}, {"least_confidence": 1.0}, {"most_cost": 10.0}, {"pair_cost": 0.0},
        {"least_joints": 0}, {"least_angle_deg": 0.0}, {"shortest_m": 3.0},
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        KeypointAssociationSettings(**wrong)
