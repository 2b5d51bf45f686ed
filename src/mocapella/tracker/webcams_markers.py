"""Colour markers on the fingertips, beside the keypoints of the method ``webcams``: more rays for the fit of a hand.

A camera of the rig detects markers, and other cameras detect keypoints. At each instant, the newest markers of each
camera belong to the followed hand whose predicted tips are nearest; they never begin a hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.association.hand_keypoints import LANDMARKS, HandKeypointSettings, SeenHand
from mocapella.conventions import NS_PER_S
from mocapella.geometry.triangulation import Views
from mocapella.model.camera import CameraRig
from mocapella.model.hand import TIPS
from mocapella.model.markers import MarkerFrame
from mocapella.tracker.arrivals import camera_problem

Float64 = NDArray[np.float64]

MOST_AGE_S: Final = 0.05
"""Greatest time between an instant and the markers that it uses [s]."""
_FEWEST: Final = 2
"""Number of markers below which a camera's are not used."""


class HandMarkers:
    """The newest markers of each camera; each frame is used by one instant at most.

    Args:
        settings: names and side of the markers.
    """

    def __init__(self, settings: HandKeypointSettings) -> None:
        self.settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self._newest: dict[str, tuple[MarkerFrame, int]] = {}
        self._heard_ns: dict[str, int] = {}

    def memory(self) -> dict[str, Any]:
        """Return all state, for a tracker's snapshot; its mutable values are shared, not copied."""
        return {name: getattr(self, name) for name in MEMORY}

    def problem(self, frame: MarkerFrame, rig: CameraRig) -> str:
        """Return why a frame cannot be used, with the remedy; empty if it can."""
        if not rig.cameras:
            return "markers need calibrated cameras: give a rig"
        if problem := camera_problem(rig, frame.sensor, frame.size_px):
            return problem
        tips = self.settings.marker_tips
        if frame.names and not set(frame.names) & set(tips):
            return f"none of its markers is one of hands.marker_tips: {', '.join(tips) or 'there are none'}"
        return ""

    def add(self, frame: MarkerFrame, at_ns: int) -> None:
        """Keep a frame of a camera, captured at a time of the common clock [ns]."""
        self._newest[frame.sensor] = (frame, at_ns)
        self._heard_ns[frame.sensor] = at_ns

    def sending(self, at_ns: int, within_s: float) -> set[str]:
        """Return the cameras that sent markers within a time before ``at_ns`` [s]."""
        return {name for name, last in self._heard_ns.items() if at_ns - last <= within_s * NS_PER_S}

    def take(self, at_ns: int, columns: Mapping[str, int]) -> list[SeenHand]:
        """Return the markers near an instant, and forget their frames and older ones.

        Args:
            at_ns: time of the instant on the common clock [ns].
            columns: index of each camera.

        Returns:
            For each camera that sees two markers or more, the tips, whose standard deviations are the detector's.
        """
        seen = []
        for name in sorted(self._newest):
            frame, captured_ns = self._newest[name]
            after_s = (captured_ns - at_ns) / NS_PER_S
            if after_s > MOST_AGE_S:
                continue  # for a later instant
            del self._newest[name]
            if after_s < -MOST_AGE_S or name not in columns:
                continue
            pixels, sds = np.full((LANDMARKS, 2), np.nan), np.full(LANDMARKS, np.nan)
            for landmark, marker in zip(TIPS, self.settings.marker_tips, strict=False):
                if marker in frame.names:
                    k = frame.names.index(marker)
                    pixels[landmark], sds[landmark] = frame.positions_px[k], frame.sd_px[k]
            if np.isfinite(sds).sum() >= _FEWEST:
                seen.append(SeenHand(columns[name], after_s, pixels, sds, left=self.settings.marker_left))
        return seen


def of_tips(seen: SeenHand, landmarks: Float64, cameras: Views, sd_m: float) -> SeenHand:
    """Return markers whose standard deviations include that of their places on the fingertips of a hand.

    Args:
        seen: the markers.
        landmarks: (21, 3) of the hand, world [m].
        cameras: all cameras.
        sd_m: standard deviation of a marker's centre about the tip [m].
    """
    view = cameras.numbers[seen.camera]
    depths = landmarks @ view[16:19] + view[21]
    with np.errstate(divide="ignore", invalid="ignore"):
        sds = np.hypot(seen.sds_px, sd_m * view[0] / np.where(depths > 0, depths, np.nan))
    return seen._replace(sds_px=sds)


def nearest(costs: Sequence[float], most: float) -> int:
    """Return the index of the least cost; −1 if it is above ``most``, or there is none."""
    best = int(np.argmin(costs)) if len(costs) else -1
    return best if best >= 0 and costs[best] <= most else -1


MEMORY: Final = ("_newest", "_heard_ns")
"""Attributes of `HandMarkers` that are its state."""
