"""What a camera that is calibrated by arms still needs."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from support.arm_frames import FPS, arm_at, places, seen

from mocapella.calibration import arm_extrinsics
from mocapella.calibration.arm_extrinsics import ArmExtrinsics, ArmExtrinsicsResult, ArmExtrinsicsSettings, Instant
from mocapella.geometry.rigid import apply
from mocapella.model.arms import ARM_JOINTS, SeenArm


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


def instants(
    times: dict[str, list[float]],
    s: ArmExtrinsicsSettings,
    arm: Callable[[str, float], SeenArm] = lambda camera, at_s: seen(arm_at(at_s), camera, np.random.default_rng(0)),
) -> tuple[list[Instant], list[int]]:
    """Paired frames of b, and their number at each new estimate; a is calibrated. Of one time, the first camera's come
    first."""
    calibration, estimates = ArmExtrinsics(s), list[int]()
    for at_s, camera in sorted(((t, name) for name, all_s in times.items() for t in all_s), key=lambda one: one[0]):
        if calibration.update(camera, [arm(camera, at_s)], at_s, {"a": places()["a"]}):
            estimates.append(len(calibration.instants["b"]))
    return calibration.instants["b"], estimates


def paired(times: dict[str, list[float]], s: ArmExtrinsicsSettings) -> list[float]:
    return [one.at_s for one in instants(times, s)[0]]


def every(interval_s: float, count: int, begin_s: float = 0.0) -> list[float]:
    return [begin_s + k * interval_s for k in range(count)]


FAST = ArmExtrinsicsSettings(most_hz=1000.0)


def test_frames_at_the_same_times_are_paired_once_each() -> None:
    same = every(1 / 32, 12)
    assert paired({"a": same, "b": same}, FAST) == paired({"b": same, "a": same}, FAST) == same[1:-2]


@pytest.mark.parametrize(
    ("hz", "calibrated_hz"), [(30, 30), (20, 30), (15, 30), (10, 30), (30, 60), (30, 15), (60, 30)]
)
def test_cameras_of_any_rates_share_all_frames_of_the_camera_without_a_pose(hz: int, calibrated_hz: int) -> None:
    own = every(1 / hz, 2 * hz, 0.004)
    found = paired({"a": every(1 / calibrated_hz, 2 * calibrated_hz), "b": own}, FAST)
    assert len(found) >= len(own) - 5
    assert found == own[own.index(found[0]) :][: len(found)]


def test_a_frame_is_paired_from_the_first_of_the_calibrated_camera_on() -> None:
    own, theirs = every(1 / 32, 24), every(1 / 32, 8, 8 / 32)
    assert paired({"a": theirs, "b": own}, FAST) == theirs[:-2]


@pytest.mark.parametrize(("interval_s", "used"), [(0.149, True), (0.151, False)])
def test_a_velocity_is_of_no_longer_than_three_tenths_of_a_second(interval_s: float, used: bool) -> None:
    times = {"a": every(interval_s, 8), "b": every(interval_s, 8, 0.05)}
    assert bool(paired(times, ArmExtrinsicsSettings(gap_s=1.0))) == used


@pytest.mark.parametrize(("measured", "used"), [(2, False), (3, True)])
def test_an_instant_has_at_least_three_joints_that_both_measure(measured: int, used: bool) -> None:
    def arm(camera: str, at_s: float) -> SeenArm:
        return seen(arm_at(at_s), camera, np.random.default_rng(0), hidden=ARM_JOINTS[measured:])

    found, _ = instants({"a": every(1 / 32, 8), "b": every(1 / 32, 8, 1 / 64)}, FAST, arm)
    assert bool(found) == used
    assert all(np.count_nonzero(one.weights) == measured for one in found)


@pytest.mark.parametrize(
    ("one", "other", "variance"),
    [(0.01, 0.02, 5e-4), (0.001, 0.04, 0.003**2 + 0.04**2), (np.nan, 0.0, 0.02**2 + 0.003**2)],
)
def test_a_joint_counts_by_the_sum_of_the_cameras_variances(one: float, other: float, variance: float) -> None:
    """None is more accurate than 3 mm, and one of unknown accuracy counts as one of 2 cm."""

    def arm(camera: str, at_s: float) -> SeenArm:
        sd = np.full(23, one if camera == "a" else other, np.float32)
        return msgspec.structs.replace(seen(arm_at(at_s), camera, np.random.default_rng(0)), sd=sd)

    found, _ = instants({"a": every(1 / 32, 8), "b": every(1 / 32, 8, 1 / 64)}, FAST, arm)
    assert found
    for instant in found:
        np.testing.assert_allclose(1 / instant.weights, variance, rtol=1e-5)


@pytest.mark.parametrize(("gap_s", "count"), [(0.0625, 5), (0.0624, 0)])
def test_an_arm_is_interpolated_across_gaps_up_to_the_longest(gap_s: float, count: int) -> None:
    s = ArmExtrinsicsSettings(most_hz=1000.0, gap_s=gap_s)
    assert len(paired({"a": every(0.0625, 8), "b": every(0.0625, 8, 0.03125)}, s)) == count


def test_frames_of_one_time_have_no_arm_between_them() -> None:
    assert paired({"a": [0.25] * 8, "b": every(1 / 32, 16)}, FAST) == []


@pytest.mark.parametrize(("most_hz", "step"), [(40.0, 1), (39.0, 2), (20.0, 2), (19.0, 3), (10.0, 4)])
def test_frames_are_paired_no_more_often_than_wanted(most_hz: float, step: int) -> None:
    """Though the times of a camera are rounded: one of 40 Hz gives all its frames if 40 Hz are wanted."""
    times = {"a": every(1 / 40, 40), "b": every(1 / 40, 40, 0.01)}
    found = paired(times, ArmExtrinsicsSettings(most_hz=most_hz))
    assert found == times["b"][1:-2:step]


@pytest.mark.parametrize(
    ("limits", "estimates"),
    [((10, 30), [10, 20, 30]), ((15, 40), [20, 30, 40]), ((20, 20), [20]), ((10, 35), [10, 20, 30])],
)
def test_an_estimate_is_renewed_with_every_tenth_frame_from_the_least_to_the_most(
    limits: tuple[int, int], estimates: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arm_extrinsics, "extrinsics_from_arm", lambda *_: "an estimate")
    s = ArmExtrinsicsSettings(instants=limits, most_hz=1000.0)
    found, renewed = instants({"a": every(1 / 32, 60), "b": every(1 / 32, 60, 1 / 64)}, s)
    assert (len(found), renewed) == (limits[1], estimates)


def test_a_share_of_the_wanted_frames_is_told_in_tenths() -> None:
    calibration = ArmExtrinsics(ArmExtrinsicsSettings(instants=(60, 300)))
    told = []
    for _ in range(60):
        told.append(calibration.needs("b").partition("(")[2])
        calibration.instants.setdefault("b", []).append(None)  # type: ignore[arg-type]
    assert told == [f"{10 * (k // 6)} % done)" for k in range(60)]


@pytest.mark.parametrize(
    ("own", "theirs", "chosen"),
    [
        ("l", "l", 0),
        ("l", "r", 0),  # alone in both: a camera may take a left arm for a right one
        ("lr", "lr", 0),
        ("rl", "lr", 1),
        ("lr", "r", 1),
        ("r", "lr", 0),
        ("llr", "lr", 2),
        ("lr", "llr", 1),
        ("ll", "l", None),
        ("l", "ll", None),
        ("l", "rr", None),
        ("llrr", "lr", None),
        ("", "l", None),
        ("l", "", None),
    ],
)
def test_an_arm_is_paired_if_it_is_the_only_one_or_the_only_one_of_its_side(
    own: str, theirs: str, chosen: int | None
) -> None:
    rng = np.random.default_rng(0)
    mine, others = (
        [seen(arm_at(0.0), "a", rng, left=side == "l", number=k) for k, side in enumerate(sides)]
        for sides in (own, theirs)
    )
    found = arm_extrinsics._only(mine, others)
    assert (found is None) == (chosen is None)
    assert found is None or found.id == chosen


def test_a_frame_counts_only_if_both_cameras_see_one_arm_all_the_time() -> None:
    """Not if an arm has another number in a frame that is needed, nor if a camera has none."""

    def count(change: Callable[[str, int], list[SeenArm] | None]) -> int:
        calibration, rng = ArmExtrinsics(FAST), np.random.default_rng(0)
        for k in FRAMES:
            for camera, at_s in (("a", k / FPS), ("b", (k + 0.5) / FPS)):
                arms = change(camera, k)
                arms = [seen(arm_at(at_s), camera, rng)] if arms is None else arms
                calibration.update(camera, arms, at_s, {"a": places()["a"]})
        return len(calibration.instants["b"])

    other = seen(arm_at(0.1), "b", np.random.default_rng(0), number=5)
    assert count(lambda *_: None) == len(PAIRED)
    for camera, needed in (("a", 2), ("b", 3)):
        for arms in ([], [other]):
            assert count(lambda c, k, of=camera, arms=arms: arms if (c, k) == (of, 4) else None) == len(PAIRED) - needed
