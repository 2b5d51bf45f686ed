"""The filter over everybody's facing: laws, and the numpy form that the training uses."""

from __future__ import annotations

import copy
import dataclasses

import msgspec
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.facing_bodies import ACROSS_X, KINECT, MIRROR, Frames, frames_of
from support.kinematic_bodies import standing

from mocapella.errors import SettingsError
from mocapella.fusion.facing import FacingFilter, FacingMemory, FacingSettings
from mocapella.fusion.facing_grid import (
    BIN,
    LEAST,
    STEP_S,
    YAWS,
    circular_sd,
    most_likely,
    most_likely_angle,
    turned_on,
    unknown,
)
from mocapella.fusion.facing_kernels import ALONE_S, LABELS_TRUE, REPORTED_SD, UNLIKE_S, view_worth
from mocapella.fusion.facing_model import FacingModel, shipped_model, untrained
from mocapella.fusion.facing_shape import LEANS_FROM, LEANS_TO, LENGTHS_M, View, view_of
from mocapella.fusion.facing_training import believed, evidence
from mocapella.geometry.angles import wrap
from mocapella.model.memory import pack, unpack
from mocapella.model.topology import topology

seeds = st.integers(0, 2**32 - 1)
MODELS = {"shipped": shipped_model(), "untrained": untrained()}
models = st.sampled_from(sorted(MODELS))
angles = st.floats(-np.pi, np.pi)
UNKNOWN = 5.0  # rad; where every direction is alike, it is no matter which is told
few = settings(max_examples=20, deadline=None)  # the first call may compile


class InNumpy:
    """One person, as docs/methods/facing.md describes it, with the functions of the training."""

    def __init__(self, model: FacingModel, first_s: float) -> None:
        self.model, self.settings = model, FacingSettings()
        self.p, self.p_angle, self.at_s, self.told_s = unknown(), unknown(), first_s, dict[str, float]()
        self.mirrored: dict[str, bool] = {}
        self.unlike: dict[str, float] = {}

    def update(
        self, sensor: str, positions: np.ndarray, toward: float, at_s: float, velocity: np.ndarray
    ) -> tuple[float, float, bool, float]:
        s = self.settings
        if at_s > self.at_s:
            self.p, self.p_angle = (turned_on(p, (at_s - self.at_s) / STEP_S) for p in (self.p, self.p_angle))
        self.at_s = max(self.at_s, at_s)
        view = view_of(positions, np.array(toward), KINECT)
        if np.isfinite(view.reported):
            counts = {
                who: np.array(np.clip((self.at_s - self.told_s.get(who, -np.inf)) / STEP_S, 0, 1))
                for who in (sensor, "motion")
            }
            trained = self.trained(view, sensor, upright(positions, toward + float(view.seen)))
            moves = s.motion_weight * counts["motion"] * self.model.motion_evidence(velocity)
            said = [moves + self.of_view(view, toward, counts[sensor], trained, w) for w in (s.shape_weight, 0.0)]
            self.told_s |= dict.fromkeys(counts, self.at_s)
            self.p, self.p_angle = believed(self.p, said[0]), believed(self.p_angle, said[1])
        yaw, was = float(most_likely_angle(self.p, self.p_angle)), self.mirrored.get(sensor, False)
        if np.isfinite(view.reported):
            away = self.p[np.abs(wrap(YAWS - view.reported)) > np.pi / 2].sum()
            others = [at for who, at in self.told_s.items() if who not in (sensor, "motion")]
            alone = max(others, default=-np.inf) <= self.at_s - ALONE_S
            mirrored = bool(away > (0.5 if was else s.swap_alone if alone else s.swap))
        else:
            limit, off = s.mirrors_from_deg, np.degrees(abs(wrap(toward - yaw)))
            mirrored = bool(off > (limit - s.hysteresis_deg if was else limit + s.hysteresis_deg))
        self.mirrored[sensor] = mirrored
        return yaw, float(circular_sd(self.p)), mirrored, float(wrap(view.reported + (np.pi if mirrored else 0.0)))

    def trained(self, view: View, sensor: str, upright: float) -> float:
        """How like the training data the sensor's view is, 0 to 1."""
        if self.model.classifier is None:
            return 1.0
        forget = -np.expm1((self.told_s.get(sensor, -np.inf) - self.at_s) / UNLIKE_S)
        far, before = float(self.model.classifier.unlike(view.features)), self.unlike.get(sensor, 0.0)
        self.unlike[sensor] = before + forget * (far - before)
        return (1 - self.unlike[sensor]) * upright

    def of_view(self, view: View, toward: float, counts: np.ndarray, trained: float, shape_weight: float) -> np.ndarray:
        """The evidence of the tables; for a view unlike the training data, that of its labels, taken as they are."""
        near = np.cos(YAWS - view.reported) - 1
        modes = LABELS_TRUE * np.exp(near / REPORTED_SD**2) + (1 - LABELS_TRUE) * np.exp((-near - 2) / REPORTED_SD**2)
        labels = self.settings.yaw_weight * counts * np.log(modes + LEAST)
        used = dataclasses.replace(self.settings, shape_weight=shape_weight)
        return trained * evidence(view, np.array(toward), self.model, used, counts) + (1 - trained) * labels


def upright(positions: np.ndarray, yaw: float) -> float:
    """1 for an upright trunk, 0 for one that leans towards the sensor or away from it beyond `LEANS_TO`."""
    trunk = positions[KINECT.index("Head")] - positions[KINECT.index("SpineBase")]
    if not LENGTHS_M[0] < np.linalg.norm(trunk) < LENGTHS_M[1]:  # also where one is not seen
        return 1.0
    lean = abs(np.arctan2(trunk @ [np.sin(yaw), 0.0, np.cos(yaw)], trunk[1]))
    return float(1 - np.clip((lean - LEANS_FROM) / (LEANS_TO - LEANS_FROM), 0, 1))


@pytest.mark.slow
@given(seeds, models)
@few
def test_the_compiled_filter_says_what_the_numpy_form_says(seed: int, name: str) -> None:
    frames = frames_of(seed)
    facings = FacingFilter(KINECT, model=MODELS[name])
    numpy_form = {person: InNumpy(MODELS[name], frames.at_s[0]) for person in frames.people}
    for k in range(len(frames.at_s)):
        now = frames.give(facings, k, k + 1)[0]
        for n, person in enumerate(frames.people):
            yaw, sd, mirrored, reported = numpy_form[person].update(
                frames.sensors[k], frames.positions[k, n], frames.toward[k, n], frames.at_s[k], frames.velocities[k, n]
            )
            row = facings.memory.p[facings.memory.people[person]]
            np.testing.assert_allclose(row, numpy_form[person].p, atol=1e-9)
            row = facings.memory.p_angle[facings.memory.people[person]]
            np.testing.assert_allclose(row, numpy_form[person].p_angle, atol=1e-9)
            assert wrap(now.yaw[n] - yaw) == pytest.approx(0, abs=1e-9)
            assert now.sd[n] == pytest.approx(sd, abs=1e-6)  # steep where every direction is alike
            assert now.mirrored[n] == mirrored
            assert np.isnan(reported) == np.isnan(now.reported[n])
            assert np.isnan(reported) or wrap(now.reported[n] - reported) == pytest.approx(0, abs=1e-9)


@given(seeds, models, st.integers(-100, 100))
@few
def test_turning_the_world_turns_the_facings(seed: int, name: str, bins: int) -> None:
    here, there = (FacingFilter(KINECT, model=MODELS[name]) for _ in range(2))
    frames = frames_of(seed)
    for one, other in zip(frames.give(here), frames.turned(bins * BIN).give(there), strict=True):
        known = one.sd < UNKNOWN
        np.testing.assert_allclose(wrap(other.yaw - one.yaw - bins * BIN)[known], 0, atol=1e-7)
        np.testing.assert_allclose(other.sd, one.sd, atol=1e-6)
        assert other.mirrored.tolist() == one.mirrored.tolist()


@pytest.mark.slow
@given(seeds, angles, st.integers(1, 11))
@few
def test_a_world_told_in_another_frame_half_way_changes_nothing_else(seed: int, angle: float, k: int) -> None:
    frames, plain, rotated = frames_of(seed), FacingFilter(KINECT), FacingFilter(KINECT)
    before = frames.give(plain)
    frames.give(rotated, 0, k)
    at_s = frames.at_s[k - 1]
    was = rotated.predicted(frames.people, at_s)
    rotated.rotate(angle)
    np.testing.assert_allclose(wrap(rotated.predicted(frames.people, at_s).yaw - was.yaw - angle), 0, atol=1e-9)
    for one, other in zip(before[k:], frames.turned(angle).give(rotated, k), strict=True):
        np.testing.assert_allclose(wrap(other.yaw - one.yaw - angle), 0, atol=1e-7)
        np.testing.assert_allclose(other.sd, one.sd, atol=1e-6)


@given(seeds, models)
@few
def test_a_mirrored_world_has_mirrored_facings_and_the_same_repairs(seed: int, name: str) -> None:
    frames, here, there = (
        frames_of(seed),
        FacingFilter(KINECT, model=MODELS[name]),
        FacingFilter(KINECT, model=MODELS[name]),
    )
    mirrored = dataclasses.replace(
        frames,
        positions=(frames.positions * ACROSS_X)[:, :, MIRROR],
        toward=-frames.toward,
        velocities=frames.velocities * ACROSS_X,
    )
    for one, other in zip(frames.give(here), mirrored.give(there), strict=True):
        np.testing.assert_allclose(wrap(other.yaw + one.yaw), 0, atol=1e-7)
        assert other.mirrored.tolist() == one.mirrored.tolist()


@given(seeds, models)
@few
def test_the_facing_does_not_depend_on_the_labels_and_the_repaired_ones_hardly(seed: int, name: str) -> None:
    """Of bodies like the training data; of others it depends a little."""
    frames, here, there = (
        frames_of(seed, like=MODELS[name].classifier),
        FacingFilter(KINECT, model=MODELS[name]),
        FacingFilter(KINECT, model=MODELS[name]),
    )
    swapped = dataclasses.replace(frames, positions=frames.positions[:, :, MIRROR])
    for k in range(len(frames.at_s)):
        (one,), (other,) = frames.give(here, k, k + 1), swapped.give(there, k, k + 1)
        np.testing.assert_allclose(wrap(other.yaw - one.yaw), 0, atol=1e-7)
        rows = here.memory.p[[here.memory.people[person] for person in frames.people]]
        off = np.abs(wrap(YAWS - one.reported[:, None])) > np.pi / 2
        clear = np.isfinite(one.reported) & (np.abs((rows * off).sum(axis=1) - 0.5) > here.settings.swap_alone - 0.5)
        np.testing.assert_allclose(wrap(other.reported - one.reported)[clear], 0, atol=1e-7)
        assert (other.mirrored != one.mirrored)[clear].all()


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [-50.0, 0.0, 35.0])
def test_a_body_unlike_the_training_data_faces_as_its_labels_say(degrees: float) -> None:
    """A Kinect v2 that reports 35° sees somebody who faces farther away; another sensor may mean what it reports."""
    classifier = shipped_model().classifier
    assert classifier is not None
    body, yaw = standing(yaw=np.radians(degrees)), np.radians(degrees)
    far = body.copy()
    far[[KINECT.index(f"{name}{side}") for name in ("Knee", "Foot") for side in ("Left", "Right")]] += 0.6 * np.array(
        (np.sin(yaw), 0.0, np.cos(yaw))
    )
    found = []
    for positions, unlike in ((body, 0.0), (far, 1.0)):
        assert classifier.unlike(view_of(positions, np.zeros(()), KINECT).features) == unlike
        facing = FacingFilter(KINECT)
        for k in range(60):
            now = facing.update("front", [1], positions[None], np.zeros(1), k / 30, np.full((1, 3), np.nan))
        assert now.unlike[0] == pytest.approx(unlike)
        assert not now.mirrored[0]
        found.append(abs(np.degrees(wrap(now.yaw[0]))))
    assert found[1] == pytest.approx(abs(degrees), abs=3)
    assert degrees == 0.0 or found[0] > abs(degrees) + 10


@given(seeds, st.floats(0, 3), st.floats(0, 3))
@few
def test_frames_that_say_nothing_do_not_matter(seed: int, first: float, then: float) -> None:
    frames, quiet, interrupted = frames_of(seed), FacingFilter(KINECT), FacingFilter(KINECT)
    frames.give(quiet)
    frames.give(interrupted)
    end_s = frames.at_s[-1]
    nothing = np.full((len(frames.people), len(KINECT), 3), np.nan)
    interrupted.update("side", frames.people, nothing, frames.toward[0], end_s + first, frames.velocities[0])
    one, other = (f.predicted(frames.people, end_s + first + then) for f in (quiet, interrupted))
    np.testing.assert_allclose(wrap(other.yaw - one.yaw), 0, atol=1e-6)
    np.testing.assert_allclose(other.sd, one.sd, atol=1e-5)


@given(seeds, st.lists(st.floats(0, 20), min_size=2, max_size=5))
@few
def test_a_prediction_only_widens_and_changes_nothing(seed: int, ages: list[float]) -> None:
    frames, facings = frames_of(seed), FacingFilter(KINECT)
    last = frames.give(facings)[-1]
    before = pack(facings.memory, (FacingMemory,))
    sds = [facings.predicted(frames.people, frames.at_s[-1] + age).sd for age in sorted(ages)]
    assert (np.diff([last.sd, *sds], axis=0) >= -1e-6).all()
    past = facings.predicted(frames.people, frames.at_s[-1] - 1.0)
    assert past.yaw.tobytes() == last.yaw.tobytes()
    assert past.sd.tobytes() == last.sd.tobytes()
    assert pack(facings.memory, (FacingMemory,)) == before


def test_of_somebody_who_was_never_seen_nothing_is_known() -> None:
    facings = FacingFilter(KINECT)
    frames = frames_of(1)
    frames.give(facings)
    unseen = facings.predicted([99, frames.people[0]], frames.at_s[-1])
    assert np.isnan(unseen.yaw).tolist() == [True, False]
    assert unseen.sd[0] == np.inf


@given(seeds)
@few
def test_a_frame_said_twice_counts_once(seed: int) -> None:
    frames = frames_of(seed)
    once, twice = FacingFilter(KINECT), FacingFilter(KINECT)
    frames.give(once)
    for k in range(len(frames.at_s)):
        frames.give(twice, k, k + 1)
        frames.give(twice, k, k + 1)
    np.testing.assert_allclose(twice.memory.p, once.memory.p, atol=1e-12)


@given(seeds, models, st.floats(0, 2 * STEP_S))
@few
def test_a_view_says_no_more_than_the_time_it_stands_for(seed: int, name: str, dt: float) -> None:
    frames, facings = frames_of(seed, frames=2, people=1, missing=0.0), FacingFilter(KINECT, model=MODELS[name])
    frames.sensors, frames.at_s = ["front", "front"], np.array([10.0, 10.0 + dt])
    frames.give(facings, 0, 1)
    before = turned_on(facings.memory.p[0], dt / STEP_S)
    frames.give(facings, 1, 2)
    s, model = facings.settings, MODELS[name]
    most = s.yaw_weight * np.ptp(model.yaw) + s.motion_weight * np.ptp(model.motion)
    most += s.shape_weight * np.ptp(model.shape) if model.shape is not None else 0.0
    assert np.ptp(np.log(facings.memory.p[0] / before)) <= most * min(dt / STEP_S, 1.0) + 1e-6


def test_a_quick_sensor_is_no_surer_than_a_slow_one() -> None:
    frames = frames_of(3, frames=1, people=1, missing=0.0)
    sds = []
    for rate_hz in (29, 58, 290):
        facings = FacingFilter(KINECT)
        n = rate_hz * 2
        many = Frames(
            ["front"] * n, np.arange(n) / rate_hz, frames.people, *(
                np.repeat(array, n, axis=0) for array in (frames.positions, frames.toward, 0 * frames.velocities)
            )
        )  # fmt: skip
        sds.append(many.give(facings)[-1].sd[0])
    assert sds[1:] == pytest.approx([sds[0]] * 2, rel=0.1)


@given(seeds)
@few
def test_people_do_not_depend_on_each_other_nor_on_their_order(seed: int) -> None:
    frames, together = frames_of(seed), FacingFilter(KINECT)
    backwards = dataclasses.replace(
        frames,
        people=frames.people[::-1],
        positions=frames.positions[:, ::-1],
        toward=frames.toward[:, ::-1],
        velocities=frames.velocities[:, ::-1],
    )
    one, other = frames.give(together)[-1], backwards.give(FacingFilter(KINECT))[-1]
    alone = FacingFilter(KINECT)
    first = dataclasses.replace(
        frames,
        people=frames.people[:1],
        positions=frames.positions[:, :1],
        toward=frames.toward[:, :1],
        velocities=frames.velocities[:, :1],
    )
    assert one.yaw.tobytes() == other.yaw[::-1].tobytes()
    assert one.sd[:1].tobytes() == first.give(alone)[-1].sd.tobytes()
    assert alone.memory.p[0].tobytes() == together.memory.p[0].tobytes()


@given(seeds, st.integers(0, 12))
@few
def test_what_is_remembered_can_be_kept_and_put_back_to_the_bit(seed: int, k: int) -> None:
    frames, whole, resumed = frames_of(seed), FacingFilter(KINECT), FacingFilter(KINECT)
    frames.give(whole)
    first = FacingFilter(KINECT)
    frames.give(first, 0, k)
    resumed.memory = unpack(pack(first.memory, (FacingMemory,)), (FacingMemory,))
    frames.give(resumed, k)
    assert pack(resumed.memory, (FacingMemory,)) == pack(whole.memory, (FacingMemory,))


def test_a_snapshot_without_the_angle_continues_with_all_evidence() -> None:
    first, resumed = FacingFilter(KINECT), FacingFilter(KINECT)
    frames = frames_of(4)
    frames.give(first, 0, 6)
    old = msgspec.to_builtins(first.memory, builtin_types=(np.ndarray,))
    del old["p_angle"]
    resumed.memory = FacingMemory(**old)
    assert resumed.memory.p_angle.tobytes() == first.memory.p.tobytes()
    frames.give(resumed, 6)
    assert resumed.memory.p_angle.tobytes() != resumed.memory.p.tobytes()


@pytest.mark.parametrize("degrees", [-30.0, 30.0])
def test_a_shape_between_front_and_back_does_not_turn_the_facing(degrees: float) -> None:
    """Of another body, the score in front of a sensor is that of the training's people seen from the side."""
    model, body = shipped_model(), standing(yaw=np.radians(degrees))
    classifier = model.classifier
    assert classifier is not None
    score, _ = classifier.score(view_of(body, np.zeros(()), KINECT).features)
    constant = np.append(np.zeros(len(classifier.weights) - 1), score - 0.2)
    odd = msgspec.structs.replace(classifier, weights=classifier.weights - constant)
    yaws = []
    for weight in (0.0, 0.2):
        facing = FacingFilter(
            KINECT, FacingSettings(shape_weight=weight), msgspec.structs.replace(model, classifier=odd)
        )
        for k in range(60):
            now = facing.update("front", [1], body[None], np.zeros(1), k / 30, np.full((1, 3), np.nan))
        yaws.append(now.yaw[0])
    assert abs(np.degrees(wrap(most_likely(facing.memory.p[0]) - yaws[0]))) > 5
    assert wrap(yaws[1] - yaws[0]) == pytest.approx(0, abs=1e-6)


@given(seeds)
@few
def test_repairs_tell_every_change_of_the_labels_and_nothing_else(seed: int) -> None:
    frames, facings, swapped = frames_of(seed, frames=30), FacingFilter(KINECT), set()
    for k, now in enumerate(frames.give(facings)):
        sensor = frames.sensors[k]
        for repair in now.repairs:
            assert (repair.sensor, repair.at_s) == (sensor, frames.at_s[k])
            assert repair.mirrored != ((repair.person, sensor) in swapped)
            (swapped.add if repair.mirrored else swapped.remove)((repair.person, sensor))
        assert now.mirrored.tolist() == [(person, sensor) in swapped for person in frames.people]


def test_who_is_forgotten_is_met_anew_and_the_others_stay() -> None:
    frames, facings, never = frames_of(5), FacingFilter(KINECT), FacingFilter(KINECT)
    frames.give(facings)
    a, b, c = frames.people
    kept = facings.predicted([a, c], 99.0)
    facings.forget([c, a, 77])
    assert list(facings.memory.people) == [a, c]
    assert facings.predicted([a, c], 99.0).yaw.tobytes() == kept.yaw.tobytes()
    assert np.isnan(facings.predicted([b], 99.0).yaw[0])
    frames.at_s += 100.0
    again, new = frames.give(facings, 0, 1)[0], frames.give(never, 0, 1)[0]
    assert again.sd[1] == new.sd[1]
    facings.forget([])
    assert (len(facings.memory.p), facings.memory.people) == (0, {})
    facings.reset()
    assert facings.memory.sensors == {}


@given(seeds)
@few
def test_two_who_turn_out_to_be_one_are_what_both_say(seed: int) -> None:
    frames, facings = frames_of(seed, people=2), FacingFilter(KINECT)
    frames.give(facings)
    a, b = frames.people
    memory = copy.deepcopy(facings.memory)
    facings.join(b, a)
    product = memory.p[0] * memory.p[1]
    np.testing.assert_allclose(facings.memory.p, [product / product.sum()], atol=1e-9)
    assert facings.memory.people == {b: 0}
    np.testing.assert_array_equal(facings.memory.told_s[0], memory.told_s.max(axis=0))


def test_joining_somebody_unknown_keeps_what_is_known() -> None:
    frames, facings = frames_of(6), FacingFilter(KINECT)
    frames.give(facings)
    a, b, c = frames.people
    was = facings.predicted([a], 99.0)
    facings.join(60, a)
    facings.join(b, 61)
    facings.join(c, c)
    assert list(facings.memory.people) == [60, b, c]
    assert facings.predicted([60], 99.0).yaw.tobytes() == was.yaw.tobytes()


def test_a_late_join_does_not_make_an_old_facing_count() -> None:
    frames, facings = frames_of(8, people=2, missing=0.0), FacingFilter(KINECT)
    a, b = frames.people
    frames.give(facings, 0, 6)
    alone = dataclasses.replace(
        frames, people=[b], positions=frames.positions[:, 1:], toward=frames.toward[:, 1:],
        velocities=frames.velocities[:, 1:], at_s=frames.at_s + 600.0,
    )  # fmt: skip
    last = alone.give(facings)[-1]
    facings.join(b, a)
    joined = facings.predicted([b], alone.at_s[-1])
    assert joined.yaw[0] == pytest.approx(last.yaw[0], abs=1e-6)
    assert joined.sd[0] == pytest.approx(last.sd[0], abs=1e-6)


@given(angles, angles, angles)
@few
def test_a_views_worth_is_from_nothing_to_one(yaw: float, toward: float, reported: float) -> None:
    worth = float(view_worth(yaw, toward, reported))
    assert 0 <= worth <= 1
    assert worth == pytest.approx(float(view_worth(yaw + 1.0, toward + 1.0, reported + 1.0)), abs=1e-9)
    assume(abs(wrap(reported - yaw)) < 1.5)
    assert view_worth(yaw, toward, yaw) >= worth


@given(angles, st.floats(0, np.pi), st.floats(0, np.pi))
@few
def test_a_view_is_worth_less_the_farther_the_person_is_turned_away(yaw: float, one: float, other: float) -> None:
    near, far = (view_worth(yaw, yaw + away, yaw) for away in sorted((one, other)))
    assert near >= far >= 0.2


def test_a_view_with_wrong_labels_or_without_a_yaw_is_worth_nothing() -> None:
    assert [view_worth(0.3, 0.3, 0.3 + off) for off in (0.0, 2.0, np.nan)] == [1, 0, 0]
    assert view_worth(0.0, np.pi, 0.0) == pytest.approx(0.2)
    assert view_worth(0.0, 0.0, np.pi / 4) == pytest.approx(0.25)


def yaw_of(body: np.ndarray, left: str, right: str) -> float:
    across = body[KINECT.index(left)] - body[KINECT.index(right)]
    return float(np.arctan2(-across[2], across[0]))


def test_what_is_seen_of_shoulders_and_hips_says_the_yaw() -> None:
    frames = frames_of(2, frames=1, people=1, missing=0.0)
    body = frames.positions[0, 0]
    for left, right, lost in (
        ("ShoulderLeft", "ShoulderRight", "ShoulderLeft"),
        ("HipLeft", "HipRight", "HipRight"),
        ("SpineShoulder", "ShoulderRight", "SpineShoulder"),
        ("HipLeft", "SpineBase", "HipLeft"),
    ):
        said = frames.give(FacingFilter(KINECT))[0]
        turned = np.pi if said.mirrored[0] else 0.0
        assert wrap(said.reported[0] - turned - yaw_of(body, left, right)) == pytest.approx(0, abs=1e-9)
        body[KINECT.index(lost)] = np.nan
    assert np.isnan(frames.give(FacingFilter(KINECT))[0].reported[0])


def test_a_view_that_does_not_say_its_yaw_is_mirrored_from_behind() -> None:
    frames, facings = frames_of(2, frames=1, people=1, missing=0.0), FacingFilter(KINECT)
    yaw = frames.give(facings)[0].yaw
    nothing = np.full_like(frames.positions[0], np.nan)
    for degrees, mirrored in ((0, False), (135, False), (145, True), (125, True), (115, False), (-145, True)):
        now = facings.update(
            "side", frames.people, nothing, yaw + np.radians(degrees), frames.at_s[0], frames.velocities[0]
        )
        assert now.mirrored.tolist() == [mirrored], degrees
    blind = facings.update("side", frames.people, nothing, np.full(1, np.nan), frames.at_s[0], frames.velocities[0])
    assert blind.mirrored.tolist() == [True]


def test_shapes_learnt_on_other_joints_say_nothing() -> None:
    kinect_v1 = topology("kinect_v1")
    rng = np.random.default_rng(0)
    positions, velocities = rng.normal(size=(1, len(kinect_v1), 3)), np.zeros((1, 3))
    one, other = FacingFilter(kinect_v1), FacingFilter(
        kinect_v1, model=msgspec.structs.replace(shipped_model(), shape=None, classifier=None)
    )  # fmt: skip
    for facings in (one, other):
        facings.update("front", [0], positions, np.zeros(1), 0.0, velocities)
    assert one.memory.p.tobytes() == other.memory.p.tobytes()


def test_nobody_in_a_frame_is_no_trouble() -> None:
    facings = FacingFilter(KINECT)
    now = facings.update("front", [], np.empty((0, 25, 3)), np.empty(0), 1.0, np.empty((0, 3)))
    assert (now.yaw.shape, now.repairs) == ((0,), ())


def test_a_frame_of_another_form_is_refused_and_changes_nothing() -> None:
    frames, facings = frames_of(4), FacingFilter(KINECT)
    frames.give(facings, 0, 1)
    before = pack(facings.memory, (FacingMemory,))
    good = [frames.positions[0], frames.toward[0], frames.velocities[0]]
    for n, wrong in enumerate((good[0][:, :20], good[1][:2], good[2][:, :2])):
        positions, toward, velocities = [*good[:n], wrong, *good[n + 1 :]]
        with pytest.raises(ValueError, match="3 people and 25 joints were expected"):
            facings.update("new", frames.people, positions, toward, 11.0, velocities)
    with pytest.raises(ValueError, match="a frame at nan s"):
        facings.update("new", frames.people, good[0], good[1], np.nan, good[2])
    assert pack(facings.memory, (FacingMemory,)) == before


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("yaw_weight", -0.1),
        ("shape_weight", 1.1),
        ("motion_weight", np.nan),
        ("hysteresis_deg", 90.0),
        ("mirrors_from_deg", 80.0),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=name):
        FacingSettings(**{name: value})
