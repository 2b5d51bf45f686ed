"""A rig that fits is never doubted; cameras exchanged, moved or mirrored are told apart and said."""

from __future__ import annotations

from collections.abc import Callable

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
