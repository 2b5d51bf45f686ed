"""The judgement of a pair of sensors by the kernels' own Python, so that no test waits for a kernel of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mocapella.calibration import pair_estimate_kernels
from mocapella.calibration.pair_calibration import PROBLEMS, PairSettings

S = PairSettings()


def interpreted(kernel: Any) -> Callable[..., Any]:
    """The kernel's Python function; without compilation, it is that itself."""
    function: Callable[..., Any] = getattr(kernel, "py_func", kernel)
    return function


COVARIANCE = interpreted(pair_estimate_kernels.covariance)
PROBLEM_OF = interpreted(pair_estimate_kernels.problem_of)
CLOCK_OFFSET = interpreted(pair_estimate_kernels.clock_offset)


def covariance(
    H: np.ndarray, B: np.ndarray, *, samples: float = 4.0, motion_s: float = 2.0, residual: float = 0.05,
    offset_sd: float = 0.01, weight: float = 500.0,
) -> np.ndarray:  # fmt: skip
    """(6, 6) of a pose with these sums."""
    C = np.empty((6, 6))
    COVARIANCE(H, B, weight, samples, motion_s, residual, offset_sd, float(S.residual_floor_m), C)
    return C


def problem_of(M: np.ndarray, *, samples: float, position_sd: float, rotation_sd: float, residual: float) -> str:
    """Text of the first problem of an estimate from moments."""
    return PROBLEMS[PROBLEM_OF(M, samples, position_sd, rotation_sd, residual, S.limits)]


def offset_of(clock: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offset of the clock and its standard deviation (...,) from sums (..., 5) [s]."""
    found = np.array([CLOCK_OFFSET(own) for own in clock.reshape(-1, clock.shape[-1])])
    return found[:, 0].reshape(clock.shape[:-1]), found[:, 1].reshape(clock.shape[:-1])
