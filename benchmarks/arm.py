"""Arms in depth images: accuracy on rendered images, `kinematic-arm` beside the baseline, and its speed.

Scenes of seeds 100 and above are scored; those below were used to choose numbers. Each detector sees the images once,
in their order, without further information.
"""

from __future__ import annotations

import statistics
import sys
import time
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Goal, Row, at_least, at_most, compared, measured
from benchmarks.line_skeleton import SR305, grid_rows, masks_of, one_thread, sr305_frames, stage_rows
from mocapella.detectors import ArmDetector, make_detector
from mocapella.evaluation.arms import ArmScores, in_image, jitter, matched, score
from mocapella.evaluation.gestures import GestureScores, gesture_scores
from mocapella.evaluation.line_skeleton_grid import rendered_frames
from mocapella.evaluation.two_cameras import CAMERAS, FUSED, beside, looks_of, two_camera_scores
from mocapella.model.arms import SeenArms
from mocapella.model.camera import Camera
from mocapella.model.hand import DIGITS, TIPS
from mocapella.model.observations import JointState
from mocapella.sources.simulate.depth_scene import DepthScene, DepthShot, load_depth_scene

SCENES: Final = (
    *("each-finger-before-palm", "each-finger-from-the-side", "touching", "fist", "fast", "rotation", "open-close"),
    *("counting", "palm-rotation", "grab", "torso", "elbow-bends", "two-hands"),
)
SENSORS: Final = ("kinect", "sr305", "tof")
GIVEN_UP: Final = ("line-skeleton-3d", "angular-segments")
"""The two ways to find fingers that the baseline's document gave up."""
DETECTORS: Final = ("kinematic-arm", "line-skeleton", *GIVEN_UP)
FPS: Final = 30.0
SECONDS: Final = 3.0
"""Of each scene, seed and sensor; each begins elsewhere in the scene, so that together they show all of it."""
STILL_S: Final = 2.4
SEEDS: Final = (100, 101)
TWO_CAMERAS: Final = ("fist", "rotation", "fast")
LABELS: Final = Path(__file__).resolve().parent.parent / "tests" / "labels" / "depth_hand_sr305.toml"
_GOALS: Final[dict[str, tuple[str, str, Goal]]] = {
    "tip_median_mm": ("fingertips, median", "mm", at_most(8)),
    "tip_p95_mm": ("fingertips, 95 %", "mm", at_most(20)),
    "wrist_median_mm": ("wrist, median", "mm", at_most(10)),
    "palm_median_mm": ("palm, median", "mm", at_most(10)),
    "elbow_median_mm": ("elbow, median", "mm", at_most(10)),
}
_PARTS: Final[dict[str, tuple[str, Goal | None]]] = {
    "followed": ("arms that are followed", None),
    "named": ("right name of visible fingertips", at_least(98)),
    "inferred": ("visible fingertips told as inferred", None),
    "occluded_found": ("self-occluded fingertips found", at_least(90)),
    "sided": ("right side", None),
}


def run(quick: bool = False) -> list[Row]:
    seeds = SEEDS[:1] if quick else SEEDS
    scenes, sensors = (SCENES[:2], SENSORS[:1]) if quick else (SCENES, SENSORS)
    totals = {name: ArmScores() for name in DETECTORS}
    gestures, ours_ms, first_ms = GestureScores(), [], []
    by_scene: dict[str, ArmScores] = {}
    for sensor in sensors:
        for name in scenes:
            for seed in seeds:
                tell(f"{name}, {sensor}, seed {seed}")
                scene = load_depth_scene(name, seed=seed, sensor=sensor)
                shots = list(clip(scene, sensor, seed, 1.0 if quick else SECONDS))
                camera = Camera(sensor, scene.sensor.size_px, scene.lens)
                for detector, total in totals.items():
                    timed = _Timed(make_detector(detector, camera), camera)
                    found = score(timed, shots)
                    total.add(found)
                    if detector == "kinematic-arm":
                        by_scene.setdefault(f"{name}, {sensor}", ArmScores()).add(found)
                        if scene.sensor.size_px == (640, 480):
                            first_ms += timed.ms[:1]
                            ours_ms += timed.ms[1:]
                        if any(arm.gesture for shot in shots for arm in shot.arms):
                            gestures.add(gesture_scores(_Told(timed.told), shots))
    rows = [*_figures(totals), *(_worst(by_scene)), *_speed(ours_ms, first_ms)]
    rows += [measured(f"arm: gestures, {what}", value, unit) for what, value, unit in _gesture_figures(gestures)]
    rows += still_rows(quick)
    rows += single_rows(quick)
    rows += two_camera_rows(quick)
    rows += stereo_rows(quick)
    frames = sr305_frames()
    if frames:
        tell("the real frames")
        rows += label_rows(frames)
        rows += stage_rows(masks_of(frames), quick)
    tell("the baseline's grid")
    camera, rendered = rendered_frames(seeds=(101,) if quick else (100, 101, 102, 103), images=2 if quick else 6)
    return rows + grid_rows(rendered, camera)[0]


def tell(what: str) -> None:
    """Print the current measurement: all of them take minutes."""
    print(f"arm: {what}", file=sys.stderr, flush=True)


def clip(scene: DepthScene, sensor: str, seed: int, seconds: float) -> Iterator[DepthShot]:
    """Some seconds of a scene, from a time that sensor and seed tell."""
    part = SEEDS.index(seed) * len(SENSORS) + SENSORS.index(sensor)
    begin = scene.period_s * part / (len(SEEDS) * len(SENSORS))
    return scene.frames(FPS, begin, begin + seconds)


class _Timed:
    """A detector, and how long each image took it [ms]."""

    def __init__(self, detector: ArmDetector, camera: Camera) -> None:
        self.detector, self.name = detector, detector.name
        self.ms: list[float] = []
        self.told: list[SeenArms] = []
        detector.update(np.zeros(camera.size_px[::-1], np.float32), 0.0)  # compiles
        detector.reset()

    def update(self, depth: NDArray[np.float32], at_s: float) -> Any:
        begin = time.perf_counter()
        seen = self.detector.update(depth, at_s)
        self.ms.append(1e3 * (time.perf_counter() - begin))
        self.told.append(seen)
        return seen

    def reset(self) -> None:
        self.detector.reset()


class _Told:
    """Replays the stored results of a detector."""

    name = "told"

    def __init__(self, told: list[SeenArms]) -> None:
        self.told, self._next = told, 0

    def update(self, depth: NDArray[np.float32], at_s: float) -> SeenArms:
        del depth, at_s
        self._next += 1
        return self.told[self._next - 1]

    def reset(self) -> None:
        self._next = 0


def _figures(totals: dict[str, ArmScores]) -> list[Row]:
    ours, peer = totals["kinematic-arm"].table(), totals["line-skeleton"].table()
    rows = [measured("arm: arms in images", ours["frames"], "")]
    for key, (what, unit, goal) in _GOALS.items():
        rows.append(compared(f"arm: {what}", ours[key], unit, peer="line-skeleton", peer_value=peer[key], goal=goal))
    for key, (what, part_goal) in _PARTS.items():
        rows.append(
            measured(f"arm: {what} (line-skeleton {100 * peer[key]:.1f} %)", 100 * ours[key], "%", goal=part_goal)
        )
    for name in GIVEN_UP:
        table = totals[name].table()
        for key in ("tip_median_mm", "tip_p95_mm"):  # elbow, wrist and palm are the baseline's
            rows.append(measured(f"arm: {_GOALS[key][0]} ({name})", table[key], "mm"))
        for key in ("named", "inferred", "occluded_found"):
            rows.append(measured(f"arm: {_PARTS[key][0]} ({name})", 100 * table[key], "%"))
    rows.append(measured("arm: fingertips without a pixel, median", ours["hidden_median_mm"], "mm"))
    rows.append(measured("arm: longest loss", ours["longest_loss_frames"], "frames", goal=at_most(3)))
    return rows


def _worst(by_scene: dict[str, ArmScores]) -> list[Row]:
    """Each scene's fingertips and names: what a mean over scenes would hide."""
    rows = []
    for name, scores in by_scene.items():
        table = scores.table()
        rows.append(measured(f"arm: {name}, fingertips, 95 %", table["tip_p95_mm"], "mm"))
        rows.append(measured(f"arm: {name}, right names", 100 * table["named"], "%"))
    return rows


def _speed(ms: list[float], first_ms: list[float]) -> list[Row]:
    return [
        measured("arm: detector, 640 × 480, an image, median", float(np.percentile(ms, 50)), "ms", goal=at_most(5)),
        measured("arm: detector, 640 × 480, an image, 99 %", float(np.percentile(ms, 99)), "ms", goal=at_most(10)),
        measured("arm: images of 640 × 480 that take longer than 10 ms", 100 * float(np.mean(np.array(ms) > 10)), "%"),
        measured("arm: the longest image after a scene's first", max(ms), "ms"),
        measured("arm: the first image of a scene, median", statistics.median(first_ms), "ms"),
    ]


def _gesture_figures(scores: GestureScores) -> list[tuple[str, float, str]]:
    return [(what, float(value), "") for what, value in scores.table().items() if isinstance(value, int | float)]


def still_rows(quick: bool) -> list[Row]:
    """Jitter of a hand that is held still, in each of the postures that a scene has."""
    rows = []
    for sensor in SENSORS[: 1 if quick else 3]:
        tell(f"still, {sensor}")
        scene = load_depth_scene("still", seed=100, sensor=sensor)
        camera = Camera(sensor, scene.sensor.size_px, scene.lens)
        worst = []
        for begin in still_from(scene, STILL_S)[: 1 if quick else None]:
            shots = list(scene.frames(FPS, begin, begin + (1.0 if quick else STILL_S)))
            worst.append(max(jitter(make_detector("kinematic-arm", camera), shots).values(), default=np.nan))
        rows.append(measured(f"arm: jitter of a still hand, {sensor}, worst of eight joints, median of postures",
                             1e3 * statistics.median(worst), "mm", goal=at_most(1.5)))  # fmt: skip
        rows.append(measured(f"arm: jitter of a still hand, {sensor}, worst joint and posture of {len(worst)}",
                             1e3 * max(worst), "mm"))  # fmt: skip
    return rows


def still_from(scene: DepthScene, seconds: float) -> list[float]:
    """When the arm begins to rest for so long, in steps of a tenth of a second."""
    times = np.arange(0.0, scene.period_s, 0.1)
    poses = [scene.poses(float(at))[0] for at in times]
    held = np.array([np.concatenate([pose.angles, pose.joints, pose.T_camera_shoulder.ravel()]) for pose in poses])
    moves = np.abs(np.diff(held, axis=0)).max(axis=1) > 1e-9
    found, k, most = [], 0, round(10 * seconds) + 1
    while k + most <= len(times):
        if moves[k : k + most].any():
            k += 1
        else:
            found.append(float(times[k]))
            k += most
    return found


def two_camera_rows(quick: bool) -> list[Row]:
    """Two cameras 60° apart that both find the arm by the detector `kinematic-arm`, beside each of them alone."""
    rows = []
    for name in TWO_CAMERAS[: 1 if quick else None]:
        tell(f"two cameras, {name}")
        scene = load_depth_scene(name, seed=100, sensor="kinect")
        cameras = [Camera(k, scene.sensor.size_px, of.lens) for k, of in zip(CAMERAS, (scene, beside(scene, 60.0)),
                                                                            strict=True)]  # fmt: skip
        first, second = (make_detector("kinematic-arm", camera) for camera in cameras)
        told = two_camera_scores(scene, looks_of((first, second)), seconds=0.7 if quick else 3.0)
        for key, words in (("tip_median_mm", "fingertips, median"), ("tip_p95_mm", "fingertips, 95 %"),
                           ("tips_of_one_camera_median_mm", "fingertips that only the other sees, median"),
                           ("palm_median_mm", "palm, median")):  # fmt: skip
            alone = ", ".join(f"{told[camera][key]:.1f}" for camera in CAMERAS)
            rows.append(measured(f"arm: two cameras, {name}, {words} (alone {alone})", told[FUSED][key], "mm"))
        followed = ", ".join(f"{100 * told[camera]['followed']:.0f}" for camera in CAMERAS)
        text = f"arm: two cameras, {name}, followed (alone {followed})"
        rows.append(measured(text, 100 * told[FUSED]["followed"], "%"))
    return rows


def single_rows(quick: bool) -> list[Row]:
    """Single images of all scenes with one arm, each of its own seed, and detected by itself."""
    rows = []
    for sensor in (*SENSORS[:2], "stereo")[: 1 if quick else None]:
        tell(f"single images, {sensor}")
        found = right = images = 0
        seen: list[float] = []
        measured_m: list[float] = []
        for scene, shot in single_shots(sensor, range(100, 104 if quick else 136)):
            if not in_image(shot.arms[0], shot):
                continue
            images += 1
            detector = make_detector("kinematic-arm", Camera(sensor, scene.sensor.size_px, scene.lens))
            arm = matched(shot.arms[0], detector.update(shot.depth * np.float32(shot.unit_m), 0.0))
            if arm is not None:
                found += 1
                off_m = np.linalg.norm(arm.points[list(TIPS)] - shot.arms[0].points[list(TIPS)], axis=1)
                visible = off_m[shot.arms[0].seen[list(TIPS)] > 0]
                right += bool((visible < 0.02).all())
                seen += visible.tolist()
                measured_m += off_m[arm.states[list(TIPS)] == JointState.TRACKED].tolist()
        wrong = 100 * float(np.mean(np.array(measured_m) > 0.03)) if measured_m else np.nan
        tips = 1e3 * np.percentile(seen, [50, 95]) if seen else [np.nan, np.nan]
        rows += [
            measured(f"arm: single images, {sensor}, with the hand, of {images}", found, ""),
            measured(f"arm: single images, {sensor}, all visible fingertips within 20 mm, of {images}", right, ""),
            measured(f"arm: single images, {sensor}, visible fingertips, median", tips[0], "mm"),
            measured(f"arm: single images, {sensor}, visible fingertips, 95 %", tips[1], "mm"),
            measured(f"arm: single images, {sensor}, measured fingertips more than 30 mm off", wrong, "%"),
        ]
    return rows


def single_shots(sensor: str, seeds: Iterable[int]) -> Iterator[tuple[DepthScene, DepthShot]]:
    """Yield one image of each seed, of the scenes with one arm by turns, at a random time."""
    names = [name for name in SCENES if name != "two-hands"]
    for seed in seeds:
        scene = load_depth_scene(names[seed % len(names)], seed=seed, sensor=sensor)
        yield scene, scene.at(float(np.random.default_rng([seed, 7]).uniform(0, scene.period_s)))


def stereo_rows(quick: bool) -> list[Row]:
    """Fists that open before a stereo camera, which makes fingers wider: 35 images at 25 Hz of each arm."""
    found = images = 0
    seen: list[float] = []
    measured_m: list[float] = []
    for seed in range(100, 102 if quick else 110):
        tell(f"stereo, seed {seed}")
        scene = load_depth_scene("open-close", seed=seed, sensor="stereo")
        detector = make_detector("kinematic-arm", Camera("stereo", scene.sensor.size_px, scene.lens))
        for k in range(8 if quick else 35):
            shot = scene.at(k / 25)
            arm = matched(shot.arms[0], detector.update(shot.depth * np.float32(shot.unit_m), k / 25))
            images += 1
            if arm is not None:
                found += 1
                off_m = np.linalg.norm(arm.points[list(TIPS)] - shot.arms[0].points[list(TIPS)], axis=1)
                seen += off_m[shot.arms[0].seen[list(TIPS)] > 0].tolist()
                measured_m += off_m[arm.states[list(TIPS)] == JointState.TRACKED].tolist()
    wrong = 100 * float(np.mean(np.array(measured_m) > 0.03)) if measured_m else np.nan
    tips = 1e3 * np.percentile(seen, [50, 95]) if seen else [np.nan, np.nan]
    return [
        measured(f"arm: stereo, images with the hand, of {images}", 100 * found / images, "%", goal=at_least(94)),
        measured("arm: stereo, visible fingertips, median", tips[0], "mm", goal=at_most(15)),
        measured("arm: stereo, visible fingertips, 95 %", tips[1], "mm", goal=at_most(35)),
        measured("arm: stereo, measured fingertips more than 30 mm off", wrong, "%", goal=at_most(2)),
    ]


def label_rows(frames: dict[str, NDArray[np.float32]]) -> list[Row]:
    """Real frames, each by itself, against labels of ours, which were committed before any detector saw the frames."""
    labels = tomllib.loads(LABELS.read_text(encoding="utf-8"))["frame"]
    rows = []
    for name in DETECTORS:
        detector = make_detector(name, SR305)
        hands = sides = five = 0
        errors: list[float] = []
        with one_thread():
            for label in labels:
                depth = next(depth for file, depth in frames.items() if Path(file).stem == Path(label["file"]).stem)
                detector.reset()
                seen = detector.update(depth, 0.0)
                if not seen.arms:
                    continue
                arm = seen.arms[0]
                hands += 1
                sides += ("left" if arm.left else "right") == label["handedness"]
                x, y, z = arm.points[list(TIPS)].T
                px = np.stack([SR305.lens[0] * x / z + SR305.lens[2], SR305.lens[1] * y / z + SR305.lens[3]], axis=1)
                apart = np.linalg.norm(px - [label[digit] for digit in DIGITS], axis=1)
                five += bool((apart <= 8).all())
                errors += apart[np.isfinite(apart)].tolist()
        n = len(labels)
        rows += [
            measured(f"arm: SR305, hands found of {n}, {name}", hands, "", goal=at_least(n)),
            measured(f"arm: SR305, right side, {name}", sides, "", goal=at_least(n)),
            measured(f"arm: SR305, frames with all fingertips within 8 px, {name}", five, "", goal=at_least(n)),
            measured(f"arm: SR305, fingertips, median, {name}", float(np.median(errors)) if errors else np.nan, "px"),
            measured(f"arm: SR305, fingertips, worst, {name}", max(errors, default=np.nan), "px", goal=at_most(8)),
        ]
    return rows
