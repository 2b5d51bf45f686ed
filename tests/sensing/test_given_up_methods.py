"""The two ways to find fingers that were given up in 2012: laws, what they find, and what is too much for them."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

cv2 = pytest.importorskip("cv2")

from support.drawn_arms import CAMERA, arm  # noqa: E402 - only where there is OpenCV

from mocapella.errors import SettingsError  # noqa: E402
from mocapella.model.arms import ARM_JOINTS  # noqa: E402
from mocapella.sensing.line_skeleton import LineSkeleton, Looked  # noqa: E402
from mocapella.sensing.line_skeleton_joints import Place, PointGrid  # noqa: E402
from mocapella.sensing.palm_segments import PalmSegments, PalmSegmentsSettings, peaks, segment_tips  # noqa: E402
from mocapella.sensing.skeleton_in_space import SkeletonInSpace, SkeletonInSpaceSettings, ends_of  # noqa: E402

BOTH = (PalmSegments, SkeletonInSpace)
PALM = Place(np.array([100.0, 200.0]), np.array([100.0, 100.0]), np.array([100.0, 125.0]), 10.0, 600.0)
"""An arm from below, with its palm in the middle."""


def look(method: type[LineSkeleton], pose: str, degrees: float) -> tuple[Looked, Any]:
    """What is seen, and how far each fingertip is from its place [m]."""
    scene = arm(pose, rotation_degrees=degrees)
    looked = method(CAMERA).look(scene.depth)
    assert looked.joints is not None
    return looked, np.linalg.norm(looked.joints - scene.truth[list(ARM_JOINTS)], axis=-1)[3:]


def count(looked: Looked) -> int:
    assert looked.hand is not None
    return len(looked.hand.outer)


@pytest.mark.parametrize("degrees", [0, 45, -45, -90])
def test_angular_segments_find_the_fingers_of_an_open_hand(degrees: int) -> None:
    looked, off = look(PalmSegments, "open", degrees)
    assert count(looked) == 5
    assert (off < 0.012).all()


@pytest.mark.parametrize("degrees", [0, -90])
def test_lines_in_space_find_the_fingers_of_an_open_hand(degrees: int) -> None:
    looked, off = look(SkeletonInSpace, "open", degrees)
    assert count(looked) == 5
    assert (off < 0.012).all()


@pytest.mark.parametrize("degrees", [0, 45, -45, -90])
@pytest.mark.parametrize("method", BOTH)
def test_fingers_that_touch_get_wrong_names(method: type[LineSkeleton], degrees: int) -> None:
    assert (look(method, "open", degrees)[1] < 0.012).sum() >= 4
    assert (look(method, "touching", degrees)[1] > 0.015).any()


@pytest.mark.parametrize("degrees", [0, 45, -45, -90])
@pytest.mark.parametrize("method", BOTH)
def test_a_finger_before_the_palm_is_not_found(method: type[LineSkeleton], degrees: int) -> None:
    off = look(method, "before palm", degrees)[1]
    assert off[1] > 0.03  # the index finger
    assert LineSkeleton(CAMERA).look(arm("before palm", rotation_degrees=degrees).depth).hand is not None
    assert look(LineSkeleton, "before palm", degrees)[1][1] < 0.012  # the method that replaced them finds it


def test_up_to_palm_and_wrist_all_three_are_one() -> None:
    joints = [look(method, "open", -45)[0].joints for method in (LineSkeleton, *BOTH)]
    for other in joints[1:]:
        assert other is not None
        np.testing.assert_array_equal(other[:3], joints[0][:3])  # type: ignore[index]


@given(st.lists(st.integers(0, 20), min_size=1, max_size=30), st.integers(1, 8))
def test_between_two_peaks_is_a_valley_and_every_deep_valley_is_between_two_peaks(values: list[int], deep: int) -> None:
    x = np.array(values, dtype=float)
    found = peaks(x, deep)
    assert len(found) >= 1
    assert x[found].max() == x.max()
    for one, other in itertools.pairwise(found):
        assert one < other
        assert x[one:other].min() < min(x[one], x[other]) - deep
    for k, value in enumerate(values):  # between neighbouring peaks, nothing rises above the higher of them
        before, after = found[found <= k], found[found >= k]
        sides = [x[one] for one in (*before[-1:], *after[:1])]
        assert value <= max(sides)


@given(st.sets(st.integers(-5, 5), min_size=1, max_size=5), st.floats(-4, 4), st.randoms(use_true_random=False))
def test_far_points_are_tips_in_the_order_of_their_angles(turns: set[int], off: float, random: Any) -> None:
    apart = [15 * k + off for k in sorted(turns)]
    turn = np.radians(apart)
    far = 100.0 + 80 * np.stack([np.sin(turn), -np.cos(turn)], axis=-1)
    all_round = np.radians(np.arange(-90, 91, 2.0))
    close = 100.0 + 12 * np.stack([np.sin(all_round), -np.cos(all_round)], axis=-1)
    pixels = np.rint(np.concatenate([far, close])).astype(np.int32)
    order = list(range(len(pixels)))
    random.shuffle(order)
    tips = segment_tips(PointGrid(pixels[order], np.ones(len(pixels))), PALM, PalmSegmentsSettings())
    np.testing.assert_array_equal(tips, np.rint(far))


def test_a_hand_that_reaches_no_farther_than_its_palm_has_no_tip() -> None:
    points = PointGrid(np.array([[100, 90], [108, 96]], dtype=np.int32), np.ones(2))
    assert segment_tips(points, PALM, PalmSegmentsSettings()).shape == (0, 2)
    assert segment_tips(points, replace(PALM, inside_px=5.0), PalmSegmentsSettings(palm_part=1.0)).shape == (1, 2)


def test_a_line_is_followed_from_each_end_to_its_fork() -> None:
    thin = np.zeros((20, 20), dtype=bool)
    thin[10, 2:11] = True  # from the left to a fork
    for k in range(1, 6):
        thin[10 - k, 10 + k] = thin[10 + k, 10 + k] = True
    ways = {tuple(way[0].tolist()): way for way in ends_of(thin)}
    assert set(ways) == {(2, 10), (15, 5), (15, 15)}
    assert len(ways[2, 10]) == 9
    assert ways[2, 10][-1].tolist() == [10, 10]
    assert ends_of(np.zeros((5, 5), dtype=bool)) == []
    block = np.zeros((9, 9), dtype=bool)
    block[3:6, 3:6] = True
    assert ends_of(block) == []  # its corners are no ends
    ring = cv2.circle(np.zeros((20, 20), np.uint8), (10, 10), 6, (1,), 1)
    assert ends_of(ring > 0) == []


@given(st.integers(2, 30), st.booleans())
def test_a_straight_line_has_two_ends_and_each_way_is_the_whole_line(length: int, diagonal: bool) -> None:
    thin = np.zeros((40, 40), dtype=bool)
    steps = np.arange(length)
    thin[3 + steps * diagonal, 4 + steps] = True
    ways = ends_of(thin)
    assert [len(way) for way in ways] == [length, length]
    np.testing.assert_array_equal(ways[0], ways[1][::-1])


@pytest.mark.parametrize(
    ("settings", "wrong"),
    [
        (PalmSegmentsSettings, {"segment_degrees": 0.1}),
        (PalmSegmentsSettings, {"palm_part": 0.5}),
        (PalmSegmentsSettings, {"gap_m": -1.0}),
        (PalmSegmentsSettings, {"grid_px": 0}),
        (SkeletonInSpaceSettings, {"back_px": 1}),
        (SkeletonInSpaceSettings, {"length_m": 1.0}),
        (SkeletonInSpaceSettings, {"tip_from_palm_m": -0.1}),
    ],
)
def test_settings_out_of_range_are_refused(settings: Any, wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        settings(**wrong)
