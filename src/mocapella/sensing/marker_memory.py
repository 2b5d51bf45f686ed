"""Column indices of the arrays of `marker_kernels`: a marker's state between images, and its result in one image."""

from __future__ import annotations

X, Y, VX, VY, SEEN_S, AREA, USUAL = range(7)
MEMORY = 7
"""Number of columns of a marker's memory.

They are centre x and y [px], velocity [px/s], capture time of the last detection [s], area at the last detection, and
area when the marker's colour was learnt [px²].
"""
FOUND, SD, ELONGATION, CONFIDENCE, CANDIDATES = 2, 3, 4, 6, 7
MERGED, REJECTED_SMALL, REJECTED_BIG, REJECTED_SHAPE, NEAR = 8, 9, 10, 11, 12
OUT = 13
"""Number of columns of a marker's result.

Besides ``X``, ``Y`` [px] and ``AREA`` [px²], they are whether it was found, standard deviation of the centre [px],
elongation, confidence (0 to 1), and the numbers of candidates, of merged pieces, and of pieces rejected as too small,
too big or of another shape, and whether it was found only by the colours of a window.
"""
