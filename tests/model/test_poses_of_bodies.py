"""Rotations of tracked bodies as quaternions."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from mocapella.model.poses import quaternion_of, rotation_of

quaternions = arrays(np.float64, 4, elements=st.floats(-2, 2)).filter(lambda q: np.linalg.norm(q) > 1e-3)


@given(quaternions)
def test_a_quaternion_is_the_rotation_that_it_is_elsewhere(q: np.ndarray) -> None:
    R = Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(rotation_of(q), R, atol=1e-12)


@given(quaternions)
def test_the_quaternion_of_a_rotation_gives_it_back(q: np.ndarray) -> None:
    back = quaternion_of(rotation_of(q))
    assert back[0] > -1e-12
    np.testing.assert_allclose(rotation_of(back), rotation_of(q), atol=1e-9)
