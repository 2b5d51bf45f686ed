"""The method webcams names cameras whose images are exchanged, live, and no longer once they are put right."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from support.keypoint_folders import RATE_HZ, frames_of, walkers, write_openpose
from support.webcam_people import circling, frames, walker

from mocapella.errors import InputError
from mocapella.library.exchanged_images import check_not_exchanged
from mocapella.library.people_report import PeopleComparison, alarms
from mocapella.library.people_triangulation import triangulate_people
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_exchange import ExchangeWatch
from mocapella.tracker.webcams_warmup import circle_of_cameras

RIG = circle_of_cameras(4)
ONE, OTHER = sorted(RIG.cameras)[:2]
CLAUSE = f"cameras {ONE} and {OTHER} seem exchanged"


def exchanged(arrivals: list[Arrival], until_s: float) -> list[Arrival]:
    """Arrivals with the names of two cameras exchanged until a time."""
    names = {ONE: OTHER, OTHER: ONE}
    return [
        Arrival(msgspec.structs.replace(one.frame, sensor=names.get(one.frame.sensor, one.frame.sensor)), one.at_ns)
        if one.at_ns < (1.0 + until_s) * 1e9
        else one
        for one in arrivals
    ]


@pytest.mark.slow
def test_exchanged_cameras_are_named_live_and_forgotten_once_they_are_put_right() -> None:
    paths = [circling(0.9, 7.0), circling(1.3, 9.0, 2.0)]
    walking = [lambda t, path=path: walker(t, path) for path in paths]
    arrivals = frames(RIG, walking, seconds=60.0, rates_hz=dict.fromkeys(RIG.cameras, 10.0))
    tracker, copy, told = WebcamsTracker(RIG), WebcamsTracker(RIG), []
    for k, one in enumerate(exchanged(arrivals, 20.0)):
        scene = tracker.update(one)
        if k == 700:
            copy.restore(tracker.snapshot())
        elif k > 700 and k < 760:
            assert copy.update(one).state == scene.state
        named = {place.sensor for place in scene.sensors if CLAUSE in place.problem}
        told.append(CLAUSE in scene.state.reason)
        assert named == ({ONE, OTHER} if told[-1] else set())
    assert any(told[: 20 * 40])
    assert not told[-1]


def test_nothing_is_kept_while_the_cameras_agree() -> None:
    watch = ExchangeWatch()
    assert watch.text == ""
    assert watch.cameras == ()
    assert watch.memory()["_kept"] == []


def test_files_in_each_others_folders_are_refused(tmp_path: Path) -> None:
    write_openpose(tmp_path, walkers(20))
    folder = tmp_path / "pose"
    one, other = sorted(folder.iterdir())[:2]
    done = triangulate_people(tmp_path, tmp_path / "rig.toml", fps=RATE_HZ)
    assert done.report.exchanged == ""
    one.rename(tmp_path / "aside")
    other.rename(one)
    (tmp_path / "aside").rename(other)
    with pytest.raises(InputError, match=r"cameras cam-0 and cam-1 seem exchanged: .* exchange the names of their fol"):
        triangulate_people(tmp_path, tmp_path / "rig.toml", fps=RATE_HZ)


def test_exchanged_films_are_named_after_tracking(tmp_path: Path) -> None:
    rig = write_openpose(tmp_path, walkers(60))
    found = frames_of(tmp_path / "pose", rig)
    first, second = found[ONE], found[OTHER]
    found[ONE] = [msgspec.structs.replace(one, sensor=ONE) for one in second]
    found[OTHER] = [msgspec.structs.replace(one, sensor=OTHER) for one in first]
    with pytest.raises(InputError, match=CLAUSE):
        check_not_exchanged(found, rig, file="pose")
    compared, tracker = PeopleComparison(rig), WebcamsTracker(rig)
    for instant in zip(*found.values(), strict=True):
        scenes = [tracker.update(Arrival(frame, frame.time_ns)) for frame in instant]
        compared.add(instant, scenes[-1])
    report = compared.report()
    assert report.exchanged == CLAUSE
    assert alarms(report, films=True) == [f"{CLAUSE}: exchange the names of their files, or their names in the rig"]
    kept: list[dict[str, KeypointFrame]] = compared._kept
    assert len(kept) <= 24
