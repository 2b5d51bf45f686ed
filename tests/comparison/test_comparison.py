"""A recording compared with a reference: what is planted is found, and what cannot be told is said."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import mocapella
from mocapella.comparison.agreement import LIMIT, agreement
from mocapella.comparison.comparison import compared
from mocapella.comparison.flexions import Flexion, flexions, hinges
from mocapella.comparison.joint_names import layout_of, matched_joints, plain_name, read_joint_map
from mocapella.comparison.lag_search import ratios_to_try
from mocapella.comparison.pairing import pairs_of_text
from mocapella.comparison.smooth_paths import smooth_paths, without_spikes
from mocapella.errors import EvaluationError, InputError, MocapellaError, SettingsError
from mocapella.evaluation.compared_pairs import SCENES, ComparedPairSettings, errors_of, simulated_pair
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.model.hand import LANDMARKS
from mocapella.model.resampling import resampled
from mocapella.model.topology import topology
from mocapella.model.trajectories import Trajectories

KINECT = topology("kinect_v2")


def moving(at: np.ndarray, seed: int = 0, joints: int = 8, people: int = 1) -> np.ndarray:
    """Joints (times, people, joints, 3) that swing about a body which moves about."""
    rng = np.random.default_rng(seed)
    shape = (people, joints, 3)
    out = np.broadcast_to(rng.normal(size=shape) * 0.3 + [0, 1, 2], (len(at), *shape)).copy()
    for own in (shape, (people, 1, 3)):
        for _ in range(3):
            size, rate, phase = (rng.uniform(low, high, own) for low, high in ((0.03, 0.1), (1.5, 8.0), (0, 6)))
            out += size * np.sin(rate * at[:, None, None, None] + phase)
    return out


def made(at: np.ndarray, positions: np.ndarray, names: tuple[str, ...] = (), **more: object) -> Trajectories:
    known = np.isfinite(positions).all(axis=3)
    people = more.pop("people", tuple(f"person_{k}" for k in range(positions.shape[1])))
    rate = more.pop("rate_hz", 1.0 / float(np.median(np.diff(at))) if len(at) > 1 else math.nan)
    keypoints = names or KINECT.joints[: positions.shape[2]]
    return Trajectories(
        "people", at, np.zeros(len(at), np.int64), people, keypoints, positions, np.where(known, 2, 0).astype(np.uint8),
        np.full(known.shape, np.nan, np.float32), rate_hz=rate, **more,
    )  # fmt: skip


def pair(
    seed: int, noise_m: float = 0.0, **more: object
) -> tuple[Trajectories, Trajectories, float, float, np.ndarray]:
    """A recording, a reference, ratio and shift of the clocks, and the rigid motion."""
    rng = np.random.default_rng(seed)
    ratio, shift = 1 + rng.uniform(-1e-3, 1e-3), rng.uniform(-3, 3)
    T = rigid(Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3))
    at, theirs = np.arange(0, 8, 1 / 30), np.arange(shift - 1, shift + 7.5, 1 / 100)
    x, y = moving(at, seed, **more), apply(inverse(T), moving((theirs - shift) / ratio, seed, **more))
    x = x + rng.normal(scale=noise_m, size=x.shape)
    return made(at, x), made(theirs, y), ratio, shift, T


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000))
def test_time_rate_and_rigid_motion_are_found(seed: int) -> None:
    ours, theirs, ratio, shift, T = pair(seed)
    found = compared({"people": ours}, {"people": theirs})
    motion = found.motion
    assert motion.reference_s(np.array(4.0)) == pytest.approx(ratio * 4 + shift, abs=2e-3)
    assert motion.ratio == pytest.approx(ratio, abs=3e-4)
    np.testing.assert_allclose(motion.T, T, atol=2e-3)
    assert motion.explained > 0.999
    assert np.nanmax(np.linalg.norm(found.errors, axis=3)) < 0.01
    rms = [found.all_positions(rigid=rigid_too).rmse for rigid_too in (False, True)]  # type: ignore[union-attr]
    assert rms[1] < 0.002
    assert rms[0] > 0.1
    assert [word.partition(" was")[0] for word in found.corrections] == [
        "the time offset", "the rate of the clocks", "the rigid motion",
    ]  # fmt: skip


@pytest.mark.parametrize("seconds", [0.6, 0.95])
def test_a_recording_below_a_second_is_compared(seconds: float) -> None:
    ours, theirs, _, shift, T = pair(4)
    found = compared(
        {"people": ours.at(ours.times_s < seconds)}, {"people": theirs.at(theirs.times_s < shift + seconds)}
    )
    assert found.motion.reference_s(np.array(0.3)) == pytest.approx(0.3 + shift, abs=0.01)
    np.testing.assert_allclose(found.motion.T, T, atol=0.02)


def test_markers_50_mm_beside_the_joints_hardly_move_the_time() -> None:
    ours, theirs, ratio, shift, _ = pair(5)
    beside = theirs.positions + np.random.default_rng(0).normal(scale=0.05, size=theirs.positions.shape[1:])
    found = compared({"people": ours}, {"people": replace(theirs, positions=beside)})
    assert found.motion.reference_s(np.array(4.0)) == pytest.approx(ratio * 4 + shift, abs=2e-3)
    assert np.all(found.motion.translation_sd_m > 0.003)  # such distances do not average out
    bare = compared({"people": ours}, {"people": replace(theirs, positions=beside)}, remove_bias=True)
    np.testing.assert_allclose(np.nanmean(bare.errors, axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(bare.errors + found.biases, found.errors, atol=1e-12)
    assert "--remove-bias" in bare.corrections[-1]
    np.testing.assert_array_equal(bare.biases, found.biases)


def of_two_sensors(seed: int, lag_s: float, bias_m: float = 0.0) -> Trajectories:
    """Results that follow the frames of two sensors in turn, of which the second sees everything later and beside."""
    rng = np.random.default_rng(seed)
    at = np.arange(0, 12, 1 / 60)
    sensors = np.arange(len(at)) % 2
    x = moving(at - lag_s * sensors, seed) + rng.normal(scale=0.003, size=(len(at), 1, 8, 3))
    return made(at, x + bias_m * rng.normal(size=(2, 1, 8, 3))[sensors], sensors=sensors)


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000))
def test_lags_of_the_sensors_count_in_the_uncertainty(seed: int) -> None:
    """The results of one of two sensors are half the lag away from those of both; a known sensor makes it known."""
    ours = of_two_sensors(seed, 0.01, 0.01)
    first = ours.at(slice(0, None, 2))
    sides = {"people": ours}, {"people": first}
    motion = compared(*sides).motion
    error = abs(motion.reference_s(np.array(6.0)) - 6.0)
    assert error == pytest.approx(0.005, abs=0.002)
    assert 0.5 < error / motion.offset_sd_s < 2.0
    turned = Rotation.from_matrix(motion.T[:3, :3]).as_rotvec()
    assert np.all(np.abs(turned) < 4 * motion.rotation_sd)
    unknown = compared({"people": replace(ours, sensors=ours.sensors[:0])}, sides[1]).motion
    assert error > 5 * unknown.offset_sd_s  # the guard: noise alone does not tell
    swapped = compared(sides[1], sides[0]).motion
    assert swapped.offset_sd_s == pytest.approx(motion.offset_sd_s, rel=0.3)


def test_sensors_that_agree_add_little_uncertainty() -> None:
    ours, theirs = of_two_sensors(1, 0.0), made(np.arange(0, 12, 0.01), moving(np.arange(0, 12, 0.01), 1))
    motion = compared({"people": ours}, {"people": theirs}).motion
    alone = compared({"people": replace(ours, sensors=ours.sensors[:0])}, {"people": theirs}).motion
    assert motion.offset_sd_s < 1.6 * alone.offset_sd_s


def test_slow_errors_count_in_the_uncertainty() -> None:
    """All joints are late, then early: neither the joints' own noise nor two seconds of it show that."""
    rng = np.random.default_rng(0)
    at, theirs = np.arange(0, 24, 1 / 30), np.arange(-1, 25, 1 / 100)
    late = 0.02 * np.sin(2 * np.pi * at / 9)
    ours = made(at, moving(at - late, 3) + rng.normal(scale=0.003, size=(len(at), 1, 8, 3)))
    motion = compared({"people": ours}, {"people": made(theirs, moving(theirs, 3))}).motion
    error = abs(motion.reference_s(np.array(12.0)) - 12.0)
    assert error < 3 * motion.offset_sd_s
    assert motion.offset_sd_s > 0.002


@pytest.mark.parametrize("rate_hz", [30.0, 100.0])
def test_an_exact_recording_that_rests_most_of_the_time_is_found(rate_hz: float) -> None:
    """What moves for a short time is no outlier while the time is rough."""
    at = np.arange(0, 20, 1 / 30) + np.random.default_rng(0).uniform(-0.002, 0.002, 600)
    moves = np.clip(np.minimum(at - 8, 11 - at), 0, 1)[:, None, None, None] ** 2
    ours = made(at, moving(np.zeros(1), 5) + moves * (moving(at, 5) - moving(np.zeros(1), 5)))
    motion = compared({"people": ours}, {"people": resampled(ours, rate_hz)}).motion
    middle = motion.middle_s
    assert motion.reference_s(np.array(middle)) == pytest.approx(middle, abs=1e-3)


def test_clock_and_space_are_held() -> None:
    """Two people, of whom the other tracker gives the ids the other way round, beside where they were."""
    ours = pair(3, people=2)[0]
    moved = replace(ours.of(["person_1", "person_0"]), individuals=("a", "b"))
    moved = replace(moved, positions=moved.positions + np.array([0.05, 0.0, 0.0]))
    found = compared({"people": ours}, {"people": moved}, same_clock=True, same_space=True)
    assert found.people == {"person_0": "b", "person_1": "a"}
    assert found.corrections == ()
    np.testing.assert_array_equal(found.motion.T, np.eye(4))
    np.testing.assert_array_equal(found.reference_s, found.times_s)
    np.testing.assert_allclose(
        found.errors[np.isfinite(found.errors).all(axis=3)].mean(axis=0), [-0.05, 0, 0], atol=1e-9
    )
    clock = compared({"people": ours}, {"people": moved}, people=found.people, same_clock=True)
    np.testing.assert_allclose(clock.motion.T[:3, 3], [-0.05, 0, 0], atol=1e-6)
    assert clock.corrections == ("the rigid motion was estimated",)
    assert (clock.motion.offset_sd_s, clock.motion.ratio_sd) == (0.0, 0.0)
    later = replace(moved, times_s=moved.times_s + 1.5)
    space = compared({"people": ours}, {"people": later}, people=found.people, same_space=True)
    assert space.motion.shift_s == pytest.approx(1.5, abs=5e-3)
    assert "the rigid motion was estimated" not in space.corrections
    assert not space.motion.rotation_sd.any()


def test_one_clock_is_the_wall_clock_where_both_state_it() -> None:
    ours = replace(pair(3)[0], began_unix_ns=10**18)
    later = replace(ours.at(slice(30, None)), began_unix_ns=10**18 + 10**9)
    later = replace(later, times_s=later.times_s - 1.0)
    found = compared({"people": ours}, {"people": later}, same_clock=True, same_space=True)
    assert np.nanmax(np.abs(found.errors)) < 1e-9
    untold = replace(later, began_unix_ns=0)
    found = compared({"people": ours}, {"people": untold}, same_clock=True, same_space=True)
    assert np.nanmax(np.abs(found.errors)) > 0.01


def test_what_cannot_be_held_is_refused() -> None:
    ours, theirs, *_ = pair(1)
    for reference, why in (
        (replace(theirs, rate_hz=math.nan), "no times; leave --same-clock out"),
        (replace(ours, positions=ours.positions + 9.0), "within 0.5 m of each other at the same time"),
        (replace(ours, times_s=ours.times_s + 99.0), "within 0.5 m of each other at the same time"),
    ):
        with pytest.raises(MocapellaError, match=why):
            compared({"people": ours}, {"people": reference}, same_clock=True, same_space=True)
    with pytest.raises(EvaluationError, match="no known joints at a common time"):
        compared({"people": ours}, {"people": replace(ours, times_s=ours.times_s + 99.0)}, same_clock=True)
    with pytest.raises(EvaluationError, match="no common motion"):
        compared({"people": ours}, {"people": made(ours.times_s, moving(ours.times_s, 99))}, same_clock=True)


def test_measured_and_inferred_samples_are_scored_apart() -> None:
    ours, theirs, *_ = pair(7)
    states = ours.states.copy()
    states[::2] = 1
    positions = ours.positions.copy()
    positions[::2, :, 2, 1] += 0.03
    found = compared({"people": replace(ours, states=states, positions=positions)}, {"people": theirs})
    name = KINECT.joints[2]
    assert found.positions("inferred")[name].bias[1] > found.positions("measured")[name].bias[1] + 0.025
    total = [found.all_positions(state).n for state in (None, "measured", "inferred")]  # type: ignore[union-attr]
    assert total[0] == total[1] + total[2]


def test_samples_that_the_reference_infers_are_not_measured() -> None:
    ours, theirs, *_ = pair(7)
    found = compared({"people": ours}, {"people": replace(theirs, states=np.minimum(theirs.states, 1))})
    assert found.positions("measured") == {}
    assert found.positions("inferred")


def test_people_are_matched_by_their_motion_or_by_the_user() -> None:
    ours, theirs, *_ = pair(3, people=2)
    theirs = replace(theirs.of(["person_1", "person_0"]), individuals=("anna", "ben"))
    found = compared({"people": ours}, {"people": theirs})
    assert found.people == {"person_0": "ben", "person_1": "anna"}
    assert any(name.startswith("person_1: ") for name in found.positions())
    one = compared({"people": ours}, {"people": theirs}, people=pairs_of_text("person_0 = ben"))
    assert one.people == {"person_0": "ben"}
    with pytest.raises(SettingsError, match="no 'bob' among people; known: anna, ben"):
        compared({"people": ours}, {"people": theirs}, people={"person_0": "bob"})
    twins = replace(theirs, positions=theirs.positions[:, [0, 0]])
    with pytest.raises(
        EvaluationError, match=r"match of individuals is ambiguous: .*person_0, person_1.* anna, ben; name pairs"
    ):
        compared({"people": ours}, {"people": twins})


@pytest.mark.parametrize("text", ["person_0", "a=b,a=c", "a=b,c=b", "=b", ""])
def test_pairs_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="write OURS=THEIRS"):
        pairs_of_text(text)
    assert pairs_of_text(None) == {}


def test_without_motion_the_time_is_unknown() -> None:
    at = np.arange(0, 6, 1 / 30)
    rng = np.random.default_rng(0)
    still = np.broadcast_to(rng.normal(size=(1, 8, 3)), (len(at), 1, 8, 3))
    T = rigid(Rotation.random(random_state=1).as_matrix(), [1.0, 2.0, 3.0])
    sides = [made(at, one + rng.normal(scale=0.003, size=one.shape)) for one in (still, apply(inverse(T), still))]
    found = compared({"people": sides[0]}, {"people": sides[1]})
    assert math.isinf(found.motion.offset_sd_s)
    assert math.isinf(found.motion.ratio_sd)
    assert "the time offset is not observable" in found.notes[0]
    assert "the time offset was estimated" not in found.corrections
    np.testing.assert_allclose(found.motion.T, T, atol=2e-3)
    later = compared({"people": sides[0]}, {"people": replace(sides[1], times_s=at + 100)})
    assert "the beginnings are taken as one time" in later.notes[0]
    with pytest.raises(EvaluationError, match="no times, and without motion"):
        compared({"people": sides[0]}, {"people": replace(sides[1], rate_hz=math.nan)})


def test_a_periodic_motion_fits_at_several_times() -> None:
    rng = np.random.default_rng(2)
    size, phase = rng.uniform(0.05, 0.1, (1, 1, 8, 3)), rng.uniform(0, 6, (1, 1, 8, 3))
    place = rng.normal(size=(8, 3))

    def at(times: np.ndarray) -> Trajectories:
        noise = rng.normal(scale=0.003, size=(len(times), 1, 8, 3))
        return made(times, noise + place + size * np.sin(np.pi * times[:, None, None, None] + phase))

    found = compared({"people": at(np.arange(0, 8, 1 / 30))}, {"people": at(np.arange(0, 8, 1 / 50))})
    assert "the motion repeats itself: it fits nearly as well" in found.notes[0]
    away = float(found.notes[0].split()[-3])
    assert away == pytest.approx(2.0 * round(away / 2.0), abs=0.05)


def test_what_cannot_be_compared_is_refused_in_one_line() -> None:
    ours, theirs, *_ = pair(1)
    other = made(theirs.times_s, moving(theirs.times_s, 99))
    nothing = replace(theirs, positions=np.full_like(theirs.positions, np.nan), states=0 * theirs.states)
    renamed = replace(theirs, keypoints=tuple(f"m{k}" for k in range(8)))
    cases = {
        "no common motion": ({"people": ours}, {"people": other}),
        "never shows the joints": ({"people": ours}, {"people": nothing}),
        r"no joint of the recording \(SpineBase,.*m0, m1": ({"people": ours}, {"people": renamed}),
        "the reference is too short": ({"people": ours}, {"people": theirs.at(slice(0, 20))}),
        "fewer than two frames": ({"people": ours.at(slice(0, 1))}, {"people": theirs}),
        "the recording has no people": ({}, {"people": theirs}),
        "has no times; give it as the reference": ({"people": replace(ours, rate_hz=math.nan)}, {"people": theirs}),
    }
    for why, sides in cases.items():
        with pytest.raises(MocapellaError, match=why) as refused:
            compared(*sides)
        assert "\n" not in str(refused.value)
    with pytest.raises(SettingsError, match="--kind 'hands': the recording has people"):
        compared({"people": ours}, {"people": theirs}, kind="hands")


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["walk", "obstacle"])
def test_simulated_people_reach_the_figures(scene: str) -> None:
    found = errors_of(simulated_pair(scene, 2000, ComparedPairSettings(seconds=60.0)))
    assert abs(found.offset_s) < 2e-3
    assert abs(found.ratio) < 1e-4
    assert found.angle_deg < 0.1
    assert found.shift_m < 2e-3
    assert found.people_right
    assert scene in SCENES


@pytest.mark.slow
def test_a_reference_without_times_gets_its_rate() -> None:
    found = errors_of(simulated_pair("walk", 2001, ComparedPairSettings(seconds=20.0, clock=False)))
    assert abs(found.offset_s) < 2e-3
    assert abs(found.ratio) < 5e-4


@pytest.mark.slow
def test_squats_and_a_walk_of_azure_and_vicon_are_not_one_motion(azure_and_vicon: Path) -> None:
    """The two files of this set show different movements: squats, and steps on the spot or on a treadmill."""
    with pytest.raises(EvaluationError, match="no common motion"):
        mocapella.compare(azure_and_vicon / "azure_positions.csv.gz", azure_and_vicon / "vicon.csv.gz")


def test_pose2sims_own_filter_shows(single_person: Path) -> None:
    """The last step of Pose2Sim put the person on the floor: 32 mm up, which the rigid motion takes away."""
    raw, last = (next((single_person / "pose-3d").glob(f"*{end}.trc")) for end in ("0-100", "LSTM"))
    found = mocapella.compare(raw, last).result
    assert found.motion.shift_s == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(found.motion.T[:3, 3], [0.0, 0.0324, 0.0], atol=1e-3)
    rmse = [found.all_positions(rigid=rigid_too).rmse for rigid_too in (False, True)]  # type: ignore[union-attr]
    assert rmse[1] < 0.02
    assert rmse[0] > 0.035
    assert {"RKnee (angle)", "LElbow (angle)"} <= set(found.angle_names)


@given(st.integers(0, 1000), st.integers(1, 3))
def test_agreement_is_that_of_bland_and_altman(seed: int, axes: int) -> None:
    d = np.random.default_rng(seed).normal(size=(50, axes))
    found = agreement(np.vstack([d, np.full((3, axes), np.nan)]))
    assert found is not None
    np.testing.assert_allclose(found.bias, d.mean(axis=0))
    np.testing.assert_allclose(found.high, d.mean(axis=0) + LIMIT * d.std(axis=0, ddof=1))
    np.testing.assert_allclose(np.subtract(found.high, found.low), 2 * LIMIT * np.array(found.difference_sd))
    assert found.n == 50
    assert found.rmse**2 == pytest.approx(found.mean**2 + found.sd**2 * 49 / 50)
    assert agreement(d[:1]) is None


def test_spikes_go_and_fast_motion_stays() -> None:
    at = np.arange(0, 4, 1 / 30)
    fast = moving(at, 4)[:, 0] + np.random.default_rng(0).normal(scale=0.005, size=(len(at), 8, 3))
    spiked = fast.copy()
    spiked[50, 3] += 0.4
    found = without_spikes(spiked)
    assert np.isnan(found[50, 3]).all()
    assert np.isfinite(found).all(axis=2).mean() > 0.98


@settings(max_examples=10)
@given(st.integers(0, 1000))
def test_smooth_paths_have_lines_and_their_velocities_exactly(seed: int) -> None:
    """A local line is exact for a uniform motion, at any times of samples, and unknown in a gap."""
    rng = np.random.default_rng(seed)
    at = np.sort(rng.uniform(0, 3, 200))
    start, velocity = rng.normal(size=(2, 4, 3))
    positions = start + at[:, None, None] * velocity
    positions[(at > 1) & (at < 1.5)] = np.nan
    found = smooth_paths(at, positions, 0.05)
    known = np.isfinite(found.positions).all(axis=(1, 2))
    times = found.times_s[known]
    np.testing.assert_allclose(found.positions[known], start + times[:, None, None] * velocity, atol=1e-9)
    np.testing.assert_allclose(found.velocities[known], np.broadcast_to(velocity, (len(times), 4, 3)), atol=1e-6)
    assert not known[(found.times_s > 1.1) & (found.times_s < 1.4)].any()
    value, slope = found.at(np.array([-1.0, 9.0]))
    assert np.isnan(value).all()
    assert np.isnan(slope).all()


def test_long_recordings_try_more_rates() -> None:
    np.testing.assert_array_equal(ratios_to_try(60.0), [1.0])
    assert len(ratios_to_try(3600.0)) > 50


def test_names_match_through_layouts() -> None:
    assert plain_name("mixamorig:Left_UpLeg") == plain_name("left upleg") == "leftupleg"
    found = {one.name: one for one in matched_joints(KINECT.joints, topology("body_25").joints)}
    assert found["KneeLeft"].theirs == {"LKnee": 1.0}
    assert found["FootLeft"].theirs.keys() == {"LHeel", "LBigToe", "LSmallToe"}
    markers = ("LASI", "RASI", "LPSI", "RPSI", "LKNE", "RKNE", "LANK", "RANK", "LWRA", "LWRB")
    found = {one.name: one for one in matched_joints(KINECT.joints, markers)}
    assert found["SpineBase"].theirs == dict.fromkeys(markers[:4], 0.25)
    assert found["WristLeft"].theirs == {"LWRA": 0.5, "LWRB": 0.5}
    assert layout_of(("Hips", "LeftUpLeg", "LeftLeg", "LeftFoot"))[0] == "bvh"
    assert len(matched_joints(LANDMARKS, tuple(name.upper().replace(" ", "_") for name in LANDMARKS))) == 21
    assert [one.common for one in matched_joints(("LKnee", "RKnee", "LHip", "x"), ("lknee", "RKNEE", "lhip", "y"))] == [
        "KneeLeft", "KneeRight", "HipLeft",
    ]  # fmt: skip


def test_a_map_names_markers_with_weights(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text('KneeLeft = { LKNE = 0.5, LKNM = 0.5 }\nHead = "TOP"\n', encoding="utf-8")
    table = read_joint_map(path)
    assert table == {"KneeLeft": {"LKNE": 0.5, "LKNM": 0.5}, "Head": {"TOP": 1.0}}
    knee, head = matched_joints(KINECT.joints, ("LKNE", "LKNM", "TOP"), table)
    assert (knee.common, head.theirs) == ("KneeLeft", {"TOP": 1.0})
    with pytest.raises(SettingsError, match=r"the reference has no 'TOP' for Head; it has LKNE, LKNM"):
        matched_joints(KINECT.joints, ("LKNE", "LKNM"), table)
    with pytest.raises(SettingsError, match="the recording has no joint 'KneeLeft'"):
        matched_joints(("Head",), ("LKNE", "LKNM", "TOP"), table)
    with pytest.raises(SettingsError, match="sum to 1"):
        matched_joints(KINECT.joints, ("LKNE",), {"KneeLeft": {"LKNE": 0.4}})
    path.write_text("KneeLeft = 3\n", encoding="utf-8")
    with pytest.raises(InputError, match="table of joints"):
        read_joint_map(path)
    path.write_text("", encoding="utf-8")
    with pytest.raises(SettingsError, match="names no joint"):
        read_joint_map(path)


def test_angles_are_those_between_bones() -> None:
    points = np.array([[0.0, 1, 0], [0, 0, 0], [1, 0, 0], [0, -1, 0]])
    of = (Flexion("bent", 0, 1, 2), Flexion("straight", 0, 1, 3))
    np.testing.assert_allclose(flexions(points, of), [np.pi / 2, 0.0], atol=1e-12)
    assert flexions(points, ()).shape == (0,)
    joints = matched_joints(KINECT.joints, KINECT.joints)
    names = {one.name for one in hinges(joints, KINECT.joints, KINECT.bones)}
    assert {"KneeLeft", "ElbowRight", "HipLeft"} <= names
    assert names == {one.name for one in hinges(joints, KINECT.joints, ())}


def test_hands_are_compared_with_the_names_of_another_program() -> None:
    ours, theirs, *_ = pair(6, joints=21)
    theirs = replace(theirs, keypoints=tuple(name.upper().replace(" ", "_") for name in LANDMARKS))
    found = compared({"hands": replace(ours, kind="hands", keypoints=LANDMARKS)}, {"points": theirs})
    assert found.kind == "hands"
    assert len(found.joints) == 21
    assert {"index PIP (angle)", "thumb IP (angle)"} <= set(found.angle_names)
    assert np.degrees(found.all_angles().rmse) < 1.0  # type: ignore[union-attr]


def test_stated_angles_are_compared_on_the_circle() -> None:
    ours, theirs, ratio, shift, _ = pair(2)
    own = (3.0 * np.sin(ours.times_s) + 3.0)[:, None, None]
    other = (3.0 * np.sin((theirs.times_s - shift) / ratio) + 3.0 + 2 * np.pi - 0.1)[:, None, None]
    sides = (replace(ours, angle_names=("bend",), angles=own), replace(theirs, angle_names=("bend",), angles=other))
    found = compared({"people": sides[0]}, {"people": sides[1]})
    assert found.angle_names[0] == "bend"
    assert found.angle_agreement()["bend"].bias[0] == pytest.approx(0.1, abs=0.01)
    assert found.all_angles("measured") is not None
    inferred = replace(sides[0], states=np.minimum(sides[0].states, 1))
    assert "bend" not in compared({"people": inferred}, {"people": sides[1]}).angle_agreement("measured")
