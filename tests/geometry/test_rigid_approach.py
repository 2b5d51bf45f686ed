from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.walking_people import BACK, FRONT, SIDE

from mocapella.geometry.rigid import inverse, rotation_about_y
from mocapella.geometry.rigid_approach import APPROACH_S, AT_ONCE_M, REACH_M, approached
from mocapella.geometry.twists import exp_twist, log_motion


@given(
    twists=st.lists(arrays(np.float64, 6, elements=st.floats(-0.02, 0.02)), min_size=1, max_size=3),
    elapsed_s=st.floats(0.02, 0.2),
)
def test_poses_approach_wanted_ones_and_arrive(twists: list[np.ndarray], elapsed_s: float) -> None:
    wanted = [FRONT, SIDE, BACK][: len(twists)]
    poses = [exp_twist(twist) @ T for twist, T in zip(twists, wanted, strict=True)]
    off = [np.linalg.norm(log_motion(want @ inverse(T))) for want, T in zip(wanted, poses, strict=True)]
    for _ in range(round(2.0 / elapsed_s)):
        poses = approached(poses, wanted, elapsed_s)
        now = [np.linalg.norm(log_motion(want @ inverse(T))) for want, T in zip(wanted, poses, strict=True)]
        assert all(n <= o + 1e-12 for n, o in zip(now, off, strict=True))
        off = now
    assert all(T is want for T, want in zip(poses, wanted, strict=True))


def test_a_pose_that_is_far_off_is_replaced_at_once_and_without_time_none_moves() -> None:
    near, far = exp_twist([0.01, 0, 0, 0, 0, 0]) @ FRONT, exp_twist([1.0, 0, 0, 0, 0, 0]) @ SIDE
    now = approached([near, far], [FRONT, SIDE], 0.0)
    np.testing.assert_allclose(now[0], near, atol=1e-12)
    assert now[1] is SIDE


@given(twist=arrays(np.float64, 6, elements=st.floats(-0.04, 0.04)), elapsed_s=st.floats(0.01, 0.3))
def test_two_steps_go_as_far_along_the_screw_as_one_of_both_times(twist: np.ndarray, elapsed_s: float) -> None:
    twist[:3] += 0.1 * np.sign(twist[:3].sum() or 1.0)  # far enough that the exponential approach is the quicker one
    pose = exp_twist(twist) @ SIDE
    (once,) = approached([pose], [SIDE], 2 * elapsed_s)
    (half,) = approached([pose], [SIDE], elapsed_s)
    (twice,) = approached([half], [SIDE], elapsed_s)
    np.testing.assert_allclose(twice, once, atol=1e-9)
    left, before = log_motion(SIDE @ inverse(half)), log_motion(SIDE @ inverse(pose))
    np.testing.assert_allclose(left, np.exp(-elapsed_s / APPROACH_S) * before, atol=1e-9)


@given(angle=st.floats(0.001, 0.1), far_m=st.floats(0.001, 0.45))
def test_a_pose_is_as_far_off_as_what_is_drawn_with_it(angle: float, far_m: float) -> None:
    """A rotation counts by the motion at the people's distance; beyond half a metre a pose is replaced at once."""
    for turn, shift, at_once in (
        (AT_ONCE_M / REACH_M * 1.001, 0.0, True),
        (AT_ONCE_M / REACH_M * 0.999, 0.0, False),
        (0.0, AT_ONCE_M * 1.001, True),
        (0.0, AT_ONCE_M * 0.999, False),
        (angle, far_m, REACH_M * angle + far_m > AT_ONCE_M),
    ):
        pose = np.eye(4)
        pose[:3, :3], pose[0, 3] = rotation_about_y(turn), shift
        wanted = np.eye(4)
        (now,) = approached([pose], [wanted], 0.01)
        assert (now is wanted) is at_once
