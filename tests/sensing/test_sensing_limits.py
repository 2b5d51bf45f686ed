"""The limits of settings: the last valid value and the first that is not."""

from __future__ import annotations

from typing import Any

import pytest

from mocapella.errors import SettingsError
from mocapella.sensing.background_memory import BackgroundMemory, MemorySettings
from mocapella.sensing.line_skeleton_settings import LineSkeletonSettings
from mocapella.sensing.markers import MarkerSettings

TINY = 1e-300


@pytest.mark.parametrize(
    ("kind", "name", "valid", "invalid"),
    [
        (MemorySettings, "guard_steps", 0.0, -TINY),
        *((MemorySettings, name, TINY, 0.0) for name in ("least_sd", "cut_sd", "strange_sd", "strange_gray_sd",
          "shadow_sd", "rate", "shadow")),
        *((MemorySettings, name, 1, 0) for name in ("window_images", "sweep_images", "every")),
        *((MemorySettings, name, 1.0, 1.000001) for name in ("rate", "shadow")),
        (BackgroundMemory, "step_px", 1, 0),
        (MarkerSettings, "largest_elongation", 1.0, 0.999999), (MarkerSettings, "brighter", 1.000001, 1.0),
        (MarkerSettings, "chroma_drift", TINY, 0.0), (MarkerSettings, "near_change", 1.000001, 1.0),
        *((LineSkeletonSettings, name, 0.0, -TINY) for name in ("least_area_px", "least_hull_px2", "hough_length_px",
          "hough_gap_px", "blob_least_m2")),
        (LineSkeletonSettings, "hough_votes", 1, 0), (LineSkeletonSettings, "palm_forward_m", 0.1, 0.100001),
        (LineSkeletonSettings, "palm_forward_m", -0.1, -0.100001), (LineSkeletonSettings, "gaussian_px", 1, 2),
        (LineSkeletonSettings, "gaussian_px", 31, 33), (LineSkeletonSettings, "gaussian_px", 3, -1),
        (LineSkeletonSettings, "median_px", 1, 2), (LineSkeletonSettings, "noise", "median", "near"),
        (LineSkeletonSettings, "angle_at", "wrist", "elbow"), (LineSkeletonSettings, "canny_low", 150.0, 150.001),
        (LineSkeletonSettings, "grid_px", 50, 51), (LineSkeletonSettings, "grid_px", 1, 0),
    ],
)  # fmt: skip
def test_a_setting_is_valid_up_to_its_limit(kind: Any, name: str, valid: Any, invalid: Any) -> None:
    kind(**{name: valid})
    with pytest.raises(SettingsError, match=f"{name} is "):
        kind(**{name: invalid})
