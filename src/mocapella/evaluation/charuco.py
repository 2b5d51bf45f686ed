"""Scores a calibration of real webcams: calibrated on half of the images, scored with the board on the others.

The scored half is triangulated corner by corner, without the board's shape; the distances between the corners of an
instant are then compared with the board's. Every corner counts that two cameras or more saw.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mocapella.calibration.cameras import calibrate_cameras
from mocapella.calibration.corner_quality import corner_quality
from mocapella.errors import EvaluationError
from mocapella.model.board import BoardView, load_board
from mocapella.model.camera import PlacedCamera
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.sensing.boards import BoardDetector
from mocapella.sources.video import Frames, pictures

TARGETS = {"distance_rms_mm": 1.2, "reprojection_median_px": 1.0}
"""Targets on the scored frames; the reprojection target is the result of the recording's own calibration."""


def evaluate(folder: Path, tell: Callable[[str], None] = lambda _: None, *, step: int = 1) -> dict[str, Any]:
    """Calibrate on odd frames and score the even ones.

    Args:
        folder: with ``charuco.toml``, ``calibration/extrinsic/*.mp4``, one of each camera, with frames of one instant
            under one number, and ``camera_array.toml``, which is scored beside.
        tell: called with the current step, in words.
        step: take only every n-th of the odd and of the even frames, for a quick look, without halves.

    Returns:
        ``calibration``, ``scored`` for our calibration and the reference, and which targets are met.
    """
    videos = sorted((folder / "calibration" / "extrinsic").glob("*.mp4"))
    if len(videos) < 2:
        raise EvaluationError(f"{folder} has no calibration/extrinsic/*.mp4 of two cameras or more")
    board = load_board(folder / "charuco.toml")
    views: dict[str, list[BoardView]] = {"odd": [], "even": []}
    for video in videos:
        tell(f"looking for the board in {video.name}")
        detector = BoardDetector(board)
        for half, first in (("odd", 1), ("even", 0)):
            for frame, image in pictures(video, Frames(first, None, 2 * step)):
                view = detector.update(image, video.stem, frame)
                if view is not None:
                    views[half].append(view)
    tell("calibrating on the odd frames")
    found = calibrate_cameras(views["odd"], board, measure=step == 1)
    reference = load_camera_rig(folder / "camera_array.toml").cameras
    instants = {(view.camera, view.frame): view.frame for view in views["even"]}

    def score(cameras: Mapping[str, PlacedCamera]) -> dict[str, Any]:
        return asdict(corner_quality(views["even"], instants, cameras, board))

    ours = score(found.rig.cameras)
    return {
        "calibration": {
            "views": len(views["odd"]),
            "instants": found.instants,
            "sigma_px": found.sigma_px,
            "left_out": None if found.left_out is None else [asdict(half) for half in found.left_out],
            "cameras": {
                name: asdict(report) | {"lens": found.rig.cameras[name].camera.lens.tolist()}
                for name, report in found.cameras.items()
            },
        },
        "scored": {"ours": ours, "reference": score(reference)},
        "targets": {name: {"limit": limit, "met": ours[name] <= limit} for name, limit in TARGETS.items()},
    }
