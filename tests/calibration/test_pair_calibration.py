from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.pair_judgement import covariance as pose_covariance
from support.walking_people import (
    BACK,
    FRONT,
    KINECT_V2,
    LEFT,
    MIRROR,
    RATE_HZ,
    SIDE,
    Sensor,
    Walker,
    errors,
    standing_at,
)

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_calibration import (
    MIRRORED_STREAM,
    NO_PERSON,
    NOT_ONE_BODY,
    ON_A_LINE,
    PairCalibration,
    PairSettings,
)
from mocapella.calibration.pair_memory import FRAMES_KEPT, BodyTrack, turned_joints
from mocapella.errors import SettingsError
from mocapella.geometry.alignment import MOMENTS, align, moments
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.geometry.twists import log_motion
from mocapella.model.topology import topology, topology_names

TRUTH = inverse(FRONT) @ SIDE
WALKER = Walker()


def calibrated(  # noqa: PLR0917 - a pair of sensors, people, and for how long
    a: Sensor,
    b: Sensor,
    walkers: Mapping[int, Walker],
    seconds: float,
    pair: PairCalibration | None = None,
    begin: float = 0.0,
    *,
    rate_hz: float = RATE_HZ,
) -> PairCalibration:
    """Both sensors' frames, as they come; body i of one is body i of the other."""
    pair = pair or PairCalibration()
    tracks = {s.name: {body: BodyTrack.empty(25) for body in walkers} for s in (a, b)}
    count = round(seconds * rate_hz)
    frames = sorted((begin + s.phase + i / rate_hz, s.name, s) for s in (a, b) for i in range(count))
    for i, (t, name, sensor) in enumerate(frames):
        if i % 15 == 14:
            pair.follow_clock(pair.estimate())
        seen = sensor.see(dict(walkers), t)
        for body, positions, states in zip(seen.ids, seen.positions, seen.states, strict=True):
            tracks[name][body].add(t + sensor.clock, positions, states, 0.2)
            pair.update(body, tracks[a.name][body], tracks[b.name][body], MIRROR)
    return pair


def test_without_noise_the_motion_is_exact() -> None:
    pair = calibrated(Sensor("a", FRONT), Sensor("b", SIDE), {0: WALKER}, 8)
    np.testing.assert_allclose(pair.T_a_b, TRUTH, atol=1e-9)
    assert pair.estimate().trusted


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_moving_a_sensors_frame_moves_the_result_with_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, B = (rigid(rotation_about_y(rng.uniform(-3, 3)), rng.normal(size=3)) for _ in range(2))
    found = []
    for T_a, T_b in ((np.eye(4), np.eye(4)), (A, B)):
        a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01)
        pair, tracks = PairCalibration(), [BodyTrack.empty(25), BodyTrack.empty(25)]
        for i in range(120):
            t = i / RATE_HZ
            for track, sensor, T in zip(tracks, (a, b), (T_a, T_b), strict=True):
                seen = sensor.see({0: WALKER}, t)
                track.add(t, apply(T, seen.positions[0]), seen.states[0], 0.2)
            pair.update(0, *tracks, MIRROR)
        found.append(pair.T_a_b)
    np.testing.assert_allclose(found[1], A @ found[0] @ inverse(B), atol=1e-8)


@pytest.mark.parametrize("kind", ["outliers", "labels", "both"])
def test_a_third_of_outliers_and_swapped_labels_do_not_matter(kind: str) -> None:
    b = Sensor("b", SIDE, noise=0.005)
    if kind in ("outliers", "both"):
        b.outliers = 0.3
    if kind in ("labels", "both"):
        b.mirrored = True
    pair = PairCalibration(mirrored_at_first=b.mirrored)
    metres, radians = errors(calibrated(Sensor("a", FRONT, noise=0.005), b, {0: WALKER}, 12, pair).T_a_b, TRUTH)
    assert metres < 0.01
    assert radians < np.radians(0.3)


def test_labels_that_are_swapped_for_a_while_are_noticed_each_time() -> None:
    a, b = Sensor("a", FRONT), Sensor("b", SIDE)
    pair = calibrated(a, b, {0: WALKER}, 6)
    mirrored = []
    for begin in (6.0, 8.0, 10.0):
        b.mirrored = begin == 8.0
        calibrated(a, b, {0: WALKER}, 2, pair, begin)
        mirrored.append(bool(pair.bodies[0][at.MIRRORED]))
    assert mirrored == [False, True, False]
    np.testing.assert_allclose(pair.T_a_b, TRUTH, atol=1e-6)


def test_the_moments_are_the_batch_of_all_frames_under_the_weights_that_were_used() -> None:
    """One frame after the other equals one fit of all, where nothing is forgotten and weights do not depend on it."""
    still = PairSettings(
        memory_s=9e5, first_memory_s=9e5, residual_floor_m=1e3, full_speed_m_s=1e-6, still_fraction=0.05, every_s=0.0
    )
    a, b = Sensor("a", FRONT, noise=0.02), Sensor("b", SIDE, noise=0.02)
    pair, A, B = PairCalibration(still), BodyTrack.empty(25), BodyTrack.empty(25)
    p, q = [], []
    for i in range(40):
        t = i / RATE_HZ
        seen = [sensor.see({0: WALKER}, t) for sensor in (a, b)]
        for track, view in zip((A, B), seen, strict=True):
            track.add(t, view.positions[0], view.states[0], 0.2)
        p.append(seen[0].positions[0])
        q.append(seen[1].positions[0])
        pair.update(0, A, B, MIRROR)
    used = slice(4, 37)  # whose velocity is known: two frames and more on either side, and the first counts otherwise
    batch = align(moments(np.concatenate(p[used]), np.concatenate(q[used])))
    np.testing.assert_allclose(pair.T_a_b, batch, atol=2e-4)


def test_memory_does_not_grow() -> None:
    short, long = (calibrated(Sensor("a", FRONT), Sensor("b", SIDE), {0: WALKER}, s) for s in (3, 20))
    assert {k: np.shape(v) for k, v in vars(short).items()} == {k: np.shape(v) for k, v in vars(long).items()}
    track = BodyTrack.empty(25)
    for i in range(10 * FRAMES_KEPT):
        track.add(float(i), np.ones((25, 3)), np.full(25, 2, dtype=np.uint8), 0.2)
        assert track.held[1] - track.held[0] == min(i + 1, FRAMES_KEPT)
        assert track.newest == i


def test_without_a_person_nothing_is_known() -> None:
    estimate = calibrated(Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01), {}, 1).estimate()
    assert estimate.problem == NO_PERSON
    assert not estimate.trusted


@pytest.mark.parametrize("people", [1, 2])
def test_standing_people_give_a_pose_that_is_less_certain_than_from_walking(people: int) -> None:
    noisy = (Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01))
    stand = {k: Walker((0.8 * k, 2.6 + 0.4 * k), speed=0.0) for k in range(people)}
    walk = {k: Walker((0.8 * k, 2.6 + 0.4 * k)) for k in range(people)}
    standing, walking = (calibrated(*noisy, crowd, 6).estimate() for crowd in (stand, walk))
    assert standing.trusted
    assert walking.trusted
    metres, radians = errors(standing.T_a_b, TRUTH)
    assert radians < 2 * standing.rotation_sd
    assert metres < 2 * standing.position_sd + 3 * standing.rotation_sd
    assert standing.rotation_sd > 1.5 * walking.rotation_sd


def test_shoulders_turned_towards_the_sensor_hardly_turn_the_pose_of_a_person_in_place() -> None:
    """As real sensors do with a person seen from the side; with the full weight, the pose turns with them."""

    def off(weight: float) -> float:
        pair, turned = PairCalibration(PairSettings(turned_weight=weight)), turned_joints(KINECT_V2)
        tracks = [BodyTrack.empty(25) for _ in range(2)]
        for i in range(90):
            for sensor, track in ((Sensor("a", FRONT), tracks[0]), (Sensor("b", SIDE), tracks[1])):
                bodies = sensor.see({0: Walker(speed=0.0)}, i / RATE_HZ)
                points = bodies.positions[0].copy()
                if sensor.name == "b":
                    spine = rigid(np.eye(3), points[0])
                    turn = spine @ rigid(rotation_about_y(np.radians(20.0)), np.zeros(3)) @ inverse(spine)
                    points[turned] = apply(turn, points[turned])
                track.add(i / RATE_HZ, points, bodies.states[0], 0.2)
            pair.update(0, *tracks, MIRROR, turned)
        return errors(pair.T_a_b, TRUTH)[1]

    assert off(PairSettings().turned_weight) < 0.5 * off(1.0)
    assert off(1.0) > np.radians(1.0)


@pytest.mark.parametrize("name", ["kinect_v1", "kinect_v2", "nite"])
def test_a_depth_sensor_turns_shoulders_elbows_and_hips_of_either_side(name: str) -> None:
    known = topology(name)
    turned = {joint.lower() for joint, is_turned in zip(known.joints, turned_joints(known), strict=True) if is_turned}
    assert len(turned) == 6
    for side in ("left", "right"):
        for part in ("shoulder", "elbow", "hip"):
            assert any(side in joint and part in joint for joint in turned)


@pytest.mark.parametrize("name", sorted(topology_names()))
def test_a_joint_is_turned_with_its_mirror_image_and_one_of_the_spine_never(name: str) -> None:
    known = topology(name)
    turned, mirror = turned_joints(known), np.array(known.mirror)
    np.testing.assert_array_equal(turned[mirror], turned)
    assert not turned[mirror == np.arange(len(mirror))].any()


def test_joints_on_a_line_are_refused() -> None:
    pair, A, B = PairCalibration(), BodyTrack.empty(25), BodyTrack.empty(25)
    line = np.zeros((25, 3))
    line[:, 1], line[:, 2] = np.linspace(0, 1.7, 25), 2.5
    for i in range(200):
        for track, T in ((A, FRONT), (B, SIDE)):
            track.add(i / RATE_HZ, apply(inverse(T), line), np.full(25, 2, dtype=np.uint8), 0.2)
        pair.update(0, A, B, MIRROR)
    assert pair.estimate().problem == ON_A_LINE


def test_two_people_who_are_taken_for_one_are_refused() -> None:
    pair, A, B = PairCalibration(), BodyTrack.empty(25), BodyTrack.empty(25)
    one, other = Walker(), Walker((0.5, 3.0), speed=0.9, phase=2.5)
    for i in range(600):
        t = i / RATE_HZ
        for track, sensor, walker in ((A, Sensor("a", FRONT), one), (B, Sensor("b", SIDE), other)):
            seen = sensor.see({0: walker}, t)
            track.add(t, seen.positions[0], seen.states[0], 0.2)
        pair.update(0, A, B, MIRROR)
    assert pair.estimate().problem == NOT_ONE_BODY


def test_a_mirrored_picture_is_said_to_be_one() -> None:
    class Mirrored(Sensor):
        def see(self, walkers: dict[int, Walker], t: float):  # type: ignore[no-untyped-def]
            seen = super().see(walkers, t)
            seen.positions[..., 0] *= -1
            return seen

    pair = calibrated(Sensor("a", FRONT), Mirrored("b", SIDE), {0: WALKER}, 20)
    assert pair.estimate().problem in (MIRRORED_STREAM, NOT_ONE_BODY)
    assert calibrated(Sensor("a", FRONT), Sensor("b", SIDE), {0: WALKER}, 20).estimate().problem == ""


def test_joints_that_are_not_there_do_not_count() -> None:
    class Holes(Sensor):
        def see(self, walkers: dict[int, Walker], t: float):  # type: ignore[no-untyped-def]
            seen = super().see(walkers, t)
            for value in (np.nan, 0.0, np.inf):
                seen.positions[:, self.rng.integers(0, 25, 3)] = value
            seen.states[:, self.rng.integers(0, 25, 3)] = 0
            return seen

    pair = calibrated(Holes("a", FRONT), Holes("b", SIDE), {0: WALKER}, 8)
    np.testing.assert_allclose(pair.T_a_b, TRUTH, atol=1e-9)
    empty = calibrated(Sensor("a", FRONT), Sensor("b", SIDE), {0: WALKER}, 0)
    track = BodyTrack.empty(25)
    track.add(0.0, np.full((25, 3), np.nan), np.zeros(25, dtype=np.uint8), 0.2)
    assert empty.update(0, track, track, MIRROR) == 0
    assert np.isnan(empty.estimate().T_a_b).any()


def test_frames_out_of_order_and_gaps_are_left_out() -> None:
    track = BodyTrack.empty(25)
    joints, states = np.ones((25, 3)), np.full(25, 2, dtype=np.uint8)
    assert track.add(1.0, joints, states, 0.2)
    assert not track.add(1.0, joints, states, 0.2)
    assert not track.add(0.5, joints, states, 0.2)
    assert not track.add(np.nan, joints, states, 0.2)
    a, b = Sensor("a", FRONT), dataclasses.replace(Sensor("b", SIDE), phase=0.0)
    pair = calibrated(a, b, {0: WALKER}, 2)
    steps = pair.scalars[at.STEPS]
    calibrated(a, b, {0: WALKER}, 0.1, pair, begin=5.0)  # too short for a velocity
    assert pair.scalars[at.STEPS] == steps
    np.testing.assert_allclose(pair.T_a_b, TRUTH, atol=1e-9)


@pytest.mark.slow
def test_somebody_who_stands_for_a_minute_does_not_wear_the_estimate_out() -> None:
    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", SIDE, noise=0.01)
    pair = calibrated(a, b, {0: WALKER}, 10)
    before = pair.estimate()
    calibrated(a, b, {0: Walker(speed=0.0)}, 60, pair, begin=10.0)
    after = pair.estimate()
    assert after.trusted
    assert after.rotation_sd < 1.5 * before.rotation_sd
    assert errors(after.T_a_b, TRUTH)[1] < np.radians(0.5)


class Biased(Sensor):
    """What real sensors do: errors of 4 cm that stay the same for 0.7 s, beside the noise."""

    def see(self, walkers: dict[int, Walker], t: float):  # type: ignore[no-untyped-def]
        seen = super().see(walkers, t)
        slow = np.random.default_rng([self.seed, int(t / 0.7)])
        seen.positions[:] += 0.04 * slow.normal(size=(25, 3))
        return seen


@pytest.mark.slow
def test_the_covariance_is_that_of_the_errors() -> None:
    """Normalised error squared of six unknowns, over runs: 6 where it is just right, and rather too careful than not.

    The first samples are expected to be worse than they are, and noise that is new in every frame does little harm.
    """
    nees, angles, sds = [], [], []
    for seed in range(16):
        a, b = Biased("a", FRONT, noise=0.02, seed=seed), Sensor("b", SIDE, noise=0.02, seed=seed)
        estimate = calibrated(a, b, {0: Walker(phase=seed)}, 15).estimate()
        d = log_motion(TRUTH @ inverse(estimate.T_a_b))
        nees.append(d @ np.linalg.solve(estimate.covariance, d))
        angles.append(np.linalg.norm(d[3:]))
        sds.append(estimate.rotation_sd)
    assert 0.5 < np.mean(nees) < 9.0
    assert np.max(nees) < 20.0
    assert np.mean(sds) < 4 * np.sqrt(np.mean(np.square(angles)))


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-4, 1e-2, 1e3]), st.sampled_from([1e-4, 1e-2, 1e3]))
def test_the_units_of_angles_and_of_the_clock_do_not_matter_to_the_covariance(
    seed: int, per_rad: float, per_s: float
) -> None:
    rng = np.random.default_rng(seed)
    H, B = (x @ x.T for x in rng.normal(size=(2, 7, 20)))
    W, samples, motion_s, residual, offset_sd = rng.uniform(0.5, 2.0, 5).tolist()

    def covariance(units: np.ndarray) -> np.ndarray:
        scale = np.outer(units, units)
        return pose_covariance(
            H * scale, B * scale, weight=W, samples=samples, motion_s=motion_s, residual=residual,
            offset_sd=offset_sd / float(units[6]),
        )  # fmt: skip

    units = np.array([1.0] * 3 + [per_rad] * 3 + [per_s])
    expected = covariance(np.ones(7)) / np.outer(units[:6], units[:6])
    np.testing.assert_allclose(covariance(units), expected, rtol=1e-6)


@pytest.mark.slow
def test_four_times_the_frames_of_the_same_errors_are_no_more_samples() -> None:
    few, many = (
        calibrated(Biased("a", FRONT), Sensor("b", SIDE), {0: WALKER}, 15, rate_hz=rate).estimate()
        for rate in (30.0, 120.0)
    )
    assert many.rotation_sd == pytest.approx(few.rotation_sd, rel=0.3)
    assert many.samples == pytest.approx(few.samples, rel=0.2)


@pytest.mark.parametrize("T_b", [SIDE, LEFT, BACK, standing_at(0.0, 0.0)])
def test_eight_seconds_of_walking_are_enough_wherever_the_second_sensor_stands(T_b: np.ndarray) -> None:
    a, b = Sensor("a", FRONT, noise=0.01), Sensor("b", T_b, noise=0.01, phase=0.011)
    metres, radians = errors(calibrated(a, b, {0: WALKER}, 8).T_a_b, inverse(FRONT) @ T_b)
    assert metres < 0.010
    assert radians < np.radians(0.3)


def test_settings_out_of_range_are_refused() -> None:
    for wrong in (
        {"memory_s": 0.0}, {"label_hysteresis_m": 0.01}, {"mirrored_weight": 1.5}, {"moved_factor": 0.5},
        {"memory_growth": -1.0}, {"velocity_window_s": 0.5}, {"every_s": 1.0}, {"samples_wanted": 0},
    ):  # fmt: skip
        with pytest.raises(SettingsError, match=next(iter(wrong))):
            PairSettings(**wrong)  # type: ignore[arg-type]


def test_what_is_remembered_is_arrays_of_fixed_size() -> None:
    pair = PairCalibration()
    assert pair.moments.shape == (MOMENTS,)
    assert pair.scalars.shape == (at.PAIR_SCALARS,)
    assert at.new_body(mirrored=True)[at.MIRRORED] == 1.0


def test_a_clock_that_is_set_otherwise_changes_nothing_of_people_who_stood() -> None:
    """Where nothing moved, times do not matter; all sums fade alike, so that their ratios stay."""
    rng = np.random.default_rng(0)
    q, gradients = rng.normal(size=(25, 3)) * [0.3, 0.5, 0.2] + [0.2, 0.1, 2.5], rng.normal(size=(4, 7))
    gradients[:, 6] = 0.0  # with the clock
    pair = PairCalibration(T_a_b=TRUTH.copy(), moments=50.0 * moments(apply(TRUTH, q), q))
    pair.scatter = gradients.T @ gradients
    pair.scalars[[at.MOTION, at.BLOCKS, at.BLOCKS_SQ, at.BLOCKS_CLOSED]] = 5.0, 4.0, 4.0, 4.0
    pair.scalars[[at.COST, at.COST_WEIGHT, at.APART_SQ]] = 0.2, 4.0, 0.4
    pair.scalars[at.CENTRE : at.CENTRE + 3] = 4.0 * apply(TRUTH, q).mean(axis=0)
    pair.clock[:] = np.array([1.0, 0.05, 1.0, 0.05, 0.05**2]) * 10  # ten equal blocks that say 50 ms
    before = pair.estimate()
    weight = pair.moments[0]
    pair.follow_clock(before)
    after = pair.estimate()
    assert pair.scalars[at.REFERENCE_OFFSET] == pytest.approx(0.05, abs=1e-4)
    assert pair.moments[0] < 0.7 * weight
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=1e-9, atol=1e-15)
    assert (after.samples, after.residual) == pytest.approx((before.samples, before.residual))
    assert after.offset_now.seconds == pytest.approx(before.offset_now.seconds)
