"""Oracles, and causes of missed limbs, of the method ``webcams`` in simulated crowds (docs/evaluation.md, *Causes*).

An oracle tells how hard a scene is: it gets the method's detections, and knows what the method has to find out. Limbs
are scored as in `mocapella.evaluation.body_parts`, of the expected people (`people_scores.expected_people`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import takewhile
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import sources_named
from mocapella.errors import SettingsError
from mocapella.evaluation.body_parts import JOINTS, LIMBS, PARTS, correct_limbs, joints_of_halpe, pcp
from mocapella.evaluation.people_scores import AFTER_NS, expected_people, match_people
from mocapella.evaluation.webcams import scene_and_cameras
from mocapella.geometry.triangulation import EVERY_CAMERA, TriangulationSettings, triangulate, views
from mocapella.model.camera import CameraRig
from mocapella.model.observations import Arrival
from mocapella.model.topology import topology
from mocapella.settings import parse
from mocapella.sources.simulate.crowd import CrowdScene, CrowdSettings, build_crowd, crowd_settings
from mocapella.sources.simulate.keypoint_camera import SimulatedKeypoints
from mocapella.sources.simulate.keypoint_faults import NO_FAULTS
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

SCENES: Final = ("shelf", "campus", "shelf-poor", "campus-poor")
"""Scenes of `evaluate_causes`, if none are named."""
RUNS: Final = ("every camera", "robust", "body", "method", "clean start", "no exchange", "exact cameras")
"""Runs of `causes`, see `CrowdCauses`."""
CAUSES: Final = ("not tracked", "sides", "other person", "one camera", "detections", "body")
"""Causes of a missed limb, in the order of their tests, see `CrowdCauses`."""
TAKEN_M: Final = 0.15
"""Distance of a wrong joint from the same joint of another person below which it is that person's [m]."""
TOP_OF_HEAD: Final = 1.6
"""Distance of the top of the head from the neck, relative to that of the face's keypoints: for detectors without it."""
_FACE: Final = [topology("halpe_26").index(name) for name in ("Nose", "LEye", "REye", "LEar", "REar")]
_NECK: Final = topology("halpe_26").index("Neck")
_HEAD: Final = topology("halpe_26").index("Head")
_PART_OF: Final = np.repeat(np.arange(len(PARTS)), [len(limbs) for limbs in PARTS.values()])
_HALPE: Final = [topology("halpe_26").index(name) for name in JOINTS]
_MIRROR: Final = [JOINTS.index({"L": "R", "R": "L"}.get(name[0], name[0]) + name[1:]) for name in JOINTS]


class CrowdCauses(msgspec.Struct, frozen=True):
    """Limbs in a scene, by run and by cause.

    Attributes:
        pcp_percent: percentage of correct parts of each run [%]. ``every camera``: true people, and their detections'
            triangulation, weighted by the confidence; ``robust``: the same without cameras that disagree; ``body``: the
            method for each person alone; ``method``: the method; ``clean start``: the method after a second without
            faults and furniture; ``no exchange``: without confusions of people, limbs and sides; ``exact cameras``:
            with the true rig and times.
        actors_percent: percentage of correct parts of the run ``method``, by person [%].
        parts_percent: the same, by part of the body [%].
        found_percent: expected people whom the method finds [%].
        precision_percent: people of the method who are a true person [%].
        causes_percent: missed limbs of the run ``method``, of all limbs [%]. ``not tracked``: the person is not found;
            ``sides``: the limb of the other side is right; ``other person``: an end is at the same joint of another
            person; ``one camera``: fewer than two cameras detect an end; ``detections``: the run ``robust`` misses the
            limb, too; ``body``: any other.
        parts_causes_percent: the same for each part of the body, of its limbs [%].
        actors_causes_percent: the same for each person, of the person's limbs [%].
    """

    pcp_percent: dict[str, float]
    actors_percent: tuple[float, ...]
    parts_percent: dict[str, float]
    found_percent: float
    precision_percent: float
    causes_percent: dict[str, float]
    parts_causes_percent: dict[str, dict[str, float]]
    actors_causes_percent: tuple[dict[str, float], ...]


class _Instant(msgspec.Struct, frozen=True, eq=False):
    """A scored instant: the truth (people, 26, 3), who is expected (people,), and the newest frame of each camera."""

    room_ns: int
    numbers: Int64
    true: Float64
    expected: NDArray[np.bool_]
    newest: dict[str, SimulatedKeypoints]


def causes(
    settings: CrowdSettings, own: WebcamsSettings | None = None, on_run: Callable[[str], None] = lambda text: None
) -> CrowdCauses:
    """Run the method and the oracles on a scene, and count why limbs are missed.

    Args:
        settings: the scene.
        own: settings of the method; None for the defaults.
        on_run: called with the name of the next run.

    Raises:
        SettingsError: see `build_crowd`.
    """
    scene = build_crowd(settings)
    on_run(RUNS[0])
    items = list(scene.frames())
    instants = _instants(items, scene.rig)
    pixels = [_owned_pixels(one, scene.calibrated) for one in instants]
    found: dict[str, list[Float64]] = {
        "every camera": _triangulated(pixels, scene.calibrated, EVERY_CAMERA),
        "robust": _triangulated(pixels, scene.calibrated, TriangulationSettings()),
    }
    on_run("body")
    alone = [_tracked(_only(items, n), scene, own) for n in instants[0].numbers.tolist()]
    found["body"] = [np.concatenate(people) for people in zip(*alone, strict=True)]
    on_run("method")
    found["method"] = _tracked(items, scene, own)
    scores = {name: _score(instants, people) for name, people in found.items()}
    for name, changed in _easier(settings).items():
        on_run(name)
        easier = build_crowd(changed)
        if name == "clean start":
            first = takewhile(lambda one: one.due_ns < AFTER_NS, easier.frames())
            others = [*first, *(one for one in items if one.due_ns >= AFTER_NS)]
        else:
            others = list(easier.frames())
        scores[name] = _score(_instants(others, easier.rig), _tracked(others, easier, own))
    who = [match_people(np.linalg.norm(one.true[:, None] - people[None], axis=-1))
           for one, people in zip(instants, found["method"], strict=True)]  # fmt: skip
    wanted = sum(int(one.expected.sum()) for one in instants)
    hits = sum(sum(bool(one.expected[i]) for i in pairs) for one, pairs in zip(instants, who, strict=True))
    given, paired = sum(len(people) for people in found["method"]), sum(map(len, who))
    counted = _causes(instants, found["method"], found["robust"], pixels, who)
    own_score = scores["method"]
    return CrowdCauses(
        {name: 100 * scores[name].mean for name in RUNS}, tuple(100 * share for share in own_score.actors),
        {part: 100 * share for part, share in own_score.parts.items()}, 100 * hits / max(wanted, 1),
        100 * paired / max(given, 1), _shares(counted.sum(axis=(0, 1))),
        {part: _shares(counted[:, k].sum(axis=0)) for k, part in enumerate(PARTS)},
        tuple(_shares(own.sum(axis=0)) for own in counted),
    )  # fmt: skip


def evaluate_causes(
    scenes: Sequence[str] | None = None, seeds: Sequence[int] = (0,), settings: Mapping[str, Any] | None = None,
    on_run: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:  # fmt: skip
    """Find the causes of missed limbs in scenes.

    Args:
        scenes: names of simulated scenes, with ``/N`` for N cameras; None for `SCENES`.
        seeds: random seeds of the scenes.
        settings: settings of the method; None for the defaults.
        on_run: called with the next step, in words.

    Returns:
        ``seeds``, and ``causes``: for each scene a `CrowdCauses` for each seed.

    Raises:
        SettingsError: an unknown scene or setting, or no seed.
    """
    if not seeds or min(seeds) < 0:
        raise SettingsError(f"seeds {list(seeds)} cannot be used; give one or more of 0, 1, 2, …")
    own = parse(WebcamsSettings, settings or {}, where="settings of webcams")
    chosen = {name: scene_and_cameras(name) for name in scenes or SCENES}
    found: dict[str, Any] = {}
    for name, (scene, cameras) in chosen.items():
        room = crowd_settings(scene)
        ring = room.ring if cameras is None else dataclasses.replace(room.ring, count=cameras)
        found[name] = [
            msgspec.to_builtins(causes(
                dataclasses.replace(room, ring=ring, seed=seed), own, partial(_say, on_run, f"{name}, seed {seed}")
            ))
            for seed in seeds
        ]  # fmt: skip
    return {"seeds": list(seeds), "causes": found}


def _say(on_run: Callable[[str], None], what: str, run: str) -> None:
    on_run(f"{what}, {run}")


def _easier(settings: CrowdSettings) -> dict[str, CrowdSettings]:
    """The scene's settings without some of its difficulties, by the name of the run."""
    camera = settings.camera
    clean = dataclasses.replace(camera, faults=NO_FAULTS)
    apart = dataclasses.replace(
        camera.faults, taken=0.0, mirrored=(0.0, 0.0, 0.0), legs_mirrored=0.0, merged=0.0, exchanged_limbs=0.0
    )
    return {
        "clean start": dataclasses.replace(settings, camera=clean, boxes=(), cylinders=()),
        "no exchange": dataclasses.replace(settings, camera=dataclasses.replace(camera, faults=apart)),
        "exact cameras": dataclasses.replace(settings, rig_error_px=0.0, out_of_step=0),
    }


def _instants(items: Iterable[SimulatedKeypoints], rig: CameraRig) -> list[_Instant]:
    """The instants of the last camera's frames, as `mocapella.evaluation.webcams.score_frames` scores them."""
    newest, instants, last = dict[str, SimulatedKeypoints](), list[_Instant](), list(rig.cameras)[-1]
    for item in items:
        newest[item.frame.sensor] = item
        if item.frame.sensor == last:
            seen = np.stack([one.visible for one in newest.values()])
            expected = expected_people(seen, item.room_ns)
            instants.append(_Instant(item.room_ns, item.people, item.positions, expected, dict(newest)))
    return instants


def _tracked(items: Iterable[SimulatedKeypoints], scene: CrowdScene, own: WebcamsSettings | None) -> list[Float64]:
    """The people (people, 26, 3) that the method finds, at each frame of the last camera."""
    tracker = WebcamsTracker(scene.calibrated, own, sensors_expected=len(scene.rig.cameras))
    people, last = [], list(scene.rig.cameras)[-1]
    for item in items:
        found = tracker.update(Arrival(item.frame, item.at_ns)).people
        if item.frame.sensor == last:
            people.append(np.array([one.positions for one in found]).reshape(len(found), 26, 3))
    return people


def _only(items: Iterable[SimulatedKeypoints], number: int) -> Iterable[SimulatedKeypoints]:
    """Frames with the detections of one person alone."""
    for item in items:
        rows, frame = item.detected == number, item.frame
        kept = msgspec.structs.replace(
            frame, ids=frame.ids[rows], positions_px=frame.positions_px[rows], confidences=frame.confidences[rows]
        )
        yield msgspec.structs.replace(item, frame=kept)


def _owned_pixels(instant: _Instant, rig: CameraRig) -> Float64:
    """Keypoints [px] and confidences (people, 26, cameras, 3) of people's own detections; NaN where not detected."""
    out = np.full((len(instant.numbers), 26, len(rig.cameras), 3), np.nan)
    for c, name in enumerate(rig.cameras):
        item = instant.newest.get(name)
        sources = None if item is None else sources_named(item.frame.topology.name)
        if item is None or sources is None:
            continue
        sure = np.where(sources >= 0, item.frame.confidences.take(sources, axis=1), 0.0)
        values = np.concatenate([item.frame.positions_px.take(sources, axis=1), sure[..., None]], axis=-1)
        values[~(sure > 0.0)] = np.nan
        for i, number in enumerate(instant.numbers.tolist()):
            rows = np.flatnonzero(item.detected == number)
            if len(rows):
                out[i, :, c] = values[rows[np.argmax(sure[rows].sum(axis=1))]]
    return out


def _triangulated(pixels: Sequence[Float64], rig: CameraRig, settings: TriangulationSettings) -> list[Float64]:
    """The people (people, 26, 3) of each instant; NaN where fewer than two cameras detect a joint."""
    placed = list(rig.cameras.values())
    cameras = views([one.camera.lens for one in placed], [one.T_camera_world for one in placed])
    found = []
    for values in pixels:
        sd_px = 0.01 * placed[0].camera.size_px[1] / np.sqrt(values[..., 2])
        points = triangulate(values[..., :2], cameras, sd_px, settings).points
        seen = np.isfinite(points[:, _FACE])
        face = np.where(seen, points[:, _FACE], 0.0).sum(axis=1) / np.where(seen.any(axis=1), seen.sum(axis=1), np.nan)
        above = points[:, _NECK] + TOP_OF_HEAD * (face - points[:, _NECK])
        points[:, _HEAD] = np.where(np.isfinite(points[:, _HEAD]), points[:, _HEAD], above)
        found.append(points)
    return found


def _score(instants: Sequence[_Instant], people: Sequence[Float64]) -> Any:
    true = [joints_of_halpe(np.where(one.expected[:, None, None], one.true, np.nan)) for one in instants]
    return pcp(np.stack(true, axis=1), [joints_of_halpe(some) for some in people])


def _shares(counted: Float64) -> dict[str, float]:
    """The share of each cause [%] of counts (all limbs, and those missed by each of `CAUSES`)."""
    return {cause: float(100 * one / max(counted[0], 1)) for cause, one in zip(CAUSES, counted[1:], strict=True)}


def _causes(
    instants: Sequence[_Instant], people: Sequence[Float64], robust: Sequence[Float64], pixels: Sequence[Float64],
    who: Sequence[dict[int, int]],
) -> Float64:  # fmt: skip
    """Count limbs (people, parts, 1 + causes): all, and those missed by each cause, see `CrowdCauses`."""
    counted = np.zeros((len(instants[0].numbers), len(PARTS), 1 + len(CAUSES)))
    for one, found, best, seen, pairs in zip(instants, people, robust, pixels, who, strict=True):
        true = joints_of_halpe(one.true)
        cameras = np.isfinite(seen[..., 0]).sum(axis=-1)[:, _HALPE]
        for i in np.flatnonzero(one.expected).tolist():
            np.add.at(counted[i, :, 0], _PART_OF, 1)
            if i not in pairs:
                np.add.at(counted[i, :, 1], _PART_OF, 1)
                continue
            own = joints_of_halpe(found[pairs[i]])
            right, _ = correct_limbs(true[i], own)
            turned, _ = correct_limbs(true[i], own[_MIRROR])
            easy, _ = correct_limbs(true[i], joints_of_halpe(best[i]))
            others = np.delete(true, i, axis=0)
            off = np.linalg.norm(own - true[i], axis=-1)
            near = np.linalg.norm(own - others, axis=-1).min(axis=0, initial=np.inf)
            taken = (near < TAKEN_M) & (near < off)
            for k in np.flatnonzero(~right).tolist():
                ends = [*LIMBS[k][0], LIMBS[k][1]]
                tests = (turned[k], taken[ends].any(), cameras[i, ends].min() < 2, not easy[k], True)
                counted[i, _PART_OF[k], 2 + next(c for c, holds in enumerate(tests) if holds)] += 1
    return counted
