"""The detector of a camera's node: which colours it has, what it saw last, and what is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.live.camera_node import Warned
from mocapella.model.markers import MarkerFrame, joined, marker_frame
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sensing.markers import MarkerDetector, MarkerReport, MarkerSettings
from mocapella.sensing.tags import TagDetector
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture

OFTEN: Final = 0.5
"""A colour of which several things are seen in more than this part of the pictures is said to be there twice."""


def colour_image(picture: Picture) -> NDArray[np.uint8]:
    """Return a colour camera's image, (height, width, 3) blue, green, red; depth cameras have other work."""
    return np.asarray(picture.image, np.uint8)


class DetectedPicture:
    """An image of a camera, the markers in it, and the detector that found them; None if no colours are learnt.

    Attributes:
        image: (height, width, 3) blue, green, red.
    """

    __slots__ = ("detector", "frame", "image", "picture")

    def __init__(self, picture: Picture, frame: MarkerFrame, detector: MarkerDetector | None) -> None:
        self.picture, self.frame, self.detector = picture, frame, detector
        self.image = colour_image(picture)


class MarkerWork:
    """Finds markers in pictures; its colours may be changed at any time, from any thread.

    Args:
        camera: the camera's name.
        acquisition: where the pictures come from; read for its reports only.
        profile: the colours; None where they are to be learnt yet, and no marker is looked for.
        settings: of the detector.
        tags: what finds tags beside the colours; None does without.

    Attributes:
        late: pictures that took longer to look at than there is time between two.
        too_late: of these, how many took so long that their markers were not sent.
        newest: what was looked at last; None before the first.
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
        self._warned = Warned()
        self._before: MarkerReport | None = None
        if profile is not None:
            self.use(profile)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the markers that are looked for."""
        return () if self.detector is None else self.detector.profile.names

    def use(self, profile: ColourProfile) -> None:
        """Look for these colours from the next picture on."""
        detector = MarkerDetector(profile, self._settings)
        width, height = profile.size_px
        detector.update(np.zeros((height, width, 3), np.uint8), 0.0)  # compiles before the clock matters
        detector.reset()
        self.detector = detector  # at once, so that the detecting thread has the one or the other

    def look(self, picture: Picture) -> MarkerFrame:
        """The markers in a picture.

        Raises:
            SettingsError: it has another size than the colours were learnt at.
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
        """Count a look that took so long, and say whether its markers are still worth sending."""
        fps = self.acquisition.state.fps
        self.late += bool(fps and took_s > 1 / fps)
        self.too_late += age_s > drop_after_s
        return age_s <= drop_after_s

    def report(self) -> dict[str, Any]:
        """Counts, since the beginning and of markers since the colours were learnt; and what is wrong."""
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
        """The report in a line."""
        report = self.report()
        looked = max(report["looked_at"], 1)
        found = ", ".join(f"{name} {100 * row['found'] / looked:.1f} %" for name, row in report["markers"].items())
        twice = {name: row["ambiguous"] for name, row in report["markers"].items() if row["ambiguous"]}
        rate = f"{report['fps']:.1f} a second; " if report["fps"] else ""
        said = ", ".join(f"{name} {count}" for name, count in twice.items())
        return (
            f"{rate}{report['taken']} pictures taken, {report['dropped']} dropped, "
            f"{report['late']} late, {report['too_late']} not sent; found: {found or 'no colours are learnt yet'}"
            + (f"; ambiguous: {said}" if said else "")
        )

    def warnings(self, now_s: float) -> Iterator[str]:
        """What has become wrong since the last look, now and then; and what is right again."""
        if not self._warned.due(now_s):
            return
        seen = None if self.detector is None else self.detector.report
        problems = dict(self._problems(seen, self._before))
        self._before = seen
        yield from self._warned.update(problems, now_s)

    def _problems(self, seen: MarkerReport | None, before: MarkerReport | None) -> Iterator[tuple[str, str]]:
        """By kind: what is wrong since ``before``, or since the beginning."""
        pictures = self.acquisition.report()
        if pictures.too_few:
            yield "rate", pictures.too_few
        if seen is None:
            yield (
                "colours",
                "no colours are learnt yet; point at them in the view, or mocapella calibrate colours learn",
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
                    f"{name} is seen twice in {100 * count / images:.0f} % of the pictures; hide the other thing of "
                    "that colour, or give the markers different colours",
                )
