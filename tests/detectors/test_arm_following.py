"""The detector ``kinematic-arm`` on rendered arms, seeds for tuning, and on real frames; and it repeats to the bit."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.detectors import ArmDetector, arm_following
from mocapella.detectors.arm_finding import ArmFinder
from mocapella.detectors.arm_following import KinematicArmDetector, _sd_m
from mocapella.detectors.arm_search import _MOST_IMAGES, Search
from mocapella.detectors.arm_settings import KinematicArmSettings
from mocapella.errors import SettingsError
from mocapella.evaluation.arms import matched, score
from mocapella.geometry.lens import project
from mocapella.model.arms import PALM, SeenArm, SeenArms
from mocapella.model.camera import Camera
from mocapella.model.hand import DIGITS, TIPS
from mocapella.sensing.arm_region import PalmCandidate
from mocapella.sources.simulate.depth_scene import DepthShot, load_depth_scene
from mocapella.steps import Steps, at_once

ROOT = Path(__file__).resolve().parents[2]
FRAMES = ROOT.parent / "shared" / "data" / "depth_hand_sr305" / "frames"
SR305 = Camera("sr305", (640, 480), np.array([476.007, 476.007, 313.683, 242.755, 0, 0, 0, 0, 0]))


LOOK = 80
"""Images in which a look for further arms ends."""


def done(result: Any) -> Steps[Any]:
    """What takes no time."""
    yield 0
    return result


@cache
def clip(name: str, sensor: str, seed: int, frames: int = 10, start_s: float = 0.0) -> tuple[Camera, list[DepthShot]]:
    scene = load_depth_scene(name, seed=seed, sensor=sensor)
    return Camera(sensor, scene.sensor.size_px, scene.lens), [scene.at(start_s + k / 30) for k in range(frames)]


def metres(shot: DepthShot) -> np.ndarray:
    return shot.depth * np.float32(shot.unit_m)


def told(detector: KinematicArmDetector, shots: list[DepthShot]) -> list[SeenArms]:
    return [detector.update(metres(shot), shot.at_s) for shot in shots]


def same(one: SeenArm, other: SeenArm) -> bool:
    arrays = ("points", "states", "sd", "angles", "T_camera_palm")
    return (one.id, one.left, one.left_sure) == (other.id, other.left, other.left_sure) and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays
    )


def that_of(shot: DepthShot, seen: SeenArms) -> SeenArm:
    """The arm of the scene; something else in it may be taken for one, too."""
    arm = matched(shot.arms[0], seen)
    assert arm is not None
    return arm


def test_it_is_an_arm_detector() -> None:
    detector: ArmDetector = KinematicArmDetector(SR305)
    assert detector.name == "kinematic-arm"


@pytest.mark.parametrize(("sensor", "seed"), [("exact", 1), ("exact", 3), ("kinect", 1), ("kinect", 3)])
def test_an_open_hand_that_turns_is_followed(sensor: str, seed: int) -> None:
    camera, shots = clip("rotation", sensor, seed)
    scores = score(KinematicArmDetector(camera), shots)
    table = scores.table()
    assert (table["followed"], table["sided"], table["longest_loss_frames"]) == (1.0, 1.0, 0)
    assert table["named"] >= 0.98
    assert table["inferred"] <= 0.1
    assert table["tip_median_mm"] < 10
    assert table["tip_p95_mm"] < 20
    for joint in ("wrist", "palm", "elbow"):
        assert table[f"{joint}_median_mm"] < 12


def test_what_is_told_of_an_arm_keeps_its_contract() -> None:
    camera, shots = clip("rotation", "exact", 1)
    detector = KinematicArmDetector(camera)
    for shot, seen in zip(shots, told(detector, shots[:4]), strict=False):
        arm = that_of(shot, seen)
        assert seen.reason == ""
        assert (arm.points.shape, arm.states.shape, arm.sd.shape, arm.angles.shape) == ((23, 3), (23,), (23,), (21,))
        assert arm.sd.dtype == np.float32
        assert set(arm.states.tolist()) <= {1, 2}
        assert (arm.sd[arm.states == 2] < arm.sd[arm.states == 1].min(initial=1.0)).all()
        assert 0.5 <= arm.left_sure <= 1.0
        assert detector.models["left" if arm.left else "right"].model.within(arm.angles, 1e-6)
        assert arm.T_camera_palm is not None
        np.testing.assert_allclose(arm.T_camera_palm[:3, 3], arm.points[0])


def test_the_same_images_give_the_same_to_the_bit_after_reset() -> None:
    camera, shots = clip("rotation", "kinect", 1)
    detector = KinematicArmDetector(camera)
    first = told(detector, shots[:6])
    detector.reset()
    for one, other in zip(first, told(detector, shots[:6]), strict=True):
        assert len(one.arms) == len(other.arms) >= 1
        assert all(same(*pair) for pair in zip(one.arms, other.arms, strict=True))


def test_mirrored_images_give_the_other_hand_mirrored() -> None:
    """The camera's axis is in the middle of the image; pixels that are looked at are others in the mirror."""
    camera, shots = clip("rotation", "exact", 1)
    plain, mirrored = KinematicArmDetector(camera), KinematicArmDetector(camera)
    offs = []
    for shot in shots[:8]:
        one = that_of(shot, plain.update(metres(shot), shot.at_s))
        truth = shot.arms[0]
        reflected = DepthShot(
            shot.at_s, shot.depth, shot.unit_m, shot.lens,
            (msgspec.structs.replace(truth, points=truth.points * [-1, 1, 1]),), shot.exact_m, shot.parts,
        )  # fmt: skip
        other = that_of(reflected, mirrored.update(np.ascontiguousarray(metres(shot)[:, ::-1]), shot.at_s))
        assert one.left != other.left
        offs.append(np.linalg.norm(one.points * [-1, 1, 1] - other.points, axis=1)[[*TIPS, 0, 21]])
    assert np.median(offs) < 0.003
    assert np.max(offs) < 0.02


def test_where_there_is_no_arm_it_says_why() -> None:
    detector = KinematicArmDetector(SR305)
    nothing = np.zeros((480, 640), np.float32)
    wall = np.full((480, 640), 1.2, np.float32)
    for depth, reason in (
        (nothing, "nothing was measured"),
        (np.full_like(nothing, 3.5), "nothing is between 0.2 and 2 m"),
        (np.full_like(nothing, 0.05), "nothing is between 0.2 and 2 m"),
        (wall, "no hand is seen"),
    ):
        seen = detector.update(depth, 0.0)
        assert seen.arms == ()
        assert reason in seen.reason


def test_an_image_of_another_size_is_refused() -> None:
    with pytest.raises(SettingsError, match="320 × 240; camera sr305 has 640 × 480 px"):
        KinematicArmDetector(SR305).update(np.zeros((240, 320), np.float32), 0.0)


def test_an_arm_that_was_away_is_found_in_the_first_image() -> None:
    camera, shots = clip("rotation", "exact", 1)
    detector = KinematicArmDetector(camera)
    nothing = np.zeros_like(metres(shots[0]))
    before = that_of(shots[2], told(detector, shots[:3])[-1])
    gone = [detector.update(nothing, 1.0 + k / 30) for k in range(30)]
    assert all(seen.arms == () for seen in gone[1:])
    back = that_of(shots[3], detector.update(metres(shots[3]), 2.1))
    truth = shots[3].arms[0]
    assert (back.left, back.id == before.id) == (truth.left, False)
    assert np.median(np.linalg.norm(back.points - truth.points, axis=1)[[*TIPS]]) < 0.010


@pytest.mark.slow
def test_two_hands_have_two_ids_and_sides() -> None:
    camera, shots = clip("two-hands", "exact", 2, 6)
    for shot, seen in zip(shots, told(KinematicArmDetector(camera), shots), strict=True):
        assert [arm.id for arm in seen.arms] == [0, 1]
        for truth in shot.arms:
            arm = matched(truth, seen)
            assert arm is not None
            assert arm.left == truth.left
        assert matched(shot.arms[0], seen) is not matched(shot.arms[1], seen)
    (one,) = told(KinematicArmDetector(camera, KinematicArmSettings(arms=1)), shots[:1])
    assert len(one.arms) == 1


def test_an_arm_that_never_fitted_well_is_not_told() -> None:
    camera, shots = clip("rotation", "exact", 1)
    (seen,) = told(KinematicArmDetector(camera, KinematicArmSettings(firm=1e-6)), shots[:1])
    assert (seen.arms, seen.reason) == ((), "a possible hand does not fit the hand model well")


def test_where_no_arm_was_is_looked_at_ever_more_rarely(monkeypatch: pytest.MonkeyPatch) -> None:
    camera, shots = clip("rotation", "exact", 1)
    detector = KinematicArmDetector(camera, KinematicArmSettings(refuse_for=2, fattening_px=0))
    looked = list[tuple[int, PalmCandidate]]()
    monkeypatch.setattr(
        ArmFinder, "best", lambda _, __, candidate, *___: looked.append((detector._frames, candidate)) or done([])
    )
    for frame in range(40):
        detector.update(metres(shots[0]), frame / 30)
    first = looked[0][1].centre
    assert [at for at, place in looked if np.linalg.norm(place.centre - first) < 1e-9] == [0, 2, 6, 14, 30]


@pytest.mark.slow
def test_a_further_arm_is_looked_for_where_it_comes_and_nowhere_where_nothing_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    camera, shots = clip("two-hands", "exact", 2, 6)
    alone = [metres(shot) for shot in shots]
    other = max(shots[0].arms, key=lambda truth: truth.points[PALM, 0])
    columns = slice(int(project(other.points, camera.lens)[:, 0].min()) - 20, None)
    for image in alone:
        image[:, columns] = 0
    looks: list[Any] = []
    candidates = ArmFinder.candidates
    monkeypatch.setattr(ArmFinder, "candidates", lambda *of: looks.append(of[3]) or candidates(*of))
    detector, came = KinematicArmDetector(camera, KinematicArmSettings(look_every=1, look_anyway_every=1000)), 0
    for k in range(2 * LOOK):
        assert len(detector.update(alone[k % 6], k / 30).arms) == 1
        came = came if k > LOOK else len(looks)  # by then the arm is firm, and all places have been looked at
    assert len(looks) == came
    both = [len(detector.update(metres(shots[k % 6]), (2 * LOOK + k) / 30).arms) for k in range(LOOK)]
    assert both[-1] == 2
    places = looks[came]
    pixels = project(places, camera.lens)
    assert (pixels[:, 0] > columns.start).all()


@pytest.mark.slow
def test_of_places_on_an_arm_that_was_found_none_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    camera, shots = clip("rotation", "exact", 1)
    finder, depth = KinematicArmDetector(camera).finder, metres(shots[0])
    candidates = at_once(finder.candidates(depth, 24))
    (best, *_) = sorted((one for c in candidates for one in at_once(finder.best(depth, c))), key=lambda one: one.cost)
    monkeypatch.setattr(ArmFinder, "best", lambda *_: done([best]))
    away = PalmCandidate(np.array([0.0, 0.0, 5.0]), 0.03, *candidates[0][2:])
    _, tried = at_once(finder.all_of(depth, [*candidates, away, away], 8, 1.0, 8))
    assert [len(tried), tried[1:]] == [3, [away, away]]
    assert len(at_once(finder.all_of(depth, [*candidates, away], 8, 1.0, 1))[1]) == 1  # there are enough
    assert len(at_once(finder.all_of(depth, [away] * 3, 8, 0.0, 8))[1]) == 2  # of those beside each other
    assert len(at_once(finder.all_of(depth, candidates, 1, 0.0, 8))[1]) == 1  # so many at most
    other = best._replace(side="left" if best.side == "right" else "right")
    monkeypatch.setattr(ArmFinder, "best", lambda *_: done([best, other]))
    assert len(at_once(finder.all_of(depth, candidates, 8, 1.0, 8))[1]) > 1  # its side is not clear


def one_arm_and_then_another(seed: int) -> tuple[Camera, list[np.ndarray], list[DepthShot]]:
    """Images of which twelve show only one of two arms, the others both, and the truth."""
    camera, shots = clip("two-hands", "exact", seed, 12 + LOOK)
    images = [metres(shot) for shot in shots]
    other = max(shots[0].arms, key=lambda truth: truth.points[PALM, 0])
    for image in images[:12]:
        image[:, int(project(other.points, camera.lens)[:, 0].min()) - 20 :] = 0
    return camera, images, shots


@pytest.mark.slow
def test_no_image_waits_for_a_look_for_further_arms(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is done a little at a time; and what is found then is followed to where it is by then."""
    camera, images, shots = one_arm_and_then_another(2)
    done: list[list[int]] = []
    furthest = Search.go_on

    def go_on(look: Any, work: float) -> bool:
        inner, done_now = look.steps, []

        def counted() -> Steps[None]:
            for step in inner:
                done_now.append(step)
                yield step

        look.steps = counted()
        more = furthest(look, work)
        look.steps = inner
        done.append(done_now)
        return more

    monkeypatch.setattr(Search, "go_on", go_on)
    detector = KinematicArmDetector(camera, KinematicArmSettings(look_every=1))
    found = None
    for image, shot in zip(images, shots, strict=True):
        before = len(done)
        seen = detector.update(image, shot.at_s)
        assert len(done) - before <= 1
        if len(seen.arms) == 2:
            found = seen, shot
            break
    assert found is not None
    spread = done[1:]  # in the first image nothing is followed
    assert len(spread) > 5
    assert all(sum(steps[:-1]) < arm_following._WORK[0][1] for steps in spread)
    seen, shot = found
    for truth in shot.arms:
        arm = matched(truth, seen)
        assert arm is not None
        assert np.linalg.norm(arm.points[PALM] - truth.points[PALM]) < 0.02


@pytest.mark.slow
def test_once_an_arm_is_lost_every_place_is_looked_at_again() -> None:
    """It may have stood for another, whose place was refused."""
    camera, shots = clip("two-hands", "exact", 2, 2)
    detector = KinematicArmDetector(camera)
    told(detector, shots)
    detector._refuse(np.array([0.0, 0.0, 1.0]))
    assert not detector._unfinished
    assert detector._refused
    detector.update(np.zeros_like(metres(shots[0])), 0.1)
    detector.update(np.zeros_like(metres(shots[0])), 0.2)
    assert not detector._arms
    assert detector._refused == []


def test_of_images_that_come_during_a_look_not_all_are_kept() -> None:
    image = np.zeros((2, 2), np.float32)
    look = Search(image, 0.0)
    for k in range(1, 1000):
        image[:] = k
        look.add(image, k / 30)
        assert len(look.images) <= _MOST_IMAGES
        times = [at_s for _, at_s in look.images]
        assert times == sorted(times)
        assert times[-1] == k / 30
        assert [float(depth[0, 0]) for depth, _ in look.images] == [round(at_s * 30) for at_s in times]  # copies
    assert look.newest[0, 0] == 999
    assert look.depth[0, 0] == 0


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "start_s"), [(1, 1 / 6), (3, 3 / 6)])
def test_the_end_of_an_upper_arm_is_not_taken_for_the_hand(seed: int, start_s: float) -> None:
    """It ends as a fist does."""
    scene = load_depth_scene("torso", seed=seed, sensor="kinect")
    shot = scene.at(scene.period_s * start_s)
    detector = KinematicArmDetector(Camera("kinect", scene.sensor.size_px, scene.lens))
    arm = that_of(shot, detector.update(metres(shot), 0.0))
    assert np.linalg.norm(arm.points[PALM] - shot.arms[0].points[PALM]) < 0.02


def test_a_hand_that_is_elsewhere_at_once_keeps_its_names() -> None:
    camera, shots = clip("rotation", "exact", 1)
    for shift in (-40, 40):
        detector = KinematicArmDetector(camera, KinematicArmSettings(arms=1))
        told(detector, shots[:4])
        beside = np.roll(metres(shots[4]), shift, axis=1)
        (arm,) = detector.update(beside, shots[4].at_s).arms
        truth = shots[4].arms[0].points
        moved = truth + np.outer(truth[:, 2], [shift / camera.lens[0], 0, 0])
        assert np.linalg.norm(moved[PALM] - truth[PALM]) > 0.035
        assert np.linalg.norm(arm.points - moved, axis=1)[[*TIPS]].max() < 0.015


@pytest.mark.parametrize("sensor", ["exact", "kinect"])
def test_an_arm_before_the_torso_is_found(sensor: str) -> None:
    camera, shots = clip("torso", sensor, 1, 6)
    table = score(KinematicArmDetector(camera), shots).table()
    assert (table["followed"], table["sided"]) == (1.0, 1.0)
    assert table["tip_median_mm"] < 10
    assert table["elbow_median_mm"] < 25


@pytest.mark.slow
def test_two_metres_a_second_are_followed() -> None:
    camera, shots = clip("fast", "exact", 1, 12)
    table = score(KinematicArmDetector(camera), shots).table()
    assert table["followed"] == 1.0
    assert table["longest_loss_frames"] == 0


@cache
def real_recording() -> tuple[int, int, list[float], list[bool]]:
    """Frames, those with an arm, errors of all tips [px], and whether the side is right; each frame by itself."""
    cv2 = pytest.importorskip("cv2")
    labels = tomllib.loads((ROOT / "tests" / "labels" / "depth_hand_sr305.toml").read_text(encoding="utf-8"))["frame"]
    detector, found, errors, sides = KinematicArmDetector(SR305), 0, [], []
    for frame in labels:
        depth = cv2.imread(str(FRAMES / frame["file"]), cv2.IMREAD_UNCHANGED).astype(np.float32) * np.float32(0.000125)
        detector.reset()
        arms: tuple[SeenArm, ...] = detector.update(depth, 0.0).arms
        if not arms:
            continue
        found += 1
        wanted = np.array([frame[digit] for digit in DIGITS])
        off = [np.linalg.norm(project(arm.points[[*TIPS]], SR305.lens) - wanted, axis=1) for arm in arms]
        best = int(np.argmin([float(np.median(each)) for each in off]))
        errors += off[best].tolist()
        sides.append(arms[best].left == (frame["handedness"] == "left"))
        print(frame["file"], "side right:", sides[-1], "tips off [px]:", off[best].round(1))
    return len(labels), found, errors, sides


@pytest.mark.slow
@pytest.mark.skipif(not FRAMES.is_dir(), reason="needs depth_hand_sr305")
def test_the_hand_of_the_real_recording_is_found_in_each_frame_by_itself() -> None:
    frames, found, errors, sides = real_recording()
    assert (frames, found) == (8, 8)
    # As measured: median 3.4 px, 95th percentile 8.6 px, all fingertips. The labels are right to about 4 px.
    assert np.median(errors) <= 6
    assert np.percentile(errors, 95) <= 14
    assert all(sides)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("arms", (0, 9)), ("hand_length_m", (0.09, 0.31)), ("believe", (0.0, 0.39)), ("keep", (0.2, 2.0)),
        ("digits", (0, 6)), ("gain", (0.0, 2.0)), ("doubt", (0.0, 2.0)), ("better", (0.0, 1.1)),
        ("firm", (0.0, 2.0)), ("look_again_after", (0, 1001)), ("refuse_for", (0, 100_001)),
        ("lost_after", (0, 1001)), ("firm_in_blocks", (0.0, 2.0)), ("fattening_px", (-2, 16)),
        ("independent_s", (-0.1, 3601)), ("look_every", (0, 1001)), ("look_anyway_every", (0, 100_001)),
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused(name: str, values: tuple[Any, ...]) -> None:
    for value in values:
        with pytest.raises(SettingsError, match="believe" if name == "keep" else name):
            replace(KinematicArmSettings(), **{name: value})


def test_what_is_seen_well_in_a_good_fit_is_surest() -> None:
    shown = np.array([0.9, 0.3, 0.12, *[0.0] * 20])
    good, bad = _sd_m(shown, 0.06), _sd_m(shown, 0.3)
    assert good[0] < good[1] < good[2] < good[3]
    assert (bad >= good).all()
    assert bad[0] == pytest.approx(0.0063, abs=1e-4)
    assert good[4] == 0.024, "a hidden fingertip may be anywhere in its reach"
