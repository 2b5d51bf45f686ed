"""Columns of the rows of `marker_kernels`: a marker's memory, and its result in an image."""

from __future__ import annotations

X, Y, VX, VY, SEEN_S, AREA, USUAL = range(7)
MEMORY = 7
"""Columns of the memory: centre [px], velocity [px/s], when last seen [s], area then and when learnt [px]."""
FOUND, SD, ELONGATION, CONFIDENCE, CANDIDATES = 2, 3, 4, 6, 7
MERGED, REJECTED_SMALL, REJECTED_BIG, REJECTED_SHAPE = 8, 9, 10, 11
OUT = 12
"""Columns of the result, besides ``X``, ``Y`` and ``AREA``."""
