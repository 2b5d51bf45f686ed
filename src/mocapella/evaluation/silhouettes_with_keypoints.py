"""Score the method ``silhouettes`` with keypoints and without, on people who sit and on a real recording.

    evaluate(["dark"], [100], seconds=0.6, data=folder)

The simulated people sit among dark things, which hide their legs (`silhouette_seated.py`). The recording is
``pose2sim_single_person``: its videos, with OpenPose's keypoints of its folder ``pose``, beside the authors' joints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.evaluation.silhouette_runs import alone, seen_at
from mocapella.evaluation.silhouette_seated import follow_seated
from mocapella.evaluation.silhouette_video import FRAME_NS, SCORED, authors_joints, filmed_rig, first_points, images_of
from mocapella.model.body_meshes import body_mesh
from mocapella.model.body_proportions import proportions_of
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.openpose_names import LANDMARKS
from mocapella.model.point_tracks import match_cameras
from mocapella.recording.bodies_file import ALONE
from mocapella.recording.detection_files import read_detections
from mocapella.recording.detections import keypoint_frames

Float64 = NDArray[np.float64]
Progress = Callable[[str], None]

JOINTS: Final = ("knee", "ankle", "wrist")
"""Kinds of joints that are scored."""
CLIP: Final = "pose2sim_single_person"


def evaluate(
    scenes: Sequence[str],
    seeds: Sequence[int],
    seconds: float | None = None,
    data: Path | None = None,
    progress: Progress = lambda text: None,
) -> dict[str, Any]:
    """Score scenes, and a recording if its folder is given.

    Args:
        scenes: names of `silhouette_seated.SEATED_SCENES`.
        seeds: seeds of each scene.
        seconds: duration of each scene and of the recording [s]; None for 1.2 s, and all of the recording.
        data: folder with the folder `CLIP`; None for no recording.
        progress: called with a line about each run.

    Returns:
        Under ``scenes``, ``{scene: {with or without: {joint: figures}}}``, and under ``recordings`` the same; the
        figures are ``median_mm``, ``p95_mm``, ``worst_mm`` and ``unsupported_percent``, and ``overlap_percent`` stands
        beside the joints.

    Raises:
        SettingsError: no such scene.
        InputError: a file of the recording is missing or cannot be read.
    """
    found: dict[str, Any] = {"scenes": {}, "recordings": {}}
    for name in scenes:
        for given in (False, True):
            progress(f"{name}, {_kind(given)}")
            runs = [follow_seated(name, seed, seconds or 1.2, keypoints=given) for seed in seeds]
            errors, supported = (np.concatenate([getattr(r, of) for r in runs]) for of in ("errors_m", "supported"))
            row = _figures(runs[0].landmarks, errors, ~supported, float(np.mean([r.overlap for r in runs])))
            found["scenes"].setdefault(name, {})[_kind(given)] = row
    if data is not None:
        for given in (False, True):
            progress(f"{CLIP}, {_kind(given)}")
            found["recordings"].setdefault(CLIP, {})[_kind(given)] = follow_clip(data / CLIP, seconds, keypoints=given)
    return found


def follow_clip(folder: Path, seconds: float | None = None, *, keypoints: bool) -> dict[str, Any]:
    """Track the person of `CLIP` from the keypoints of the first frame; return the figures of `evaluate`.

    Args:
        folder: folder of the recording.
        seconds: duration [s]; None for all.
        keypoints: whether the keypoints of the folder ``pose``, of all people in the images, are given, too.

    Raises:
        InputError: a file is missing or cannot be read.
    """
    points, rig = first_points(folder), filmed_rig(folder)
    mesh = body_mesh("male", None, proportions_of(points), supple=True)
    tracker = alone(mesh, points, rig, period_s=FRAME_NS / NS_PER_S)
    given = _keypoints(folder, rig) if keypoints else {}
    count = None if seconds is None else round(seconds * NS_PER_S / FRAME_NS)
    places, unsupported, overlaps = [], [], list[float]()
    names = tuple(mesh.landmarks)
    for k, images in enumerate(islice(images_of(folder, rig.cameras), count)):
        fit = seen_at(tracker, images, k * FRAME_NS, k, given.get(k, ())).bodies[ALONE].fit
        places.append(fit.landmarks)
        unsupported.append(np.zeros(len(names), np.bool_) if fit.supported is None else ~fit.supported)
        overlaps += [seen.overlap for seen in fit.seen.values()]
    theirs = authors_joints(folder, len(places))
    columns = [names.index(LANDMARKS[name]) for name in SCORED]
    ours = np.array(places)[: len(theirs), columns]
    errors = np.linalg.norm(ours - theirs, axis=-1)
    doubted = np.array(unsupported)[: len(theirs), columns]
    return _figures([names[k] for k in columns], errors, doubted, float(np.mean(overlaps)))


def _keypoints(folder: Path, rig: CameraRig) -> Mapping[int, Sequence[KeypointFrame]]:
    """Return the keypoints of all people in the recording's images, by number of the frame."""
    detected = read_detections([folder / "pose"])
    names = match_cameras([one.camera for one in detected], rig.cameras, file=folder)
    found: dict[int, list[KeypointFrame]] = {}
    first = min(int(one.numbers[0]) for one in detected if len(one.numbers))
    for name, one in zip(names, detected, strict=True):
        frames = keypoint_frames(one, name, rig.cameras[name].camera.size_px, NS_PER_S / FRAME_NS)
        for number, frame in zip(one.numbers.tolist(), frames, strict=True):
            found.setdefault(number - first, []).append(frame)
    return found


def _figures(
    landmarks: Sequence[str], errors_m: Float64, unsupported: NDArray[np.bool_], overlap: float
) -> dict[str, Any]:
    """Return the figures of `evaluate` of errors (frames, landmarks) [m]."""
    out: dict[str, Any] = {"overlap_percent": 100.0 * overlap}
    for joint in JOINTS:
        these = [k for k, name in enumerate(landmarks) if name.endswith(joint)]
        errors = 1e3 * errors_m[:, these]
        errors = errors[np.isfinite(errors)]
        median, p95, worst = np.percentile(errors, [50, 95, 100]).tolist()
        share = 100.0 * float(unsupported[:, these].mean())
        out[joint] = {"median_mm": median, "p95_mm": p95, "worst_mm": worst, "unsupported_percent": share}
    return out


def _kind(given: bool) -> str:
    return "with keypoints" if given else "without keypoints"
