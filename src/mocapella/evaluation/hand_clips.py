"""Scores the hands of the method ``webcams`` on a recording of two webcams, which has no reference.

The recording is ``stereo_hand_webcams`` (T. Batpurev, *handpose3d*): a bare hand over a desk, its cameras 74° apart.
Without a reference, the figures are of consistency: the distance of the hand from detections that the tracker did not
get, and its jitter. The unit of the calibration is not stated, so the hand is scaled to an average palm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.hand_keypoints import hand_sources
from mocapella.conventions import NS_PER_S
from mocapella.decoding import read_whole
from mocapella.detectors.keypoint_detector import PeopleDetector
from mocapella.errors import InputError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.geometry.triangulation import triangulate, views
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.hand import LANDMARKS, PARENTS, hand_model
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import TrackedHand
from mocapella.model.topology import topology
from mocapella.sources.video import pictures
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings

Float64 = NDArray[np.float64]

CLIP: Final = "stereo_hand_webcams"
CLIP_HZ: Final = 30.0
CLIP_PX: Final = (720, 720)
WITHHELD_EVERY: Final = 5
"""Every so many instants, the frame of one camera is withheld, in turns."""
MOST_TEXT: Final = 100_000
_FIX: Final = f"name the folder that has {CLIP}"
_WRIST, _MIDDLE = 0, 9
_SD_PX: Final = 8.0
"""Standard deviation of a detected landmark's coordinates [px]."""


class HandClip(msgspec.Struct, frozen=True, eq=False):
    """Detections of a hand in the images of two cameras at the same instants.

    Attributes:
        rig: the cameras, scaled to an average palm.
        frames: for each instant, the frames of the cameras in the order of the rig.
    """

    rig: CameraRig
    frames: tuple[tuple[KeypointFrame, ...], ...]


class HandClipFigures(msgspec.Struct, frozen=True):
    """Figures of a recording without a reference; % of a hand are relative to its longer side in the image.

    Attributes:
        instants: number of instants.
        detected_percent: instants when all cameras detect a hand [%].
        followed_percent: instants with a hand, from the first of these on [%].
        ids: number of different ids.
        measured_percent: landmarks given as measured, of the instants with a hand [%].
        bones_percent: standard deviation of the triangulated bones' lengths over the instants, relative to their means:
            of the detections, not of the fitted hand, whose bones are rigid [%].
        seen_px, seen_percent: median distance of the hand from the detections that it was fitted to [px, % of a hand].
        withheld_px, withheld_percent, withheld_p95_percent: median and 95th percentile of the distance from detections
            of a camera whose frame was withheld [px, % of a hand].
        jitter_mm: root mean square of the second difference of the landmarks over time, over √6, at the assumed scale
            [mm].
        detections_jitter_mm: the same of the triangulated detections [mm].
    """

    instants: int
    detected_percent: float
    followed_percent: float
    ids: int
    measured_percent: float
    bones_percent: float
    seen_px: float
    seen_percent: float
    withheld_px: float
    withheld_percent: float
    withheld_p95_percent: float
    jitter_mm: float
    detections_jitter_mm: float


def read_hand_clip(
    folder: Path, detector: Callable[[], PeopleDetector], on_image: Callable[[str], None] = lambda text: None
) -> HandClip:
    """Detect the hands in the films of the recording.

    Args:
        folder: folder of the recordings, with `CLIP`.
        detector: makes a detector of hands, for each film.
        on_image: called with the next step, in words.

    Raises:
        InputError: a file is missing or has another format.
    """
    own, cameras = folder / CLIP, {}
    placed = [_camera(own, c) for c in range(2)]
    for c, one in enumerate(placed):
        made, rows = detector(), []
        on_image(f"{CLIP}, film {c + 1} of 2")
        for k, image in pictures(own / f"cam{c}_test.mp4"):
            seen = made.update(image, k / CLIP_HZ)
            rows.append(
                keypoint_frame(
                    one.camera.name, made.topology, time_ns=round((1.0 + k / CLIP_HZ) * NS_PER_S), size_px=CLIP_PX,
                    positions_px=seen.positions_px, sequence=k,
                    confidences=seen.confidences if len(seen.confidences) else 1.0,
                )
            )  # fmt: skip
        cameras[one.camera.name] = rows
    frames = tuple(zip(*cameras.values(), strict=False))
    return HandClip(scaled({one.camera.name: one for one in placed}, frames), frames)


def scaled(cameras: dict[str, PlacedCamera], frames: Sequence[Sequence[KeypointFrame]]) -> CameraRig:
    """Return a rig in metres, from one in an unknown unit: the palm is that of an average hand.

    Raises:
        InputError: no instant has a hand in all images.
    """
    points = triangulated(CameraRig(cameras), frames)
    palms = np.linalg.norm(points[:, _MIDDLE] - points[:, _WRIST], axis=1)
    palms = palms[np.isfinite(palms)]
    if not len(palms):
        raise InputError("no hand is seen by two cameras", field=CLIP, fix=_FIX)
    unit_m = float(np.linalg.norm(hand_model("full").shape("right").bases[2])) / float(np.median(palms))
    rig = {}
    for name, one in cameras.items():
        T = one.T_camera_world.copy()
        T[:3, 3] *= unit_m
        rig[name] = PlacedCamera(one.camera, T, one.covariance)
    return CameraRig(rig)


def triangulated(rig: CameraRig, frames: Sequence[Sequence[KeypointFrame]]) -> Float64:
    """Triangulate the first hand of each frame: landmarks (instants, 21, 3); NaN where the cameras do not agree."""
    cameras = views(
        [one.camera.lens for one in rig.cameras.values()], [one.T_camera_world for one in rig.cameras.values()]
    )
    pixels = np.array([[_first(frame) for frame in instant] for instant in frames])
    return triangulate(np.moveaxis(pixels, 1, 2), cameras, _SD_PX).points


def score_hand_clip(clip: HandClip, settings: WebcamsSettings | None = None) -> HandClipFigures:
    """Track a recording twice, once with all frames and once with some withheld, and score the hands.

    Args:
        clip: the recording.
        settings: settings of the method; None for the defaults.
    """
    hands = _tracked(clip, settings, withhold=False)
    seen = [_reprojected(clip, k, c, hands[k]) for k in range(len(hands)) for c in range(len(clip.rig.cameras))]
    others = _tracked(clip, settings, withhold=True)
    withheld = [
        _reprojected(clip, k, c, others[k])
        for k in range(len(others))
        for c in range(len(clip.rig.cameras))
        if _is_withheld(k, c, len(clip.rig.cameras))
    ]
    points = triangulated(clip.rig, clip.frames)
    lengths = np.array([np.linalg.norm(points[:, b] - points[:, a], axis=1) for b, a in enumerate(PARENTS) if a >= 0])
    there = [hand is not None for hand in hands]
    first = there.index(True) if any(there) else len(there)
    known = [hand for hand in hands if hand is not None]
    both = [all(len(frame.ids) for frame in instant) for instant in clip.frames]
    landmarks = np.array([np.full((len(LANDMARKS), 3), np.nan) if hand is None else hand.landmarks for hand in hands])
    seen_px, far_px = (np.concatenate([[], *(one[0] for one in rows)]) for rows in (seen, withheld))
    seen_share, far_share = (np.concatenate([[], *(one[1] for one in rows)]) for rows in (seen, withheld))
    return HandClipFigures(
        len(hands), 100.0 * float(np.mean(both)), 100.0 * float(np.mean(there[first:])) if known else 0.0,
        len({hand.id for hand in known}),
        100.0 * float(np.mean([hand.states == JointState.TRACKED for hand in known])) if known else 0.0,
        100.0 * float(np.nanmedian(np.nanstd(lengths, axis=1) / np.nanmean(lengths, axis=1))),
        _middle(seen_px, 50), 100 * _middle(seen_share, 50), _middle(far_px, 50), 100 * _middle(far_share, 50),
        100 * _middle(far_share, 95), 1e3 * _jitter(landmarks), 1e3 * _jitter(points),
    )  # fmt: skip


def _is_withheld(k: int, camera: int, cameras: int) -> bool:
    return k % WITHHELD_EVERY == WITHHELD_EVERY - 1 and k // WITHHELD_EVERY % cameras == camera


def _tracked(clip: HandClip, settings: WebcamsSettings | None, *, withhold: bool) -> list[TrackedHand | None]:
    """Return the first hand after each instant; None without one."""
    tracker = WebcamsTracker(clip.rig, settings, sensors_expected=len(clip.rig.cameras))
    out: list[TrackedHand | None] = []
    for k, instant in enumerate(clip.frames):
        hands: Sequence[TrackedHand] = ()
        for c, frame in enumerate(instant):
            if not (withhold and _is_withheld(k, c, len(instant))):
                hands = tracker.update(Arrival(frame, frame.time_ns)).hands
        out.append(hands[0] if hands else None)
    return out


def _reprojected(clip: HandClip, k: int, camera: int, hand: TrackedHand | None) -> tuple[Float64, Float64]:
    """Return the distances of a camera's detected landmarks from the hand [px], and over the hand's side."""
    frame = clip.frames[k][camera]
    px = _first(frame)
    if hand is None or not np.isfinite(px).any():
        return np.empty(0), np.empty(0)
    placed = clip.rig.cameras[frame.sensor]
    away = np.linalg.norm(project(apply(placed.T_camera_world, hand.landmarks), placed.camera.lens) - px, axis=1)
    away = away[np.isfinite(away)]
    side = float((np.nanmax(px, axis=0) - np.nanmin(px, axis=0)).max())
    return away, away / side


def _first(frame: KeypointFrame) -> Float64:
    """Return the pixels (21, 2) of the first hand of a frame; NaN without one."""
    ((_, source),) = hand_sources(topology("hand").name)
    if not len(frame.ids):
        return np.full((len(LANDMARKS), 2), np.nan)
    return np.asarray(frame.positions_px[0, source], dtype=np.float64)


def _jitter(points: Float64) -> float:
    """Return the jitter of landmarks (instants, 21, 3), as in `HandClipFigures` [m]; NaN if no three are in a row."""
    second = points[2:] - 2.0 * points[1:-1] + points[:-2]
    known = second[np.isfinite(second).all(axis=-1)]
    return float(np.sqrt((known**2).sum(axis=-1).mean() / 6.0)) if len(known) else np.nan


def _middle(values: Float64, percent: float) -> float:
    return float(np.percentile(values, percent)) if len(values) else np.nan


def _camera(folder: Path, number: int) -> PlacedCamera:
    """Read the lens and the pose of a camera, in the unit of the files."""
    where = folder / "camera_parameters"
    lens = read_numbers(where / f"c{number}.dat")
    pose = read_numbers(where / f"rot_trans_c{number}.dat")
    if len(lens) != 14 or len(pose) < 12:
        raise InputError("has other numbers than a camera's", file=where, fix=_FIX)
    own = np.array([lens[0], lens[4], lens[2], lens[5], *lens[9:14]])
    T = rigid(np.array(pose[:9]).reshape(3, 3), np.array(pose[9:12]))
    return PlacedCamera(Camera(f"cam{number}", CLIP_PX, own), T, np.full((6, 6), np.nan))


def read_numbers(path: Path) -> list[float]:
    """Return the finite numbers of a text file; all other words are left out.

    Raises:
        InputError: the file cannot be read, or is too large.
    """
    text = read_whole(path, fix=_FIX, most_bytes=MOST_TEXT).decode("ascii", errors="replace")
    out = []
    for word in text.split():
        try:
            value = float(word)
        except ValueError:
            continue
        if math.isfinite(value):
            out.append(value)
    return out
