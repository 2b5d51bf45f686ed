"""Detect people's keypoints by MediaPipe Pose (Bazarevsky et al., BlazePose, CVPR workshops 2020)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors.keypoint_detector import SeenPeople
from mocapella.detectors.people_slots import OneSeen, PeopleSlots, SlotSettings
from mocapella.errors import InputError
from mocapella.model.keypoints import NO_ID
from mocapella.model.topology import Topology, topology
from mocapella.sensing.image_crops import to_rgb

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]

TOPOLOGY: Final = "mediapipe_pose"
OUTSIDE: Final = 0.05
"""Keypoints farther outside of the image than this part of its longer side are guesses, and are not used."""
FULL: Final = 1
"""The model that the package ships (pose_landmark_full); the others would be downloaded."""
SHIPPED: Final = "modules/pose_landmark/pose_landmark_full.tflite"
FOUND: Final = 0.5
"""MediaPipe's own threshold of a person [0 to 1]."""


def _indices(*names: str) -> list[int]:
    return [topology(TOPOLOGY).index(name) for name in names]


(NOSE,) = _indices("NOSE")
EARS: Final = _indices("LEFT_EAR", "RIGHT_EAR")
FACE: Final = [
    NOSE, *_indices("MOUTH_LEFT", "MOUTH_RIGHT"),
    *_indices(*(f"{side}_EYE{part}" for side in ("LEFT", "RIGHT") for part in ("_INNER", "", "_OUTER"))),
]  # fmt: skip
"""Keypoints that the head hides from behind."""


class MediaPipePeople:
    """Keypoints of several people: a `PeopleDetector` with one instance of MediaPipe Pose for each.

    MediaPipe's smoothing is off: it would delay the keypoints, and the tracker smooths them.

    Args:
        settings: number of people, and how new ones are found.

    Attributes:
        topology: ``mediapipe_pose``.

    Raises:
        InputError: the installed version of MediaPipe has no models; says what would work.
    """

    def __init__(self, settings: SlotSettings) -> None:
        self.topology: Topology = topology(TOPOLOGY)
        check_shipped()
        self._slots = PeopleSlots(_OnePose, settings)
        self._slots.update(np.zeros((64, 64, 3), np.uint8), 0.0)  # loads the model before the first image counts
        self._slots.reset()

    def update(self, image: UInt8, at_s: float, regions_px: Float32 | None = None) -> SeenPeople:
        """Detect the people in the next image; see `PeopleDetector.update`."""
        return self._slots.update(to_rgb(image), at_s, regions_px) or nobody(len(self.topology))

    def reset(self) -> None:
        """Forget all earlier images."""
        self._slots.reset()


class MediaPipeTask:
    """Keypoints of several people by MediaPipe's Pose Landmarker with a model's file: a `PeopleDetector`.

    Args:
        settings: number of people, and their least confidence.
        model: the model's file, such as ``pose_landmarker_full.task``.

    Attributes:
        topology: ``mediapipe_pose``.

    Raises:
        InputError: the file is no model of the Pose Landmarker.
    """

    def __init__(self, settings: SlotSettings, model: Path) -> None:
        from mediapipe.tasks.python import BaseOptions, vision

        self.topology: Topology = topology(TOPOLOGY)
        options = vision.PoseLandmarkerOptions(
            base_options=BaseOptions(model_asset_path=str(model)), running_mode=vision.RunningMode.VIDEO,
            num_poses=settings.most_people, min_pose_presence_confidence=settings.least_confidence,
        )  # fmt: skip
        self._make: Callable[[], Any] = partial(vision.PoseLandmarker.create_from_options, options)
        try:
            self._landmarker = self._make()
        except (RuntimeError, ValueError) as error:
            fix = "give a pose_landmarker model of MediaPipe (.task), or leave --model out"
            raise InputError("is no model of MediaPipe's Pose Landmarker", file=model, fix=fix) from error
        self._last_ms = -1

    def update(self, image: UInt8, at_s: float, regions_px: Float32 | None = None) -> SeenPeople:
        """Detect the people in the next image; see `PeopleDetector.update`. Regions are not used."""
        import mediapipe as mp

        at_ms = round(1e3 * at_s)
        self._last_ms = max(self._last_ms + 1, at_ms)  # it refuses times that do not rise
        found = self._landmarker.detect_for_video(mp.Image(mp.ImageFormat.SRGB, to_rgb(image)), self._last_ms)
        size_px = (image.shape[1], image.shape[0])
        pairs = zip(found.pose_landmarks, found.pose_world_landmarks, strict=True)
        people = [one_seen(marks, world, size_px) for marks, world in pairs]
        if not people:
            return nobody(len(self.topology))
        return SeenPeople(
            np.full(len(people), NO_ID, np.int64),
            np.stack([one.positions_px for one in people]),
            np.stack([one.confidences for one in people]),
            np.stack([one.relative for one in people]),
        )

    def reset(self) -> None:
        """Forget all earlier images."""
        self._landmarker.close()
        self._landmarker, self._last_ms = self._make(), -1


class _OnePose:
    """An instance of MediaPipe Pose, which follows one person."""

    def __init__(self) -> None:
        from mediapipe.python.solution_base import SolutionBase
        from mediapipe.python.solutions.pose import Pose

        self._pose = Pose(
            model_complexity=FULL, smooth_landmarks=False,
            min_detection_confidence=FOUND, min_tracking_confidence=FOUND,
        )  # fmt: skip
        # `Pose.process` removes the presences, which are a factor of the confidences.
        self._process: Callable[..., Any] = SolutionBase.process
        self._fresh = True

    def follow(self, image: UInt8) -> OneSeen | None:
        found = self._process(self._pose, input_data={"image": image})
        self._fresh = not found.pose_landmarks
        if not found.pose_landmarks or not found.pose_world_landmarks:
            return None
        size_px = (image.shape[1], image.shape[0])
        return one_seen(found.pose_landmarks.landmark, found.pose_world_landmarks.landmark, size_px)

    def forget(self) -> None:
        if not self._fresh:  # one that has just lost its person has forgotten it
            self._pose.reset()
            self._fresh = True


def one_seen(marks: Any, world: Any, size_px: tuple[int, int]) -> OneSeen:
    """Return a person's keypoints from MediaPipe's landmarks.

    The confidence is visibility times presence. Keypoints too far outside of the image (`OUTSIDE`) are not seen, and
    neither is a face that looks away from the camera: MediaPipe guesses it with full confidence. It does so if the
    nose is farther from the camera than the middle of the ears.

    Args:
        marks: landmarks with x and y, 0 to 1 from edge to edge of the image, and visibility and presence, 0 to 1.
        world: landmarks with x, y and z relative to the hips' middle, in the camera's axes [m].
        size_px: (width, height) of the image.
    """
    values = np.array([(m.x, m.y, m.visibility, m.presence) for m in marks], np.float32)
    size = np.array(size_px, np.float32)
    positions = values[:, :2] * size - 0.5  # the middle of the first pixel is (0, 0)
    beyond = np.maximum(-positions, positions - (size - 1)).max(axis=-1)
    sure = np.clip(values[:, 2] * values[:, 3], 0.0, 1.0)
    sure[(beyond > OUTSIDE * size.max()) | ~np.isfinite(positions).all(axis=-1)] = 0.0
    relative = np.array([(m.x, m.y, m.z) for m in world], np.float32)
    if relative[NOSE, 2] > relative[EARS, 2].mean():
        sure[FACE] = 0.0
    positions[sure == 0] = np.nan
    return OneSeen(positions, sure.astype(np.float32), relative)


def nobody(joints: int) -> SeenPeople:
    """Return the result for an image without people, for a topology of so many joints."""
    return SeenPeople(
        np.zeros(0, np.int64), np.zeros((0, joints, 2), np.float32), np.zeros((0, joints), np.float32),
        np.zeros((0, joints, 3), np.float32),
    )  # fmt: skip


def check_shipped(folder: Path | None = None) -> None:
    """Check that the installed MediaPipe has the models that it once shipped: nothing is downloaded.

    Args:
        folder: folder of the package; None for the installed one.

    Raises:
        InputError: it has not; names the version that has, and the file that newer ones take.
    """
    if folder is None:
        import importlib.util

        spec = importlib.util.find_spec("mediapipe")
        folder = Path() if spec is None or spec.origin is None else Path(spec.origin).parent
    if not (folder / SHIPPED).is_file() or not (folder / "python" / "solutions" / "pose.py").is_file():
        fix = "give a model with --model pose_landmarker_full.task, or install mediapipe 0.10.21 (the extra mediapipe)"
        raise InputError("this version of MediaPipe has no models of its own", fix=fix)
