"""Association and pose of crowds beside Pose2Sim's association, triangulation and filter, on the same detections.

Six simulated people before eight cameras, 25 keypoints (BODY_25) with the measured errors. Pose2Sim reads them from
OpenPose JSON, in an environment of its own (`uv run --no-project --isolated --with pose2sim`, or the Python that
``POSE2SIM_PYTHON`` names), with its defaults for several people. Both have one thread, and times are the processor's:
other programs do not count. Its time for reading JSON is a row of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.harness import Row, at_most, compared, measured, times_the_peer
from mocapella.evaluation.people_scores import PeopleScore
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.sources.simulate.crowd import CrowdScene, crowd_scene
from mocapella.sources.simulate.hand_keypoints import hand_frames, hand_keypoint_scene
from mocapella.sources.simulate.keypoint_camera import SimulatedKeypoints
from mocapella.tracker.instants import CameraInstant
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_hands import WebcamsHands

CAMERAS: Final = 8
HZ: Final = 30
ONE_THREAD: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
PATIENCE_S: Final = 1500
TURNS: Final = 3


def run(quick: bool = False) -> list[Row]:
    scene = crowd_scene("six-walk", seed=5, cameras=CAMERAS, topology="body_25")
    items = instants(scene, 10 if quick else 60)
    what = f"{len(scene.settings.people)} people × {CAMERAS} cameras × 25 keypoints"
    turns = [per_instant(scene.rig, items) for _ in range(TURNS)]
    ms = 1e3 * float(np.median([np.mean(turn) for turn, _ in turns]))
    slow = 1e3 * float(np.median([np.percentile(turn, 95) for turn, _ in turns]))
    inner = 1e3 * float(np.median([np.mean(turn) for _, turn in turns]))
    rows = [
        measured(f"webcams: association + pose alone, {what}", inner, "ms", goal=at_most(1.0)),
        measured(f"webcams: an instant with its 8 scenes, {what}", ms, "ms"),
        measured(f"webcams: an instant, 95th percentile, {what}", slow, "ms"),
    ]
    rows += hand_rows(1.0 if quick else 4.0)
    with tempfile.TemporaryDirectory() as folder:
        write_project(Path(folder), scene.rig, items)
        begin = time.process_time()
        read_project(Path(folder))
        reading = 1e3 * (time.process_time() - begin) / len(items)
        rows.append(measured("webcams: reading the JSON of an instant", reading, "ms"))
        peer = pose2sim(Path(folder))
    if peer is None:
        return rows
    stages = [peer["seconds"][stage] for stage in ("personAssociation", "triangulation", "filtering")]
    name = f"Pose2Sim {peer['version']}"
    peer_ms = 1e3 * sum(stages) / len(items)
    rows.append(compared(
        f"webcams: association + pose, {what}", ms, "ms", peer=f"{name}, with its files", peer_value=peer_ms,
        goal=times_the_peer(50),
    ))  # fmt: skip
    rows.append(compared(
        f"webcams: the same, both with reading, {what}", ms + reading, "ms", peer=name, peer_value=peer_ms,
        goal=times_the_peer(50),
    ))  # fmt: skip
    for stage, seconds in peer["seconds"].items():
        rows.append(measured(f"webcams: {name}, {stage}, an instant", 1e3 * seconds / len(items), "ms"))
    return rows


def hand_rows(seconds: float) -> list[Row]:
    """Time of the fit of one hand of a person, and of both with their assignment, with errors of a detector."""
    fits: list[float] = []
    updates: list[float] = []

    class TimedHands(WebcamsHands):
        def _fit(self, one: Any, seen: Any) -> None:
            begin = time.process_time()
            super()._fit(one, seen)
            fits.append(time.process_time() - begin)

        def update(self, *arguments: Any) -> None:
            begin = time.process_time()
            super().update(*arguments)
            updates.append(time.process_time() - begin)

    scene = hand_keypoint_scene("person")
    tracker = WebcamsTracker(scene.rig, sensors_expected=len(scene.rig.cameras))
    tracker._hands = TimedHands(tracker.settings)
    tracker._hands.set_rig(scene.rig)
    for item in hand_frames(scene, 0, seconds=1.0 + seconds):
        tracker.update(Arrival(item.frame, item.at_ns))
    what = f"{len(scene.rig.cameras)} cameras × 21 keypoints"
    skipped = HZ  # instants of the first second, in which kernels are compiled and the person is found
    fit_ms, both_ms = (1e3 * float(np.median(values)) for values in (fits[2 * skipped :], updates[skipped:]))
    return [
        measured(f"webcams: fit of a hand, {what}", fit_ms, "ms", goal=at_most(0.3)),
        measured(f"webcams: both hands of a person with their assignment, {what}", both_ms, "ms"),
    ]


def instants(scene: CrowdScene, count: int) -> list[list[SimulatedKeypoints]]:
    """Frames of all cameras after the first second, for each instant."""
    found: dict[int, list[SimulatedKeypoints]] = {}
    for item in scene.frames():
        if item.frame.sequence >= HZ + count:
            break
        if item.frame.sequence >= HZ:
            found.setdefault(item.frame.sequence, []).append(item)
    return [found[k] for k in sorted(found) if len(found[k]) == CAMERAS]


def per_instant(rig: CameraRig, items: Sequence[Sequence[SimulatedKeypoints]]) -> tuple[list[float], list[float]]:
    """Seconds of each instant once all people are found: of all updates, and of association and pose alone.

    Raises:
        RuntimeError: the tracker does not find the people, so that its time means nothing.
    """
    inner: list[float] = []

    class Timed(WebcamsTracker):
        def _track(self, instant: CameraInstant) -> None:
            begin = time.process_time()
            super()._track(instant)
            inner.append(time.process_time() - begin)

    tracker = Timed(rig, sensors_expected=CAMERAS)
    arrivals = [[Arrival(one.frame, one.at_ns) for one in instant] for instant in items]
    score, seconds = PeopleScore(), []
    for k, instant in enumerate(arrivals):
        begin = time.process_time()
        for arrival in instant:
            scene = tracker.update(arrival)
        seconds.append(time.process_time() - begin)
        seen = np.stack([one.visible for one in items[k]]).astype(np.int64)
        score.update(items[k][-1].room_ns, items[k][0].people, items[k][0].positions, seen, scene.people)
    found = score.figures()
    if not found.found_percent > 90:
        raise RuntimeError(f"only {found.found_percent:.0f} % of the people are found; the time means nothing")
    skipped = min(5, len(seconds) - 1)
    return seconds[skipped:], inner[skipped:]


def write_project(folder: Path, rig: CameraRig, items: Sequence[Sequence[SimulatedKeypoints]]) -> None:
    """Write detections and calibration as Pose2Sim reads them."""
    import cv2

    (folder / "calibration").mkdir()
    text = []
    for name, placed in rig.cameras.items():
        fx, fy, cx, cy, *distortion = placed.camera.lens.tolist()
        rotation, _ = cv2.Rodrigues(placed.T_camera_world[:3, :3])
        text += [
            f"[{name}]", f'name = "{name}"', f"size = {[float(v) for v in placed.camera.size_px]}",
            f"matrix = [[{fx}, 0.0, {cx}], [0.0, {fy}, {cy}], [0.0, 0.0, 1.0]]", f"distortions = {distortion[:4]}",
            f"rotation = {rotation.ravel().tolist()}", f"translation = {placed.T_camera_world[:3, 3].tolist()}",
            "fisheye = false", "",
        ]  # fmt: skip
    text += ["[metadata]", "adjusted = false", "error = 0.0"]
    (folder / "calibration" / "Calib_simulated.toml").write_text("\n".join(text), encoding="utf-8")
    for k, instant in enumerate(items):
        for one in instant:
            where = folder / "pose" / f"{one.frame.sensor}_json"
            where.mkdir(parents=True, exist_ok=True)
            path = where / f"{one.frame.sensor}_{k:06d}.json"
            path.write_text(json.dumps(openpose(one.frame)), encoding="utf-8")


def openpose(frame: KeypointFrame) -> dict[str, Any]:
    """A frame as OpenPose's JSON."""
    table = np.concatenate([np.nan_to_num(frame.positions_px), frame.confidences[..., None]], axis=-1)
    people = [{"person_id": [-1], "pose_keypoints_2d": row.ravel().round(3).tolist()} for row in table]
    return {"version": 1.3, "people": people}


def read_project(folder: Path) -> int:
    """Read all JSON as arrays, as our readers do without their checks; return the number of detections."""
    count = 0
    for path in sorted((folder / "pose").glob("*/*.json")):
        people = json.loads(path.read_bytes())["people"]
        count += len(np.array([person["pose_keypoints_2d"] for person in people]).reshape(len(people), -1, 3))
    return count


def pose2sim(folder: Path) -> dict[str, Any] | None:
    """Run Pose2Sim's stages; None, with a warning, where it cannot be run."""
    own = os.environ.get("POSE2SIM_PYTHON")
    uv = ["uv", "run", "--no-project", "--isolated", "--python", "3.11", "--with", "pose2sim", "python"]
    command = [own] if own else uv
    script = Path(__file__).with_name("_pose2sim.py")
    try:
        done = subprocess.run(
            [*command, str(script), str(folder), str(HZ)], capture_output=True, text=True, timeout=PATIENCE_S,
            env=os.environ | ONE_THREAD, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        warnings.warn(f"no peer: {error}", stacklevel=2)
        return None
    if done.returncode:
        warnings.warn(f"no peer: {done.stderr.strip().splitlines()[-1:]}", stacklevel=2)
        return None
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found
