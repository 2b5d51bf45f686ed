"""Score the method ``hands`` on rendered images with ground truth, with colours learnt as by a user who points.

The pipeline is the live one: images → markers → rays → hand, with the cameras' own frames in the order of their times.
The tracker's result after each frame is compared with the hand at the instant of the newest processed pixel. The
person's bones, the base marker's position and the rig are known exactly, so their errors are not part of the score.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.model.hand import TIPS
from mocapella.model.observations import Arrival
from mocapella.settings import parse
from mocapella.sources.simulate.hand_camera import SimulatedHandCamera
from mocapella.sources.simulate.hand_motion import landmarks_of
from mocapella.sources.simulate.hand_scene import base_places, hand_scene_names, load_hand_scene
from mocapella.tracker.hands import HandsSettings, HandsTracker

Float64 = NDArray[np.float64]

BEGIN_S: Final = 10.0
"""Colours are learnt from the images before this time; the hand must be found within `SETTLE_S` after it [s]."""
SETTLE_S: Final = 0.3
LASTS_S: Final = 3.0
CLEARLY: Final = 0.6
"""A marker must be found if at least this fraction of it is visible, 0 to 1."""
NEAR_PX: Final = 6.0
"""A detection farther from the marker's true position is a false one [px]."""


def evaluate(
    scenes: Sequence[str] | None,
    seeds: Sequence[int],
    settings: Mapping[str, Any] | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Return scores by scene: for each seed, and for all seeds together.

    Args:
        scenes: names of the scenes; None for all but the demo's.
        seeds: random seeds of motion, light and noise.
        settings: fields of `HandsSettings`, by name.
        tell: called with the current step, in words.

    Returns:
        ``scenes``: figures by scene, then by seed (as text) and ``all``; their names contain the unit. Also ``seeds``,
        and ``seconds``, the scored duration of a scene.

    Raises:
        SettingsError: no such scene or setting, or no seed.
    """
    known = [name for name in hand_scene_names() if name != "demo"]
    wanted = list(scenes) if scenes is not None else known
    for name in wanted:
        if name not in known:
            raise SettingsError(f"unknown scene {name!r}; known: {one_of(name, known)}")
    if not seeds:
        raise SettingsError("no seed; give at least one, such as 0")
    found: dict[str, Any] = {}
    for name in wanted:
        runs = []
        for seed in seeds:
            tell(f"{name}, seed {seed}")
            runs.append(run(name, seed, settings))
        found[name] = {
            "all": _scores(_together(runs)),
            **{str(s): _scores(r) for s, r in zip(seeds, runs, strict=True)},
        }
    return {"scenes": found, "seeds": list(seeds), "seconds": LASTS_S}


FrameRows = dict[str, Float64]


def run(name: str, seed: int, settings: Mapping[str, Any] | None = None) -> FrameRows:
    """Track one simulated scene; return the errors as arrays, by name.

    Args:
        name: name of the scene.
        seed: random seed of motion, light and noise.
        settings: fields of `HandsSettings`, by name.

    Returns:
        For each camera frame and marker, (frames, markers): whether it must be found, ``wanted``, is ``found``, or is
        detected in a wrong place, ``false``; and its error ``off_px``. For each frame after `SETTLE_S`: errors
        ``marker_mm`` and ``depth_percent`` (frames, 5) of the triangulated fingertips; errors of the hand,
        ``landmark_mm`` (frames, 21), ``tip_off_m`` (frames, 5, 3) less their mean, and ``angle_deg`` (frames, 21). NaN
        where there is no marker or hand.
    """
    scene = load_hand_scene(name, seed=seed)
    given = {"base_places_m": base_places(scene).tolist(), "tips": scene.names[:5], "base": scene.names[5:]}
    values = parse(HandsSettings, {**given, **(settings or {})}, where="settings of hands")
    tracker = HandsTracker(scene.rig, values, shape=scene.shape)
    cameras = [SimulatedHandCamera(scene, camera) for camera in scene.cameras]
    rows: dict[str, list[Any]] = {key: [] for key in _KEYS}
    newest_s = -np.inf
    z = min(camera.position_m[2] for camera in scene.cameras.values())
    for frame in heapq.merge(
        *(camera.frames(BEGIN_S, BEGIN_S + LASTS_S) for camera in cameras), key=lambda frame: frame.due_s
    ):
        told = tracker.update(Arrival(frame.frame, frame.frame.time_ns))
        camera = scene.cameras[frame.frame.sensor]
        px = frame.frame.positions_px[frame.frame.found, 1]
        late_s = camera.readout_s * float(px.max()) / max(camera.size_px[1] - 1, 1) if len(px) else 0.0
        newest_s = max(newest_s, frame.frame.time_ns / NS_PER_S + late_s)
        clearly = frame.shot.visible >= CLEARLY
        off = np.linalg.norm(frame.frame.positions_px - frame.shot.centres_px, axis=-1)
        rows["wanted"].append(clearly)
        rows["found"].append(clearly & (off <= NEAR_PX))
        rows["false"].append(frame.frame.found & ~(off <= NEAR_PX))
        rows["off_px"].append(np.where(frame.shot.visible > 0.95, off, np.nan))
        if frame.due_s < BEGIN_S + SETTLE_S:
            continue
        pose = scene.motion.at(newest_s - 1e-9)
        truth = landmarks_of(scene.model, scene.shape, pose)
        there = told.hands[0] if told.hands else None
        points = told.points.positions[:5] if told.points is not None else np.full((5, 3), np.nan)
        rows["marker_mm"].append(1e3 * np.linalg.norm(points - truth[list(TIPS)], axis=-1))
        rows["depth_percent"].append(100 * np.abs((z - points[:, 2]) / (z - truth[list(TIPS), 2]) - 1))
        landmarks = there.landmarks if there else np.full((21, 3), np.nan)
        rows["landmark_mm"].append(1e3 * np.linalg.norm(landmarks - truth, axis=-1))
        rows["tip_off_m"].append((landmarks - truth)[list(TIPS)])
        rows["angle_deg"].append(np.degrees(np.abs(there.angles - pose.angles)) if there else np.full(21, np.nan))
    made = {key: np.array(values) for key, values in rows.items()}
    made["tip_off_m"] -= np.nanmean(made["tip_off_m"], axis=0)  # a constant error is no jitter
    return made


_KEYS: Final = (
    *("wanted", "found", "false", "off_px"),
    *("marker_mm", "depth_percent", "landmark_mm", "tip_off_m", "angle_deg"),
)


def _together(runs: Sequence[FrameRows]) -> FrameRows:
    return {key: np.concatenate([run[key] for run in runs]) for key in _KEYS}


def _scores(run: FrameRows) -> dict[str, float]:
    tips = run["landmark_mm"][:, list(TIPS)]
    return {
        "found_percent": 100 * float(run["found"].sum() / max(run["wanted"].sum(), 1)),
        "false_percent": 100 * float(run["false"].mean()),
        "centre_px_median": float(np.nanmedian(run["off_px"])),
        "marker_mm_median": float(np.nanmedian(run["marker_mm"])),
        "marker_mm_p95": float(np.nanpercentile(run["marker_mm"], 95)),
        "marker_lost_percent": 100 * float(np.isnan(run["marker_mm"]).mean()),
        "tip_mm_median": float(np.nanmedian(tips)),
        "tip_mm_p95": float(np.nanpercentile(tips, 95)),
        "landmark_mm_median": float(np.nanmedian(run["landmark_mm"])),
        "depth_percent_mean": float(np.nanmean(run["depth_percent"])),
        "angle_deg_median": float(np.nanmedian(run["angle_deg"])),
        "angle_deg_p95": float(np.nanpercentile(run["angle_deg"], 95)),
        "jitter_mm": 1e3 * float(np.sqrt(np.nanmean(np.sum(run["tip_off_m"] ** 2, axis=-1)))),
        "hand_lost_percent": 100 * float(np.isnan(run["landmark_mm"]).all(axis=-1).mean()),
    }
