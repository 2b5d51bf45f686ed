"""Image encoding of a node that sends images: frames, counts, and warnings."""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

from mocapella.conventions import NS_PER_S
from mocapella.live.camera_node import FaultReports
from mocapella.live.marker_work import colour_image
from mocapella.live.unmarked_work import UnmarkedWork
from mocapella.model.images import ImageFrame, image_frame
from mocapella.sensing.images import encode_image
from mocapella.settings import check
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture

_LATELY: Final = 300
"""Number of last images whose median size is reported."""
NO_MARKERS: Final = "this camera only sends its images; mocapella node markers detects markers"


@dataclass(frozen=True)
class ImageSettings:
    """Encoding of images.

    Attributes:
        format: ``jpeg``, or ``png``, which is lossless and about ten times as large.
        quality: quality of a JPEG, 1 to 100.
        delay_s: latency from capture to arrival, for example of a network camera [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    format: Literal["jpeg", "png"] = "jpeg"
    quality: int = 90
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        check(self.format in ("jpeg", "png"), "format", self.format, "jpeg or png")
        check(1 <= self.quality <= 100, "quality", self.quality, "1 to 100")
        check(0 <= self.delay_s <= 10, "delay_s", self.delay_s, "0 to 10 s")


class ImageWork(UnmarkedWork):
    """Encodes images as frames; a `mocapella.live.camera_service.PictureWork` without markers.

    Args:
        camera: the camera's name.
        acquisition: source of the images; used for its reports only.
        settings: settings of the encoding; the defaults if None.
    """

    def __init__(self, camera: str, acquisition: Acquisition, settings: ImageSettings | None = None) -> None:
        super().__init__(camera, acquisition, NO_MARKERS)
        self.settings = settings or ImageSettings()
        self.sent = self.bytes = 0
        self._sizes: deque[int] = deque(maxlen=_LATELY)
        self._warned = FaultReports()

    def frame(self, picture: Picture) -> ImageFrame:
        """Encode an image (height, width, 3) uint8 BGR, keep it as ``newest``, and return it as a frame.

        The frame's time is the picture's minus `ImageSettings.delay_s`.
        """
        s, pixels = self.settings, colour_image(picture)
        data = encode_image(pixels, s.format, s.quality)
        self.sent, self.bytes = self.sent + 1, self.bytes + len(data)
        self._sizes.append(len(data))
        self.keep(picture)
        at_ns = picture.time_ns - round(s.delay_s * NS_PER_S)
        return image_frame(self.camera, data, time_ns=at_ns, format=s.format, size_px=picture.size_px)

    def report(self) -> dict[str, Any]:
        """Return counts, in the form of ``--json``."""
        pictures = self.acquisition.report()
        return {
            "source": self.acquisition.source.name,
            "times": self.acquisition.source.times,
            **asdict(pictures),
            "sent": self.sent,
            "bytes": self.bytes,
            "median_bytes": round(statistics.median(self._sizes)) if self._sizes else 0,
            "markers": {},
            "problems": [*([pictures.too_few] if pictures.too_few else []), *self.acquisition.state.problems],
        }

    def words(self) -> str:
        """Return the counts of the report as one line for the terminal."""
        report = self.report()
        rate = f"{report['fps']:.1f} a second; " if report["fps"] else ""
        return (
            f"{rate}{report['taken']} pictures taken, {report['dropped']} dropped, {report['sent']} sent, "
            f"{report['median_bytes'] / 1000:.0f} kB each"
        )

    def warnings(self, now_s: float) -> Iterator[str]:
        """Yield faults since the last check, and recoveries; nothing if the last check is too recent.

        ``now_s`` is the present time on a monotonic clock [s].
        """
        if self._warned.due(now_s):
            few = self.acquisition.report().too_few
            yield from self._warned.update({"rate": few} if few else {}, now_s)
