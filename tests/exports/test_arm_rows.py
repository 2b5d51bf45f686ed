"""Arms of one depth image as JSON and as rows of a table: every value in its place, and unknown ones empty."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from support.messages import some_arm

from mocapella.exports.arm_rows import COLUMNS, STATES, frame_row, handedness, table_rows
from mocapella.geometry.lens import project
from mocapella.model.arms import ARM_JOINT_NAMES, ARM_POINTS, SeenArm, SeenArms

LENS = np.array([476.0, 480.0, 320.0, 240.0, 0, 0, 0, 0, 0])


def arm(number: int, **changes: Any) -> SeenArm:
    """An arm before the camera, one of whose joints is not known, and another without a standard deviation."""
    made = some_arm(number, np.random.default_rng(number))
    points = made.points + np.array([0, 0, 4])
    known = np.isfinite(points).all(axis=1)
    points[~known] = [0.5, 0.25, 2.0]
    states, sd = np.full(len(points), 2, np.uint8), np.full(len(points), 0.0123456, np.float32)
    lost, vague = (ARM_POINTS.index(name) for name in ARM_JOINT_NAMES[:2])
    points[lost], states[lost], states[vague], sd[vague] = np.nan, 0, 1, np.nan
    return msgspec.structs.replace(made, points=points, states=states, sd=sd, **changes)


def found(*arms: SeenArm, reason: str = "") -> SeenArms:
    return SeenArms(arms, reason)


@pytest.mark.parametrize("all_points", [False, True])
def test_each_joint_has_its_state_place_projection_and_deviation(all_points: bool) -> None:
    one = arm(3)
    row = frame_row("a.png", 1.23456789, found(one, reason="dark"), LENS, all_points=all_points)
    assert (row["file"], row["time_s"], row["reason"]) == ("a.png", 1.234568, "dark")
    (written,) = row["arms"]
    assert (written["id"], written["gesture"], written["grabbing"]) == (3, "open", one.grabbing)
    assert (written["handedness_sure"], written["gesture_sure"]) == (
        round(one.left_sure, 4),
        round(one.gesture_sure, 4),
    )
    assert tuple(written["joints"]) == (ARM_POINTS if all_points else ARM_JOINT_NAMES)
    for name, joint in written["joints"].items():
        k = ARM_POINTS.index(name)
        assert joint["state"] == STATES[one.states[k]]
        if name == ARM_JOINT_NAMES[0]:
            assert joint["m"] is joint["px"] is None
        else:
            np.testing.assert_allclose(joint["m"], one.points[k], atol=0.5e-5)
            np.testing.assert_allclose(joint["px"], project(one.points[k], LENS), atol=0.5e-2)
        assert joint["sd_m"] == (None if name == ARM_JOINT_NAMES[1] else 0.01235)


@pytest.mark.parametrize(
    ("sure", "left", "said"),
    [(0.5, True, "unknown"), (0.51, True, "left"), (0.51, False, "right"), (1.0, True, "left")],
)
def test_a_side_is_said_if_it_is_likelier_than_the_other(sure: float, left: bool, said: str) -> None:
    assert handedness(arm(1, left=left, left_sure=sure)) == said


def test_the_table_has_a_row_for_each_joint_of_each_arm_with_the_values_of_the_json() -> None:
    row = frame_row("a.png", 0.5, found(arm(3), arm(4), reason="dark"), LENS)
    rows = list(table_rows("take", row))
    joints = [(one, name) for one in row["arms"] for name in one["joints"]]
    assert len(rows) == len(joints) == 2 * len(ARM_JOINT_NAMES)
    for cells, (one, name) in zip(rows, joints, strict=True):
        assert len(cells) == len(COLUMNS)
        of = dict(zip(COLUMNS, cells, strict=True))
        joint = one["joints"][name]
        assert (of["recording"], of["file"], of["time_s"], of["reason"]) == ("take", "a.png", 0.5, "dark")
        assert [of[key] for key in ("arm", "handedness", "gesture", "grabbing", "joint", "state")] == [
            one["id"], one["handedness"], one["gesture"], int(one["grabbing"]), name, joint["state"],
        ]  # fmt: skip
        assert [of["x_m"], of["y_m"], of["z_m"]] == (joint["m"] or [""] * 3)
        assert [of["x_px"], of["y_px"]] == (joint["px"] or [""] * 2)
        assert of["sd_m"] == ("" if joint["sd_m"] is None else joint["sd_m"])


def test_an_image_without_arms_is_one_row_with_the_reason() -> None:
    (cells,) = table_rows("=take", frame_row("a.png", 0.5, found(reason="nobody"), LENS))
    assert len(cells) == len(COLUMNS)
    assert cells[1:3] == ["a.png", 0.5]
    assert cells[0] != "=take"  # a formula of a spreadsheet
    assert (set(cells[3:-1]), cells[-1]) == ({""}, "nobody")
