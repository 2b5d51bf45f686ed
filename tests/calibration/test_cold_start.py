"""Two sensors from nothing, before many people: what puts all of them together is believed."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.walking_people import FRONT, KINECT_V2, MIRROR, RATE_HZ, SIDE, Sensor, Walker, errors

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import MOST, POSTURE_S, WHICH_SIDE, WHO_IS_WHO, ColdStart, Likeliest, unwalked
from mocapella.calibration.pair_calibration import WALK, PairCalibration, PairEstimate, PairSettings
from mocapella.calibration.pair_memory import SensorTracks
from mocapella.calibration.people import PeopleCalibration
from mocapella.calibration.shared_people import mutually_nearest
from mocapella.calibration.time_offset import TimeOffset
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y

T_A_B = inverse(FRONT) @ SIDE
points = arrays(np.float64, st.tuples(st.integers(0, 5), st.just(3)), elements=st.floats(-2, 2))


@given(points, points, st.floats(-3, 3), st.floats(0.01, 1))
def test_each_is_near_one_only_and_the_frame_does_not_matter(
    a: np.ndarray, b: np.ndarray, yaw: float, within_m: float
) -> None:
    T = rigid(rotation_about_y(yaw), (1.0, 0.0, -2.0))
    straight = mutually_nearest(np.eye(4)[None], a, b, within_m)
    turned = mutually_nearest(inverse(T)[None], a, apply(T, b) if len(b) else b, within_m + 1e-9)
    distance = np.linalg.norm(a[:, None] - b[None], axis=-1)
    assert (distance[straight[0]] <= within_m).all()
    if len(np.unique(distance.round(6))) == distance.size:
        assert straight.sum(axis=1).max(initial=0) <= 1
        assert straight.sum(axis=2).max(initial=0) <= 1
        assert (straight <= turned).all()


def seen(people: Mapping[int, Walker], seconds: float = 1.0) -> tuple[ColdStart, SensorTracks, SensorTracks]:
    """What two sensors make of people who stand or walk, each with its own ids."""
    cold, tracks = ColdStart(PairSettings()), [SensorTracks.empty(len(KINECT_V2)) for _ in range(2)]
    for k in range(round(seconds * RATE_HZ)):
        for sensor, of, first in ((Sensor("a", FRONT), tracks[0], 0), (Sensor("b", SIDE), tracks[1], 50)):
            bodies = sensor.see({first + body: who for body, who in people.items()}, k / RATE_HZ)
            of.add(k / RATE_HZ, bodies.ids, bodies.positions, bodies.states, 0.2)
        cold.update(tracks[0], tracks[1], MIRROR)
    return cold, *tracks


def stands(x: float, z: float = 2.8) -> Walker:
    return Walker((x, z), speed=0.0)


def estimated(motion_s: float, residual: float = 0.05) -> PairEstimate:
    unknown = TimeOffset(0.0, 0.1, False)
    return PairEstimate(T_A_B, 1e-4 * np.eye(6), 0.02, 0.03, motion_s, 1.0, residual, unknown, unknown, "")


@pytest.mark.parametrize(
    ("rival", "labels", "motion_s", "wary", "problem"),
    [
        (np.inf, np.inf, 2.0, False, ""),
        (np.inf, 0.06, 2.0, False, WHICH_SIDE),  # the body may as well be seen from behind
        (np.inf, 0.08, 2.0, False, ""),
        (0.06, np.inf, 2.0, False, WHO_IS_WHO),
        (np.inf, np.inf, 0.9 * POSTURE_S, False, WALK),
        (np.inf, np.inf, 2.0, True, WALK),
    ],
)
def test_an_estimate_from_one_posture_needs_a_clear_fit(
    rival: float, labels: float, motion_s: float, wary: bool, problem: str
) -> None:
    one = Likeliest(PairCalibration(), rival, labels)
    assert one.judged(estimated(motion_s), wary=wary).problem == problem


def test_who_has_walked_is_told_by_the_walk_and_not_by_the_posture() -> None:
    walked = PairCalibration()
    walked.scalars[at.BLOCKS_CLOSED] = walked.settings.samples_wanted
    assert Likeliest(walked, 0.08, 0.05).judged(estimated(0.5), wary=True).trusted
    assert not Likeliest(walked, 0.06, np.inf).judged(estimated(0.5)).trusted


def test_with_several_people_an_estimate_from_a_walk_has_to_be_more_certain() -> None:
    walked, sure = PairCalibration(), estimated(5.0)
    walked.scalars[at.BLOCKS_CLOSED] = walked.settings.samples_wanted
    unsure = msgspec.structs.replace(sure, rotation_sd=0.05)
    assert Likeliest(walked, np.inf, np.inf).judged(unsure).trusted
    assert Likeliest(walked, np.inf, np.inf).judged(unsure, wary=True).problem == WALK
    assert Likeliest(walked, np.inf, np.inf).judged(sure, wary=True).trusted


def test_what_most_agree_on_is_not_trusted_before_somebody_has_walked() -> None:
    """Six who stand and hide each other are matched wrongly for seconds."""
    crowd = {k: Walker((0.7 * k - 0.7, 2.6 + 0.5 * (k % 2)), speed=0.0) for k in range(3)}
    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01, phase=0.011)
    calibration = PeopleCalibration()
    for k in range(round(3 * RATE_HZ)):
        for sensor in (a, b):
            bodies = sensor.see(crowd, sensor.phase + k / RATE_HZ)
            state = calibration.update(bodies, round(1e9 * (100 + sensor.phase + k / RATE_HZ)))
    assert not state.sensors["b"].trusted
    assert "walk" in state.sensors["b"].condition
    assert unwalked(estimated(9.0)).problem == WALK


def test_a_body_that_was_forgotten_elsewhere_begins_anew() -> None:
    """An estimator that most bodies agree with is refined beside its hypothesis."""
    cold, a, b = seen({0: stands(0.0)})
    (one, *_) = cold.hypotheses.values()
    one.forget_bodies(lambda who: False)
    cold.update(a, b, MIRROR)
    assert one.bodies.keys() == {(0, 50)}
    assert one.bodies[0, 50][at.STEP_AT] == one.bodies[0, 50][at.LAST] > 0.5


def test_people_who_stand_unevenly_say_who_is_who() -> None:
    cold, a, b = seen({0: stands(-0.9), 1: stands(0.2, 3.3), 2: stands(0.8, 2.4)})
    agreed = cold.agreed(a, b, None)
    assert agreed is not None
    assert errors(agreed.T_a_b, T_A_B)[0] < 0.05
    assert cold.agreed(a, b, agreed) is agreed


def test_an_even_row_and_a_pair_leave_it_open() -> None:
    for row in ((-0.9, 0.0, 0.9), (-0.7, 0.4)):
        cold, a, b = seen({body: stands(x) for body, x in enumerate(row)})
        assert cold.agreed(a, b, None) is None


def test_what_was_believed_wrongly_gives_way_to_what_puts_more_together() -> None:
    cold, a, b = seen({0: stands(-0.9), 1: stands(0.2, 3.3), 2: stands(0.8, 2.4)})
    wrong = PairCalibration.begun_from(T_A_B @ rigid(np.eye(3), (0.0, 0.0, 1.0)), PairSettings())
    agreed = cold.agreed(a, b, wrong)
    assert agreed is not None
    assert agreed is not wrong


@pytest.mark.parametrize("renewed_s", [1.3, 1e9])
def test_five_who_cross_place_two_sensors_in_seconds_though_their_ids_never_last(renewed_s: float) -> None:
    rng = np.random.default_rng(3)
    crowd = {
        k: Walker((x, z), phase=1.7 * k, speed=0.6 + 0.1 * k)
        for k, (x, z) in enumerate([(-0.8, 2.6), (0.7, 2.4), (0.1, 3.4), (-0.5, 3.7), (0.9, 3.2)])
    }
    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01, phase=0.011)
    names = {sensor: rng.permutation(10_000) for sensor in "ab"}
    calibration = PeopleCalibration()
    for k in range(round(7 * RATE_HZ)):
        for sensor in (a, b):
            t = sensor.phase + k / RATE_HZ
            age = int(t / renewed_s)
            bodies = sensor.see({int(names[sensor.name][10 * age + who]): at for who, at in crowd.items()}, t)
            state = calibration.update(bodies, round(1e9 * (100 + t)))
    assert calibration.tied == {"a", "b"}
    one, other = (state.sensors[name].T_world_sensor for name in "ab")
    metres, radians = errors(inverse(one) @ other, T_A_B)
    assert metres < 0.02
    assert radians < np.radians(0.6)


def crowd(*numbers: int) -> SensorTracks:
    tracks, states = SensorTracks.empty(len(KINECT_V2)), np.full((len(numbers), len(KINECT_V2)), 2, np.uint8)
    tracks.add(0.0, numbers, np.ones((len(numbers), len(KINECT_V2), 3)), states, 0.2)
    return tracks


def test_hypotheses_are_of_the_bodies_that_both_sensors_see_now_and_known_ones_go_on() -> None:
    cold = ColdStart(PairSettings())
    cold.update(crowd(1, 2), crowd(5, 6), MIRROR)
    before = dict(cold.hypotheses)
    assert set(before) == {(a, b, swapped) for a in (1, 2) for b in (5, 6) for swapped in (False, True)}
    assert all(one.mirrored_at_first is key[2] for key, one in before.items())
    cold.update(crowd(2, 3), crowd(6), MIRROR)
    assert set(cold.hypotheses) == {(a, 6, swapped) for a in (2, 3) for swapped in (False, True)}
    assert all(cold.hypotheses[key] is before[key] for key in ((2, 6, False), (2, 6, True)))
    cold.update(crowd(2), crowd(5), MIRROR)
    assert set(cold.hypotheses) == {(2, 5, False), (2, 5, True)}
    cold.update(crowd(2), crowd(), MIRROR)
    assert cold.hypotheses == {}


def test_hypotheses_of_a_crowd_are_bounded_and_stay_the_same() -> None:
    cold, many = ColdStart(PairSettings()), crowd(*range(7))
    cold.update(many, many, MIRROR)
    first = list(cold.hypotheses)
    assert len(first) == MOST
    assert first[:3] == [(0, 0, False), (0, 0, True), (0, 1, False)]
    cold.update(many, many, MIRROR)
    assert list(cold.hypotheses) == first


def test_hypotheses_together_are_what_each_would_be_alone() -> None:
    """They share a body's interpolated frames only at one time, and bodies may change their slots."""
    people = {k: Walker((0.7 * k - 0.7, 2.6), phase=1.7 * k, speed=0.6) for k in range(3)}
    sensors = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01, phase=0.011)
    seen = [SensorTracks.empty(len(KINECT_V2)) for _ in sensors]
    cold, alone = ColdStart(PairSettings()), dict[tuple[int, int, bool], PairCalibration]()
    for k in range(45):
        for sensor, tracks in zip(sensors, seen, strict=True):
            bodies = sensor.see(people, sensor.phase + k / RATE_HZ)
            order = np.arange(len(bodies.ids))
            if k == 20:
                tracks.clear()
                order = order[::-1]
            ids = [bodies.ids[i] for i in order]
            tracks.add(sensor.phase + k / RATE_HZ, ids, bodies.positions[order], bodies.states[order], 0.2)
        cold.update(*seen, MIRROR)
        for (one, other, swapped), together in cold.hypotheses.items():
            begun = (one, other, swapped) in alone
            single = alone.setdefault((one, other, swapped), PairCalibration(mirrored_at_first=swapped))
            single.update((one, other), seen[0].bodies[one], seen[1].bodies[other], MIRROR)
            if not begun:
                together.scalars[at.REFERENCE_OFFSET] = single.scalars[at.REFERENCE_OFFSET] = 0.01 * (one % 2 + swapped)
    assert len(alone) == 18
    for key, single in alone.items():
        assert single.scalars[at.STEPS] > 5
        assert single.is_copy_of(cold.hypotheses[key])
