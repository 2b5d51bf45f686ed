"""Compares triangulated points with the results of Caliscope and Pose2Sim from the same detections.

The detections are 2D keypoints of sample recordings; equal inputs make the programs' triangulations comparable.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import MOST_TABLE_BYTES, decode_csv, read_whole
from mocapella.errors import InputError
from mocapella.fusion.point_tracks import TracksSettings, triangulate_tracks
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.point_tracks import SpaceTracks
from mocapella.recording.image_tracks_file import read_image_tracks
from mocapella.recording.trc_file import read_trc

Float64 = NDArray[np.float64]

LINEAR_HOLISTIC: Final = TracksSettings("linear", largest_error_px=40.0)
WEIGHTED_LINEAR: Final = TracksSettings("weighted-linear")
HANDS: Final = (100, 200)
"""First of Caliscope's numbers of the 21 landmarks of the right and of the left hand; the body's 33 begin at 0."""
HAND_BONES: Final = tuple(
    (0 if joint == 1 else 4 * finger + joint - 1, 4 * finger + joint) for finger in range(5) for joint in range(1, 5)
)
"""Bones of a hand as pairs of indices of its 21 landmarks: the wrist, and four landmarks of each digit."""
BODY_LANDMARKS, HAND_LANDMARKS = 33, 21


class Agreement(msgspec.Struct, frozen=True):
    """Comparison of points with a reference.

    Attributes:
        compared: number of points in both.
        reference: number of points in the reference.
        median_mm, p95_mm: median and 95th percentile of the distances [mm].
        within_1_mm: share of the reference's points with ours within 1 mm.
    """

    compared: int
    reference: int
    median_mm: float
    p95_mm: float
    within_1_mm: float


class BoneLengthVariation(msgspec.Struct, frozen=True):
    """Median over the bones of both hands of the coefficient of variation of a bone's length.

    Attributes:
        ours: coefficient (standard deviation over mean) of all our points.
        reference: coefficient of all points of the reference.
        reference_where_ours: coefficient of the points of the reference that we have, too.
    """

    ours: float
    reference: float
    reference_where_ours: float


def agreement(ours: Float64, reference: NDArray[np.floating]) -> Agreement:
    """Compare points (..., 3) with a reference (..., 3) in the same frame [m]; missing points are NaN.

    At least one point must be in both.
    """
    there = np.isfinite(reference).all(axis=-1)
    distances = 1000.0 * np.linalg.norm(ours - reference, axis=-1)[there]
    both = distances[np.isfinite(distances)]
    median, p95 = np.percentile(both, [50, 95])
    return Agreement(len(both), int(there.sum()), float(median), float(p95), float((distances <= 1.0).mean()))


def holistic(folder: Path, settings: TracksSettings = LINEAR_HOLISTIC) -> tuple[Agreement, BoneLengthVariation]:
    """Triangulate the hands and the body of ``mediapipe_holistic_4cam``, and compare them with Caliscope's points.

    Args:
        folder: folder of that sample recording.
        settings: settings of the triangulation.

    Returns:
        The distances of hands and body from Caliscope's points, and the variation of bone lengths of the hands, of both
        programs.

    Raises:
        InputError: a file is missing or has another format.
    """
    recording = folder / "recording_1" / "HOLISTIC"
    tracks = read_image_tracks([recording / "xy_HOLISTIC.csv"])
    space, _ = triangulate_tracks(tracks, load_camera_rig(folder / "config.toml"), settings)
    reference = caliscope_points(recording / "xyz_HOLISTIC.csv", space)
    numbers = np.array([int(name) for name in space.points])
    chosen = (numbers < BODY_LANDMARKS) | np.isin(numbers, [b + i for b in HANDS for i in range(HAND_LANDMARKS)])
    ours = space.positions
    shared = np.where(np.isfinite(ours), reference, np.nan)
    steady = BoneLengthVariation(*(variation(points, numbers) for points in (ours, reference, shared)))
    return agreement(ours[:, chosen], reference[:, chosen]), steady


def variation(points: Float64, numbers: NDArray[np.int64]) -> float:
    """Return the median over the hands' bones of the coefficient of variation of a bone's length.

    Args:
        points: (frames, points, 3) [m]; frames without a bone do not count for that bone.
        numbers: (points,) Caliscope's numbers of the points; all landmarks of both hands are among them.
    """
    places = {int(number): p for p, number in enumerate(numbers)}
    found = []
    for base in HANDS:
        for a, b in HAND_BONES:
            lengths = np.linalg.norm(points[:, places[base + a]] - points[:, places[base + b]], axis=-1)
            found.append(np.nanstd(lengths) / np.nanmean(lengths))
    return float(np.median(found))


def caliscope_points(path: Path, space: SpaceTracks) -> Float64:
    """Read points (frames, points, 3) from Caliscope's CSV [m]; NaN if missing.

    Args:
        path: the CSV.
        space: gives frames and points, and their order; points that it lacks are left out.

    Raises:
        InputError: the file is no such CSV, or has a frame that ``space`` lacks.
    """
    frames, points = ({value: i for i, value in enumerate(values)} for values in (space.frames.tolist(), space.points))
    result = np.full(space.positions.shape, np.nan)
    try:
        for _, row in decode_csv(read_whole(path, fix="give its xyz CSV", most_bytes=MOST_TABLE_BYTES), file=path)[1]:
            if row["point_id"] in points:
                place = frames[int(row["sync_index"])], points[row["point_id"]]
                result[place] = [float(row[f"{axis}_coord"]) for axis in "xyz"]
    except (KeyError, ValueError) as error:
        raise InputError(f"not Caliscope's points: {error}", file=path, fix="give its xyz CSV") from error
    return result


def single_person(folder: Path, settings: TracksSettings = WEIGHTED_LINEAR) -> Agreement:
    """Triangulate ``pose2sim_single_person``, and compare all points with Pose2Sim's unfiltered TRC.

    Args:
        folder: folder of that sample recording.
        settings: settings of the triangulation.

    Raises:
        InputError: a file is missing or has another format.
    """
    tracks = read_image_tracks(sorted((folder / "pose-associated").glob("*_json")))
    space, _ = triangulate_tracks(tracks, load_camera_rig(folder / "calibration" / "Calib_qualisys.toml"), settings)
    (path,) = (p for p in (folder / "pose-3d").glob("*.trc") if "filt" not in p.name)
    reference = read_trc(path)
    ours = space.positions[: len(reference), [space.points.index(name) for name in reference.keypoints]]
    return agreement(ours, reference.positions[:, 0][..., [2, 0, 1]])  # its Y is the world's z
