"""numba's ``njit``, for all files of kernels: what was compiled of older sources is gone before the first is loaded."""

from pathlib import Path

from numba import njit

from mocapella.kernel_cache import discard_stale

__all__ = ["njit"]

discard_stale(Path(__file__).parent)
