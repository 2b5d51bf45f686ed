"""Score a calibration of real webcams, which is computed from half of the images, by the board in the other half.

The scored half is triangulated corner by corner, without the board's shape. The distances between the corners of one
instant are then compared with the board's. All corners seen by two or more cameras are used.
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
    """Calibrate cameras on the odd frames of videos of a board, and score the calibration on the even ones.

    Args:
        folder: contains ``charuco.toml``; ``calibration/extrinsic/*.mp4``, one synchronised video per camera; and
            ``camera_array.toml``, a reference calibration, which is scored as well.
        tell: called with the current step, in words.
        step: only every ``step``-th of the odd and of the even frames is used; 2 or more is for a quick check, without
            cross-validation of the calibration.

    Returns:
        JSON-like: ``calibration``; ``scored``, quality of this calibration (``ours``) and the reference; ``targets``,
        each with its limit, and whether ours meets it.

    Raises:
        EvaluationError: the folder has fewer than two videos.
        InputError: a file cannot be read.
        CalibrationError: the views of the board do not determine the cameras.
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
