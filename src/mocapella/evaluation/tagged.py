"""Score the pose of a tagged object in rendered images, with the cameras of the hands' scenes.

A tag of 40 mm is swung in front of the cameras, without a hand; images have the cameras' blur, noise and mosaic, and
no motion blur. The pose after each frame is compared with the ground truth at the instant of that frame.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.fusion.marker_rays import RayState
from mocapella.fusion.object_poses import ObjectPoses
from mocapella.geometry.rigid import inverse, rigid
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.model.tags import corner_names, corner_places
from mocapella.sensing.tags import TagDetector, TagSettings
from mocapella.sources.simulate.camera_image import camera_image
from mocapella.sources.simulate.hand_scene import HandScene, load_hand_scene
from mocapella.sources.simulate.tag_picture import draw_tags

Float64 = NDArray[np.float64]

SCENES: Final = ("wide", "thesis")
"""Scenes that define the cameras, with global shutters."""
SIDE_M: Final = 0.04
LASTS_S: Final = 1.5
SETTLE_S: Final = 0.3
_TAG: Final = 7
_DICTIONARY: Final = "APRILTAG_36H11"
_TAG_SD_PX: Final = 0.1


def evaluate_tag(
    scenes: Sequence[str], seeds: Sequence[int], tell: Callable[[str], None] = lambda text: None
) -> dict[str, dict[str, float]]:
    """Return the scores of a tag, by scene: ``NAME`` with all cameras, ``NAME, one camera`` with the first alone.

    Args:
        scenes: names of scenes; only those in `SCENES` are scored.
        seeds: random seeds of the motion and the noise.
        tell: called with the current step, in words.

    Returns:
        ``mm_median``, ``mm_p95``, ``deg_median`` and ``deg_p95`` of the pose's errors, where a pose is known, and
        ``tracked_percent`` and ``lost_percent``, the shares of frames with a tracked pose and without any.
    """
    found = {}
    for name in scenes:
        if name not in SCENES:
            continue
        for one in (False, True):
            runs = []
            for seed in seeds:
                label = f"{name}, one camera" if one else name
                tell(f"a tag, {label}, seed {seed}")
                runs.append(_run(load_hand_scene(name, seed=seed), seed, one))
            found[label] = _scores(np.concatenate(runs))
    return found


def place_at(scene: HandScene, seed: int, at_s: float) -> Float64:
    """Return the pose ``T_world_tag`` (4, 4) of a simulated tag that swings near the hand's position.

    The tag faces the cameras, and moves with at most 0.6 m/s and 210°/s.

    Args:
        scene: gives the position about which the tag swings.
        seed: random seed of the motion.
        at_s: time since the scene's start [s].
    """
    rng = np.random.default_rng([seed, 11])
    phase, rates, lean = rng.uniform(0, 6, (2, 3)), rng.uniform(3, 7, (2, 3)), rng.uniform(-0.5, 0.5, 3)
    turn = lean + 0.3 * np.sin(rates[0] * at_s + phase[0])
    middle = np.array(scene.settings.motion.centre_m)
    return rigid(exp_twist([0, 0, 0, *turn])[:3, :3], middle + 0.05 * np.sin(rates[1] * at_s + phase[1]))


def _run(scene: HandScene, seed: int, one: bool) -> Float64:
    """Return (frames, 3): errors [mm], [°], and whether the pose is marked tracked; NaN errors if unknown."""
    cameras = list(scene.cameras.values())[: 1 if one else None]
    names = corner_names(_TAG)
    poses = ObjectPoses(scene.rig, corner_places(SIDE_M), planes=((0, 1, 2, 3),))
    detectors = {camera.name: TagDetector(camera.name, TagSettings(_DICTIONARY, (_TAG,))) for camera in cameras}
    instants = heapq.merge(
        *([(c.phase_s + k / c.fps, c.name) for k in range(math.ceil(LASTS_S * c.fps))] for c in cameras)
    )
    rows = []
    for at_s, name in instants:
        camera, truth = scene.cameras[name], place_at(scene, seed, at_s)
        linear = np.full((camera.size_px[1], camera.size_px[0], 3), 0.3, np.float32)
        T_camera_tag = {_TAG: camera.T_camera_world @ truth}
        draw_tags(linear, camera.lens, T_camera_tag, dictionary=_DICTIONARY, side_m=SIDE_M)
        rng = np.random.default_rng([seed, 12, round(1e6 * at_s)])
        frame = detectors[name].update(camera_image(linear, camera.image, rng), at_s)
        if frame.names == names:
            poses.update(name, frame.positions_px, np.hypot(frame.sd_px, _TAG_SD_PX), at_s)
        if at_s < SETTLE_S:
            continue
        pose = poses.at(at_s)
        if pose.T_world_object is None:
            rows.append([np.nan, np.nan, 0.0])
            continue
        off = inverse(truth) @ pose.T_world_object
        turned = math.degrees(float(np.linalg.norm(log_motion(off)[3:])))
        rows.append([1e3 * float(np.linalg.norm(off[:3, 3])), turned, float(pose.state == RayState.TRACKED)])
    return np.array(rows)


def _scores(rows: Float64) -> dict[str, Any]:
    away, turned, tracked = rows.T
    return {
        "mm_median": float(np.nanmedian(away)),
        "mm_p95": float(np.nanpercentile(away, 95)),
        "deg_median": float(np.nanmedian(turned)),
        "deg_p95": float(np.nanpercentile(turned, 95)),
        "tracked_percent": 100 * float(tracked.mean()),
        "lost_percent": 100 * float(np.isnan(away).mean()),
    }
