"""What a simulated room tells the filter of the people's motion."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.evaluation_sessions import KINECT, body

from mocapella.evaluation import facing_simulation as module
from mocapella.evaluation.facing_simulation import VELOCITY_OVER_S, _velocity, simulated_figures
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.model.observations import JointState, body_frame


def test_a_velocity_is_a_mean_of_the_past_and_known_once_half_of_it_is_past() -> None:
    """Somebody falls from rest at 1 m/s²: the mean velocity [m/s] is the time [s] at the middle of the past."""
    places: deque[tuple[float, np.ndarray]] = deque()
    for sixteenths in range(20):
        at_s = sixteenths / 16  # exact, as are the limits
        found = _velocity(places, at_s, np.array([0.0, -0.5 * at_s**2, 0.0]))
        if at_s < 0.5 * VELOCITY_OVER_S:
            assert np.isnan(found).all()
        else:
            np.testing.assert_allclose(found, [0, -(at_s - 0.5 * min(at_s, VELOCITY_OVER_S)), 0], atol=1e-12)


T_WORLD_SENSOR = rigid(rotation_about_y(0.4), [0.5, 1.2, -0.3])
FPS = 16
PLACE = np.array([1.0, 0.2, 2.5])
STEP = np.array([0.5, 0.0, 1.0])


class Told:
    """A filter that keeps what it is told, and whose facings and labels are wrong as given for each frame."""

    def __init__(self, off: np.ndarray, mirrored: np.ndarray) -> None:
        self.off, self.mirrored, self.told = off, mirrored, []

    def update(self, sensor: str, people: list[int], positions: Any, *told: Any) -> SimpleNamespace:
        k = len(self.told)
        self.told.append((positions, *told))
        return SimpleNamespace(yaw=np.array([yaw_at(k) + self.off[k]]), mirrored=self.mirrored[k : k + 1])


def yaw_at(k: int) -> float:
    return float(wrap(0.3 * k))


def frames(mirrored: np.ndarray) -> list[SimpleNamespace]:
    """A person who turns while walking straight, before one sensor, which swaps labels in some frames."""
    made = []
    for k, swapped in enumerate(mirrored):
        true = body(yaw_at(k)) + PLACE + STEP * k / FPS
        states = np.full((1, 25), JointState.TRACKED)
        states[0, 3], states[0, 4] = JointState.NOT_TRACKED, JointState.INFERRED
        seen = apply(inverse(T_WORLD_SENSOR), true[list(KINECT.mirror)] if swapped else true)[None]
        frame = body_frame("one", KINECT, time_ns=k, positions=seen, states=states)
        truth = SimpleNamespace(
            room_ns=round(1e9 * k / FPS), topology=KINECT, positions=true[None], body_people=np.array([0]),
            mirrored=np.array([swapped]),
        )  # fmt: skip
        made.append(SimpleNamespace(frame=frame, truth=truth))
    return made


def figures_of(
    monkeypatch: pytest.MonkeyPatch, off: np.ndarray, reported: np.ndarray, repaired: np.ndarray
) -> tuple[module.SimulatedFigures, Told]:
    sensor = SimpleNamespace(name="one", T_world_sensor=T_WORLD_SENSOR)
    monkeypatch.setattr(module, "SimulatedSensor", lambda *_: sensor)
    monkeypatch.setattr(module, "merge", lambda *_: frames(reported))
    of: Any = Told(off, repaired)
    room: Any = SimpleNamespace(sensor_names=["one"])
    return simulated_figures(room, of, 1.0), of


def test_facings_and_labels_are_wrong_as_often_as_they_were_made(monkeypatch: pytest.MonkeyPatch) -> None:
    off = np.radians([90, 10, -20, 30, 40, 100, -100, 175, -30, 30])  # the first is just right
    reported, repaired = np.arange(10) < 4, np.arange(10) < 3
    found, _ = figures_of(monkeypatch, off, reported, repaired)
    assert (found.bodies, found.wrong_as_reported_percent, found.wrong_percent) == (10, 40.0, 10.0)
    assert found.facing_wrong_percent == 30.0
    assert found.off_deg == pytest.approx(35.0)


def test_a_filter_is_told_of_the_room_and_of_joints_that_are_tracked_or_inferred(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nobody = np.zeros(8, dtype=bool)
    _, of = figures_of(monkeypatch, np.zeros(8), nobody, nobody)
    for k, (positions, toward, at_s, velocities) in enumerate(of.told):
        true = body(yaw_at(k)) + PLACE + STEP * k / FPS
        true[3] = np.nan
        np.testing.assert_allclose(positions[0], true, atol=1e-6)
        sight = T_WORLD_SENSOR[:3, 3] - (body(yaw_at(k)) + PLACE + STEP * k / FPS).mean(axis=0)
        assert np.hypot(*sight[[0, 2]]) * np.exp(1j * toward[0]) == pytest.approx(complex(sight[2], sight[0]))
        assert at_s == k / FPS
        assert velocities[0] == pytest.approx(STEP if k >= 2 else np.full(3, np.nan), nan_ok=True)
