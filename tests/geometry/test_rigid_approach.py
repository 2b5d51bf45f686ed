from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.walking_people import BACK, FRONT, SIDE

from mocapella.geometry.rigid import inverse
from mocapella.geometry.rigid_approach import approached
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
