"""Scores the method ``webcams`` on simulated crowds and on Pose2Sim's clips (docs/evaluation.md, *Webcams*)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.evaluation.keypoint_clips import CLIPS, POSE2SIM_HZ, KeypointClip, pose2sim_clip
from mocapella.evaluation.people_scores import PeopleFigures, PeopleScore, match_people
from mocapella.evaluation.simulation import Tracked
from mocapella.model.camera import CameraRig
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Person
from mocapella.settings import parse
from mocapella.sources.simulate.crowd import CrowdScene, crowd_names, crowd_scene
from mocapella.sources.simulate.keypoint_camera import SimulatedKeypoints
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings, numbered_time_sd_s

Float64 = NDArray[np.float64]

EIGHT: Final = "six-walk/8"
"""The scene ``six-walk`` with eight cameras; a number after a scene's name is that of the cameras."""
TARGETS: Final[Mapping[str, tuple[str, float]]] = {
    "hota": ("least", 0.95),
    "switches": ("most", 0),
    "visible_mm": ("most", 35.0),
}
"""Targets of the scenes of six people, ``six-walk`` and `EIGHT`."""
CLIP_TARGETS: Final[Mapping[str, tuple[float, float]]] = {
    "pose2sim_two_people": (35.0, 110.0),
    "pose2sim_single_person": (25.0, 80.0),
}
"""Largest median and 95th percentile of each person's distance to the authors' result, by clip [mm]."""
LEAST_PRESENT: Final = 97.0
"""Least share of a clip's frames where each person is found [%]."""


class ClipPerson(msgspec.Struct, frozen=True):
    """One person of a clip against the authors' result.

    Attributes:
        present_percent: frames where the person is found [%].
        median_mm, p95_mm: median and 95th percentile of the distance of all joints of the reference [mm].
        ids: number of different numbers that the person had.
    """

    present_percent: float
    median_mm: float
    p95_mm: float
    ids: int


class ClipFigures(msgspec.Struct, frozen=True):
    """Figures of a clip.

    Attributes:
        people: of each person of the reference.
        others_percent: people found beyond the reference's, relative to the frames [%].
        measured_percent: joints of found people given as measured [%].
    """

    people: tuple[ClipPerson, ...]
    others_percent: float
    measured_percent: float


def evaluate(
    scenes: Sequence[str] | None = None,
    seeds: Sequence[int] = (0,),
    settings: Mapping[str, Any] | None = None,
    data: Path | None = None,
    on_run: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Score the method.

    Args:
        scenes: names of simulated scenes, with ``/N`` for N cameras; None for all.
        seeds: random seeds of the scenes.
        settings: settings of the method; None for the defaults.
        data: folder of the recordings; None leaves the clips out.
        on_run: called with the next step, in words.

    Returns:
        ``scenes``, ``clips``, ``seeds`` and ``targets``, as docs/evaluation.md describes.

    Raises:
        SettingsError: an unknown scene or setting, or no seed.
        InputError: a file of the clips is missing or has another format.
    """
    names = [*crowd_names(), EIGHT] if scenes is None else list(scenes)
    if not seeds or min(seeds) < 0:
        raise SettingsError(f"seeds {list(seeds)} cannot be used; give one or more of 0, 1, 2, …")
    chosen = [scene_and_cameras(name) for name in names]
    own = parse(WebcamsSettings, settings or {}, where="settings of webcams")
    result: dict[str, Any] = {"seeds": list(seeds), "scenes": {}, "clips": {}}
    for name, (scene, cameras) in zip(names, chosen, strict=True):
        runs = []
        for seed in seeds:
            on_run(f"{name}, seed {seed}")
            runs.append(msgspec.to_builtins(score_scene(crowd_scene(scene, seed=seed, cameras=cameras), own)))
        result["scenes"][name] = {"mean": _mean(runs), "runs": runs}
    if data is not None:
        films = {"time_sd_s": numbered_time_sd_s(POSE2SIM_HZ), **(settings or {})}
        own = parse(WebcamsSettings, films, where="settings of webcams")
        for name in CLIPS:
            on_run(name)
            result["clips"][name] = msgspec.to_builtins(score_clip(pose2sim_clip(data, name), own))
    result["targets"] = judged(result)
    return result


def score_scene(
    scene: CrowdScene, settings: WebcamsSettings | None = None, tracker: Tracked | None = None
) -> PeopleFigures:
    """Track a simulated scene, and score it at each frame of the last camera.

    Args:
        scene: the scene.
        settings: settings of the method; None for the defaults.
        tracker: another tracker, in the world of the scene's rig; None for the method's.
    """
    return score_frames(scene.frames(), scene.rig, tracker or _tracker(scene.calibrated, settings))


def score_frames(items: Iterable[SimulatedKeypoints], rig: CameraRig, tracker: Tracked) -> PeopleFigures:
    """Score a tracker on frames in the order of their arrival; see `score_scene`."""
    score, visible = PeopleScore(), dict[str, NDArray[np.bool_]]()
    last = list(rig.cameras)[-1]
    for item in items:
        visible[item.frame.sensor] = item.visible
        scene = tracker.update(Arrival(item.frame, item.at_ns))
        if item.frame.sensor == last:
            seen = np.stack(list(visible.values())).astype(np.int64)
            score.update(item.room_ns, item.people, item.positions, seen, scene.people)
    return score.figures()


def score_clip(
    clip: KeypointClip, settings: WebcamsSettings | None = None, tracker: Tracked | None = None
) -> ClipFigures:
    """Track a clip, and compare each person with the authors' result after each instant."""
    used = tracker or _tracker(clip.rig, settings)
    people = clip.reference
    apart: list[list[Float64]] = [[] for _ in people]
    ids: list[set[int]] = [set() for _ in people]
    present, others, measured, joints = [0] * len(people), 0, 0, 0
    for t, instant in enumerate(clip.frames):
        found: tuple[Person, ...] = ()
        for frame in instant:
            found = used.update(Arrival(frame, frame.time_ns)).people
        positions = np.array([person.positions for person in found]).reshape(len(found), people.shape[2], 3)
        distance = np.linalg.norm(people[:, t, None] - positions[None], axis=-1)
        pairs = match_people(distance)
        others += len(found) - len(pairs)
        for i, j in pairs.items():
            apart[i].append(distance[i, j][np.isfinite(distance[i, j])])
            ids[i].add(found[j].id)
            present[i] += 1
        measured += sum(int((person.states == JointState.TRACKED).sum()) for person in found)
        joints += sum(len(person.states) for person in found)
    rows_of = []
    for i in range(len(people)):
        values = 1e3 * np.concatenate(apart[i]) if apart[i] else np.full(1, np.nan)
        median, p95 = np.percentile(values, [50, 95])
        rows_of.append(ClipPerson(100 * present[i] / len(clip.frames), float(median), float(p95), len(ids[i])))
    return ClipFigures(tuple(rows_of), 100 * others / len(clip.frames), 100 * measured / max(joints, 1))


def judged(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return whether each target is met: value, limit and verdict, by its name."""
    out: dict[str, Any] = {}
    for scene in ("six-walk", EIGHT):
        if scene in result["scenes"]:
            for figure, (kind, limit) in TARGETS.items():
                value = result["scenes"][scene]["mean"][figure]
                met = value is not None and (value >= limit if kind == "least" else value <= limit)
                out[f"{scene}: {figure}"] = {"value": value, "limit": limit, "kind": kind, "met": bool(met)}
    for clip, (median, p95) in CLIP_TARGETS.items():
        for k, person in enumerate(result["clips"].get(clip, {}).get("people", ()), 1):
            for figure, limit in (("median_mm", median), ("p95_mm", p95)):
                met = bool(person[figure] is not None and person[figure] <= limit)
                row = {"value": person[figure], "limit": limit, "kind": "most", "met": met}
                out[f"{clip}, person {k}: {figure}"] = row
            met = person["present_percent"] >= LEAST_PRESENT
            row = {"value": person["present_percent"], "limit": LEAST_PRESENT, "kind": "least", "met": met}
            out[f"{clip}, person {k}: present_percent"] = row
        if clip in result["clips"]:
            others = result["clips"][clip]["others_percent"]
            out[f"{clip}: others_percent"] = {"value": others, "limit": 0.0, "kind": "most", "met": others <= 0.0}
    return out


def _tracker(rig: CameraRig, settings: WebcamsSettings | None) -> WebcamsTracker:
    return WebcamsTracker(rig, settings, sensors_expected=len(rig.cameras))


def scene_and_cameras(name: str) -> tuple[str, int | None]:
    """Return the scene of a name with ``/N``, and the number of cameras; None for the scene's.

    Raises:
        SettingsError: an unknown scene, or no number of cameras.
    """
    scene, _, cameras = name.partition("/")
    if scene not in crowd_names():
        raise SettingsError(f"unknown scene {scene!r}; known: {one_of(scene, crowd_names())}")
    if cameras and not (cameras.isdecimal() and 1 <= int(cameras) <= 32):
        raise SettingsError(f"scene {name!r}: write the number of cameras as in six-walk/8, from 1 to 32")
    return scene, int(cameras) if cameras else None


def _mean(runs: Sequence[Mapping[str, float]]) -> dict[str, float | None]:
    """Mean of each figure over the runs; None where a run has none. Switches are summed."""
    out: dict[str, float | None] = {}
    for name in runs[0]:
        values = np.array([run[name] for run in runs], dtype=np.float64)
        value = float(values.sum() if name == "switches" else values.mean())
        out[name] = value if np.isfinite(value) else None
    return out
