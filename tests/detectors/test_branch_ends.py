"""Ends of the branches of a hand's surface: which are found, which a fit explains, and which digits reach one."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.detectors.arm_finding import ArmFinder, Found
from mocapella.detectors.arm_following import KinematicArmDetector
from mocapella.detectors.branch_ends import (
    EXPLAINED_M,
    REACHED_M,
    branch_ends,
    missed,
    reached,
    reaching,
    shown_ends,
    unexplained,
)
from mocapella.kinematics.arm_fit import ArmModel, ArmPose, Fitted
from mocapella.model.camera import Camera
from mocapella.model.hand import DIGITS, TIPS, hand_model
from mocapella.sensing.arm_region import ArmRegionSettings

ROOT = Path(__file__).resolve().parents[2]
FRAMES = ROOT.parent / "shared" / "data" / "depth_hand_sr305" / "frames"
SR305 = Camera("sr305", (640, 480), np.array([476.007, 476.007, 313.683, 242.755, 0, 0, 0, 0, 0]))
S = ArmRegionSettings()
LENS = np.array([500.0, 500.0, 159.5, 119.5])
Z_M = 0.5
seeds = st.integers(0, 2**32 - 1)


def ends_and_tips(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return some ends, and five tips, in a cube of 8 cm [m]; some ends are at tips."""
    rng = np.random.default_rng(seed)
    tips = rng.uniform(0, 0.08, (5, 3))
    ends = rng.uniform(0, 0.08, (rng.integers(0, 6), 3))
    at = rng.random(len(ends)) < 0.5
    ends[at] = tips[: len(ends)][at] + rng.normal(0, 0.004, (at.sum(), 3))
    return ends, tips


@given(seeds)
def test_an_end_is_unexplained_where_no_tip_is_near_the_farthest_first(seed: int) -> None:
    ends, tips = ends_and_tips(seed)
    off_m = [min(float(np.linalg.norm(end - tip)) for tip in tips) for end in ends]
    expected = [ends[k] for k in sorted(range(len(ends)), key=lambda k: -off_m[k]) if off_m[k] > EXPLAINED_M]
    np.testing.assert_array_equal(unexplained(ends, tips), np.reshape(expected, (-1, 3)))


@given(seeds)
def test_ends_at_tips_cost_nothing_and_far_ones_their_number(seed: int) -> None:
    ends, tips = ends_and_tips(seed)
    assert missed(tips, tips) == pytest.approx(0.0, abs=1e-6)
    assert missed(ends + 100.0, tips) == pytest.approx(len(ends), abs=1e-3)
    assert len(unexplained(tips, tips)) == 0


@given(seeds, st.floats(0.0, 0.1), st.floats(0.001, 0.1))
def test_an_end_farther_from_all_tips_costs_more(seed: int, off_m: float, more_m: float) -> None:
    tips = ends_and_tips(seed)[1]
    beyond = tips[[np.argmax(tips[:, 0])]]
    x = np.array([1.0, 0.0, 0.0])
    assert missed(beyond + off_m * x, tips) < missed(beyond + (off_m + more_m) * x, tips) < 1.0


@given(seeds)
def test_a_tip_has_reached_an_end_if_both_are_nearest_to_each_other(seed: int) -> None:
    ends, tips = ends_and_tips(seed)
    targets = reached(ends, tips)
    for digit, target in enumerate(targets):
        if np.isfinite(target[0]):
            off_m = np.linalg.norm(target[None] - tips[digit], axis=1)[0]  # summed as the distances below, to the bit
            assert off_m <= EXPLAINED_M
            assert off_m == min(np.linalg.norm(ends - tips[digit], axis=1))
            assert off_m == min(np.linalg.norm(tips - target, axis=1))
    for end in ends:  # the nearest of all pairs
        if len(ends) and np.linalg.norm(ends[:, None] - tips, axis=2).min() == np.linalg.norm(tips - end, axis=1).min():
            explained = len(unexplained(end[None], tips)) == 0
            assert (targets == end).all(axis=1).any() == explained
    np.testing.assert_array_equal(reached(tips, tips), tips)


@cache
def arm_model() -> ArmModel:
    model = hand_model("full").stretched(25.0, 28.0, 4.0)
    return ArmModel(model, model.shape("right"))


def open_hand() -> ArmPose:
    model = arm_model()
    view = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]).T
    return ArmPose(
        np.ascontiguousarray(view).reshape(9), np.array([0.0, 0.05, 0.5]), model.natural.copy(), model.state()
    )


@settings(max_examples=25)
@given(st.integers(0, 4), st.integers(1, 1000))
def test_the_digit_of_a_tip_can_reach_it_and_moves_alone(digit: int, way: int) -> None:
    model, pose = arm_model(), open_hand()
    columns = model.columns[digit]
    free = columns >= 0
    held = pose._replace(z=pose.z.copy())
    held.z[columns[free]] = model.ways[digit][1 + way % (len(model.ways[digit]) - 1), free]
    end = model.points(held)[TIPS[digit]]
    starts = [*reaching(model, pose, end)]
    assert digit in [int(np.flatnonzero(np.isfinite(targets[:, 0]))[0]) for _, targets in starts]
    for start, targets in starts:
        (moved,) = np.flatnonzero(np.isfinite(targets[:, 0]))
        np.testing.assert_array_equal(targets[moved], end)
        assert np.linalg.norm(model.points(start)[TIPS[moved]] - end) < REACHED_M
        others = np.delete(np.arange(len(pose.z)), model.columns[moved][model.columns[moved] >= 0])
        np.testing.assert_array_equal(start.z[others], pose.z[others])
        np.testing.assert_array_equal(start.t, pose.t)


def test_no_digit_reaches_the_elbow() -> None:
    model, pose = arm_model(), open_hand()
    assert [*reaching(model, pose, model.points(pose)[22])] == []


def drawn(fingers: list[tuple[float, float]], long_m: float = 0.08, cut: bool = False) -> np.ndarray:
    """Return a depth image [m] of a flat palm, 8 cm wide, with upright fingers: (middle, width) across the palm [m]."""
    depth = np.zeros((240, 320), np.float32)
    x, y = (np.indices(depth.shape)[::-1] - LENS[2:, None, None]) * Z_M / LENS[0]
    shown = (np.abs(x) < 0.04) & (np.abs(y) < 0.04)
    for middle, wide in fingers:
        shown |= (np.abs(x - middle) < wide / 2) & (y <= -0.039) & (y > -0.04 - long_m)
    depth[shown] = Z_M
    return depth[50:] if cut else depth


PALM = np.array([0.0, 0.0, Z_M])


@given(st.lists(st.sampled_from([-0.03, -0.01, 0.01, 0.03]), unique=True, max_size=4), st.floats(0.05, 0.07))
def test_each_finger_ends_a_branch(middles: list[float], long_m: float) -> None:
    found = branch_ends(drawn([(middle, 0.012) for middle in middles], long_m), LENS, PALM, S)
    tops = np.array([[middle, -0.04 - long_m, Z_M] for middle in middles]).reshape(-1, 3)
    for top in tops:
        assert np.linalg.norm(found - top, axis=1).min() < 0.01
    assert len(found) == len(middles)


@pytest.mark.parametrize(
    ("depth", "palm"),
    [
        (drawn([(0.0, 0.04)]), PALM),  # as wide as a wrist
        (drawn([(0.0, 0.012)], 0.015), PALM),  # shorter than a finger
        (drawn([(0.0, 0.012)], cut=True), PALM - np.array([0.0, 50 * Z_M / LENS[0], 0.0])),  # cut by the image's border
        (drawn([(0.0, 0.012)]), PALM + np.array([0.0, 0.0, 0.06])),  # before the palm
        (drawn([(0.0, 0.012)]), PALM - np.array([0.0, 0.0, 0.6])),  # behind the camera
        (np.zeros((240, 320), np.float32), PALM),
    ],
)
def test_no_finger_ends_there(depth: np.ndarray, palm: np.ndarray) -> None:
    assert branch_ends(depth, LENS, palm, S).shape == (0, 3)


def test_the_lens_may_have_a_distortion() -> None:
    depth = drawn([(0.0, 0.012)])
    np.testing.assert_array_equal(
        branch_ends(depth, np.concatenate([LENS, np.zeros(5)]), PALM, S), branch_ends(depth, LENS, PALM, S)
    )


def test_of_two_fits_of_a_hand_the_one_that_explains_the_ends_is_kept() -> None:
    finder = ArmFinder({"right": arm_model()}, LENS, S, 0.3, 0.006)
    fitted = Fitted(open_hand(), np.zeros(7))
    cheaper, better = Found(0.10, "right", fitted, 0.04), Found(0.12, "right", fitted, 0.01)
    assert finder.apart([cheaper, better]) == [better]
    assert finder.apart([better, cheaper]) == [better]
    assert finder.apart([cheaper._replace(missed=0.0), better]) == [cheaper._replace(missed=0.0)]


def bar(end_m: float, *, before: float = Z_M + 0.05, hidden: bool = False) -> np.ndarray:
    """Return a depth image [m]: an upright bar 1.4 cm wide whose upper end is at y = −end_m, before a surface."""
    depth = np.full((240, 320), before, np.float32)
    x, y = (np.indices(depth.shape)[::-1] - LENS[2:, None, None]) * Z_M / LENS[0]
    depth[(np.abs(x) < 0.007) & (y > -end_m) & (y < 0.05)] = Z_M
    if hidden:
        depth[(np.abs(x) < 0.03) & (y < -end_m) & (y > -end_m - 0.05)] = Z_M - 0.08
    return depth


def bones(long_m: float = 0.03, radius_m: float = 0.007) -> np.ndarray:
    """Return (5, 8) five equal last bones of fingers that point up, whose flesh ends at y = −long_m − radius_m."""
    axis = Z_M + radius_m
    return np.tile([0.0, 0.0, axis, 0.0, -long_m, axis, radius_m, radius_m], (5, 1))


@given(st.floats(0.02, 0.032))
def test_a_fingertip_before_a_surface_ends_where_its_own_surface_ends(end_m: float) -> None:
    found = shown_ends(bar(end_m), LENS, bones())
    np.testing.assert_allclose(found[:, 1], -end_m, atol=0.004)
    np.testing.assert_allclose(found[:, 0], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "depth",
    [
        bar(0.037),  # its own end
        bar(0.08),  # seen farther than its end
        bar(0.005),  # nothing of it within the length that may be missing
        bar(0.025, before=0.0),  # before nothing: the silhouette is judged by the fit
        bar(0.025, hidden=True),  # behind a nearer surface
        np.zeros((240, 320), np.float32),
    ],
)
def test_no_surface_tells_the_end_of_a_fingertip(depth: np.ndarray) -> None:
    assert np.isnan(shown_ends(depth, LENS, bones())).all()


def test_ends_farther_than_asked_are_not_reached() -> None:
    tips = np.arange(15.0).reshape(5, 3)
    ends = tips + np.array([0.018, 0.0, 0.0])
    assert np.isnan(reached(ends, tips)).all()
    np.testing.assert_array_equal(reached(ends, tips, 0.02), ends)


def test_the_flesh_of_a_fingertip_ends_less_than_its_radius_beyond_the_landmark() -> None:
    model, pose = arm_model(), open_hand()
    beyond = model.tip_ends(pose) - model.points(pose)[[*TIPS]]
    radii = model.last_bones(pose)[:, 7]
    assert (np.linalg.norm(beyond, axis=1) < radii).all()
    along = model.points(pose)[[*TIPS]] - model.last_bones(pose)[:, :3]
    cosines = (beyond * along).sum(axis=1) / np.linalg.norm(beyond, axis=1) / np.linalg.norm(along, axis=1)
    np.testing.assert_allclose(cosines, 1.0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.skipif(not FRAMES.is_dir(), reason="needs depth_hand_sr305")
def test_all_fingertips_of_a_real_hand_are_at_their_labels() -> None:
    labels = tomllib.loads((ROOT / "tests" / "labels" / "depth_hand_sr305.toml").read_text(encoding="utf-8"))["frame"]
    worst_px = []
    for label in labels:
        depth = cv2.imread(str(FRAMES / label["file"]), cv2.IMREAD_UNCHANGED).astype(np.float32) * np.float32(0.000125)
        arm = KinematicArmDetector(SR305).update(depth, 0.0).arms[0]
        x, y, z = arm.points[[*TIPS]].T
        px = np.stack([SR305.lens[0] * x / z + SR305.lens[2], SR305.lens[1] * y / z + SR305.lens[3]], axis=1)
        worst_px.append(np.linalg.norm(px - [label[digit] for digit in DIGITS], axis=1).max())
    assert max(worst_px) < 8  # labels are right to 4 px
