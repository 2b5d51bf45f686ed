"""What a camera that is calibrated by arms still needs."""

from __future__ import annotations

import numpy as np
import pytest
from support.arm_frames import FPS, arm_at, places, seen

from mocapella.calibration.arm_extrinsics import ArmExtrinsics, ArmExtrinsicsResult, ArmExtrinsicsSettings
from mocapella.geometry.rigid import apply
from mocapella.model.arms import ARM_JOINTS


def test_a_camera_needs_what_its_estimate_lacks_or_else_an_arm() -> None:
    calibration = ArmExtrinsics()
    assert calibration.needs("left") == "move one arm about where another camera sees it too (0 % done)"
    for missing in ("move it farther", ""):
        calibration.found["left"] = ArmExtrinsicsResult(np.eye(4), 0.0, 0.01, 0.01, 0.01, missing)
        assert calibration.needs("left") == missing


FRAMES = range(8)
PAIRED = FRAMES[1:-2]  # frames of b with one before and one after, when a's next one has come
JOINTS = set(range(len(ARM_JOINTS)))


def shared(hidden: dict[tuple[str, int], int]) -> dict[float, set[int]]:
    """Joints that count, by the number of b's frame, where a camera infers a joint in some of its frames."""
    calibration, rng = ArmExtrinsics(ArmExtrinsicsSettings(most_hz=1000.0)), np.random.default_rng(0)
    for k in FRAMES:
        for camera, at_s in (("a", k / FPS), ("b", (k + 0.5) / FPS)):
            inferred = [ARM_JOINTS[hidden[camera, k]]] if (camera, k) in hidden else []
            arm = seen(arm_at(at_s), camera, rng, hidden=inferred)
            calibration.update(camera, [arm], at_s, {"a": places()["a"]})
    return {round(one.at_s * FPS - 0.5): set(np.flatnonzero(one.weights).tolist()) for one in calibration.instants["b"]}


@pytest.mark.parametrize("phase", [0.1, 0.5, 0.9])
def test_an_instant_is_where_the_arm_was_when_the_camera_saw_it_in_the_world_and_in_the_camera(phase: float) -> None:
    """Even though the calibrated camera saw it before and after; what is left is because the arm's path is curved."""
    calibration, rng = ArmExtrinsics(ArmExtrinsicsSettings(most_hz=1000.0)), np.random.default_rng(0)
    for k in FRAMES:
        for camera, at_s in (("a", k / FPS), ("b", (k + phase) / FPS)):
            arm = seen(arm_at(at_s), camera, rng, noise_m=0.0)
            calibration.update(camera, [arm], at_s, {"a": places()["a"]})
    assert len(calibration.instants["b"]) == len(PAIRED)
    for one in calibration.instants["b"]:
        before, truth, after = (arm_at(one.at_s + k / FPS)[list(ARM_JOINTS)] for k in (-1, 0, 1))
        np.testing.assert_allclose(one.world, truth, atol=5e-4)
        np.testing.assert_allclose(apply(places()["b"], one.own), truth, atol=1e-6)
        np.testing.assert_allclose(one.velocity @ places()["b"][:3, :3].T, (after - before) * FPS / 2, atol=1e-6)


def test_joints_that_both_cameras_measure_count() -> None:
    assert shared({}) == dict.fromkeys(PAIRED, JOINTS)


@pytest.mark.parametrize("joint", sorted(JOINTS))
def test_a_joint_that_a_camera_infers_in_a_frame_counts_in_none_that_needs_it(joint: int) -> None:
    """An instant is one frame of b with those before and after, for its velocity, between two frames of a."""
    middle = FRAMES[len(FRAMES) // 2]
    for camera, needing in (("a", {middle - 1, middle}), ("b", {middle - 1, middle, middle + 1})):
        counted = shared({(camera, middle): joint})
        assert counted == {k: JOINTS - {joint} if k in needing else JOINTS for k in PAIRED}
