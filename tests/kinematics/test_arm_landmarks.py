"""Where on an arm's flesh its landmarks are."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from mocapella.kinematics import arm_flesh_kernels as fk
from mocapella.kinematics.arm_fit import ArmModel, ArmPose
from mocapella.model.arms import ARM_POINTS, ELBOW, PALM
from mocapella.model.hand import TIPS, WRIST, Handedness, hand_model


@pytest.mark.parametrize("side", get_args(Handedness))
def test_a_landmark_of_the_hand_is_sought_on_the_flesh_where_it_is(side: Handedness) -> None:
    """Each joint is where a bone begins, and each fingertip where the last bone ends; others are near."""
    model = ArmModel(hand_model("full"), hand_model("full").shape(side))
    pose = ArmPose(np.eye(3).reshape(9), np.zeros(3), model.natural + 0.1, model.state())
    pieces, places = model.pieces(pose)[0], model._places
    assert len(places) == len(ARM_POINTS)
    chosen, along = pieces[places[:, 0].astype(int)], places[:, 1]
    on_flesh = chosen[:, fk.FROM : fk.FROM + 3] + (along * chosen[:, fk.LENGTH])[:, None] * chosen[:, fk.U : fk.U + 3]
    points = model.points(pose)
    joints = np.setdiff1d(np.arange(1, 21), TIPS)
    np.testing.assert_allclose(on_flesh[joints], points[joints], atol=1e-12)
    np.testing.assert_allclose(on_flesh[[*TIPS]], points[[*TIPS]], atol=0.004)  # the round end reaches beyond its axis
    np.testing.assert_allclose(on_flesh[[WRIST, PALM, ELBOW]], points[[WRIST, PALM, ELBOW]], atol=0.011)
    assert np.flatnonzero(places[:, 2]).tolist() == list(TIPS)
