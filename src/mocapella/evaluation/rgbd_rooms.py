"""Errors of joints that keypoints and depth images give, in rendered rooms with exact truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import JointState
from mocapella.model.topology import Topology, topology
from mocapella.sensing.keypoint_depth import KeypointLift
from mocapella.sources.simulate.room_depth import room_depth_scene
from mocapella.sources.simulate.room_keypoints import KeypointErrors, RoomKeypoints

Float64 = NDArray[np.float64]

SCENES: Final = ("stand", "walk", "sit", "bend", "wave", "obstacle", "exchange", "crowd")
FIRST_S: Final = 7.0
"""People stand still until then [s]."""
FAR_M: Final = 0.2
"""An error above is counted as a joint at another place [m]."""


class RgbdScore(msgspec.Struct, frozen=True):
    """Errors of one scene, over all images, people and joints.

    Attributes:
        scene, view, topology: the scene, the place of its camera, and the detector's keypoints.
        people: number of people that the detector saw, over all images.
        found: share of these that have a body in space.
        tracked: share of the joints in view that are tracked.
        median_mm, p95_mm: error of tracked joints [mm].
        far: share of tracked joints with an error above `FAR_M`.
        hidden_tracked: share of the joints behind something that are tracked nevertheless.
        inferred_mm: median error of inferred joints [mm].
    """

    scene: str
    view: str
    topology: str
    people: int
    found: float
    tracked: float
    median_mm: float
    p95_mm: float
    far: float
    hidden_tracked: float
    inferred_mm: float


def score_rgbd(
    scenes: Sequence[str] = SCENES,
    seeds: Sequence[int] = (100,),
    *,
    sensor: str = "kinect",
    keypoints: str = "coco_17",
    images: int = 40,
    errors: KeypointErrors | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> list[RgbdScore]:
    """Score each scene from the place of its first sensor.

    Args:
        scenes: names of rooms.
        seeds: random seeds; by convention from 100 on for scoring.
        sensor: the depth camera, one of `mocapella.sources.simulate.depth_scene.depth_sensor_names`.
        keypoints: topology of the simulated detector.
        images: number of images of a scene and seed.
        errors: errors of the simulated detector; the defaults if None.
        tell: receives a text about the progress.

    Raises:
        SettingsError: an unknown scene, sensor or topology.
    """
    scores = []
    for name in scenes:
        tell(name)
        scores.append(_score(name, seeds, sensor, topology(keypoints), images=images, errors=errors))
    return scores


def percentile_mm(errors_m: Float64, percent: float) -> float:
    """Return a percentile of errors [mm]; NaN without any."""
    return 1e3 * float(np.percentile(errors_m, percent)) if len(errors_m) else float("nan")


def _score(
    name: str, seeds: Sequence[int], sensor: str, own: Topology, *, images: int, errors: KeypointErrors | None
) -> RgbdScore:  # fmt: skip
    rows, seen, found, view = [np.empty((0, 3))], 0, 0, ""
    for seed in seeds:
        scene = room_depth_scene(name, seed=seed, sensor=sensor)
        view = scene.room.sensor_names[0]
        detector, lift = RoomKeypoints(scene, own, errors, seed=seed), KeypointLift(scene.lens, scene.sensor.size_px)
        for at_s in np.linspace(FIRST_S, scene.period_s - 0.1, images).tolist():
            shot = scene.at(at_s)
            frame, (truth, visible) = detector.of(shot, name, time_ns=1), detector.truth(shot)
            joints = lift.joints(frame, shot.depth * np.float32(shot.unit_m))
            seen, found = seen + len(frame.ids), found + len(joints.detection)
            for row, detection in enumerate(joints.detection.tolist()):
                person = int(frame.ids[detection])
                apart = np.linalg.norm(joints.positions[row] - truth[person], axis=-1)
                known = np.isfinite(truth[person]).all(axis=-1)
                rows.append(np.stack([joints.states[row], visible[person], apart], axis=-1)[known])
    table = np.concatenate(rows)
    tracked, visible = table[:, 0] == JointState.TRACKED, table[:, 1] > 0
    good, guessed = table[tracked, 2], table[table[:, 0] == JointState.INFERRED, 2]

    def share(of: NDArray[np.bool_], where: NDArray[np.bool_]) -> float:
        return float(of[where].mean()) if where.any() else 0.0

    return RgbdScore(
        name, view, own.name, seen, found / max(seen, 1), share(tracked, visible),
        percentile_mm(good, 50), percentile_mm(good, 95),
        float((good > FAR_M).mean()) if len(good) else float("nan"), share(tracked, ~visible),
        percentile_mm(guessed, 50),
    )  # fmt: skip
