"""What a value costs under a model of the empty scene."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.background import SPREAD_UNIT, BackgroundModel
from mocapella.sensing.region_contour import RegionSettings, read_band


@pytest.mark.parametrize("channels", [pytest.param(1, marks=pytest.mark.slow), 3])  # grey has kernels of its own
@pytest.mark.parametrize(("least_sd", "spread"), [(5.0, 0.0), (5.0, 4.0), (5.0, 10.0), (20.0, 10.0)])
def test_a_value_costs_half_its_square_in_standard_deviations_more_than_the_usual_one(
    channels: int, least_sd: float, spread: float
) -> None:
    """The standard deviation is the pixel's, but never below the least one; grey images count like three channels."""
    shape, usual, off = (40, 48) if channels == 1 else (40, 48, channels), 100, 30
    model = BackgroundModel(
        np.full(shape, usual, np.uint8), np.full(shape, SPREAD_UNIT * spread, np.uint8), least_sd, darkest=1.0
    )
    everywhere = Silhouette((0, 0), 1, np.zeros(shape[:2], np.float32))
    settings = RegionSettings(median=False)
    told = []
    for value in (usual, usual + off, usual - off):
        band = read_band(np.full(shape, value, np.uint8), everywhere, None, None, settings, guided=False)
        cost = model.costs(band, settings)[band.known > 0]
        np.testing.assert_allclose(cost, cost[0], rtol=1e-5)
        told.append(float(cost[0]))
    more = 3 * 0.5 * (off / max(least_sd, spread)) ** 2
    assert told[1] - told[0] == pytest.approx(more, rel=1e-4)
    assert told[2] - told[0] == pytest.approx(more, rel=1e-4)
