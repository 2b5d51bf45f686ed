"""Detect people in films of calibrated cameras, and track them: frames and scenes as of a live session."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.detectors.keypoint_detector import PeopleDetector, frame_of
from mocapella.model.camera import PlacedCamera
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.model.topology import topology
from mocapella.sources.frame_set import FrameSet
from mocapella.tracker.expected_regions import expected_regions
from mocapella.tracker.protocol import Tracker

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

_HALPE: Final = topology("halpe_26")
_NECK: Final = _HALPE.index("Neck")
_ANKLES: Final = _HALPE.index("LAnkle"), _HALPE.index("RAnkle")
FILM_NODE: Final = 1
"""Id of the node of a film's frames."""
Record = Callable[[KeypointFrame, Arrival, Scene], None]


class FilmCounts(msgspec.Struct, frozen=True):
    """Counts of a run.

    Attributes:
        instants: number of instants, with an image of each camera.
        images: number of images by camera.
        with_people: number of images by camera with a detected person.
        tracked: number of instants with a tracked person or hand.
        most_people: largest number of people tracked at once.
        ids: number of different people.
    """

    instants: int
    images: Mapping[str, int]
    with_people: Mapping[str, int]
    tracked: int
    most_people: int
    ids: int


class FilmPeople:
    """Detects and tracks people in synchronised films.

    The tracker's people are projected into each image before it is searched, so that a detector of one person finds
    again after an occlusion.

    Args:
        cameras: calibrated cameras by name; no person is expected in images of other cameras.
        detectors: a detector for each camera, by name.
        tracker: a tracker of keypoints that has seen no frame yet.
        record: receives each frame with its arrival and scene.

    Attributes:
        frames: the keypoint frames of the last instant.
        upright: (3,) sum of the vectors from the ankles to the neck of all people so far, world [m].
    """

    def __init__(
        self,
        cameras: Mapping[str, PlacedCamera],
        detectors: Mapping[str, PeopleDetector],
        tracker: Tracker,
        record: Record = lambda frame, arrival, scene: None,
    ) -> None:
        self._cameras, self._detectors, self._tracker, self._record = cameras, detectors, tracker, record
        self._scene: Scene | None = None
        self._instants = self._tracked = self._most = 0
        self._ids: set[int] = set()
        self._images: dict[str, int] = dict.fromkeys(detectors, 0)
        self._seen: dict[str, int] = dict.fromkeys(detectors, 0)
        self.frames: list[KeypointFrame] = []
        self.upright: Float64 = np.zeros(3)

    def steps(self, films: Iterable[FrameSet]) -> Iterator[Scene]:
        """Yield the scene after each instant of the films; an instant is tracked when the iterator is advanced."""
        for shown in films:
            yield self.step(shown)

    def step(self, shown: FrameSet) -> Scene:
        """Detect people in the images of an instant, track them, and return the scene after the last camera.

        Args:
            shown: an image of at least one camera.
        """
        at_ns = shown.time_ns + 1  # a time of 0 is unknown
        scene = self._scene
        self.frames = []
        for name, image in shown.images.items():
            placed = self._cameras.get(name)
            regions = None
            if placed is not None and self._scene is not None:
                regions = expected_regions(self._scene.people, placed)
            frame = _detected(self._detectors[name], name, image, at_ns, self._images[name], regions=regions)
            self.frames.append(frame)
            self._images[name] += 1
            self._seen[name] += bool(frame.bodies)
            arrival = Arrival(frame, at_ns)
            scene = self._tracker.update(arrival)
            self._record(frame, arrival, scene)
        assert scene is not None  # there is an image
        self._scene = scene
        self._instants += 1
        self._tracked += bool(scene.people or scene.hands)
        self._most = max(self._most, len(scene.people))
        self._ids |= {person.id for person in scene.people}
        for person in scene.people:
            height = person.positions[_NECK] - person.positions[list(_ANKLES)].mean(axis=0)
            self.upright += np.nan_to_num(height)
        return scene

    @property
    def rejected(self) -> Mapping[str, int]:
        """Numbers of frames that the tracker did not use, by reason."""
        return self._tracker.report.rejected

    @property
    def counts(self) -> FilmCounts:
        """Counts so far."""
        return FilmCounts(
            self._instants, dict(self._images), dict(self._seen), self._tracked, self._most, len(self._ids)
        )


def detect_in_films(
    films: Iterable[FrameSet], detectors: Mapping[str, PeopleDetector], shown: Callable[[], bool] = lambda: True
) -> dict[str, list[KeypointFrame]]:
    """Return the keypoint frames of films, by camera.

    Args:
        films: an image of each camera for each instant.
        detectors: a detector for each camera, by name.
        shown: called after each instant; False ends the detection.
    """
    found: dict[str, list[KeypointFrame]] = {name: [] for name in detectors}
    for one in films:
        at_ns = one.time_ns + 1  # a time of 0 is unknown
        for name, image in one.images.items():
            found[name].append(_detected(detectors[name], name, image, at_ns, len(found[name])))
        if not shown():
            break
    return found


def _detected(
    finds: PeopleDetector, camera: str, image: UInt8, at_ns: int, sequence: int, *, regions: Float32 | None = None
) -> KeypointFrame:
    """Return the keypoint frame of a film's image, with its number ``sequence``."""
    seen = finds.update(image, at_ns / NS_PER_S, regions)
    made = frame_of(seen, finds.topology, camera, at_ns, (image.shape[1], image.shape[0]))
    return msgspec.structs.replace(made, node_id=FILM_NODE, sequence=sequence)
