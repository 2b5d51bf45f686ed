"""Marker detection in a camera's node: its colours, its newest result, counts, and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.live.camera_node import FaultReports
from mocapella.model.markers import MarkerFrame, joined, marker_frame
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sensing.markers import MarkerDetector, MarkerReport, MarkerSettings
from mocapella.sensing.tags import TagDetector
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture

OFTEN: Final = 0.5
"""Fraction of the images above which an ambiguous colour is reported."""


def colour_image(picture: Picture) -> NDArray[np.uint8]:
    """Return a colour camera's image, (height, width, 3) uint8 blue, green, red, without a copy if it is uint8."""
    return np.asarray(picture.image, np.uint8)


class DetectedPicture:
    """An image of a camera, the markers in it, and the detector that found them.

    Attributes:
        picture: the image with its times, as taken.
        frame: the detected markers.
        detector: the detector that was used; None if no colours are learnt.
        image: (height, width, 3) uint8 blue, green, red; the picture's array, not a copy.
    """

    __slots__ = ("detector", "frame", "image", "picture")

    def __init__(self, picture: Picture, frame: MarkerFrame, detector: MarkerDetector | None) -> None:
        self.picture, self.frame, self.detector = picture, frame, detector
        self.image = colour_image(picture)


class MarkerWork:
    """Detects markers in images; its colours can be replaced at any time, from any thread.

    Args:
        camera: the camera's name.
        acquisition: source of the images; used for its reports only.
        profile: the markers' colours; None until they are learnt.
        settings: settings of the detector; the defaults if None.
        tags: detector of tags, besides the colours; None detects no tags.

    Attributes:
        late: number of images whose processing took longer than the frame period.
        too_late: number of images whose markers were too old to send.
        newest: the last processed image; None before the first.
    """

    def __init__(
        self,
        camera: str,
        acquisition: Acquisition,
        profile: ColourProfile | None,
        settings: MarkerSettings | None = None,
        *,
        tags: TagDetector | None = None,
    ) -> None:
        self.camera, self.acquisition, self._settings, self._tags = camera, acquisition, settings, tags
        self.detector: MarkerDetector | None = None
        self.late = self.too_late = 0
        self.newest: DetectedPicture | None = None
        self._warned = FaultReports()
        self._before: MarkerReport | None = None
        if profile is not None:
            self.use(profile)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the markers to detect."""
        return () if self.detector is None else self.detector.profile.names

    def use(self, profile: ColourProfile) -> None:
        """Detect these colours from the next image on; first the detector's kernels are compiled on this thread."""
        detector = MarkerDetector(profile, self._settings)
        width, height = profile.size_px
        detector.update(np.zeros((height, width, 3), np.uint8), 0.0)  # compiles before the first frame
        detector.reset()
        self.detector = detector  # one assignment, so that the detecting thread has the old or the new one

    def look(self, picture: Picture) -> MarkerFrame:
        """Detect the markers in an image, and keep both as ``newest``.

        Args:
            picture: image (height, width, 3) uint8 blue, green, red.

        Returns:
            The colour markers, then the tags; without learnt colours, only the tags. Node id, number and publication
                time are 0 until the frame is published.

        Raises:
            SettingsError: its size differs from that of the images that the colours were learnt in.
        """
        detector, image = self.detector, colour_image(picture)
        if detector is None:
            frame = marker_frame(
                self.camera, (), time_ns=picture.time_ns, size_px=picture.size_px, positions_px=np.zeros((0, 2))
            )
        else:
            frame = detector.update(image, picture.time_ns / NS_PER_S)
        if self._tags is not None:
            frame = joined(frame, self._tags.update(image, picture.time_ns / NS_PER_S))
        self.newest = DetectedPicture(picture, frame, detector)
        return frame

    def in_time(self, took_s: float, age_s: float, drop_after_s: float) -> bool:
        """Update the counts ``late`` and ``too_late``; return whether an image's markers are recent enough to send.

        Args:
            took_s: duration of the processing [s].
            age_s: time since the image was available [s].
            drop_after_s: largest age of an image whose markers are sent [s].
        """
        fps = self.acquisition.state.fps
        self.late += bool(fps and took_s > 1 / fps)
        self.too_late += age_s > drop_after_s
        return age_s <= drop_after_s

    def report(self) -> dict[str, Any]:
        """Return counts since the start (of markers, since the colours were learnt) and current problems."""
        seen = None if self.detector is None else self.detector.report
        markers = {} if seen is None else {
            name: {"found": int(seen.found[k]), "ambiguous": int(seen.ambiguous[k])}
            for k, name in enumerate(seen.names)
        }  # fmt: skip
        return {
            "source": self.acquisition.source.name,
            "times": self.acquisition.source.times,
            **asdict(self.acquisition.report()),
            "late": self.late,
            "too_late": self.too_late,
            "looked_at": 0 if seen is None else seen.images,
            "markers": markers,
            "tags": None if self._tags is None else msgspec.structs.asdict(self._tags.report),
            "brightness": None if seen is None else seen.brightness,
            "chroma_shift": None if seen is None else seen.chroma_shift,
            "problems": [*dict(self._problems(seen, None)).values(), *self.acquisition.state.problems],
        }

    def words(self) -> str:
        """Return the counts of the report as one line for the terminal."""
        report = self.report()
        looked = max(report["looked_at"], 1)
        found = ", ".join(f"{name} {100 * row['found'] / looked:.1f} %" for name, row in report["markers"].items())
        twice = {name: row["ambiguous"] for name, row in report["markers"].items() if row["ambiguous"]}
        rate = f"{report['fps']:.1f} a second; " if report["fps"] else ""
        ambiguous = ", ".join(f"{name} {count}" for name, count in twice.items())
        return (
            f"{rate}{report['taken']} pictures taken, {report['dropped']} dropped, "
            f"{report['late']} late, {report['too_late']} not sent; found: {found or 'no colours are learnt yet'}"
            + (f"; ambiguous: {ambiguous}" if ambiguous else "")
        )

    def warnings(self, now_s: float) -> Iterator[str]:
        """Yield faults since the last check, and recoveries; nothing if the last check is too recent.

        ``now_s`` is the present time on a monotonic clock [s].
        """
        if not self._warned.due(now_s):
            return
        seen = None if self.detector is None else self.detector.report
        problems = dict(self._problems(seen, self._before))
        self._before = seen
        yield from self._warned.update(problems, now_s)

    def _problems(self, seen: MarkerReport | None, before: MarkerReport | None) -> Iterator[tuple[str, str]]:
        """Yield faults with their kinds, since ``before`` or since the start."""
        pictures = self.acquisition.report()
        if pictures.too_few:
            yield "rate", pictures.too_few
        if seen is None:
            yield (
                "colours",
                "no colours are learnt yet; click on them in the view, or run mocapella calibrate colours learn",
            )
            return
        if seen.light:
            yield "light", seen.light
        if before is None or before.names != seen.names or before.images > seen.images:  # other colours
            images, ambiguous = seen.images, seen.ambiguous
        else:
            images, ambiguous = seen.images - before.images, seen.ambiguous - before.ambiguous
        for name, count in zip(seen.names, ambiguous, strict=True):
            if images and count > OFTEN * images:
                yield (
                    name,
                    f"{name} is seen twice in {100 * count / images:.0f} % of the images; hide the other object "
                    "of that colour, or give the markers different colours",
                )
