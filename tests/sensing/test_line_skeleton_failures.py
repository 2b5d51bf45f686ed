"""Where the methods of 2012 fail, on scenes that a newer method is to pass: fingers that touch, a fist, rotation.

Each test says first that the method works on the scene beside, so that it is the scene that is too much for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from support.abandoned_methods import fingers_by_defects, hand_mask, lines_of_fingers  # noqa: E402
from support.drawn_arms import CAMERA, arm  # noqa: E402 - only where there is OpenCV

from mocapella.model.arms import ARM_JOINTS, SeenArm  # noqa: E402
from mocapella.sensing.line_skeleton import LineSkeleton  # noqa: E402

WRIST_ROW = 275
"""Of the drawn upright hand."""


def seen_in(depth: Any) -> SeenArm:
    (seen,) = LineSkeleton(CAMERA).update(depth, 0.0).arms
    return seen


def tips_off_m(pose: str, degrees: float) -> Any:
    scene = arm(pose, rotation_degrees=degrees)
    return np.linalg.norm(seen_in(scene.depth).joints - scene.truth[list(ARM_JOINTS)], axis=-1)[3:]


def outer_fingers(pose: str, degrees: float) -> int:
    looked = LineSkeleton(CAMERA).look(arm(pose, rotation_degrees=degrees).depth)
    assert looked.hand is not None
    return len(looked.hand.outer)


@pytest.mark.parametrize("degrees", [-45, -90])
def test_fingers_that_touch_merge_and_those_after_them_get_wrong_names(degrees: int) -> None:
    assert outer_fingers("open", degrees) == 5
    assert outer_fingers("touching", degrees) < 5
    off = tips_off_m("touching", degrees)
    assert (off[:2] < 0.012).all()
    assert off[4] > 0.05  # the little finger, which is far from the two that touch


@pytest.mark.parametrize("degrees", [0, 45, -45, -90])
def test_a_closed_fist_has_fingers(degrees: int) -> None:
    """No finger is stretched out: those that the outline shows are knuckles."""
    assert outer_fingers("fist", degrees) >= 1
    assert (tips_off_m("fist", degrees) > 0.03).all()


@pytest.mark.parametrize("degrees", [90, 180])
def test_rotation_loses_elbow_and_order(degrees: int) -> None:
    """An arm from above or from the other side has its elbow at its fingers, and fingers at its elbow."""
    assert (tips_off_m("open", -90) < 0.012).all()
    scene = arm(rotation_degrees=degrees)
    seen = seen_in(scene.depth)
    truth = scene.truth[list(ARM_JOINTS)]
    assert np.linalg.norm(seen.joints[0] - truth[0]) > 0.2
    assert (tips_off_m("open", degrees) > 0.1).all()
    assert (seen.joint_states[3:] == 2).any()  # and it says that they were measured


def test_a_left_hand_has_its_names_in_the_wrong_order() -> None:
    """Names are by angle alone: a left hand's little finger is called the thumb."""
    scene = arm(rotation_degrees=45)
    mirrored = scene.truth[list(ARM_JOINTS)] * [-1, 1, 1]
    seen = seen_in(np.ascontiguousarray(np.roll(scene.depth[:, ::-1], 1, axis=1)))  # about the drawn camera's axis
    assert (np.linalg.norm(seen.joints[3:] - mirrored[:2:-1], axis=-1) < 0.012).all()
    assert seen.left_sure == 0.5


def test_convexity_defects_lose_fingers_that_touch_or_lie_before_the_palm() -> None:
    def counted(pose: str) -> int:
        return fingers_by_defects(hand_mask(arm(pose).depth, WRIST_ROW), deep_px=15)

    assert counted("open") == 5
    assert counted("touching") == 4
    assert counted("before palm") == 4
    assert counted("fist") == 0


def test_defects_do_not_know_the_end_of_a_single_finger() -> None:
    """One finger alone has no gap beside it that is narrower than a right angle: it is as good as a fist."""
    mask = np.zeros((200, 200), dtype=np.uint8)
    cv2.circle(mask, (100, 140), 35, (255,), cv2.FILLED)
    cv2.line(mask, (100, 140), (100, 40), (255,), 15)
    assert fingers_by_defects(mask, deep_px=15) == 0


def test_hough_lines_are_not_fingers() -> None:
    """A finger has two sides, and palm and arm have lines, too: their number does not tell what the hand does."""
    number = {
        pose: len(lines_of_fingers(hand_mask(arm(pose).depth, WRIST_ROW), 25))
        for pose in ("open", "touching", "before palm", "fist")
    }
    assert min(number["open"], number["touching"], number["before palm"]) > 5
    assert number["before palm"] >= number["touching"]  # although fewer fingers stand out
    assert number["fist"] > 0  # although none does
