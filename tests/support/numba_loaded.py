"""Import numba and compile once, for processes that are forked afterwards."""

from numba import njit

njit(lambda x: 3 * x)(2)
