"""A rig that fits is never doubted; cameras exchanged, moved or mirrored are told apart and said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mocapella.calibration.rig_fit import RigFit, RigFitSettings
from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.model.camera import Camera, CameraRig, PlacedCamera

Float64 = NDArray[np.float64]
SIZE = (640, 480)
LENS = np.array([530.0, 530.0, 319.5, 239.5, -0.05, 0.0, 0.0, 0.0, 0.0])
HZ = 30.0
READOUT_S = 0.02


def rig(baseline_m: float, turn: float) -> CameraRig:
    """Left and right, turned towards what is half a metre ahead; z is ahead, y down."""
    places = {
        name: inverse(rigid(rotation_about_y(-side * turn), [side * baseline_m / 2, 0.0, 0.0]))
        for name, side in (("left", -1), ("right", 1))
    }
    return CameraRig(
        {
            name: PlacedCamera(Camera(name, SIZE, LENS, readout_s=READOUT_S), T, np.zeros((6, 6)))
            for name, T in places.items()
        }
    )


PARALLEL, WIDE = rig(0.075, 0.0), rig(0.4, np.arctan2(0.2, 0.5))


def marker_places(at_s: float) -> Float64:
    """(6, 3) of a hand's size, half a metre ahead, that moves at up to 0.6 m/s."""
    spread = np.random.default_rng(5).uniform(-0.08, 0.08, (6, 3))
    return spread + np.array([0.1 * np.sin(6 * at_s), 0.05 * np.cos(5 * at_s), 0.5])


def pictured(cameras: CameraRig, name: str, at_s: float) -> Float64:
    """(6, 2) each marker where it was when its row was read."""
    placed = cameras.cameras[name]
    rows = np.zeros(6)
    for _ in range(3):
        moments = at_s + rows * READOUT_S / (SIZE[1] - 1)
        points = np.stack([marker_places(t)[i] for i, t in enumerate(moments)])
        px = project(apply(placed.T_camera_world, points), placed.camera.lens)
        rows = px[:, 1]
    return px


def watch(
    cameras: CameraRig,
    *,
    seconds: float = 2.0,
    seen: Callable[[str, Float64], tuple[str, Float64]] = lambda name, px: (name, px),
) -> RigFit:
    fit = RigFit(cameras, 6)
    rng = np.random.default_rng(1)
    for k in range(round(seconds * HZ)):
        for name, phase in (("left", 0.0), ("right", 0.4)):
            at_s = (k + phase) / HZ
            as_name, px = seen(name, pictured(cameras, name, at_s) + rng.normal(0, 0.3, (6, 2)))
            fit.update(as_name, px, at_s)
    return fit


@pytest.mark.parametrize("cameras", [PARALLEL, WIDE])
def test_a_rig_that_fits_is_not_doubted_though_cameras_see_a_moving_hand_in_turn(cameras: CameraRig) -> None:
    fit = watch(cameras)
    assert fit.problem == ""
    (rms,) = fit.rms_px()
    assert rms < 1.0
    assert fit.rms_px(exchanged=True)[0] > 3.0 * rms


@pytest.mark.parametrize("cameras", [PARALLEL, WIDE])
def test_swapped_cameras_are_named(cameras: CameraRig) -> None:
    other = {"left": "right", "right": "left"}
    fit = watch(cameras, seen=lambda name, px: (other[name], px))
    assert fit.problem.startswith("left and right seem to be swapped")
    assert "exchange them" in fit.problem


@pytest.mark.parametrize("cameras", [PARALLEL, WIDE])
def test_a_camera_that_was_turned_or_mirrors_does_not_fit(cameras: CameraRig) -> None:
    def turned(name: str, px: Float64) -> tuple[str, Float64]:
        return name, px + ([15.0, 12.0] if name == "left" else [0.0, 0.0])

    def mirrored(name: str, px: Float64) -> tuple[str, Float64]:
        return name, np.where(np.array([name == "left", False]), SIZE[0] - 1 - px, px)

    for wrong in (turned, mirrored):
        assert "do not fit the rig" in watch(cameras, seen=wrong).problem


def test_it_is_said_when_it_is_known_and_no_longer_when_it_is_mended() -> None:
    swapped = {"left": "right", "right": "left"}
    fit = watch(PARALLEL, seconds=0.2, seen=lambda name, px: (swapped[name], px))
    assert fit.problem == ""  # a few points are no reason
    assert np.isnan(fit.rms_px()).all()
    fit = RigFit(PARALLEL, 6, RigFitSettings(memory_s=0.5))
    said = []
    for k in range(150):
        for name, phase in (("left", 0.0), ("right", 0.4)):
            at_s = (k + phase) / HZ
            fit.update(swapped[name] if k < 60 else name, pictured(PARALLEL, name, at_s), at_s)
        said.append(bool(fit.problem))
    assert said[59]
    assert not said[-1]


def test_markers_that_one_camera_alone_sees_and_frames_out_of_order_say_nothing() -> None:
    fit = watch(PARALLEL, seen=lambda name, px: (name, px if name == "left" else np.full((6, 2), np.nan)))
    assert fit.problem == ""
    before = fit.rms_px()
    fit.update("left", np.zeros((6, 2)), 0.0)
    np.testing.assert_array_equal(fit.rms_px(), before)


def test_a_single_wrong_marker_counts_no_more_than_the_cap() -> None:
    def seen(name: str, px: Float64) -> tuple[str, Float64]:
        if name == "right":
            px[3] = 600.0, 20.0
        return name, px

    (rms,) = watch(WIDE, seen=seen).rms_px()
    assert rms <= RigFitSettings().cap_px / np.sqrt(6) + 0.5


def test_settings_out_of_range_are_refused() -> None:
    for changed in ({"memory_s": 0.0}, {"every_s": -1.0}, {"swapped_ratio": 0.5}, {"least_points": np.nan}):
        with pytest.raises(SettingsError, match=next(iter(changed))):
            RigFitSettings(**changed)


ROWS_S = {"left": READOUT_S, "right": 0.0}
STRAIGHT = CameraRig(
    {
        name: PlacedCamera(
            Camera(name, SIZE, LENS * [1, 1, 1, 1, 0, 1, 1, 1, 1], readout_s=ROWS_S[name]), placed.T_camera_world,
            np.zeros((6, 6)),
        )
        for name, placed in PARALLEL.cameras.items()
    }
)  # fmt: skip
"""Without distortion, what moves along the picture at one speed has pixels that do."""
PLACES = np.random.default_rng(5).uniform(-0.08, 0.08, (6, 3)) * [1, 1, 0.2] + [0, 0, 0.5]


def steady(name: str, at_s: float) -> Float64:
    """(6, 2) pixels of markers that move steadily, each where it was when its row was read."""
    placed, rows = STRAIGHT.cameras[name], np.zeros(6)
    for _ in range(30):
        moments = at_s + rows * ROWS_S[name] / (SIZE[1] - 1)
        points = PLACES + moments[:, None] * [0.12, 0.1, 0.0]
        px = np.asarray(project(apply(placed.T_camera_world, points), placed.camera.lens))
        rows = px[:, 1]
    return px


def shown(frames: list[tuple[str, float]], s: RigFitSettings, as_name: dict[str, str] | None = None) -> RigFit:
    fit = RigFit(STRAIGHT, 6, s)
    for name, at_s in frames:
        fit.update((as_name or {}).get(name, name), steady(name, at_s), at_s)
    return fit


IN_TURN = [(name, k / 16 + late) for k in range(16) for name, late in (("left", 0.0), ("right", 0.03125))]
FEW = RigFitSettings(least_points=6.0, every_s=0.0, memory_s=1e5)


def test_markers_that_move_steadily_fit_exactly_whenever_and_row_by_row_the_cameras_see_them() -> None:
    assert shown(IN_TURN, FEW).rms_px()[0] < 1e-6
    late = sorted(((name, at_s + 0.04 * (name == "left")) for name, at_s in IN_TURN), key=lambda frame: frame[1])
    assert shown(late, FEW).rms_px()[0] < 1e-6


def test_exchanged_cameras_are_far_off_unless_each_has_the_others_name() -> None:
    fit = shown(IN_TURN, FEW)
    other = shown(IN_TURN, FEW, {"left": "right", "right": "left"})
    np.testing.assert_allclose(other.rms_px(), fit.rms_px(exchanged=True), rtol=0.05)
    np.testing.assert_allclose(other.rms_px(exchanged=True), 0.0, atol=2.0)
    assert other.rms_px()[0] > 3.0


def test_a_frame_that_comes_twice_counts_once() -> None:
    frames = [("left", 0.0), ("right", 0.0625), ("left", 0.0625)]
    one, twice = (shown([*frames, *more], FEW) for more in ([], [("left", 0.0625)]))
    np.testing.assert_array_equal(twice.rms_px(), one.rms_px())
    assert np.isfinite(one.rms_px()).all()


@pytest.mark.parametrize(("least", "known"), [(8.2, True), (8.3, False)])
def test_markers_fade_to_a_part_in_e_within_the_memory_whenever_that_is(least: float, known: bool) -> None:
    s = RigFitSettings(least_points=least, every_s=0.0, memory_s=0.0625)
    fit = RigFit(STRAIGHT, 6, s)
    for name, at_s in (("left", 0.0), ("right", 0.0), ("left", 0.0625), ("right", 0.0625)):
        fit.update(name, steady(name, at_s), 100.0 + at_s)  # compared at the right one's times
    assert np.isfinite(fit.rms_px()).all() == known


@pytest.mark.parametrize(("least", "known"), [(6.0, True), (6.001, False)])
def test_a_frame_is_compared_once_and_with_as_many_markers_as_are_wanted_a_pair_is_judged(
    least: float, known: bool
) -> None:
    """Though the other camera goes on alone."""
    s = RigFitSettings(least_points=least, every_s=0.0, memory_s=1e5)
    frames = [("left", 0.0), ("right", 0.03125), *(("left", k / 16) for k in range(1, 12))]
    assert np.isfinite(shown(frames, s).rms_px()).all() == known
    again = [("left", 0.0), ("left", 0.0), ("right", 0.03125), ("left", 0.0625), ("left", 0.0625)]
    assert np.isfinite(shown(again, s).rms_px()).all() == known


@pytest.mark.parametrize(("every_s", "compared"), [(0.0625, 16), (0.0626, 8), (0.125, 8)])
def test_a_pair_is_compared_as_often_as_is_wanted(every_s: float, compared: int) -> None:
    frames = [(name, k / 16) for k in range(16) for name in ("left", "right")]
    for points, known in ((compared, True), (compared + 1, False)):
        s = RigFitSettings(least_points=6 * points - 1, every_s=every_s, memory_s=1e5)
        assert np.isfinite(shown(frames, s).rms_px()).all() == known


@pytest.mark.parametrize(("longest_s", "known"), [(0.0625, True), (0.0624, False)])
def test_pixels_are_interpolated_across_gaps_up_to_the_longest(longest_s: float, known: bool) -> None:
    s = RigFitSettings(least_points=6.0, every_s=0.0, memory_s=1e5, longest_gap_s=longest_s)
    assert np.isfinite(shown(IN_TURN, s).rms_px()).all() == known


def test_a_rig_that_is_off_by_the_largest_distance_still_fits() -> None:
    fit = shown(IN_TURN, FEW, {"left": "right", "right": "left"})
    (now,) = fit.rms_px()
    fit.settings = replace(FEW, largest_px=float(now))
    assert fit.problem == ""
    fit.settings = replace(FEW, largest_px=float(np.nextafter(now, 0)))
    assert "swapped" in fit.problem
