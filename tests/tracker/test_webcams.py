"""The method webcams: promises of a tracker, symmetries, faults of detectors and of rigs, and the reasons it gives."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from support.webcam_people import (
    HALPE,
    between,
    circling,
    frames,
    identities,
    last_of_each,
    run,
    standing,
    walker,
)

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Phase, Scene
from mocapella.model.topology import topology
from mocapella.testing import check_tracker
from mocapella.tracker import METHODS
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings
from mocapella.tracker.webcams_warmup import circle_of_cameras

Float64 = NDArray[np.float64]
Person = Callable[[float], Float64 | None]


def person(path: Any, **more: Any) -> Person:
    return lambda at_s: walker(at_s, path, **more)


FOUR = circle_of_cameras(4)
TWO = CameraRig({name: FOUR.cameras[name] for name in ("cam-0", "cam-1")})
PAIR: list[Person] = [person(circling(0.8, 6)), person(circling(0.8, 6, np.pi), height_m=1.6, phase=1.0)]


def numbers(scenes: list[Scene], people: list[Person]) -> list[set[int]]:
    return [{number for number, _ in one} for one in identities(scenes, people)]


def check_two_people(scenes: list[Scene], people: list[Person], *, most_error_m: float = 0.05) -> None:
    """Both are tracked from the fourth instant on, each under one number, and nobody else."""
    found = identities(scenes[4:], people)
    assert [len({number for number, _ in one}) for one in found] == [1, 1]
    assert {len(scene.people) for scene in scenes[4:]} == {2}
    assert all(np.mean([error for _, error in one]) < most_error_m for one in found)


def test_it_keeps_the_promises_of_a_tracker() -> None:
    arrivals = frames(FOUR, PAIR, seconds=0.5, offsets_s={"cam-1": 0.004, "cam-2": 0.011, "cam-3": 0.029})
    other = msgspec.structs.replace(arrivals[9].frame, sensor="cam-9")
    scenes = check_tracker(lambda: WebcamsTracker(FOUR), [*arrivals, Arrival(other, arrivals[-1].at_ns)])
    assert len(scenes[-1].people) == 2


def test_measured_joints_are_near_the_true_ones_and_their_deviations_say_how_near() -> None:
    scenes = last_of_each(run(WebcamsTracker(FOUR), frames(FOUR, PAIR, seconds=1.5)))
    check_two_people(scenes, PAIR, most_error_m=0.03)
    errors, sds = [], []
    for scene in scenes[15:]:
        for i, one in enumerate(sorted(scene.people, key=lambda one: one.positions[HALPE.index("Nose"), 1])):
            truth = sorted((p(scene.at_ns / 1e9 - 1.0) for p in PAIR), key=lambda p: float(p[0, 1]))[i]  # type: ignore[index]
            measured = one.states == JointState.TRACKED
            assert measured.sum() >= 20
            assert one.sd is not None
            errors += np.linalg.norm(one.positions - truth, axis=1)[measured].tolist()
            sds += one.sd[measured].tolist()
    assert np.sqrt(np.mean(np.square(errors)) / 3.0) < 3.0 * np.sqrt(np.mean(np.square(sds)))


def test_the_order_of_the_detections_changes_nothing() -> None:
    random = np.random.default_rng(5)

    def shuffled(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        order = random.permutation(len(px))
        return px[order], sure[order]

    plain = run(WebcamsTracker(FOUR), frames(FOUR, PAIR, seconds=0.4))
    other = run(WebcamsTracker(FOUR), frames(FOUR, PAIR, seconds=0.4, fault=shuffled))
    for one, two in zip(plain, other, strict=True):
        places = [sorted(p.positions.tobytes() for p in scene.people) for scene in (one, two)]
        assert places[0] == places[1]


def test_other_names_of_the_cameras_give_the_same_people() -> None:
    new = {"cam-0": "z", "cam-1": "c", "cam-2": "m", "cam-3": "a"}
    arrivals = frames(FOUR, PAIR, seconds=0.5)
    cameras = {}
    for old, name in new.items():
        placed = FOUR.cameras[old]
        camera = msgspec.structs.replace(placed.camera, name=name)
        cameras[name] = msgspec.structs.replace(placed, camera=camera)
    rig = CameraRig(cameras)
    renamed = [Arrival(msgspec.structs.replace(a.frame, sensor=new[a.frame.sensor]), a.at_ns) for a in arrivals]
    plain, other = run(WebcamsTracker(FOUR), arrivals), run(WebcamsTracker(rig), renamed)
    for one in plain[-1].people:
        near = min(other[-1].people, key=lambda p: float(np.abs(p.positions - one.positions).max()))
        assert near.positions == pytest.approx(one.positions, abs=1e-3)


def test_another_world_gives_the_same_people_there() -> None:
    T_new_world = rigid(rotation_about_y(0.7), (3.0, 0.5, -2.0))
    moved = {
        name: msgspec.structs.replace(one, T_camera_world=one.T_camera_world @ inverse(T_new_world))
        for name, one in FOUR.cameras.items()
    }
    arrivals = frames(FOUR, PAIR, seconds=0.5)
    plain, other = run(WebcamsTracker(FOUR), arrivals)[-1], run(WebcamsTracker(CameraRig(moved)), arrivals)[-1]
    for one, two in zip(plain.people, other.people, strict=True):
        assert two.positions == pytest.approx(apply(T_new_world, one.positions), abs=2e-3)


def test_two_cameras_show_people_after_three_instants() -> None:
    scenes = last_of_each(run(WebcamsTracker(TWO), frames(TWO, PAIR[:1], seconds=0.5)))
    assert [len(scene.people) for scene in scenes[:2]] == [0, 0]
    assert len(scenes[4].people) == 1
    early = WebcamsTracker(TWO, WebcamsSettings(confirm_instants=1))
    assert len(last_of_each(run(early, frames(TWO, PAIR[:1], seconds=0.1)))[1].people) == 1


def test_people_who_pass_each_other_keep_their_numbers() -> None:
    people = [
        person(between((-1.8, 0.15), (1.8, 0.15))),
        person(between((1.8, -0.15), (-1.8, -0.15)), height_m=1.7, phase=1.0),
    ]
    scenes = last_of_each(run(WebcamsTracker(FOUR), frames(FOUR, people, seconds=3.0)))
    check_two_people(scenes, people)


def faults(random: Any) -> dict[str, Callable[[str, float, Float64, Float64], tuple[Float64, Float64]]]:
    mirror = np.array(HALPE.mirror)
    below = ("Hip", "Knee", "Ankle", "Toe", "Heel")
    legs = [i for i, name in enumerate(HALPE.joints) if any(part in name for part in below)]

    def swapped(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        px, sure = px.copy(), sure.copy()
        for i in range(len(px)):
            if random.random() < 0.15:
                px[i], sure[i] = px[i][mirror], sure[i][mirror]
        return px, sure

    def twice(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        if len(px) and random.random() < 0.5:
            px = np.concatenate([px, px[:1] + random.normal(size=px[:1].shape)])
            sure = np.concatenate([sure, 0.9 * sure[:1]])
        return px, sure

    def halves(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        if len(px) and random.random() < 0.3:
            upper, lower = sure[-1].copy(), np.zeros(26)
            lower[legs], upper[legs] = upper[legs], 0.0
            px, sure = np.concatenate([px, px[-1:]]), np.concatenate([sure[:-1], [upper], [lower]])
        return px, sure

    def merged(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        if len(px) == 2 and random.random() < 0.2:
            of_first = random.random(26) < 0.6
            px = np.where(of_first[None, :, None], px[:1], px[1:])
            sure = np.where(of_first[None], sure[:1], sure[1:])
        return px, sure

    def missed(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        kept = random.random(len(px)) > 0.2
        return px[kept], sure[kept]

    def bystander(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        if name == "cam-0" and len(px):
            px = np.concatenate([px, px[:1] * 0.3 + [400.0 + 20.0 * at_s, 100.0]])
            sure = np.concatenate([sure, np.full((1, 26), 0.9)])
        return px, sure

    return {one.__name__: one for one in (swapped, twice, halves, merged, missed, bystander)}


@pytest.mark.parametrize("fault", ["swapped", "twice", "halves", "merged", "missed", "bystander"])
@pytest.mark.slow
def test_faults_of_a_detector_do_no_harm(fault: str) -> None:
    arrivals = frames(FOUR, PAIR, seconds=3.0, fault=faults(np.random.default_rng(2))[fault])
    check_two_people(last_of_each(run(WebcamsTracker(FOUR), arrivals)), PAIR)


@pytest.mark.slow
def test_a_person_begun_with_left_and_right_exchanged_above_the_hips_recovers() -> None:
    mirror = np.array(HALPE.mirror)
    upper = np.array([name.endswith(("Shoulder", "Elbow", "Wrist")) for name in HALPE.joints])

    def exchanged(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        first = upper & (at_s < 0.2)
        return px[:, np.where(first, mirror, np.arange(26))], sure

    one = [person(circling(0.8, 6))]
    scenes = last_of_each(run(WebcamsTracker(FOUR), frames(FOUR, one, seconds=2.0, fault=exchanged)))
    shoulder = HALPE.index("LShoulder")
    assert scenes[-1].people[0].id == 0
    true = one[0](scenes[-1].at_ns / 1e9 - 1.0)
    assert true is not None
    assert np.linalg.norm(scenes[-1].people[0].positions[shoulder] - true[shoulder]) < 0.08


@pytest.mark.slow
def test_cameras_of_other_clocks_and_rates_track_together() -> None:
    arrivals = frames(
        FOUR, PAIR, seconds=3.0, offsets_s={"cam-1": 0.007, "cam-2": 0.015, "cam-3": 0.024},
        rates_hz={"cam-1": 10.0, "cam-2": 15.0},
    )  # fmt: skip
    check_two_people(run(WebcamsTracker(FOUR), arrivals)[12:], PAIR)


def test_a_camera_that_stops_does_not_stop_the_others() -> None:
    arrivals = frames(FOUR, PAIR, seconds=1.5)
    kept = [one for one in arrivals if one.frame.sensor != "cam-3" or one.at_ns < 1_500_000_000]
    scenes = last_of_each(run(WebcamsTracker(FOUR), kept))
    check_two_people(scenes, PAIR)
    assert scenes[-1].state.phase == Phase.TRACKING


@pytest.mark.slow
def test_who_leaves_and_returns_keeps_the_number() -> None:
    def leaves(at_s: float) -> Float64 | None:
        return None if 1.5 < at_s < 4.0 else walker(at_s, circling(0.8, 6, np.pi), height_m=1.6)

    people: list[Person] = [PAIR[0], leaves]
    scenes = last_of_each(run(WebcamsTracker(FOUR), frames(FOUR, people, seconds=5.0)))
    assert [len(one) for one in numbers(scenes, people)] == [1, 1]
    assert len(scenes[100].people) == 1  # 1.8 s after


def test_an_unseen_person_is_inferred_and_then_gone() -> None:
    def leaves(at_s: float) -> Float64 | None:
        return None if at_s > 0.5 else walker(at_s, standing(0.0, 0.0))

    scenes = last_of_each(run(WebcamsTracker(FOUR), frames(FOUR, [leaves], seconds=1.6)))
    states = scenes[22].people[0].states
    assert set(states.tolist()) <= {int(JointState.INFERRED), int(JointState.NOT_TRACKED)}
    assert scenes[24].people[0].condition == "no camera sees this person"
    assert scenes[-1].people == ()


def test_a_person_whom_one_camera_sees_is_inferred() -> None:
    def alone(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        return (px, sure) if name == "cam-0" or at_s < 0.7 else (px[:0], sure[:0])

    arrivals = frames(FOUR, [person(standing(0.0, 0.0))], seconds=1.5, fault=alone)
    one = last_of_each(run(WebcamsTracker(FOUR), arrivals))[-1].people[0]
    assert one.condition == "only one camera sees this person"
    assert JointState.TRACKED not in one.states.tolist()
    assert np.linalg.norm(one.positions - walker(0.0, standing(0.0, 0.0)), axis=1).mean() < 0.3


@pytest.mark.slow
def test_a_moved_camera_is_named_and_the_others_go_on() -> None:
    place = FOUR.cameras["cam-2"]
    T = rigid(rotation_about_y(0.15), (0.2, 0.0, 0.0)) @ place.T_camera_world
    rig = CameraRig({**FOUR.cameras, "cam-2": msgspec.structs.replace(place, T_camera_world=T)})
    scenes = last_of_each(run(WebcamsTracker(rig), frames(FOUR, PAIR, seconds=3.0)))
    check_two_people(scenes, PAIR)
    told = {place.sensor: place.problem for place in scenes[-1].sensors}
    assert {name for name, problem in told.items() if problem} == {"cam-2"}
    assert "calibrate again" in told["cam-2"]


@pytest.mark.parametrize(
    ("case", "said"),
    [
        ("moved", "cam-0, cam-1 see people, but no two cameras agree .* calibrate again"),
        ("alone", "only cam-0 sees people: a second camera must see them, too"),
        ("far", "people are too small in the images .* move the cameras nearer"),
        ("empty", ""),
    ],
)
@pytest.mark.slow
def test_it_says_why_nobody_is_tracked(case: str, said: str) -> None:
    def fault(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        if case == "empty" or (case == "alone" and name != "cam-0"):
            return px[:0], sure[:0]
        if case == "far" and len(px):
            return px.mean(axis=1, keepdims=True) * 0.5 + 0.03 * px + [0.0, 40.0 * (name == "cam-1")], sure
        return px + np.array([0.0, 90.0 * (name == "cam-1")]), sure

    scenes = run(
        WebcamsTracker(TWO), frames(TWO, PAIR, seconds=6.0, rates_hz=dict.fromkeys(TWO.cameras, 15.0), fault=fault)
    )
    assert not any(scene.people for scene in scenes)
    if said:
        assert re.match(said, scenes[-1].state.reason)
    else:
        assert scenes[-1].state.reason == ""


def test_one_camera_is_waited_for() -> None:
    arrivals = [one for one in frames(TWO, PAIR, seconds=0.3) if one.frame.sensor == "cam-0"]
    state = run(WebcamsTracker(TWO), arrivals)[-1].state
    assert (state.phase, state.sensors_missing) == (Phase.WAITING_FOR_SENSORS, 1)


def overloaded(arrivals: list[Arrival], seed: int) -> list[Arrival]:
    """The arrivals of a busy machine: each camera stands still for 0.2 to 0.8 s now and then, and delivers a burst."""
    random = np.random.default_rng(seed)
    due: dict[str, tuple[float, float]] = {}
    found = []
    for order, one in enumerate(arrivals):
        at_s, name = one.at_ns / 1e9, one.frame.sensor
        begin, end = due.setdefault(name, (1.0 + random.uniform(0.5, 1.5), 0.0))
        if end <= begin:
            end = begin + random.uniform(0.2, 0.8)
        elif at_s >= end:
            begin = end + random.exponential(1.5)
            end = begin + random.uniform(0.2, 0.8)
        due[name] = begin, end
        found.append((end if begin <= at_s < end else at_s, order, one))
    return [one for *_, one in sorted(found, key=lambda item: item[:2])]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_on_a_busy_machine_people_keep_their_numbers_and_the_state_stays(seed: int) -> None:
    arrivals = overloaded(frames(FOUR, PAIR, seconds=8.0), seed)
    tracker = WebcamsTracker(FOUR, sensors_expected=4)
    scenes = run(tracker, arrivals)
    assert tracker.report.rejected  # it is busy enough
    assert numbers(scenes[60:], PAIR) == [{0}, {1}] or numbers(scenes[60:], PAIR) == [{1}, {0}]
    assert {one.id for scene in scenes for one in scene.people} == {0, 1}
    phases = [scene.state.phase for scene in scenes]
    began = phases.index(Phase.TRACKING)
    assert set(phases[began:]) == {Phase.TRACKING}


def test_a_camera_that_stops_is_missing_after_the_stated_time_and_at_once_there_again() -> None:
    arrivals = frames(TWO, PAIR, seconds=4.0)
    stopped = [one for one in arrivals if one.frame.sensor == "cam-0" or not 2.0e9 < one.at_ns < 4.0e9]
    for after_s, missing in ((1.0, True), (3.0, False)):
        tracker = WebcamsTracker(TWO, WebcamsSettings(missing_after_s=after_s))
        scenes = run(tracker, stopped)
        waiting = [scene.at_ns / 1e9 for scene in scenes[8:] if scene.state.phase == Phase.WAITING_FOR_SENSORS]
        assert bool(waiting) == missing
        assert scenes[-1].state.phase == Phase.TRACKING
        if waiting:
            assert (min(waiting), max(waiting)) == (pytest.approx(3.0, abs=0.1), pytest.approx(4.0, abs=0.1))


def test_a_camera_cannot_be_missing_before_it_is_silent() -> None:
    with pytest.raises(SettingsError, match="missing_after_s"):
        WebcamsSettings(silent_after_s=1.0, missing_after_s=0.5)


@pytest.mark.slow
def test_two_strangers_on_one_line_are_no_person() -> None:
    """Opposite cameras see somebody each: nobody is where their rays cross, as the two other cameras show."""

    def strangers(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        return (px, sure) if name in ("cam-0", "cam-2") else (px[:0], sure[:0])

    ghost: list[Person] = [person(standing(0.0, 0.0))]
    scenes = run(WebcamsTracker(FOUR), frames(FOUR, ghost, seconds=2.5, fault=strangers))
    assert not any(scene.people for scene in scenes)
    alone = CameraRig({name: FOUR.cameras[name] for name in ("cam-0", "cam-1")})
    scenes = run(WebcamsTracker(alone), frames(alone, ghost, seconds=0.5))
    assert len(scenes[-1].people) == 1  # nobody contradicts


@pytest.mark.slow
def test_strangers_on_one_line_stay_nobody_while_others_hide_their_place() -> None:
    """Who hides the place from the cameras that saw nobody there does not make a person of the strangers."""

    def strangers(name: str, at_s: float, px: Float64, sure: Float64) -> tuple[Float64, Float64]:
        return (px, sure) if name in ("cam-0", "cam-2") else (px[1:], sure[1:])

    hiding: list[Person] = [person(between((x, -1.2), (x, 1.2), 0.8)) for x in (1.5, -1.5)]
    ghost: Person = person(standing(0.0, 0.0))
    arrivals = frames(FOUR, [ghost, *hiding], seconds=2.6, fault=strangers, occlusion=False)
    scenes = run(WebcamsTracker(FOUR), arrivals)
    assert max(len(scene.people) for scene in scenes) == 2


@pytest.mark.slow
def test_free_running_cameras_of_a_low_rate_measure_joints_and_say_how_well() -> None:
    """Scenes between the instants of 10 Hz cameras are predicted; their deviations are neither too small nor large."""
    rates = dict.fromkeys(FOUR.cameras, 10.0)
    offsets = {name: 0.025 * i for i, name in enumerate(sorted(FOUR.cameras))}
    scenes = run(WebcamsTracker(FOUR), frames(FOUR, PAIR, seconds=5.0, rates_hz=rates, offsets_s=offsets))
    check_two_people(scenes[8:], PAIR, most_error_m=0.05)
    errors, sds, measured = [], [], []
    for scene in scenes[60:]:
        truth = [one(scene.at_ns / 1e9 - 1.0) for one in PAIR]
        for one in scene.people:
            apart = min((np.linalg.norm(one.positions - p, axis=1) for p in truth if p is not None), key=np.mean)
            assert one.sd is not None
            measured += (one.states == JointState.TRACKED).tolist()
            errors += apart.tolist()
            sds += one.sd.tolist()
    assert np.mean(measured) > 0.7
    assert 0.4 < np.sqrt(np.mean(np.square(errors)) / 3.0 / np.mean(np.square(sds))) < 1.3


def test_a_single_frame_and_an_empty_one_give_nobody() -> None:
    tracker = WebcamsTracker(FOUR)
    assert tracker.update(frames(FOUR, PAIR, seconds=0.04)[0]).people == ()
    empty = keypoint_frame("cam-1", HALPE, time_ns=5, size_px=(640, 480), positions_px=[])
    assert tracker.update(Arrival(empty, 1_000_000_000)).people == ()


def refused(frame: Any, at_ns: int = 2_000_000_000) -> str:
    tracker = WebcamsTracker(FOUR)
    run(tracker, frames(FOUR, PAIR, seconds=0.3))
    before = tracker.report.kept
    tracker.update(Arrival(frame, at_ns))
    assert tracker.report.kept == before
    return next(iter(tracker.report.rejected))


def test_frames_that_do_not_belong_to_the_rig_are_refused_with_a_remedy() -> None:
    def frame(**more: Any) -> Any:
        given = {"sensor": "cam-0", "of": HALPE, "size_px": (640, 480), "time_ns": 10**10, **more}
        return keypoint_frame(
            given["sensor"], given["of"], time_ns=given["time_ns"], size_px=given["size_px"], positions_px=[]
        )

    assert "the rig has no camera 'cam-7'; it has cam-0, cam-1, cam-2, cam-3" in refused(frame(sensor="cam-7"))
    assert "its images are 320 × 240, the rig's 640 × 480" in refused(frame(size_px=(320, 240)))
    assert "have no mapping to halpe_26" in refused(frame(of=topology("kinect_v2")))
    assert "time goes backwards" in refused(frame(time_ns=4))
    assert "older than other cameras' frames" in refused(frame(), at_ns=900_000_000)


def test_a_rig_that_sees_no_distance_is_refused() -> None:
    with pytest.raises(SettingsError, match="two cameras at different places"):
        WebcamsTracker(CameraRig({"cam-0": FOUR.cameras["cam-0"]}))
    twin = msgspec.structs.replace(FOUR.cameras["cam-0"], camera=FOUR.cameras["cam-1"].camera)
    with pytest.raises(SettingsError, match="within 5 cm"):
        WebcamsTracker(CameraRig({"cam-0": FOUR.cameras["cam-0"], "cam-1": twin}))


def test_the_method_makes_a_tracker_from_the_text_of_a_rig() -> None:
    tracker = METHODS["webcams"].make({"rig": encode_camera_rig(FOUR), "confirm_instants": 5}, 2, {})
    assert isinstance(tracker, WebcamsTracker)
    assert tracker.settings.confirm_instants == 5


def test_a_new_calibration_begins_anew_and_gives_no_number_twice() -> None:
    arrivals = frames(FOUR, PAIR, seconds=0.8)
    tracker = WebcamsTracker(FOUR)
    first = run(tracker, arrivals[:40])[-1]
    tracker.use_rig(FOUR, "calibrated again")
    scenes = run(tracker, arrivals[40:])
    assert (scenes[0].people, scenes[0].state.reason) == ((), "calibrated again")
    assert scenes[0].step == first.step + 1
    assert not {p.id for p in first.people} & {p.id for p in scenes[-1].people}
    assert len(scenes[-1].people) == 2


@pytest.mark.parametrize(
    "wrong",
    [
        {"confirm_instants": 0}, {"sure_cameras": 1}, {"unseen_s": 0.0}, {"hidden_s": 0.0},
        {"one_camera_s": 0.0}, {"remember_s": -1.0},
        {"same_size": -1.0}, {"doubtful_instants": 0}, {"same_within_m": 2.0}, {"measured_sd_m": 0.0},
        {"measured_s": -1.0}, {"slow_error_s": 0.0}, {"late_s": 0.0}, {"silent_after_s": 0.0},
    ],
)  # fmt: skip
def test_settings_of_webcams_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        WebcamsSettings(**wrong)
