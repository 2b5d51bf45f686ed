"""A refresh is spread over frames: each does a bounded part, all together do what a whole one does."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.walking_people import FRONT, RATE_HZ, SIDE, Sensor, Walker, standing_at

from mocapella.calibration import people
from mocapella.calibration.people import WORK_A_FRAME, WORK_PER_PAIR, PeopleCalibration
from mocapella.model.bodies import Bodies
from mocapella.model.memory import pack, unpack
from mocapella.tracker.default import _REMEMBERED

SENSORS, SECONDS = 7, 2.5
CROWD = {
    0: Walker((-0.7, 2.6), speed=0.5),
    1: Walker((0.6, 3.1), phase=1.9),
    2: Walker((0.1, 2.2), phase=1.0, speed=0.4),
}


@cache
def frames() -> list[tuple[Bodies, int]]:
    """What sensors around three people who walk see."""
    ring = [
        Sensor(f"s{i}", standing_at(2.6 * np.sin(a), 2.8 - 2.6 * np.cos(a), -np.degrees(a)), noise=0.01)
        for i, a in enumerate(np.linspace(0, 2 * np.pi, SENSORS, endpoint=False))
    ]
    return [
        (sensor.see(CROWD, t), round(1e9 * (100 + t)))
        for k in range(round(SECONDS * RATE_HZ))
        for i, sensor in enumerate(ring)
        for t in [(k + i / SENSORS) / RATE_HZ]
    ]


def memory(calibration: PeopleCalibration) -> bytes:
    return pack(calibration.memory(), _REMEMBERED)


def recalled(data: bytes) -> PeopleCalibration:
    calibration = PeopleCalibration()
    calibration.recall(unpack(data, _REMEMBERED))
    return calibration


class Watched(PeopleCalibration):
    """Notes the steps of each frame."""

    steps_taken: tuple[tuple[str, int], ...] = ()

    def _take(self, name: str, keys: Any, now: float, people: Any) -> None:
        Watched.steps_taken += ((name, len(keys) or len(self._pairs)),)
        super()._take(name, keys, now, people)


def test_a_frame_does_a_bounded_part_of_a_refresh() -> None:
    calibration, refreshes, split = Watched(), 0, 0
    for bodies, at_ns in frames():
        Watched.steps_taken, before = (), calibration.state
        state = calibration.update(bodies, at_ns)
        assert bodies.sensor in state.sensors
        work = [WORK_PER_PAIR.get(name, 1) * pairs for name, pairs in Watched.steps_taken]
        assert len(work) == 1 or sum(work) <= WORK_A_FRAME
        for name, pairs in Watched.steps_taken:
            assert name not in WORK_PER_PAIR or pairs <= WORK_A_FRAME // WORK_PER_PAIR[name]
        refreshes += state is not before
        split += bool(calibration._steps)
    assert refreshes > SECONDS / calibration.settings.refresh_s
    assert split > refreshes
    assert all(sensor.trusted and sensor.root == "s0" for sensor in calibration.state.sensors.values())


@pytest.mark.slow
def test_the_steps_together_give_what_a_whole_refresh_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    calibration = PeopleCalibration()
    for k, (bodies, at_ns) in enumerate(frames()):
        calibration.update(bodies, at_ns)
        if k % 150 != 149:
            continue
        whole, spread = recalled(memory(calibration)), recalled(memory(calibration))
        spread._begin_refresh(calibration._now)
        updates = 0
        while spread._steps:
            spread._advance(calibration._now, None, WORK_A_FRAME)
            updates += 1
        assert updates > 1
        with monkeypatch.context() as patched:
            patched.setattr(people, "WORK_A_FRAME", 10**9)
            whole._begin_refresh(calibration._now)
            whole._advance(calibration._now, None, 10**9)
        assert not whole._steps
        assert memory(whole) == memory(spread)


@pytest.mark.slow
def test_a_memory_from_the_middle_of_a_refresh_goes_on_to_the_bit() -> None:
    first, others = PeopleCalibration(), dict[str, PeopleCalibration]()
    for bodies, at_ns in frames()[:420]:
        for calibration in (first, *others.values()):
            calibration.update(bodies, at_ns)
        following = first._steps[0][0] if first._steps else ""
        if following in {"calibrations", "graph", "poses", "results"} - others.keys() and first._refreshed > 0.5:
            others[following] = recalled(memory(first))
    assert others.keys() >= {"calibrations", "graph", "poses"}
    for other in others.values():
        assert memory(other) == memory(first)


def test_a_memory_keeps_that_an_estimator_is_also_a_hypothesis() -> None:
    """Three people who stand: what most bodies agree on is refined, and stays a hypothesis until somebody walks."""
    standing = {0: Walker((-0.9, 2.8), speed=0.0), 1: Walker((0.2, 3.3), speed=0.0), 2: Walker((0.8, 2.4), speed=0.0)}
    sensors = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01, phase=0.011)
    first, other = PeopleCalibration(), PeopleCalibration()
    for k in range(60):
        for sensor in sensors:
            t = sensor.phase + k / RATE_HZ
            bodies, at_ns = sensor.see(standing, t), round(1e9 * (100 + t))
            first.update(bodies, at_ns)
            if k > 40:
                other.update(bodies, at_ns)
        if k == 40:
            (pair,) = first._pairs.values()
            assert any(one is pair.calibration for one in pair.cold.hypotheses.values())
            other = recalled(memory(first))
    assert memory(other) == memory(first)


def test_an_older_memory_has_no_steps() -> None:
    calibration = PeopleCalibration()
    for bodies, at_ns in frames()[:300]:
        calibration.update(bodies, at_ns)
        if calibration._steps:
            break
    assert calibration._steps
    older = {name: value for name, value in PeopleCalibration().memory().items() if name != "_steps"}
    calibration.recall(older)
    assert calibration._steps == []
