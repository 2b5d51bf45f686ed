"""Score ``silhouettes`` on a real recording, ``pose2sim_single_person``: a balancing person and four cameras.

The body starts from the keypoints of the first frame alone. The later frames are compared with Pose2Sim's joints, with
the 2D keypoints, which the tracker does not use there, and with outlines drawn by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_toml, read_whole
from mocapella.geometry.signed_distance import signed_distance
from mocapella.kinematics.silhouette_fit import Figure, Outline, eye, see
from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.openpose_names import LANDMARKS
from mocapella.model.rigged_mesh import posed
from mocapella.model.silhouettes import overlap
from mocapella.recording.image_tracks_file import read_image_tracks
from mocapella.recording.trc_file import read_trc
from mocapella.sources.video import pictures
from mocapella.sources.video_set import VideoSet
from mocapella.tracker.body_fitter import FittedBody
from mocapella.tracker.silhouette_start import joints_of_points

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bools = NDArray[np.bool_]

SCORED: Final = tuple(
    f"{side}{name}" for name in ("Hip", "Knee", "Ankle", "Shoulder", "Elbow", "Wrist") for side in "LR"
)
CONFIDENT: Final = 0.3
GROWN_PX: Final = 15
FRAME_NS: Final = 16_666_667


class VideoScore(msgspec.Struct, frozen=True):
    """The accuracy of a tracked body.

    Attributes:
        frames: number of frames.
        median_mm, p95_mm: median and 95th percentile of the distances from Pose2Sim's joints, over joints and frames
            [mm].
        joints_mm: median of these distances by joint [mm].
        inside: share of the limbs' confident 2D keypoints within the projected mesh, dilated by 15 px.
        overlaps: intersection over union with outlines drawn by hand, by ``camera frame``.
    """

    frames: int
    median_mm: float
    p95_mm: float
    joints_mm: dict[str, float]
    inside: float
    overlaps: dict[str, float]


def rig_of(folder: Path) -> CameraRig:
    """Read the calibrated cameras of ``pose2sim_single_person``, named as its videos: ``cam01``, not ``cam_01``.

    Args:
        folder: folder of the recording, with ``calibration/Calib_qualisys.toml``.

    Raises:
        InputError: the file is missing or is no camera rig.
    """
    rig = load_camera_rig(folder / "calibration" / "Calib_qualisys.toml")
    return CameraRig({name.replace("_", ""): camera for name, camera in rig.cameras.items()})


def filmed_rig(folder: Path) -> CameraRig:
    """Return the cameras of `rig_of`, cropped to the videos' image sizes; some are 8 pixels narrower than calibrated.

    Args:
        folder: folder of the recording, with ``videos/NAME.mp4`` for each camera.

    Raises:
        InputError: a file is missing or cannot be read.
    """
    cameras = rig_of(folder)
    videos = {name: folder / "videos" / f"{name}.mp4" for name in cameras.cameras}
    return VideoSet(videos, cameras, other_size="crop").rig


def images_of(folder: Path, cameras: Mapping[str, object]) -> Iterator[dict[str, UInt8]]:
    """Yield the images (height, width, 3) uint8 BGR of all cameras, by name, until the shortest video ends.

    Args:
        folder: folder of the recording, with ``videos/NAME.mp4``.
        cameras: the cameras by the names of their videos; only the names are used.
    """
    videos = [pictures(folder / "videos" / f"{name}.mp4") for name in cameras]
    for shown in zip(*videos, strict=False):
        yield {name: image for name, (_, image) in zip(cameras, shown, strict=True)}


def first_points(folder: Path) -> dict[str, Float64]:
    """Triangulate the body's landmarks from the 2D keypoints of the first frame.

    Args:
        folder: folder of the recording, with OpenPose's files in ``pose-associated/*_json`` and the calibration.

    Returns:
        Positions (3,) in the rig's world [m], by the landmark's name; landmarks that are not found are left out.

    Raises:
        InputError: a file is missing or cannot be read, or no keypoint is named as a landmark.
        CalibrationError: the cameras' keypoints do not meet in space.
    """
    tracks = read_image_tracks(sorted((folder / "pose-associated").glob("*_json")))
    return joints_of_points(tracks, load_camera_rig(folder / "calibration" / "Calib_qualisys.toml"))


def authors_joints(folder: Path, count: int) -> Float64:
    """Return the authors' joints `SCORED` in the first ``count`` frames, (frames, joints, 3) in the rig's world [m]."""
    (path,) = (p for p in (folder / "pose-3d").glob("*.trc") if "filt" not in p.name)
    reference = read_trc(path)
    markers = [reference.keypoints.index(name) for name in SCORED]
    return np.asarray(reference.positions[:count, 0][:, markers][..., [2, 0, 1]], dtype=np.float64)


def near(outline: Outline, pixels: Float64) -> Bools:
    """Return for each point (n, 2) x, y [px] whether it is inside a body's outline, or less than `GROWN_PX` outside.

    The outline's ``step_px`` is 1. Points beyond its window are not near.
    """
    grown = signed_distance(outline.mask, GROWN_PX + 2) > -GROWN_PX
    x, y = (np.round(pixels).astype(int) - outline.origin_px).T
    rows, columns = grown.shape
    there = (y >= 0) & (y < rows) & (x >= 0) & (x < columns)
    return np.asarray(there & grown[np.where(there, y, 0), np.where(there, x, 0)])


def score_video(
    folder: Path,
    body: Figure,
    followed: list[FittedBody],
    outlines: Path,
    draw: Callable[[list[Float64], list[Float64]], UInt8],
) -> VideoScore:
    """Score the body tracked in ``pose2sim_single_person``, from its first frame on.

    Args:
        folder: folder of the recording.
        body: the tracked body's mesh.
        followed: the tracker's result for each frame, from the first.
        outlines: TOML file of outlines drawn by hand.
        draw: function that renders polygons and holes, (n, 2) each [px], as a mask of 1920 × 1088 pixels.
    """
    names = list(body.mesh.landmarks)
    rig = rig_of(folder)
    theirs = authors_joints(folder, len(followed))
    ours = np.array([one.landmarks for one in followed])[:, [names.index(LANDMARKS[name]) for name in SCORED]]
    far = 1000.0 * np.linalg.norm(ours[: len(theirs)] - theirs, axis=-1)
    joints = dict(zip(SCORED, np.nanmedian(far, axis=0).tolist(), strict=True))
    far = far[np.isfinite(far)]

    tracks = read_image_tracks(sorted((folder / "pose-associated").glob("*_json")))
    columns = [tracks.points.index(name) for name in SCORED]
    drawn = decode_toml(read_whole(outlines, fix="name the file of the drawn outlines"), file=outlines)["outline"]
    within: list[bool] = []
    overlaps: dict[str, float] = {}
    for frame, one in enumerate(followed):
        vertices = posed(body.mesh, one.pose)
        for c, (name, placed) in enumerate(rig.cameras.items()):
            outline = see(body, vertices, eye(placed), step_px=1, margin_px=2 * GROWN_PX)
            if outline is None:
                continue
            pixels, sure = tracks.pixels[frame, c, columns], tracks.confidences[frame, c, columns] > CONFIDENT
            within += near(outline, pixels[sure]).tolist()
            for label in drawn:
                if (label["camera"], label["frame"]) == (name, frame):
                    truth = draw([np.array(p) for p in label["person"]], [np.array(p) for p in label["without"]]) > 0
                    mesh = outline.silhouette.mask((truth.shape[1], truth.shape[0]))
                    overlaps[f"{name} {frame}"] = overlap(truth, mesh)
    return VideoScore(
        len(followed), float(np.median(far)), float(np.percentile(far, 95)), joints, float(np.mean(within)), overlaps
    )
