"""What a camera that is calibrated by arms still needs."""

from __future__ import annotations

import numpy as np

from mocapella.calibration.arm_extrinsics import ArmExtrinsics, ArmExtrinsicsResult


def test_a_camera_needs_what_its_estimate_lacks_or_else_an_arm() -> None:
    calibration = ArmExtrinsics()
    assert calibration.needs("left") == "move one arm about where another camera sees it too (0 % done)"
    for missing in ("move it farther", ""):
        calibration.found["left"] = ArmExtrinsicsResult(np.eye(4), 0.0, 0.01, 0.01, 0.01, missing)
        assert calibration.needs("left") == missing
