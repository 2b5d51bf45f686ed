"""People in films: what is detected is tracked, and the tracker's people are expected in the next images."""

from __future__ import annotations

import numpy as np
import pytest
from support.known_people import RIG, KnownPeople, brightness, joints_at, placed

from mocapella.library.keypoint_tracking import rig_with_y_up, wrong_up
from mocapella.live.film_people import FilmPeople
from mocapella.model.observations import JointState
from mocapella.model.scene import Person
from mocapella.sources.frame_set import FrameSet
from mocapella.tracker.expected_regions import expected_regions
from mocapella.tracker.webcams import WebcamsTracker

HZ = 20.0


def films(count: int, black: str = "") -> list[FrameSet]:
    levels = {name: 0 if name == black else brightness(k) for k, name in enumerate(RIG.cameras)}
    images = {name: np.full((480, 640, 3), level, np.uint8) for name, level in levels.items()}
    return [FrameSet.at_rate(k, HZ, images) for k in range(count)]


def people_at(*joints: np.ndarray) -> tuple[Person, ...]:
    states = np.full(26, JointState.TRACKED, np.uint8)
    return tuple(Person(k, one, states, ()) for k, one in enumerate(joints))


def test_a_walking_person_is_tracked_and_expected() -> None:
    detectors = {name: KnownPeople() for name in RIG.cameras}
    recorded = []
    run = FilmPeople(RIG.cameras, detectors, WebcamsTracker(RIG, sensors_expected=3), lambda *row: recorded.append(row))
    scenes = list(run.steps(films(12, black="")))
    (person,) = scenes[-1].people
    error = np.linalg.norm(person.positions - joints_at(11 / HZ), axis=-1)
    assert np.median(error) < 0.03
    counts = run.counts
    assert (counts.instants, counts.most_people, counts.ids) == (12, 1, 1)
    assert counts.images == counts.with_people == dict.fromkeys(RIG.cameras, 12)
    assert counts.tracked >= 8
    assert [(row[0].sequence, row[1].at_ns) for row in recorded[:4]] == [(0, 1), (0, 1), (0, 1), (1, 50_000_001)]
    for finds in detectors.values():
        assert finds.regions[0] is None
        assert len(finds.regions[-1]) == 1


@pytest.mark.parametrize(("up", "problem"), [("y", ""), ("-y", "stand along -y"), ("z", "stand along ")])
def test_people_who_do_not_stand_along_y_are_noticed(up: str, problem: str) -> None:
    rig = rig_with_y_up(RIG, up)
    run = FilmPeople(rig.cameras, {name: KnownPeople() for name in rig.cameras}, WebcamsTracker(rig))
    assert wrong_up(run.upright) == ""
    for shown in films(8):
        run.step(shown)
    said = wrong_up(run.upright)
    assert (bool(said), problem in said, "--up" in said) == (bool(problem), True, bool(problem))


def test_a_camera_that_sees_nobody_is_counted() -> None:
    run = FilmPeople(RIG.cameras, {name: KnownPeople() for name in RIG.cameras}, WebcamsTracker(RIG))
    for shown in films(3, black="cam-1"):
        run.step(shown)
    assert run.counts.with_people == {"cam-0": 3, "cam-1": 0, "cam-2": 3}


@pytest.mark.parametrize("camera", [0, 1, 2])
def test_a_region_holds_the_persons_joints_in_the_image(camera: int) -> None:
    one = placed(camera)
    (box,) = expected_regions(people_at(joints_at(0.2)), one)
    seen = KnownPeople().update(np.full((2, 2, 3), brightness(camera), np.uint8), 0.2).positions_px[0]
    assert (seen >= box[:2]).all()
    assert (seen <= box[2:]).all()


def test_nobody_is_expected_behind_the_camera_or_outside_of_its_image() -> None:
    one = placed(0)
    behind = joints_at(0.0) + np.array([0.0, 0.0, 10.0])
    aside = joints_at(0.0) + np.array([30.0, 0.0, 0.0])
    assert expected_regions(people_at(behind, aside), one).shape == (0, 4)
    assert expected_regions(people_at(), one).shape == (0, 4)
