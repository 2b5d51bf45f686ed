"""Errors of detectors of keypoints, as measured on recordings of people.

    confidence ~ quantiles[state, group]
    error      = (√slow · AR + √(1 − slow) · white) · core[group, confidence] · size       or, in the tail, · tail_ratio

``size`` is the person's stature in the image [px], AR an autoregressive process of first order, and the state visible,
hidden by the own body, or hidden by another. ``mocapella lab train keypoint-errors`` fits the tables, see
docs/simulation.md.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_json
from mocapella.errors import SettingsError, one_of
from mocapella.sources.simulate.keypoint_body import GROUPS

Float64 = NDArray[np.float64]

CONFIDENCE_BINS: Final = (0.0, 0.3, 0.5, 0.7)
"""Lower ends of the bins of confidence of the errors."""
QUANTILES: Final = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)
"""Quantiles at which the confidences are given."""
STATES: Final = ("visible", "hidden by the own body", "hidden by another")
"""States of a keypoint, the first axis of several tables."""


class DetectorErrors(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Tables of a detector's errors. A person's size is the stature in the image [px].

    Attributes:
        measured_on: description of the recordings, the method and the counts.
        core: (groups, bins) standard deviation of a coordinate by group and confidence, relative to the size.
        tail_share: (states, bins) probability that an error belongs to the tail.
        tail_ratio: standard deviation of the tail, relative to the core.
        quantiles: (states, groups, 7) confidences at `QUANTILES`.
        missing: (states, groups) probability that a keypoint is not reported.
        slow: share of the variance that changes slowly.
        slow_s: time constant of the slow part [s].
    """

    measured_on: dict[str, Any]
    core: list[list[float]]
    tail_share: list[list[float]]
    tail_ratio: float
    quantiles: list[list[list[float]]]
    missing: list[list[float]]
    slow: float
    slow_s: float


class ErrorTables:
    """`DetectorErrors` as arrays.

    Args:
        data: the tables.

    Attributes:
        data: as given.
        core: (groups, bins) relative to the size.
        tail_share: (states, bins).
        quantiles: (states, groups, 7).
        missing: (states, groups).

    Raises:
        SettingsError: a table has another shape.
    """

    def __init__(self, data: DetectorErrors) -> None:
        self.data = data
        groups, bins, states = len(GROUPS), len(CONFIDENCE_BINS), len(STATES)
        self.core = _shaped("core", data.core, (groups, bins))
        self.tail_share = _shaped("tail_share", data.tail_share, (states, bins))
        self.quantiles = _shaped("quantiles", data.quantiles, (states, groups, len(QUANTILES)))
        self.missing = _shaped("missing", data.missing, (states, groups))

    def confidences(self, states: NDArray[np.int64], groups: NDArray[np.int64], uniform: Float64) -> Float64:
        """Return the confidences (...,) at cumulative probabilities ``uniform`` (...,), interpolated linearly.

        Args:
            states: (...,) indices in `STATES`.
            groups: (...,) indices in `keypoint_body.GROUPS`.
            uniform: (...,) from 0 to 1.
        """
        tables = self.quantiles[states, groups]
        grid = np.array(QUANTILES)
        k = np.clip(np.searchsorted(grid, uniform, side="right") - 1, 0, len(grid) - 2)
        low = np.take_along_axis(tables, k[..., None], -1)[..., 0]
        high = np.take_along_axis(tables, k[..., None] + 1, -1)[..., 0]
        return np.asarray(low + (uniform - grid[k]) / (grid[k + 1] - grid[k]) * (high - low))


def bin_of(confidences: Float64) -> NDArray[np.int64]:
    """Return the index in `CONFIDENCE_BINS` of confidences (...,)."""
    return np.searchsorted(np.array(CONFIDENCE_BINS), confidences, side="right") - 1


@cache
def detector_errors(name: str) -> ErrorTables:
    """Return the tables of a detector, which ``data/keypoint_errors.json`` has.

    Raises:
        SettingsError: unknown detector; lists the known ones.
    """
    known = _data()
    if name not in known:
        raise SettingsError(f"unknown detector {name!r}; known: {one_of(name, known)}")
    return ErrorTables(known[name])


def read_detectors(data: bytes, *, file: object = None) -> dict[str, DetectorErrors]:
    """Read the tables of all detectors from JSON.

    Raises:
        InputError: the bytes are no such JSON.
    """
    fix = "write it with `mocapella lab train keypoint-errors`"
    return decode_json(data, dict[str, DetectorErrors], what="table of detectors' errors", file=file, fix=fix)


def detectors_to_json(detectors: dict[str, DetectorErrors]) -> str:
    """Write the tables of detectors as JSON, with a final newline."""
    return json.dumps(msgspec.to_builtins(detectors), indent=1, ensure_ascii=False) + "\n"


@cache
def _data() -> dict[str, DetectorErrors]:
    resource = files("mocapella.sources.simulate") / "data" / "keypoint_errors.json"
    return read_detectors(resource.read_bytes(), file=resource)


def _shaped(name: str, values: Any, shape: tuple[int, ...]) -> Float64:
    try:
        array = np.array(values, dtype=np.float64)
    except ValueError:
        array = np.zeros(0)
    if array.shape != shape:
        raise SettingsError(f"{name} has the shape {array.shape}; it wants {shape}")
    return array
