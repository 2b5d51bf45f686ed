"""Keypoint detection in a camera's node: people in each image, counts, and warnings."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.detectors.keypoint_detector import PeopleDetector, frame_of
from mocapella.live.camera_node import FaultReports
from mocapella.live.marker_work import colour_image
from mocapella.live.unmarked_work import UnmarkedWork
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.sensor_frame import SensorFrame
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.wire.expected import ExpectedPeople, read_expected

Float32 = NDArray[np.float32]

MOST_SKIPPED: Final = 0.1
"""Share of skipped images above which a warning is given."""
MOST_TOO_LATE: Final = 0.05
"""Part of the skipped images whose keypoints were too old to send, above which the warning states the limit."""
LATELY: Final = 1000
"""Number of last images whose age at the end of the detection is reported."""
DARK: Final = 16.0
"""Mean brightness below which an image counts as black [0 to 255]."""
FLAT: Final = 2.0
"""Standard deviation of the brightness below which an image counts as uniform [0 to 255]."""
_EVERY_PX: Final = 8
EXPECTED_S: Final = 0.5
"""Time for which people are expected where they were expected last [s]."""
NO_COLOURS: Final = "this camera sends keypoints of people; mocapella node markers detects markers"


class KeypointWork(UnmarkedWork):
    """Detects people in images; a `mocapella.live.camera_service.PictureWork` without markers.

    Args:
        camera: the camera's name.
        acquisition: source of the images; used for its reports only.
        finds: the detector, for this camera alone.

    Attributes:
        late: number of images whose processing took longer than the frame period.
        too_late: number of images whose keypoints were too old to send.
        images: number of processed images.
        with_people: number of these with a detected person.
        with_expected: number of these where the server expected a person.
    """

    def __init__(self, camera: str, acquisition: Acquisition, finds: PeopleDetector) -> None:
        super().__init__(camera, acquisition, NO_COLOURS)
        self._finds = finds
        self.late = self.too_late = self.images = self.with_people = self.with_expected = self._people = 0
        self._expected: ExpectedPeople | None = None
        self._took_s = 0.0
        self._ages_s: deque[float] = deque(maxlen=LATELY)
        self._dead = ""
        self._warned = FaultReports()
        self._before = (0, 0, 0)
        self._drop_after_s = math.inf

    def expect(self, data: bytes) -> None:
        """Search the next images where the server expects people, until it tells otherwise; on any thread.

        Args:
            data: encoded `mocapella.wire.expected.ExpectedPeople`.

        Raises:
            WireError: the message cannot be read.
        """
        self._expected = read_expected(data)

    def _regions(self, time_ns: int) -> Float32 | None:
        """Return the boxes (people, 4) where people are expected at a capture time [px]; None if unknown."""
        known = self._expected
        if known is None or not 0 <= time_ns - known.time_ns <= EXPECTED_S * NS_PER_S:
            return None
        return known.boxes

    def look(self, picture: Picture) -> KeypointFrame:
        """Detect the people in an image (height, width, 3) uint8 BGR, keep it as ``newest``, and return their frame.

        Node id, number and publication time are 0 until the frame is published.
        """
        image = colour_image(picture)
        self._dead = dead(image)
        regions = self._regions(picture.time_ns)
        seen = self._finds.update(image, picture.time_ns / NS_PER_S, regions)
        frame = frame_of(seen, self._finds.topology, self.camera, picture.time_ns, picture.size_px)
        self.images, self._people = self.images + 1, frame.bodies
        self.with_people += bool(frame.bodies)
        self.with_expected += regions is not None and len(regions) > 0
        self.keep(picture)
        return frame

    def frame(self, picture: Picture) -> SensorFrame:
        """Return the frame that is published for an image; see `look`."""
        return self.look(picture)

    def in_time(self, took_s: float, age_s: float, drop_after_s: float) -> bool:
        """Update the counts ``late`` and ``too_late``; return whether an image's keypoints are recent enough to send.

        Args:
            took_s: duration of the detection [s].
            age_s: time since the image was available [s].
            drop_after_s: largest age of an image whose keypoints are sent [s].
        """
        fps = self.acquisition.state.fps
        self._took_s += took_s
        self._drop_after_s = drop_after_s
        self._ages_s.append(age_s)
        self.late += bool(fps and took_s > 1 / fps)
        self.too_late += age_s > drop_after_s
        return age_s <= drop_after_s

    def report(self) -> dict[str, Any]:
        """Return counts since the start and current problems, in the form of ``--json``."""
        pictures = self.acquisition.report()
        return {
            "source": self.acquisition.source.name,
            "times": self.acquisition.source.times,
            **asdict(pictures),
            "images": self.images,
            "with_people": self.with_people,
            "with_expected": self.with_expected,
            "people": self._people,
            "late": self.late,
            "too_late": self.too_late,
            "skipped_share": self._skipped(pictures.taken, pictures.dropped, self.too_late),
            "mean_ms": 1e3 * self._took_s / self.images if self.images else 0.0,
            "p99_ms": 1e3 * float(np.percentile(self._ages_s, 99)) if self._ages_s else 0.0,
            "markers": {},
            "problems": [*self._problems((0, 0, 0)).values(), *self.acquisition.state.problems],
        }

    def words(self) -> str:
        """Return the counts of the report as one line for the terminal."""
        report = self.report()
        rate = f"{report['fps']:.1f} a second; " if report["fps"] else ""
        return (
            f"{rate}{report['taken']} pictures taken, {100 * report['skipped_share']:.1f} % skipped, "
            f"{report['mean_ms']:.0f} ms each; people now: {report['people']}"
        )

    def warnings(self, now_s: float) -> Iterator[str]:
        """Yield faults since the last check, and recoveries; nothing if the last check is too recent.

        ``now_s`` is the present time on a monotonic clock [s].
        """
        if not self._warned.due(now_s):
            return
        pictures = self.acquisition.report()
        problems, self._before = self._problems(self._before), (pictures.taken, pictures.dropped, self.too_late)
        yield from self._warned.update(problems, now_s)

    def _problems(self, before: tuple[int, int, int]) -> dict[str, str]:
        pictures, found = self.acquisition.report(), {}
        if pictures.too_few:
            found["rate"] = pictures.too_few
        now = (pictures.taken, pictures.dropped, self.too_late)
        share = self._skipped(*(a - b for a, b in zip(now, before, strict=True)))
        if share > MOST_SKIPPED:
            advice = "make the pictures smaller, lower --fps, close other programs, or use a faster detector"
            if self.too_late - before[2] > MOST_TOO_LATE * share * (now[0] - before[0]):
                advice = (
                    f"keypoints older than {1e3 * self._drop_after_s:.0f} ms are not sent, and a detection takes "
                    f"{1e3 * self._took_s / self.images:.0f} ms; {advice}, or give --set drop_after_ms=1000"
                )
            found["skipped"] = f"the detector is too slow: {100 * share:.0f} % of the images are skipped; {advice}"
        if self._dead:
            found["image"] = f"its picture is {self._dead}; take the cover off the lens, and switch on a light"
        return found

    @staticmethod
    def _skipped(taken: int, dropped: int, too_late: int) -> float:
        return (dropped + too_late) / taken if taken > 0 else 0.0


def dead(image: Any) -> str:
    """Return ``black`` or ``of one colour`` for such an image (height, width, 3) uint8; empty if it shows something."""
    some = image[::_EVERY_PX, ::_EVERY_PX].astype(np.float32).mean(axis=-1)
    if some.mean() < DARK and some.max() < 2 * DARK:
        return "black"
    return "of one colour" if some.std() < FLAT else ""
