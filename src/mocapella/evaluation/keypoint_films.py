"""Scores the method ``webcams`` with a detector on the films of a clip, and the lag of keypoints behind images.

Keypoint files of a clip need not begin with its films' first image. Their lag is measured without a reference: the
motion of keypoints between images is compared with the images' own motion at these places, see `lag_behind_images`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.detectors.keypoint_detector import PeopleDetector, frame_of
from mocapella.evaluation.keypoint_clips import KeypointClip, pose2sim_clip
from mocapella.evaluation.webcams import ClipFigures, score_clip
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.model.topology import topology
from mocapella.sensing.point_motion import grey, point_motion
from mocapella.settings import parse
from mocapella.sources.frame_set import FrameSet
from mocapella.sources.video_set import VideoSet
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

FILMS: Final = ("pose2sim_single_person",)
"""Clips whose films show all people of the reference."""
MOST_MEDIAN_MM: Final = 45.0
"""Largest median distance of the people in films to the reference of the same number of frame [mm]."""
LAGS: Final = 4
"""Largest lag that is searched, either way [frames]."""
FEWEST: Final = 8
"""Least number of moving points that tell about the lag."""
SCALE: Final = 0.5
"""Size of the images whose motion is measured."""
LEAST_PX: Final = 1.0
"""Least motion of a point between two images that tells about the lag [px of the scaled image]."""
MOST_PX: Final = 40.0
"""Motions are limited to this length, so that single errors count little [px of the scaled image]."""
LIMBS: Final = tuple(f"{side}{name}" for name in ("Elbow", "Wrist", "Knee", "Ankle") for side in "LR")
"""Joints whose motion tells the lag: they move most."""


class FilmFigures(msgspec.Struct, frozen=True):
    """Figures of a clip whose films a detector has seen.

    Attributes:
        as_is: compared with the reference of the same number of frame.
        aligned: compared with the reference of the same image, by the lag of the clip's own keypoints.
        reference_lag_frames: lag of the clip's own keypoints, and so of the reference, behind the images [frames].
        detector_lag_frames: lag of the detector's keypoints behind the images [frames].
    """

    as_is: ClipFigures
    aligned: ClipFigures
    reference_lag_frames: float
    detector_lag_frames: float


def score_films(
    folder: Path,
    name: str,
    make: Callable[[], PeopleDetector],
    settings: WebcamsSettings | None = None,
    on_instant: Callable[[int], None] = lambda number: None,
) -> FilmFigures:
    """Detect and track the people in a clip's films as `mocapella people` does, and score them.

    Args:
        folder: folder of the recordings.
        name: one of `FILMS`.
        make: makes a detector for a camera.
        settings: settings of the method; None for the defaults.
        on_instant: called with the number of each instant.

    Raises:
        InputError: a file is missing or has another format.
    """
    clip = pose2sim_clip(folder, name)
    films = films_of(folder, clip)
    frames = tuple(detected(films, make, settings, on_instant))
    count = min(len(frames), len(clip.frames))
    seen = msgspec.structs.replace(clip, rig=films.rig, frames=frames[:count], reference=clip.reference[:, :count])
    lags = [lag_behind_images(films, one, LAGS) for one in (clip.frames[:count], frames[:count])]
    return FilmFigures(
        score_clip(seen, settings), score_clip(shifted(seen, round(lags[0])), settings), lags[0], lags[1]
    )


def films_of(folder: Path, clip: KeypointClip) -> VideoSet:
    """Return the films of a Pose2Sim clip; where the right border is cut off, all pixels are as calibrated."""
    paths = {name: folder / clip.name / "videos" / f"cam{k:02d}.mp4" for k, name in enumerate(clip.rig.cameras, 1)}
    return VideoSet(paths, clip.rig, other_size="crop")


def detected(
    films: VideoSet,
    make: Callable[[], PeopleDetector],
    settings: WebcamsSettings | None,
    on_instant: Callable[[int], None],
) -> Iterator[tuple[KeypointFrame, ...]]:
    """Yield the keypoints of all cameras at each instant, searched where a tracker of them expects people."""
    detectors = {name: make() for name in films.rig.cameras}
    tracker = WebcamsTracker(films.rig, settings, sensors_expected=len(detectors))
    for number, shown in enumerate(films):
        on_instant(number)
        at_ns, row = shown.time_ns + 1, []  # a time of 0 is unknown
        regions = {name: tracker.expected_regions(name) for name in detectors}
        for name, image in shown.images.items():
            seen = detectors[name].update(image, at_ns / NS_PER_S, regions[name])
            frame = frame_of(seen, detectors[name].topology, name, at_ns, (image.shape[1], image.shape[0]))
            row.append(msgspec.structs.replace(frame, sequence=number))
            tracker.update(Arrival(row[-1], at_ns))
        yield tuple(row)


def shifted(clip: KeypointClip, lag: int) -> KeypointClip:
    """Return a clip whose reference of frame k is that of frame k + lag; without one at the ends."""
    count = len(clip.frames)
    reference = np.full_like(clip.reference, np.nan)
    first, last = max(0, -lag), min(count, count - lag)
    reference[:, first:last] = clip.reference[:, first + lag : last + lag]
    return msgspec.structs.replace(clip, reference=reference)


def lag_behind_images(
    films: Sequence[FrameSet] | VideoSet, frames: Sequence[Sequence[KeypointFrame]], most: int
) -> float:
    """Return by how many frames keypoints lag behind the images of their number, between frames by a parabola.

    The velocity of the limbs' keypoints (central differences) is correlated with the images' optical flow at the
    keypoints, for images up to ``most`` frames earlier or later. The lag has the largest correlation, over all cameras.

    Args:
        films: an image of each camera for each frame.
        frames: the keypoints of all cameras for each frame; of several people in an image, the most confident counts.
        most: largest lag that is searched [frames].

    Returns:
        The lag; NaN if too little moves.
    """
    greys: list[Mapping[str, UInt8]] = [
        {name: grey(image, SCALE) for name, image in one.images.items()} for one, _ in zip(films, frames, strict=False)
    ]
    tracks = [{frame.sensor: SCALE * _limbs(frame) for frame in row} for row in frames]
    lags = np.arange(-most, most + 1)
    own: list[list[Float64]] = [[] for _ in lags]
    flow: list[list[Float64]] = [[] for _ in lags]
    for k in range(most + 1, len(greys) - most - 1):
        for name, points in tracks[k].items():
            velocity = (tracks[k + 1][name] - tracks[k - 1][name]) / 2
            for i, lag in enumerate(lags.tolist()):
                image, before, after = (greys[k - lag + step][name] for step in (0, -1, 1))
                moved = (point_motion(image, after, points) - point_motion(image, before, points)) / 2
                own[i].append(velocity)
                flow[i].append(moved)
    agreement = [
        _correlation(np.concatenate(a), np.concatenate(b)) if a else np.nan for a, b in zip(own, flow, strict=True)
    ]
    return peak(lags, np.array(agreement))


def peak(places: NDArray[np.int64], values: Float64) -> float:
    """Return the place of the largest value, by a parabola through it and its neighbours; NaN if all are unknown."""
    if not np.isfinite(values).any():
        return float("nan")
    i = int(np.nanargmax(values))
    if i in (0, len(values) - 1):
        return float(places[i])
    before, top, after = values[i - 1 : i + 2]
    bend = before - 2 * top + after
    step = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(places[i] + step)


def _limbs(frame: KeypointFrame) -> Float64:
    """Return the pixels (limbs, 2) of the most confident person's limbs; NaN where not seen."""
    single = frame.topology.single_joints("halpe_26")
    halpe = topology("halpe_26")
    out = np.full((len(LIMBS), 2), np.nan)
    if not len(frame.ids):
        return out
    person = frame.positions_px[int(np.argmax(frame.confidences.sum(axis=1)))]
    for k, name in enumerate(LIMBS):
        own = halpe.index(name) if frame.topology.name == halpe.name else single.get(halpe.index(name))
        if own is not None:
            out[k] = person[own]
    return out


def _correlation(own: Float64, flow: Float64) -> float:
    """Return the correlation of velocities (n, 2) with the motion (n, 2) of the images; NaN if too little moves."""
    known = np.isfinite(own).all(axis=1) & np.isfinite(flow).all(axis=1)
    known &= np.linalg.norm(flow, axis=1) >= LEAST_PX
    if known.sum() < FEWEST:
        return float("nan")
    a, b = (np.clip(values[known], -MOST_PX, MOST_PX).ravel() for values in (own, flow))
    return float(np.corrcoef(a, b)[0, 1]) if a.std() > 0 and b.std() > 0 else float("nan")


def evaluate_films(
    data: Path,
    make: Callable[[], PeopleDetector],
    settings: Mapping[str, Any] | None = None,
    on_run: Callable[[str], None] = lambda text: None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Score the films of all `FILMS`.

    Args:
        data: folder of the recordings.
        make: makes a detector for a camera.
        settings: settings of the method; None for the defaults.
        on_run: called with the next step, in words.

    Returns:
        `FilmFigures` by clip as JSON types, and whether each target is met, as `mocapella.evaluation.webcams.judged`.

    Raises:
        InputError: a file of the clips is missing or has another format.
        SettingsError: an unknown setting.
    """
    own = parse(WebcamsSettings, settings or {}, where="settings of webcams")
    found, targets = {}, {}
    for name in FILMS:

        def tell(number: int, name: str = name) -> None:
            on_run(f"films of {name}, image {number}")

        figures = score_films(data, name, make, own, tell)
        found[name] = msgspec.to_builtins(figures)
        value = figures.as_is.people[0].median_mm
        row = {"value": value, "limit": MOST_MEDIAN_MM, "kind": "most", "met": value <= MOST_MEDIAN_MM}
        targets[f"films of {name}: median_mm"] = row
    return found, targets
