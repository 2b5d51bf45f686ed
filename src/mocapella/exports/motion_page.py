"""Write a motion as one HTML page that plays it in 3D in any browser, without a server and without the network."""

from __future__ import annotations

import base64
import html
import json
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np

from mocapella.errors import SettingsError
from mocapella.model.observations import JointState
from mocapella.model.resampling import resampled, usual_rate_hz
from mocapella.model.trajectories import Trajectories

MOST_FRAMES_HZ: Final = 30.0
"""Largest frame rate of a page [Hz]."""
MOST_BYTES: Final = 64 << 20
"""Largest size of a page's positions [bytes]."""
_STEPS: Final = 32_000
"""Number of steps from the middle of a motion to its farthest coordinate, in 16 bits."""
_LEAST_UNIT_M: Final = 1e-3


def page_of(trajectories: Trajectories, title: str = "") -> str:
    """Return an HTML page that plays trajectories, at `MOST_FRAMES_HZ` at most.

    Unknown keypoints are not drawn; inferred ones are hollow, and their bones dashed. Positions are rounded to a
    millimetre, and coarser only if the motion reaches farther than 32 m.

    Args:
        trajectories: all individuals to show.
        title: the page's title.

    Raises:
        SettingsError: nothing in them is known, or they are too long for a page.
    """
    wanted = min(usual_rate_hz(trajectories), MOST_FRAMES_HZ)
    size = 7 * trajectories.states[0].size * wanted * float(np.ptp(trajectories.times_s)) if len(trajectories) else 0
    if size > MOST_BYTES:
        minutes = float(np.ptp(trajectories.times_s)) / 60.0
        raise SettingsError(
            f"a motion of {minutes:.0f} minutes is too long for a page; choose some individuals, a lower rate, or in "
            "Python a part of it, such as at(slice(0, 9000))"
        )
    motion = resampled(trajectories, wanted)
    known = np.all(np.isfinite(motion.positions), axis=3)
    if not known.any():
        raise SettingsError(f"no keypoint of the {motion.kind} is ever known: there is nothing to show")
    places = motion.positions[known]
    low, high = places.min(axis=0), places.max(axis=0)
    middle = (low + high) / 2.0
    unit = max(_LEAST_UNIT_M, float((high - low).max()) / 2.0 / _STEPS)
    steps = np.where(known[..., None], np.rint((motion.positions - middle) / unit), 0.0).astype("<i2")
    states = np.where(known, motion.states, JointState.NOT_TRACKED).astype(np.uint8)
    radius = max(0.5, float(np.linalg.norm(high - low)) / 2.0)
    values = {
        "individuals": motion.individuals,
        "keypoints": motion.keypoints,
        "bones": motion.bones,
        "frames": len(motion),
        "rate_hz": motion.rate_hz,
        "unit_m": unit,
        "radius_m": radius,
        "floor_m": float(low[1] - middle[1]),
        "cell_m": 1.0 if radius >= 1.0 else 0.25,
        "positions": base64.b64encode(steps.tobytes()).decode("ascii"),
        "states": base64.b64encode(states.tobytes()).decode("ascii"),
    }
    text = json.dumps(values, ensure_ascii=False).replace("<", "\\u003c")
    page = resources.files("mocapella.exports").joinpath("motion_page.html").read_text(encoding="utf-8")
    return page.replace("__TITLE__", html.escape(title or motion.kind)).replace("__MOTION__", text)


def write_page(trajectories: Trajectories, path: Path) -> None:
    """Write the page of trajectories.

    Raises:
        SettingsError: as in `page_of`.
        OSError: the file cannot be written.
    """
    path.write_text(page_of(trajectories, path.stem), encoding="utf-8")
