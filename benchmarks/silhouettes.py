"""Accuracy of bodies fitted to silhouettes, on rendered scenes with ground truth, and a real clip; and their time.

`--part NAME` runs one part alone: ``noise`` (accuracy, jitter, and what the penalty on jitter costs),
``corruption`` (frames stored wrong, with the penalty and without), ``seated`` (legs that images hardly show),
``support`` (doubt about misplaced limbs), ``live`` (time a frame), ``step`` (a Gauss–Newton step beside numpy, of the
group twists), ``video`` (four cameras' real clip), ``storage`` (size of a take of images). All tuning used seeds below
100, if a part's seeds do not say otherwise; these are from 100 on.
`docs/evaluation.md` defines the scores.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Row, at_least, at_most, measured
from benchmarks.tracker import recordings
from mocapella.conventions import NS_PER_S
from mocapella.evaluation import silhouette_video
from mocapella.evaluation.silhouette_experiments import STRONG, RunRow, corrupted, followed
from mocapella.evaluation.silhouette_runs import alone, filmed, follow, rough_joints, seen_at, with_penalty
from mocapella.evaluation.silhouette_seated import SEATED_SCENES, doubt_score, follow_seated
from mocapella.evaluation.silhouettes import Outcome, outcome
from mocapella.kinematics.silhouette_fit import figure
from mocapella.live.image_work import ImageSettings
from mocapella.model.body_meshes import body_mesh
from mocapella.model.body_proportions import proportions_of
from mocapella.model.images import ImageFrame, image_frame
from mocapella.recording.bodies_file import ALONE
from mocapella.schema import encode_frame
from mocapella.sensing.images import as_png, encode_image
from mocapella.sources.referenced_images import referred
from mocapella.sources.simulate.corruption import Corruption
from mocapella.sources.simulate.silhouette_scene import silhouette_scene

UInt8 = NDArray[np.uint8]

SEEDS: Final = (100, 101, 102)
STRONG_SEEDS: Final = tuple(range(100, 120))
SEATED_SEEDS: Final = (110,)
"""Of people who sit; bounds of what counts as evidence were compared on 100 and 101, too."""
SUPPORT_SCENES: Final = tuple(name for name in SEATED_SCENES if name.startswith("misplaced"))
SUPPORT_SEEDS: Final = (420, 421, 422)
"""Of people whose limbs start elsewhere; bounds of support were chosen on seeds from 200 to 206 and 300 to 302."""
SCENES: Final = ("knee-bend", "runner")
IMAGES: Final[dict[str, Corruption | None]] = {
    "clean": None, "noise": Corruption(0.15), "noise and rectangles": Corruption(0.15, rectangles=4),
}  # fmt: skip
"""The noise of the paper is 15 %, and its runner has random rectangles, too."""
OUTLINES: Final = Path(__file__).resolve().parents[1] / "tests" / "labels" / "pose2sim_single_person_outlines.toml"
SIZE_PX: Final = (1088, 1920)
"""Of the clip's images."""


def run(quick: bool = False, parts: Sequence[str] = ()) -> list[Row]:
    return [row for part, measure in PARTS.items() if not parts or part in parts for row in measure(quick)]


def noise(quick: bool) -> Iterator[Row]:
    """Accuracy under the paper's noise, and what the penalty does to clean and noisy images."""
    runs: list[RunRow] = []
    for scene in SCENES:
        for seed in SEEDS[:1] if quick else SEEDS:
            film = filmed(silhouette_scene(scene, seed=seed), 0.1 if quick else None)
            for images, corruption in IMAGES.items():
                worse = corrupted(corruption, seed)
                runs += [followed(film, "own", images, worse, weight)[0] for weight in (0.0, 1.0)]
                if images == "noise":
                    runs.append(followed(film, "measured", images, worse, 1.0)[0])

    def mean(figure_of: Callable[[RunRow], float], **chosen: Any) -> float:
        some = [figure_of(one) for one in runs if all(getattr(one, key) == value for key, value in chosen.items())]
        return float(np.mean(some))

    with_it = {"images": "noise", "weight": 1.0}
    for body, goal in (("own", at_most(3)), ("measured", None)):
        of = {**with_it, "body": body}
        for scene in SCENES:
            name = f"silhouettes: {scene}, 15 % noise, {body} body"
            figures = {
                "joint angle error": (lambda r: r.score.angle_deg, "°", goal),
                "joint angle error, sd": (lambda r: r.score.angle_sd_deg, "°", goal),
                "knees and elbows": (lambda r: r.score.hinge_deg, "°", None),
                "knees and elbows, sd": (lambda r: r.score.hinge_sd_deg, "°", None),
                "landmarks, median": (lambda r: r.score.median_mm, "mm", None),
                "landmarks, 95 %": (lambda r: r.score.p95_mm, "mm", None),
                "IoU": (lambda r: 100 * r.overlap, "%", None),
            }
            for what, (figure_of, unit, wanted) in figures.items():
                yield measured(f"{name}, {what}", mean(figure_of, scene=scene, **of), unit, goal=wanted)
    for scene in SCENES:
        own = {"scene": scene, "body": "own"}
        for images in IMAGES:
            off, on = (mean(lambda r: r.score.jitter, **own, images=images, weight=w) for w in (0.0, 1.0))
            goal = None if images == "clean" else at_least(60)
            name = f"silhouettes: {scene}, {images}, jitter lowered by the penalty"
            yield measured(name, 100 * (1 - on / off), "%", goal=goal)
        worst_of = {**own, "images": "noise and rectangles", "weight": 1.0}
        angle = mean(lambda r: r.score.angle_deg, **worst_of)
        yield measured(f"silhouettes: {scene}, noise and rectangles, joint angle error", angle, "°")
        more = mean(lambda r: r.score.angle_deg, **own, images="clean", weight=1.0)
        less = mean(lambda r: r.score.angle_deg, **own, images="clean", weight=0.0)
        yield measured(f"silhouettes: {scene}, clean, error added by the penalty", more - less, "°", goal=at_most(0.3))
    bend = {"scene": "knee-bend", "body": "own", **with_it}
    worst = [one for one in runs if all(getattr(one, key) == value for key, value in bend.items())]
    yield measured(
        "silhouettes: knee-bend, noise, peak kept, worst seed",
        100 * min(one.kept or 0.0 for one in worst),
        "%",
        goal=at_least(97),
    )
    yield measured(
        "silhouettes: knee-bend, noise, lag, worst seed",
        max(np.inf if one.lag is None else abs(one.lag) for one in worst),
        "frames",
        goal=at_most(1),
    )


def corruption(quick: bool) -> Iterator[Row]:
    """How many runs fail where images are as wrong as `STRONG` says."""
    failed = {0.0: 0, 1.0: 0}
    seeds = STRONG_SEEDS[:1] if quick else STRONG_SEEDS
    for seed in seeds:
        scene = STRONG.scenes[seed % len(STRONG.scenes)]
        film = filmed(silhouette_scene(scene, seed=seed), 0.1 if quick else None)
        joints = rough_joints(film.scene)
        (worse,) = STRONG.images.values()
        worse = corrupted(worse, seed)
        for weight in failed:
            done = follow(film, film.scene.mesh, joints, with_penalty(weight), corruption=worse)
            ended: Outcome = outcome(done.movement, film.truth)
            failed[weight] += bool(ended.problem)
    scenes, count = " and ".join(STRONG.scenes), len(seeds)
    name = f"silhouettes: {scenes} with wrong frames, runs of {count} that"
    yield measured(f"{name} fail without the penalty", failed[0.0], "", goal=at_least(count / 2))
    yield measured(f"{name} succeed with it", count - failed[1.0], "", goal=at_least(count))


def live(quick: bool) -> Iterator[Row]:
    """Time a frame, the images being there, on one core."""
    film = filmed(silhouette_scene("runner", seed=SEEDS[0]), 0.1 if quick else None)
    joints = rough_joints(film.scene)
    with one_core():
        follow(film, film.scene.mesh, joints, clock=time.perf_counter)  # warm-up: compile the kernels now
        took = follow(film, film.scene.mesh, joints, clock=time.perf_counter).seconds
    # The first frame, whose pose is rough, is fitted for longer.
    ms, dofs = 1e3 * took[1:], film.scene.mesh.tree.dofs
    cameras = list(film.scene.rig.cameras.values())
    width, height = cameras[0].camera.size_px
    name = f"silhouettes: {len(cameras)} cameras {width} × {height}, {dofs} dofs"
    yield measured(f"{name}, a frame, median", float(np.median(ms)), "ms", goal=at_most(8))
    yield measured(f"{name}, a frame, 99 %", float(np.percentile(ms, 99)), "ms")


def step(quick: bool) -> Iterator[Row]:
    """The group twists has more of it."""
    from benchmarks import twists

    yield next(twists.steps(quick))


def seated(quick: bool) -> Iterator[Row]:
    """Legs of people who sit still among dark things, which images hardly show."""
    for name in islice(SEATED_SCENES, 2 if quick else None):
        runs = [follow_seated(name, seed, 0.4 if quick else 1.2) for seed in SEATED_SEEDS]
        for joint, goal, wish in (("knee", 100, 50), ("ankle", 150, 80)):
            scores = [one.score(joint) for one in runs]
            of = f"silhouettes: seated, {name}, {joint}s"
            yield measured(f"{of}, median", float(np.mean([s.median_mm for s in scores])), "mm", goal=at_most(wish))
            yield measured(f"{of}, 95 %", max(s.p95_mm for s in scores), "mm")
            yield measured(f"{of}, largest", max(s.worst_mm for s in scores), "mm", goal=at_most(goal))
            yield measured(f"{of}, doubted", 100 * float(np.mean([s.doubted for s in scores])), "%")
            yield measured(
                f"{of}, off by 100 mm without doubt", 100 * max(s.unsaid for s in scores), "%", goal=at_most(0)
            )
            yield measured(f"{of}, shown by no image", 100 * float(np.mean([s.hidden for s in scores])), "%")
            yield measured(
                f"{of}, of these without doubt", 100 * max(s.hidden_unsaid for s in scores), "%", goal=at_most(0)
            )
            yield measured(f"{of}, of the others doubted", 100 * float(np.mean([s.shown_doubted for s in scores])), "%")
        overlap = 100 * float(np.mean([one.overlap for one in runs]))
        yield measured(f"silhouettes: seated, {name}, overlap with its own segmentation", overlap, "%")


def support(quick: bool) -> Iterator[Row]:
    """Doubt about limbs that start elsewhere, and about right ones beside them."""
    for name in SUPPORT_SCENES[: 1 if quick else None]:
        runs = [follow_seated(name, seed, 0.16) for seed in SUPPORT_SEEDS[: 1 if quick else None]]
        for joint in ("knee", "ankle", "elbow", "wrist"):
            found, of = doubt_score(runs, joint), f"silhouettes: support, {name}, {joint}s"
            yield measured(f"{of}, off by 100 mm", found.far, "")
            if found.far:
                yield measured(f"{of}, of these doubted", 100 * found.far_doubted, "%")
            if found.right:
                yield measured(f"{of}, off by 50 mm at most, doubted", 100 * found.right_doubted, "%")


def video(quick: bool) -> Iterator[Row]:
    """The real clip, from the first frame's keypoints on."""
    folder = recordings() / "pose2sim_single_person"
    if not folder.is_dir():
        warnings.warn(f"no video measured: {folder} is not there (MOCAPELLA_DATA names another place)", stacklevel=2)
        return
    points = silhouette_video.first_points(folder)
    mesh = body_mesh("male", None, proportions_of(points), supple=True)
    rig = silhouette_video.filmed_rig(folder)
    tracker = alone(mesh, points, rig, period_s=silhouette_video.FRAME_NS / NS_PER_S)
    seen, took = [], []
    for k, images in enumerate(islice(silhouette_video.images_of(folder, rig.cameras), 8 if quick else None)):
        begin = time.perf_counter()
        seen.append(seen_at(tracker, images, k * silhouette_video.FRAME_NS, k).bodies[ALONE].fit)
        took.append(1e3 * (time.perf_counter() - begin))
    scored = silhouette_video.score_video(folder, figure(mesh), seen, OUTLINES, drawn)
    name = f"silhouettes: real clip of {scored.frames} frames"
    yield measured(f"{name}, beside Pose2Sim, median", scored.median_mm, "mm", goal=at_most(60))
    yield measured(f"{name}, beside Pose2Sim, 95 %", scored.p95_mm, "mm", goal=at_most(120))
    for joint in ("Hip", "Knee", "Ankle", "Shoulder", "Elbow", "Wrist"):
        both = float(np.mean([scored.joints_mm[side + joint] for side in "LR"]))
        yield measured(f"{name}, {joint.lower()}s, median", both, "mm")
    grown = f"{name}, keypoints in the mesh grown by {silhouette_video.GROWN_PX} px"
    yield measured(grown, 100 * scored.inside, "%", goal=at_least(95))
    overlaps: Mapping[str, float] = scored.overlaps
    if overlaps:
        mean = 100 * float(np.mean([*overlaps.values()]))
        yield measured(f"{name}, IoU with {len(overlaps)} outlines by hand, mean", mean, "%", goal=at_least(80))
        worst = min(overlaps, key=overlaps.__getitem__)
        yield measured(f"{name}, IoU with outlines by hand, worst ({worst})", 100 * overlaps[worst], "%")
    yield measured(f"{name}, a frame, median", float(np.median(took)), "ms")


def drawn(person: Sequence[Any], without: Sequence[Any]) -> UInt8:
    """(height, width) of polygons and holes, for `silhouette_video.score_video`."""
    import cv2

    mask = np.zeros(SIZE_PX[::-1], np.uint8)
    for polygons, value in ((person, 1), (without, 0)):
        for polygon in polygons:
            cv2.fillPoly(mask, [np.round(polygon).astype(np.int32)], value)
    return mask


@contextmanager
def one_core() -> Iterator[None]:
    """What is inside runs on one core, where the system can say so."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def storage(quick: bool) -> Iterator[Row]:
    """What a take of images takes: encoded as `node camera` does, without loss, or referred to."""
    scene = silhouette_scene("runner", seed=100, cameras=4, size_px=(640, 480), fps=30.0)
    images = [image for k in range(0, len(scene), len(scene) if quick else 10) for image in scene.images(k)]
    frames = [image_frame("left", image, time_ns=k) for k, image in enumerate(images)]
    encoded = ImageSettings()
    ways: dict[str, Callable[[ImageFrame], ImageFrame]] = {
        f"jpeg {encoded.quality}": lambda frame: image_frame(
            "left", encode_image(frame.data, "jpeg", encoded.quality), time_ns=1, format="jpeg", size_px=frame.size_px
        ),
        "png": as_png,
        "file": lambda frame: referred(frame, Path("left.mp4"), "0" * 64, 1000),
    }
    for name, way in ways.items():
        median = float(np.median([len(encode_frame(way(frame))) for frame in frames]))
        yield measured(f"silhouettes: a 640 × 480 image in a take, {name}", median / 1000, "kB")
        yield measured(f"silhouettes: an hour of four cameras at 30 Hz, {name}", 4 * 30 * 3600 * median / 1e9, "GB")


PARTS: Final[dict[str, Callable[[bool], Iterator[Row]]]] = {
    "noise": noise, "corruption": corruption, "seated": seated, "support": support, "live": live, "step": step,
    "video": video, "storage": storage,
}  # fmt: skip
