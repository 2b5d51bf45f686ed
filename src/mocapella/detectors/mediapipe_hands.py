"""Registers the keypoint detector ``mediapipe-hands``: MediaPipe Hands, 21 landmarks of each hand in an image.

F. Zhang et al., MediaPipe Hands: On-device Real-time Hand Tracking (2020). The package of the extra
``mediapipe`` ships its models. Which hand is a left one is not used: the tracker decides it in space.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors.keypoint_detector import KeypointDetector, PeopleDetector, SeenPeople
from mocapella.detectors.mediapipe_pose import missing
from mocapella.model.keypoints import NO_ID
from mocapella.model.topology import Topology, topology
from mocapella.settings import check

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]


@dataclass(frozen=True)
class HandDetectorSettings:
    """Settings of the detector ``mediapipe-hands``.

    Attributes:
        most_hands: hands at once in one image; larger: slower with each hand [number]
        least_confidence: MediaPipe's thresholds of a palm and of a followed hand; larger: fewer wrong and fewer true
            hands [0 to 1]

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    most_hands: int = 2
    least_confidence: float = 0.5

    def __post_init__(self) -> None:
        check(1 <= self.most_hands <= 20, "most_hands", self.most_hands, "from 1 to 20")
        check(0 <= self.least_confidence <= 1, "least_confidence", self.least_confidence, "from 0 to 1")


class MediaPipeHands:
    """Landmarks of the hands in one camera's images: a `PeopleDetector` whose detections are hands.

    Args:
        settings: number of hands, and thresholds.

    Attributes:
        topology: ``hand``.

    Raises:
        InputError: the installed version of MediaPipe has no models; says what would work.
    """

    def __init__(self, settings: HandDetectorSettings) -> None:
        from mediapipe.python.solutions.hands import Hands

        from mocapella.detectors.mediapipe_people import check_shipped

        check_shipped()
        self.topology: Topology = topology("hand")
        self._hands = Hands(
            max_num_hands=settings.most_hands, min_detection_confidence=settings.least_confidence,
            min_tracking_confidence=settings.least_confidence,
        )  # fmt: skip

    def update(self, image: UInt8, at_s: float, regions_px: Float32 | None = None) -> SeenPeople:
        """Detect the hands in the next image; see `PeopleDetector.update`. Regions are not used."""
        from mocapella.sensing.image_crops import to_rgb

        found = self._hands.process(to_rgb(image))
        return seen_hands(found.multi_hand_landmarks, found.multi_handedness, (image.shape[1], image.shape[0]))

    def reset(self) -> None:
        """Forget all earlier images."""
        self._hands.reset()


def seen_hands(marks: Any, sides: Any, size_px: tuple[int, int]) -> SeenPeople:
    """Return hands from MediaPipe's landmarks.

    A landmark has no confidence of its own: it gets the hand's, the confidence of its side.

    Args:
        marks: list of hands with ``landmark``, each with x and y, 0 to 1 from edge to edge; None if there is no hand.
        sides: list of the sides with ``classification``, each with ``score``, 0 to 1.
        size_px: (width, height) of the image.
    """
    hands = list(marks or [])
    places = np.array([[(m.x, m.y) for m in hand.landmark] for hand in hands], np.float32).reshape(-1, 21, 2)
    positions = places * np.array(size_px, np.float32) - 0.5  # the middle of the first pixel is (0, 0)
    scores = np.array([side.classification[0].score for side in (sides or [])[: len(hands)]], np.float32)
    sure = np.repeat(np.clip(scores, 0.0, 1.0).reshape(-1, 1), 21, axis=1)
    return SeenPeople(np.full(len(hands), NO_ID, np.int64), positions, sure.astype(np.float32))


def _make(settings: Any, _model: Path | None) -> PeopleDetector:
    return MediaPipeHands(settings)


MEDIAPIPE_HANDS: Final = KeypointDetector(
    interface=1,
    name="mediapipe-hands",
    summary="MediaPipe Hands: 21 keypoints of each hand, for hands alone before two or more cameras.",
    settings=lambda: HandDetectorSettings,
    make=_make,
    missing=missing,
)
