"""Follow several people with a detector of one person: an instance for each person, and one that searches for others.

Instances remember where their person was. The searching instance sees an image where the people who are found are
blank. An instance whose person is lost, or is the person of another instance, becomes free.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors.keypoint_detector import SeenPeople
from mocapella.sensing.person_regions import SEEN, alike, box_of, covered, only, without
from mocapella.settings import check

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]

BLANK_MARGIN = 0.1
"""Margin of the blank boxes, part of their longer side: hair and clothes are around the keypoints."""
MOST_COVERED = 0.6
"""A person whose box is covered to a larger part by one person's blank box is a remnant of that person."""


class OneSeen(NamedTuple):
    """Keypoints of one person: (keypoints, 2) positions [px], (keypoints,) confidences, (keypoints, 3) relative [m]."""

    positions_px: Float32
    confidences: Float32
    relative: Float32


class OnePersonDetector(Protocol):
    """A detector that follows one person from image to image."""

    def follow(self, image: UInt8) -> OneSeen | None:
        """Return the person where it was before, or anywhere if it has none; None if no person is seen there."""

    def forget(self) -> None:
        """Forget the person."""


@dataclass(frozen=True)
class SlotSettings:
    """Settings of `PeopleSlots`.

    Attributes:
        most_people: people at once in one image; larger: slower with each person [number]
        least_confidence: least mean confidence of the keypoints of a person that counts [0 to 1]
        search_every_s: time from a search without a further person to the next, while a person is followed; larger:
            faster, and later to find [s]

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    most_people: int = 3
    least_confidence: float = 0.5
    search_every_s: float = 0.4

    def __post_init__(self) -> None:
        check(1 <= self.most_people <= 20, "most_people", self.most_people, "from 1 to 20")
        check(0 <= self.least_confidence <= 1, "least_confidence", self.least_confidence, "from 0 to 1")
        check(0 <= self.search_every_s <= 60, "search_every_s", self.search_every_s, "from 0 to 60 s")


@dataclass
class _Slot:
    id: int
    detector: OnePersonDetector
    seen: OneSeen
    box: Float32 = field(default_factory=lambda: np.zeros(4, np.float32))


class PeopleSlots:
    """People who are followed by one instance each.

    Args:
        make: makes an instance; called at most ``most_people`` times.
        settings: number of people, and how new ones are found.
    """

    def __init__(self, make: Callable[[], OnePersonDetector], settings: SlotSettings) -> None:
        self._make, self._settings = make, settings
        self._slots: list[_Slot] = []
        self._free: list[OnePersonDetector] = []
        self._made = self._next_id = 0
        self._searched_s = self._missed_s = -np.inf

    def update(self, image: UInt8, at_s: float, regions_px: Float32 | None = None) -> SeenPeople | None:
        """Return the people in the next image, in the order of their discovery; None for a free instance.

        Args:
            image: (height, width, 3) uint8, in the channel order of the instances.
            at_s: capture time [s].
            regions_px: (people, 4) boxes where people are expected; None without [px].
        """
        kept: list[_Slot] = []
        for slot in self._slots:
            if self._followed(slot, image, kept):
                kept.append(slot)
            else:
                slot.detector.forget()
                self._free.append(slot.detector)
        if len(kept) < len(self._slots):
            self._missed_s = -np.inf  # search at once where a lost person is expected
        self._slots = kept
        self._look_for_others(image, at_s, [] if regions_px is None else list(regions_px))
        if not self._slots:
            return None
        seen = [slot.seen for slot in self._slots]
        return SeenPeople(
            np.array([slot.id for slot in self._slots], np.int64),
            np.stack([one.positions_px for one in seen]),
            np.stack([one.confidences for one in seen]),
            np.stack([one.relative for one in seen]),
        )

    def reset(self) -> None:
        """Forget all people, and begin again with the first id."""
        for slot in self._slots:
            slot.detector.forget()
            self._free.append(slot.detector)
        self._slots, self._next_id = [], 0
        self._searched_s = self._missed_s = -np.inf

    def _look_for_others(self, image: UInt8, at_s: float, regions_px: list[Float32]) -> None:
        """Search for further people: where they are expected, else where no person is found yet."""
        if not self._free and self._made >= self._settings.most_people:
            return
        missing = [region for region in regions_px if covered(region, self._boxes()) < MOST_COVERED]
        if missing and self._due(at_s, self._missed_s):
            found = [self._search(only(image, region)) for region in missing]
            if any(found):
                return
            self._missed_s = at_s
        if self._due(at_s, self._searched_s) and not self._search(without(image, self._boxes())):
            self._searched_s = at_s

    def _due(self, at_s: float, last_s: float) -> bool:
        """Whether a search is due, after the last one without a further person."""
        return not self._slots or not 0 <= at_s - last_s < self._settings.search_every_s

    def _followed(self, slot: _Slot, image: UInt8, earlier: list[_Slot]) -> bool:
        seen = slot.detector.follow(image)
        if seen is None or not self._sure(seen) or any(_same(seen, other.seen) for other in earlier):
            return False
        box = box_of(seen.positions_px, seen.confidences, BLANK_MARGIN)
        if box is None:
            return False
        slot.seen, slot.box = seen, box
        return True

    def _search(self, image: UInt8) -> bool:
        """Follow a further person in an image, and return whether there is one; then there may be more."""
        detector = self._spare()
        if detector is None:
            return False
        seen = detector.follow(image)
        box = None if seen is None else box_of(seen.positions_px, seen.confidences, BLANK_MARGIN)
        if (
            seen is None
            or box is None
            or not self._sure(seen)
            or covered(box, self._boxes()) > MOST_COVERED
            or any(_same(seen, other.seen) for other in self._slots)
        ):
            detector.forget()
            self._free.append(detector)
            return False
        self._slots.append(_Slot(self._next_id, detector, seen, box))
        self._next_id += 1
        return True

    def _spare(self) -> OnePersonDetector | None:
        if self._free:
            return self._free.pop()
        if self._made >= self._settings.most_people:
            return None
        self._made += 1
        return self._make()

    def _boxes(self) -> list[Float32]:
        return [slot.box for slot in self._slots]

    def _sure(self, seen: OneSeen) -> bool:
        there = seen.confidences >= SEEN
        return bool(there.any()) and float(seen.confidences[there].mean()) >= self._settings.least_confidence


def _same(one: OneSeen, other: OneSeen) -> bool:
    return alike(one.positions_px, other.positions_px, np.minimum(one.confidences, other.confidences))
