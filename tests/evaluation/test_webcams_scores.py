"""Scores of the method webcams: with trackers that know the truth or nothing, and the real one on a short scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation.keypoint_clips import CLIPS, KeypointClip, pose2sim_clip
from mocapella.evaluation.webcams import CLIP_TARGETS, EIGHT, evaluate, judged, score_clip, score_frames, score_scene
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Person, Phase, Scene, TrackerState
from mocapella.model.topology import topology
from mocapella.sources.simulate.crowd import CrowdScene, build_crowd, crowd_scene, crowd_settings
from mocapella.sources.simulate.keypoint_camera import SimulatedKeypoints
from mocapella.tracker.protocol import scene_at

DATA = Path(__file__).resolve().parents[3] / "shared/data"
needs_data = pytest.mark.skipif(not all((DATA / name).is_dir() for name in CLIPS), reason="no recordings")


class Known:
    """A tracker that is told the people, by the time of the arrival."""

    def __init__(self, people: dict[int, np.ndarray]) -> None:
        self.people = people

    def update(self, arrival: Arrival) -> Scene:
        states = np.full(26, JointState.TRACKED, np.uint8)
        sd = np.full(26, 0.01, np.float32)
        found = tuple(
            Person(k, positions, np.where(np.isfinite(positions[:, 0]), states, 0).astype(np.uint8), (), sd)
            for k, positions in enumerate(self.people[arrival.at_ns])
        )
        parts: dict[str, tuple[Any, ...]] = {"people": found}
        return scene_at(arrival, 0, TrackerState(Phase.TRACKING), parts, topology=topology("halpe_26"))


def short(name: str = "two-walk", seconds: float = 1.5) -> CrowdScene:
    return build_crowd(dataclasses.replace(crowd_settings(name), seconds=seconds))


def known(items: list[SimulatedKeypoints]) -> Known:
    return Known({item.at_ns: item.positions for item in items})


def test_who_knows_the_truth_scores_best_and_who_knows_nothing_worst() -> None:
    scene = short()
    items = list(scene.frames())
    best = score_frames(iter(items), scene.rig, known(items))
    assert best.hota == 1.0
    assert best.found_percent == 100.0
    assert best.visible_mm == 0.0
    assert best.instants == sum(item.frame.sensor == "c4" for item in items)
    nothing = Known({item.at_ns: item.positions[:0] for item in items})
    worst = score_frames(iter(items), scene.rig, nothing)
    assert worst.hota == 0.0
    assert worst.found_percent == 0.0


def clip_of(scene: CrowdScene) -> KeypointClip:
    rows: dict[int, list[SimulatedKeypoints]] = {}
    for item in scene.frames():
        rows.setdefault(item.frame.sequence, []).append(item)
    frames = tuple(tuple(item.frame for item in row) for row in rows.values())
    truth = np.stack([row[0].positions for row in rows.values()], axis=1)
    return KeypointClip("simulated", scene.rig, frames, truth, 30.0)


def test_a_clip_counts_who_is_there_and_who_should_not_be() -> None:
    clip = clip_of(short())
    times = [row[0].time_ns for row in clip.frames]
    exact = Known({at: clip.reference[:, k] for k, at in enumerate(times)})
    found = score_clip(clip, tracker=exact)
    assert [person.present_percent for person in found.people] == [100.0, 100.0]
    assert [person.median_mm for person in found.people] == [0.0, 0.0]
    assert found.others_percent == 0.0
    third = {at: np.concatenate([clip.reference[:1, k], clip.reference[:1, k] + 5.0]) for k, at in enumerate(times)}
    found = score_clip(clip, tracker=Known(third))
    assert [person.present_percent for person in found.people] == [100.0, 0.0]
    assert np.isnan(found.people[1].median_mm)
    assert found.others_percent == 100.0


def test_a_clip_without_tracked_people_is_scored() -> None:
    clip = clip_of(short(seconds=0.2))
    nothing = Known({row[0].time_ns: clip.reference[:0, 0] for row in clip.frames})
    found = score_clip(clip, tracker=nothing)
    assert [person.present_percent for person in found.people] == [0.0, 0.0]
    assert found.others_percent == found.measured_percent == 0.0


def test_targets_are_judged() -> None:
    def verdicts(**changed: Any) -> Iterator[bool]:
        mean = {"hota": 0.96, "switches": 0.0, "visible_mm": 30.0} | changed
        return (row["met"] for row in judged({"scenes": {EIGHT: {"mean": mean}}, "clips": {}}).values())

    assert list(verdicts()) == [True, True, True]
    assert list(verdicts(hota=0.9)) == [False, True, True]
    assert list(verdicts(switches=1.0, visible_mm=None)) == [True, False, False]
    person = {"present_percent": 96.0, "median_mm": None, "p95_mm": 70.0, "ids": 1}
    clips = {"pose2sim_single_person": {"people": [person], "others_percent": 1.0}}
    assert [row["met"] for row in judged({"scenes": {}, "clips": clips}).values()] == [False, True, False, False]


@pytest.mark.parametrize(
    ("scenes", "seeds", "settings", "words"),
    [
        (["nowhere"], (0,), None, "six-walk"),
        (["six-walk/x"], (0,), None, "from 1 to 32"),
        (["six-walk/99"], (0,), None, "from 1 to 32"),
        (["two-walk"], (), None, "one or more"),
        (["two-walk"], (-1,), None, "one or more"),
        (["two-walk"], (0,), {"nothing": 1}, "unknown key"),
    ],
)
def test_what_cannot_be_scored_is_refused(scenes: Any, seeds: Any, settings: Any, words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        evaluate(scenes, seeds, settings)


@pytest.mark.slow
def test_the_method_finds_two_people_without_a_switch() -> None:
    found = score_scene(short(seconds=5.0))
    assert found.switches == 0
    assert found.hota > 0.95
    assert found.visible_mm < 35.0
    assert found.phantoms_percent == 0.0


@pytest.mark.slow
def test_a_scene_is_scored_alike_again() -> None:
    assert score_scene(short(seconds=2.0)) == score_scene(short(seconds=2.0))


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("name", list(CLIPS))
def test_the_people_of_the_real_clips_are_found(name: str) -> None:
    median, p95 = CLIP_TARGETS[name]
    found = score_clip(pose2sim_clip(DATA, name))
    assert found.others_percent == 0.0
    for person in found.people:
        assert person.present_percent >= 97.0
        assert person.median_mm <= median
        assert person.p95_mm <= p95
        assert person.ids == 1


def test_the_eight_cameras_are_those_of_a_scene() -> None:
    assert len(crowd_scene("two-walk", cameras=8).rig.cameras) == 8
