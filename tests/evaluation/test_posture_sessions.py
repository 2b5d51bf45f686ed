"""People in postures unlike walking keep their left and right, and the score notices where they do not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation import posture_sessions
from mocapella.evaluation.posture_sessions import POSTURE_S, PostureResult, score_postures
from mocapella.geometry.rigid import rigid, rotation_about_y
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Person, Phase, Scene, SensorPlace, TrackerState
from mocapella.model.skeleton import SKELETON
from mocapella.sources.simulate import Room
from mocapella.sources.simulate.postures import RISE_S
from mocapella.tracker.default import DefaultTracker


@pytest.fixture(scope="module")
def away() -> list[PostureResult]:
    """Somebody with the back to the main sensor, whose labels it exchanges."""
    return list(score_postures(180.0, 0, ("bow", "lean-back")))


@pytest.mark.slow
def test_who_bows_or_leans_back_keeps_left_and_right(away: list[PostureResult]) -> None:
    assert [result.posture for result in away] == ["bow", "lean-back"]
    assert [(result.wrong, result.missing, result.warned) for result in away] == [(0, 0, 0)] * 2
    for result in away:
        assert result.frames > 100
        assert result.fused_m < 0.1


@pytest.mark.slow
def test_who_kneels_has_no_condition() -> None:
    assert [result.warned for seed in (0, 1) for result in score_postures(0.0, seed, ("kneel",))] == [0, 0]


def exchanged(scene: Scene) -> Scene:
    people = [
        msgspec.structs.replace(person, positions=person.positions[list(SKELETON.mirror)]) for person in scene.people
    ]
    return scene.with_parts(people=tuple(people))


@pytest.mark.slow
def test_exchanged_labels_and_missing_people_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    class Wrong(DefaultTracker):
        """Exchanges left and right in the first half of the scored frames, and finds nobody in the second."""

        scored = 0

        def update(self, arrival: Any) -> Scene:
            scene = super().update(arrival)
            if not counting:
                return scene
            self.scored += 1
            return exchanged(scene) if self.scored < 90 else scene.with_parts(people=())

    counting: list[bool] = []
    frames = posture_sessions._frames

    def counted(*of: Any) -> Iterator[Any]:
        if of[1] > 0:
            counting.append(True)
        yield from frames(*of)

    monkeypatch.setattr(posture_sessions, "DefaultTracker", Wrong)
    monkeypatch.setattr(posture_sessions, "_frames", counted)
    monkeypatch.setattr(posture_sessions, "_WALK", ("go 0.3 2.8", "go 0.0 2.8"))
    (result,) = score_postures(0.0, 0, ("stand",), azimuths_deg=(0.0,))
    assert result.wrong > 40
    assert result.missing > 40
    assert result.wrong + result.missing == result.frames
    assert result.fused_m > 0.1
    assert np.isfinite(result.best_m)


def test_who_knows_the_truth_is_scored_perfect_while_the_posture_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    rooms: list[Room] = []
    T_method_world = rigid(rotation_about_y(1.0), (3.0, -1.0, 2.0))
    build = posture_sessions._room

    def kept(*of: Any) -> tuple[Room, float]:
        room, begins_s = build(*of)
        rooms.append(room)
        return room, begins_s

    class Truthful:
        def __init__(self, sensors_expected: int) -> None:
            assert sensors_expected == 1

        def snapshot(self) -> bytes:
            return b"it has no memory"

        def restore(self, snapshot: bytes) -> None:
            assert snapshot == self.snapshot()

        def update(self, arrival: Arrival) -> Scene:
            (sensor,), frame = rooms[-1].settings.sensors, arrival.frame
            true = rooms[-1].positions_at(arrival.at_ns - round(sensor.latency_s * 1e9))[0]
            R, t = T_method_world[:3, :3], T_method_world[:3, 3]
            person = Person(0, true @ R.T + t, np.full(len(true), JointState.TRACKED, np.uint8), ())
            place = SensorPlace(sensor.name, T_method_world @ sensor.T_world_sensor)
            state = TrackerState(Phase.TRACKING)
            return Scene(
                0,
                arrival.at_ns,
                frame.sensor,
                0,
                frame.sequence,
                frame.topology,
                state,
                {"people": (person,)},
                (place,),
            )

    monkeypatch.setattr(posture_sessions, "DefaultTracker", Truthful)
    monkeypatch.setattr(posture_sessions, "_room", kept)
    monkeypatch.setattr(posture_sessions, "_WALK", ())
    for result in score_postures(0.0, 0, ("stand", "bow"), azimuths_deg=(0.0,)):
        held_s = POSTURE_S - 2 * RISE_S
        assert 0.97 * 30 * held_s < result.frames <= 30 * held_s + 1  # a few are lost
        assert (result.missing, result.warned, result.wrong) == (0, 0, 0)
        assert result.fused_m < 1e-9
        assert result.best_m > 0.005


def test_an_unknown_posture_is_refused() -> None:
    with pytest.raises(SettingsError, match="levitate"):
        next(score_postures(0.0, 0, ("levitate",)))
