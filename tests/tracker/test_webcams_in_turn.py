"""Cameras of the method webcams that process few images, out of phase, as on a busy machine."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from support.webcam_people import Path, circling, frames, run, standing, walker

from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Scene
from mocapella.sources.simulate.crowd import CrowdScene, crowd_scene
from mocapella.sources.simulate.keypoint_camera import SimulatedKeypoints
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings
from mocapella.tracker.webcams_warmup import circle_of_cameras

Float64 = NDArray[np.float64]
FOUR = circle_of_cameras(4)
SECONDS = 8.0
Keeps = Callable[[int, int], bool]
"""Whether a camera of an index processes its image of a number."""


def every(count: int) -> Keeps:
    """Every so manieth image, each camera one image after the one before."""
    return lambda camera, image: image % count == camera % count


def mixed(camera: int, image: int) -> bool:
    """Every third to fifth image, by camera."""
    return every(3 + camera % 3)(camera, image)


def kept(scene: CrowdScene, keeps: Keeps) -> list[SimulatedKeypoints]:
    """The frames of the images that are processed, in the order of their arrival."""
    cameras = list(scene.rig.cameras)
    numbers = dict.fromkeys(cameras, 0)
    found = []
    for item in scene.frames():
        name = item.frame.sensor
        if item.room_ns < SECONDS * 1e9 and keeps(cameras.index(name), numbers[name]):
            found.append(item)
        numbers[name] += 1
    return found


def tracked(scene: CrowdScene, items: list[SimulatedKeypoints], settings: WebcamsSettings) -> tuple[float, float]:
    """The share of joints that are measured, and the root mean square of their errors over their deviations."""
    tracker = WebcamsTracker(scene.calibrated, settings, sensors_expected=len(scene.rig.cameras))
    measured, ratios = [], []
    for item in items:
        for person in tracker.update(Arrival(item.frame, item.at_ns)).people:
            off = np.asarray(person.positions) - item.positions
            nearest = off[np.nanmean(np.linalg.norm(off, axis=-1), axis=1).argmin()]
            here = person.states == JointState.TRACKED
            measured.append(here.mean())
            ratios += ((nearest[here] ** 2).sum(axis=-1) / 3 / np.asarray(person.sd)[here] ** 2).tolist()
    return float(np.mean(measured)), float(np.sqrt(np.mean(ratios)))


@pytest.mark.slow
@pytest.mark.parametrize(("keeps", "least"), [(every(3), 0.9), (every(5), 0.85), (mixed, 0.65)])
def test_joints_are_measured_by_cameras_that_see_them_in_turn(keeps: Keeps, least: float) -> None:
    scene = crowd_scene("two-walk", seed=1)
    items = kept(scene, keeps)
    share, ratio = tracked(scene, items, WebcamsSettings())
    assert share > least
    assert ratio < 1.25
    alone, _ = tracked(scene, items, WebcamsSettings(measured_s=0.0))
    assert alone < share - 0.02


def delayed(items: list[SimulatedKeypoints]) -> list[SimulatedKeypoints]:
    """Frames whose times differ by a millisecond; in every third second, some are lost, and others overtaken."""
    rng, cameras = np.random.default_rng(1), sorted({item.frame.sensor for item in items})
    arrives_ns, there = dict.fromkeys(cameras, 0.0), []
    for item in items:
        name = item.frame.sensor
        at_ns = item.at_ns + round(1e6 * (0.4 * cameras.index(name) + rng.normal(0.0, 0.2)))
        busy = int(item.at_ns / 1e9) % 3 == 2
        if not busy or rng.random() > 0.3:
            arrives_ns[name] = max(at_ns + busy * rng.exponential(40e6), arrives_ns[name] + 1.0)
            there.append((arrives_ns[name], name, msgspec.structs.replace(item, at_ns=at_ns)))
    return [item for _, _, item in sorted(there, key=lambda one: one[:2])]


@pytest.mark.slow
def test_late_frames_do_not_make_later_joints_unsure() -> None:
    scene = crowd_scene("two-walk", seed=1)
    share, ratio = tracked(scene, delayed(kept(scene, every(1))), WebcamsSettings())
    assert share > 0.85
    assert ratio < 1.25


def in_turn(seconds: float, path: Path) -> tuple[list[Scene], bytes]:
    """The scenes of a person before cameras that never see the same instant, and the tracker's last state."""
    every_s, names = 0.06, tuple(FOUR.cameras)
    offsets = {name: every_s * k for k, name in enumerate(names)}
    rates = dict.fromkeys(names, 1.0 / (every_s * len(names)))
    tracker = WebcamsTracker(FOUR, sensors_expected=len(names))
    seen = frames(
        FOUR, [lambda at_s: walker(at_s, path)], seconds=seconds, noise=0.004, offsets_s=offsets, rates_hz=rates
    )
    return run(tracker, seen), tracker.snapshot()


def test_a_person_whom_cameras_see_in_turn_stays_and_is_measured() -> None:
    scenes, _ = in_turn(12.5, standing(0.0, 0.0))
    assert {len(scene.people) for scene in scenes[12:]} == {1}
    assert {person.id for scene in scenes for person in scene.people} == {0}
    shares = [(scene.people[0].states == JointState.TRACKED).mean() for scene in scenes[40:]]
    assert np.mean(shares) > 0.9
    assert {scene.people[0].condition for scene in scenes[40:]} == {""}


def test_scenes_use_the_frames_of_an_incomplete_instant_which_change_no_state(monkeypatch: pytest.MonkeyPatch) -> None:
    path = circling(0.8, 6.0)

    def errors(scenes: list[Scene]) -> list[float]:
        return [
            float(np.nanmean(np.linalg.norm(one.people[0].positions - walker(one.at_ns / 1e9 - 1.0, path), axis=-1)))
            for one in scenes[20:]
        ]

    now, state = in_turn(4.0, path)
    monkeypatch.setattr("mocapella.tracker.webcams.AHEAD_S", 10.0)
    later, other = in_turn(4.0, path)
    assert state == other
    assert np.mean(errors(now)) < 0.9 * np.mean(errors(later))


def test_cameras_that_have_images_do_not_see_in_turn() -> None:
    names = sorted(FOUR.cameras)

    def one_at_a_time(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        sees = at_s < 2.0 or round(30 * at_s) % len(names) == names.index(name)
        return (px, sure) if sees else (px[:0], sure[:0])

    seen = frames(
        FOUR, [lambda at_s: walker(at_s, standing(0.0, 0.0))], seconds=6.0, noise=0.004, fault=one_at_a_time,
        rates_hz=dict.fromkeys(names, 30.0),
    )  # fmt: skip
    scenes = run(WebcamsTracker(FOUR, WebcamsSettings(one_camera_s=1.0), sensors_expected=len(names)), seen)
    assert len(scenes[4 * 55].people) == 1
    assert not scenes[-1].people
