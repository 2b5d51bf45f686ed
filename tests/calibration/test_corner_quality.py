"""Distances between triangulated corners, and how large their errors must be expected."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from support.filmed_boards import BOARD, SIZE, Filmed, film

from mocapella.calibration.board_bundle import CAMERA
from mocapella.calibration.corner_quality import CameraNoise, CornerQuality, corner_quality
from mocapella.geometry.twists import exp_twist
from mocapella.model.camera import Camera, PlacedCamera

FILMED = film(cameras=2, instants=6)
INSTANTS = {(view.camera, view.frame): view.frame for view in FILMED.views}
NO_ERRORS = np.zeros((2, CAMERA, 2, CAMERA))


def cameras(filmed: Filmed, errors: np.ndarray | None = None) -> dict[str, PlacedCamera]:
    """As they are, or with errors (cameras, 15) of poses and lenses."""
    of = np.zeros((2, CAMERA)) if errors is None else errors
    return {
        f"c{k}": PlacedCamera(
            Camera(f"c{k}", SIZE, filmed.lenses[k] + of[k, 6:]), exp_twist(of[k, :6]) @ filmed.T_camera_first[k],
            np.zeros((6, 6)),
        )
        for k in range(2)
    }  # fmt: skip


def measured(noise: CameraNoise | None = None, **changed: object) -> CornerQuality:
    values = {"views": FILMED.views, "cameras": cameras(FILMED), "board": BOARD, **changed}
    return corner_quality(values["views"], INSTANTS, values["cameras"], values["board"], noise)  # type: ignore[arg-type]


def test_exact_corners_of_two_cameras_are_all_measured_and_have_no_error() -> None:
    found = measured()
    ids = {(view.camera, view.frame): set(view.ids.tolist()) for view in FILMED.views}
    shared = [len(ids["c0", k] & ids["c1", k]) for k in range(6)]
    assert (found.points, found.distances) == (sum(shared), sum(n * (n - 1) // 2 for n in shared))
    assert found.distance_rms_mm < 1e-5
    assert found.scale_percent == pytest.approx(0, abs=1e-6)
    assert found.reprojection_rms_px < 1e-5
    assert np.isnan(found.predicted_rms_mm)


@pytest.mark.parametrize("larger", [0.9, 1.25])
def test_a_board_of_another_size_than_is_said_shows_in_the_scale_and_in_millimetres(larger: float) -> None:
    found = measured(board=replace(BOARD, square_m=larger * BOARD.square_m))
    assert found.scale_percent == pytest.approx(100 * (1 / larger - 1), abs=1e-4)
    by_one_square_mm = abs(larger - 1) * 1e3 * BOARD.square_m
    assert by_one_square_mm < found.distance_median_mm < 5 * by_one_square_mm
    assert found.distance_median_mm < 1.5 * found.distance_rms_mm


def test_corners_that_one_camera_alone_saw_measure_nothing() -> None:
    found = measured(views=[view for view in FILMED.views if view.camera == "c0"])
    assert (found.points, found.distances) == (0, 0)
    assert np.isnan(found.distance_rms_mm)


def test_the_error_expected_from_the_noise_of_corners_is_that_of_noisy_corners() -> None:
    rng = np.random.default_rng(0)
    noisy = [
        msgspec.structs.replace(view, corners_px=view.corners_px + rng.normal(0, 0.4, view.corners_px.shape))
        for view in FILMED.views
    ]
    found = measured(CameraNoise(0.4, NO_ERRORS), views=noisy)
    assert found.predicted_rms_mm == pytest.approx(found.distance_rms_mm, rel=0.15)
    assert found.predicted_rms_mm == pytest.approx(2 * measured(CameraNoise(0.2, NO_ERRORS)).predicted_rms_mm, rel=0.02)


@pytest.mark.parametrize("unknown", [0, 2, 4, 5, 6, 8, 10])
def test_the_error_expected_from_that_of_a_camera_is_what_it_causes(unknown: int) -> None:
    """A small error of one number of the second camera, and the same in both, which may cancel."""
    sd = 0.002 if unknown < 6 else 1.0 if unknown < 10 else 0.002
    for both in (False, True):
        error = np.zeros((2, CAMERA))
        error[1, unknown] = sd
        error[0, unknown] = sd * both
        caused = measured(cameras=cameras(FILMED, error)).distance_rms_mm
        covariance = np.outer(error.ravel(), error.ravel()).reshape(2, CAMERA, 2, CAMERA)
        expected = measured(CameraNoise(0.0, covariance)).predicted_rms_mm
        assert expected == pytest.approx(caused, rel=0.05, abs=0.01)
        assert expected > 0.02 or both
