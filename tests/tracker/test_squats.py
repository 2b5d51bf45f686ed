"""Somebody who squats before one sensor: a posture, and a sensor, that the facing was not trained on."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from support.azure_squats import Squats, knee_flexion, read_squats

from mocapella.geometry.rigid import inverse
from mocapella.model.observations import Arrival, body_frame
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.default_settings import DefaultSettings
from mocapella.tracker.people import PeopleSettings


class Tracked(NamedTuple):
    """The results: frames with a person, (frames, joints, 3) skeletons [m], swapped views, and the last sensor pose."""

    frames: list[int]
    positions: np.ndarray
    swapped: int
    T_world_sensor: np.ndarray


@pytest.fixture(scope="module")
def squats(azure_and_vicon: Path) -> Squats:
    return read_squats(azure_and_vicon)


@pytest.fixture(scope="module")
def tracked(squats: Squats) -> Tracked:
    return track(squats, DefaultSettings())


def track(squats: Squats, settings: DefaultSettings) -> Tracked:
    tracker, frames, positions, swapped = DefaultTracker(settings), list[int](), [], 0
    for k, at_s in enumerate(squats.at_s):
        at_ns = 10**9 + round(1e9 * at_s)
        frame = body_frame(
            "azure",
            squats.rows.topology,
            time_ns=at_ns,
            positions=squats.rows.positions[k, None],
            states=squats.rows.states[k, None],
            sequence=k,
        )
        scene = tracker.update(Arrival(frame, at_ns))
        for person in scene.parts["people"]:
            frames.append(k)
            positions.append(person.positions)
            swapped += len(tracker.sensor_views().swapped)
    (place,) = scene.sensors
    return Tracked(frames, np.array(positions), swapped, place.T_world_sensor)


@pytest.mark.slow
def test_no_view_is_swapped(squats: Squats, tracked: Tracked) -> None:
    assert len(tracked.frames) > 0.99 * len(squats.at_s)
    assert tracked.swapped == 0


@pytest.mark.slow
def test_the_vertical_is_known_from_where_the_body_is_in_balance(squats: Squats, tracked: Tracked) -> None:
    """The camera stood level: the straight legs say so. The back leans forward all the time."""
    up = inverse(tracked.T_world_sensor)[:3, 1]
    assert np.degrees(np.arccos(up[1])) < 5


def test_the_knees_are_bent_as_far_as_the_sensor_sees(squats: Squats, tracked: Tracked) -> None:
    check_knees(squats, tracked, most_deg=3)


@pytest.mark.slow
def test_without_a_body_model_the_knees_are_those_of_the_sensor(squats: Squats) -> None:
    settings = DefaultSettings(people=PeopleSettings(smoothing="kalman"))
    check_knees(squats, track(squats, settings), most_deg=3)


def check_knees(squats: Squats, tracked: Tracked, most_deg: float) -> None:
    for side in ("Left", "Right"):
        seen, found = knee_flexion(squats.positions[tracked.frames], side), knee_flexion(tracked.positions, side)
        assert np.sqrt(np.mean((found - seen) ** 2)) < most_deg
        assert np.corrcoef(found, seen)[0, 1] > 0.95
