"""Find the unit of length of a rig by the size of the people in its images.

Files of rigs do not state their unit. Of two cameras that agree about a person, the distances from the neck over hips
and knees to the ankles are in the rig's unit, and units of length differ by far more than people do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import sources_named
from mocapella.association.ray_agreement import AGREES, apart, rays_of, shared_instants, spread_of
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]

USUAL_M: Final = 1.25
"""Length of people from the neck over hips and knees to the ankles: between that of adults and children [m]."""
FEWEST: Final = 10
"""Least number of such lengths that tell the unit."""
POSSIBLE_M: Final = (0.5, 1.7)
"""Such lengths of children from 0.8 m to people of 2.2 m, and a tenth more [m]."""
LEAST_SINE: Final = 0.1
"""Least sine of the angle between two rays that measure a distance."""
UNITS: Final = {-3: "millimetres", -2: "centimetres", 1: "centimetres", 3: "metres"}
"""What the lengths of a rig's file are, by the power of ten that corrects the lengths as read.

Long translations are read as millimetres (`mocapella.model.camera_rig_file`), so those in centimetres are ten times too
small then.
"""
_CHAINS: Final = [
    [topology("halpe_26").index(name) for name in ("Neck", f"{side}Hip", f"{side}Knee", f"{side}Ankle")]
    for side in "LR"
]

_NECK: Final = topology("halpe_26").index("Neck")
_SHOULDERS: Final = [topology("halpe_26").index(f"{side}Shoulder") for side in "LR"]


def rig_in_metres(frames: Mapping[str, Sequence[KeypointFrame]], rig: CameraRig) -> tuple[CameraRig, str]:
    """Return the rig in metres, and a sentence that names the unit; the rig itself and no text if it is in metres.

    Args:
        frames: the frames by the rig's camera names; frames of one instant have the same ``sequence``.
        rig: the cameras.
    """
    lengths = people_lengths(frames, rig)
    if len(lengths) < FEWEST:
        return rig, ""
    length = float(np.median(lengths))
    power = round(float(np.log10(USUAL_M / length)))
    if power not in UNITS:
        return rig, ""
    cameras = {}
    for name, one in rig.cameras.items():
        T = one.T_camera_world.copy()
        T[:3, 3] *= 10.0**power
        cameras[name] = msgspec.structs.replace(one, T_camera_world=T)
    return CameraRig(cameras), (
        f"people would be {length:.3g} m from neck to ankles: the rig's lengths were taken as {UNITS[power]}, and the "
        "results are in metres"
    )


def unlikely_scale(frames: Mapping[str, Sequence[KeypointFrame]], rig: CameraRig) -> str:
    """Return a sentence if the people are larger or smaller than people are, with the likely scale, or no text.

    Args:
        frames: the frames by the rig's camera names; frames of one instant have the same ``sequence``.
        rig: the cameras.
    """
    lengths = people_lengths(frames, rig)
    length = float(np.median(lengths)) if len(lengths) >= FEWEST else USUAL_M
    least, most = POSSIBLE_M
    if least <= length <= most:
        return ""
    than, factor, size = ("longer", length / USUAL_M, "large") if length > most else ("less", USUAL_M / length, "small")
    return (
        f"people are {length:.3g} m from neck to ankles, {than} than people are: the rig's lengths are about "
        f"{factor:.2g} times too {size}, and so are all results; give the true size of the board's squares, and "
        "calibrate again"
    )


def people_lengths(frames: Mapping[str, Sequence[KeypointFrame]], rig: CameraRig) -> Float64:
    """Return lengths (n,) of people from the neck to the ankles, of two cameras each, in the unit of the rig."""
    found: list[float] = []
    for seen in shared_instants(frames):
        rays = {}
        for name, frame in seen.items():
            sources = sources_named(frame.topology.name)
            if sources is not None:
                origin, directions = rays_of(frame, rig.cameras[name])
                rays[name] = origin, np.where((sources >= 0)[:, None], directions[:, sources], np.nan)
        for one, other in combinations(rays, 2):
            (o, some), (p, others) = rays[one], rays[other]
            away = apart(some, others, p - o) / np.maximum(spread_of(some), 1e-9)[:, None]
            for i, j in zip(range(len(some)), away.argmin(axis=1) if away.size else (), strict=False):
                if away[i, j] < AGREES:
                    points = _crossings(o, some[i], p, others[j])
                    if np.isnan(points[_NECK]).any():  # not every detector has it
                        points[_NECK] = points[_SHOULDERS].mean(axis=0)
                    found += [float(np.linalg.norm(np.diff(points[chain], axis=0), axis=1).sum()) for chain in _CHAINS]
    lengths = np.array(found)
    known: Float64 = lengths[np.isfinite(lengths)]
    return known


def _crossings(o: Float64, some: Float64, p: Float64, others: Float64) -> Float64:
    """Return the points (keypoints, 3) on rays from ``o`` that are nearest to those from ``p``; NaN if unknown."""
    cosine = (some * others).sum(axis=-1)
    sine2 = 1.0 - cosine**2
    between = p - o
    s = ((some @ between) - cosine * (others @ between)) / np.where(sine2 > LEAST_SINE**2, sine2, np.nan)
    return np.where((s > 0.0)[:, None], o + s[:, None] * some, np.nan)
