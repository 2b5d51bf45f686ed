"""What is expected of a lens before any view of it."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.calibration.lens_prior import (
    ASPECT_SD,
    CENTRE_SD,
    COEFFICIENTS,
    DISTORTION_SD,
    OBSERVED,
    lens_prior,
    observed,
)

SIZES, FOCAL = np.array([[640.0, 480.0], [1920.0, 1080.0]]), np.array([500.0, 1400.0])


def cost(camera: int, lens: np.ndarray) -> float:
    prior = lens_prior(SIZES, FOCAL)
    off = lens - prior.mean[camera]
    return float(off @ prior.precision[camera] @ off)


@pytest.mark.parametrize("camera", [0, 1])
def test_a_focal_length_is_free_but_for_its_aspect_which_is_expected_within_half_a_percent(camera: int) -> None:
    f, (width, height) = FOCAL[camera], SIZES[camera]
    lens = np.array([f, f, (width - 1) / 2, (height - 1) / 2, 0, 0, 0, 0, 0])
    assert cost(camera, lens) == 0.0
    assert cost(camera, lens + 300.0 * np.eye(9)[0] + 300.0 * np.eye(9)[1]) == pytest.approx(0.0, abs=1e-9)
    assert cost(camera, lens + ASPECT_SD * f * np.eye(9)[1]) == pytest.approx(1.0)
    for axis in (2, 3):
        assert cost(camera, lens + CENTRE_SD * width * np.eye(9)[axis]) == pytest.approx(1.0)
    for axis, sd in enumerate(DISTORTION_SD, 4):
        assert cost(camera, lens + sd * np.eye(9)[axis]) == pytest.approx(1.0)


def test_what_views_know_twice_as_well_as_before_is_observed() -> None:
    sd = np.array([9.0, 9.0, CENTRE_SD * 640, CENTRE_SD * 640, *DISTORTION_SD])
    assert OBSERVED == 0.5
    assert observed(np.diag((0.49 * sd) ** 2), (640, 480)) == list(COEFFICIENTS[2:])
    assert observed(np.diag((0.51 * sd) ** 2), (640, 480)) == []
    some = np.where(np.arange(9) % 2, 0.1, 0.9) * sd
    assert observed(np.diag(some**2), (640, 480)) == list(COEFFICIENTS[3::2])
