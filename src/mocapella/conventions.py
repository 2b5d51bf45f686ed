"""Conventions for units, times, frames and rotations.

Units        metres, seconds, radians. A name carries its unit when it is not one of these (``_px``, ``_ns``, ``_hz``).
Time         ``_ns`` is an integer number of nanoseconds on the clock given by the name or docstring: exact, so that a
             recording can be compared to the bit. Durations and settings are seconds as floats.
Frames       right-handed. A sensor's *camera space* is the Kinect's: x to the sensor's left, y up, z out of the lens.
             The world has y up.
Transforms   ``T_to_from`` maps points of ``from`` into ``to``: ``p_world = T_world_sensor @ p_sensor``; neighbours
             cancel. A transform is a (4, 4) array, leading axes are batches.
Rotations    matrices ``R_to_from`` (3, 3), or unit quaternions in the order (w, x, y, z).
Missing      NaN = not seen. A joint that is *not tracked* has NaN in every coordinate.
"""

from __future__ import annotations

from typing import Final

NS_PER_S: Final = 1_000_000_000
SCHEMA_VERSION: Final = 1
"""Version of the message schema (`mocapella.schema`); here, so that ``--version`` imports no codec."""
NOT_AVAILABLE: Final = -9999
"""Code of a missing value in the study log."""
