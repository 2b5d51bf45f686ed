"""A keypoint detector of one person who wears a bright cap: the nose is where the cap is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors.keypoint_detector import KeypointDetector, SeenPeople
from mocapella.model.keypoints import NO_ID
from mocapella.model.topology import topology
from mocapella.settings import check

Image = NDArray[np.uint8]
Boxes = NDArray[np.float32]


@dataclass(frozen=True)
class CapSettings:
    """What counts as a cap.

    Attributes:
        bright: smallest brightness of its pixels, 0 to 255; larger: less else is taken for a cap [1].
        smallest_px: smallest number of its pixels; larger: a cap must be nearer [px].
    """

    bright: int = 200
    smallest_px: int = 20

    def __post_init__(self) -> None:
        check(0 < self.bright < 256, "bright", self.bright, "1 to 255")
        check(self.smallest_px > 0, "smallest_px", self.smallest_px, "above 0 px")


class CapDetector:
    """See `mocapella.detectors.keypoint_detector.PeopleDetector`."""

    topology = topology("coco_17")

    def __init__(self, settings: CapSettings) -> None:
        self._settings = settings

    def update(self, image: Image, at_s: float, regions_px: Boxes | None = None) -> SeenPeople:
        rows, columns = np.nonzero(image.min(axis=2) >= self._settings.bright)
        people = int(len(rows) >= self._settings.smallest_px)
        positions = np.full((people, len(self.topology), 2), np.nan, np.float32)
        confidences = np.zeros(positions.shape[:2], np.float32)
        if people:
            nose = self.topology.joints.index("nose")
            positions[0, nose], confidences[0, nose] = (columns.mean(), rows.mean()), 1.0
        return SeenPeople(np.full(people, NO_ID), positions, confidences)

    def reset(self) -> None:
        """Do nothing: it remembers no image."""


BRIGHT_CAP = KeypointDetector(
    interface=1,
    name="bright-cap",
    summary="One person's nose, by a bright cap.",
    settings=lambda: CapSettings,
    make=lambda settings, model: CapDetector(settings),
    missing=lambda: "",
)
