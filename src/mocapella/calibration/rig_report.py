"""Describe the quality of a rig in a table and sentences, for terminal, view and JSON.

It gives reprojection errors, uncertainty of extrinsics and focal length, and errors of triangulated distances.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from itertools import combinations
from typing import Any, Final

import msgspec
import numpy as np

from mocapella.calibration.cameras import CameraCalibration
from mocapella.calibration.parallel_alignment import align_pair

NEARLY_PARALLEL_DEG: Final = 20.0
"""Largest angle between the axes of two cameras that are reported as a parallel pair."""
HEADINGS: Final = (
    ("camera", ""), ("views", ""), ("fields", "%"), ("own", "px"), ("all", "px"), ("place", "± mm"), ("turn", "± °"),
    ("focal", "± %"), ("from 1st", "m"),
)  # fmt: skip
"""Columns of `table`: heading and unit; docs/cameras.md explains them."""


def table(found: CameraCalibration) -> list[tuple[str, ...]]:
    """Return a row of texts for each camera, in the columns `HEADINGS`."""
    first, rows = next(iter(found.rig.cameras)), []
    for name, of in found.cameras.items():
        figures = (of.own_px, of.reprojection_px, of.position_sd_mm, of.rotation_sd_deg, of.focal_sd_percent)
        apart = f"{distance(found, first, name):.3f}"
        rows.append((name, str(of.views), f"{100 * of.fields:.0f}", *(f"{value:.2f}" for value in figures), apart))
    return rows


def sentences(found: CameraCalibration) -> list[str]:
    """Describe the errors of the corners in millimetres, and the alignment of a parallel pair; empty without either."""
    fit, out = found.fit, []
    if fit.points:
        out.append(
            f"{fit.points} corners of {found.shared_instants} instants triangulated one by one: distances within "
            f"{fit.distance_rms_mm:.2f} mm (RMS), reprojection {fit.reprojection_median_px:.2f} px (median)"
        )
    if found.left_out:
        halves = " and ".join(f"{half.distance_rms_mm:.2f}" for half in found.left_out)
        expected = " and ".join(f"{half.predicted_rms_mm:.2f}" for half in found.left_out)
        out.append(f"each half by the other: {halves} mm (RMS; expected {expected})")
    pair = pair_of(found)
    if pair is not None:
        out.append(
            f"pair: axes {pair['axes_deg']:.2f}° apart, baseline {1e3 * pair['baseline_m']:.1f} mm, vertical disparity "
            f"up to {pair['vertical_px']:.1f} px"
        )
        out += pair["advice"]
    return out


def tape_measure(found: CameraCalibration) -> str:
    """Describe the distances between cameras, so that users can check the board's size; empty for one camera."""
    names: Sequence[str] = list(found.rig.cameras)
    said = [f"{a} – {b} {distance(found, a, b):.3f} m" for a, b in combinations(names, 2)]
    if not said:
        return ""
    return f"compare with a tape measure: {', '.join(said)}; if they differ, correct the board's square"


def as_result(found: CameraCalibration) -> dict[str, Any]:
    """Return all results as values for JSON; unknown numbers are null."""
    names = list(found.rig.cameras)
    cameras = {}
    for name in names:
        placed = found.rig.cameras[name]
        cameras[name] = asdict(found.cameras[name]) | {
            "size_px": list(placed.camera.size_px),
            "lens": placed.camera.lens.tolist(),
            "T_camera_world": placed.T_camera_world.tolist(),
            "distance_to_first_m": distance(found, names[0], name),
        }
    result: dict[str, Any] = _finite(
        {
            "cameras": cameras,
            "instants": found.instants,
            "shared_instants": found.shared_instants,
            "sigma_px": found.sigma_px,
            "dispersion": found.dispersion,
            "fit": asdict(found.fit),
            "left_out": None if found.left_out is None else [asdict(half) for half in found.left_out],
            "pair": pair_of(found),
            "hints": [msgspec.to_builtins(hint) for hint in found.hints],
        }
    )
    return result


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def distance(found: CameraCalibration, a: str, b: str) -> float:
    """Return the distance between the cameras named a and b [m]."""
    T_a, T_b = (found.rig.cameras[name].T_camera_world for name in (a, b))
    at_a, at_b = (-T[:3, :3].T @ T[:3, 3] for T in (T_a, T_b))
    return float(np.linalg.norm(at_a - at_b))


def pair_of(found: CameraCalibration) -> dict[str, Any] | None:
    """Return the alignment of two nearly parallel cameras as values for JSON; None for other rigs.

    The values are the fields of `PairAlignment`, the cameras' names ``first`` and ``second``, and ``advice``.
    """
    if len(found.rig.cameras) != 2:
        return None
    (first, a), (second, b) = found.rig.cameras.items()
    pair = align_pair(a, b)
    if pair.axes_deg > NEARLY_PARALLEL_DEG:
        return None
    return asdict(pair) | {"first": first, "second": second, "advice": pair.advice(first, second)}
