"""Several people by a detector of one: each is followed, further ones are found, and none twice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.detectors.people_slots import OneSeen, PeopleSlots, SlotSettings
from mocapella.errors import SettingsError

SIZE = 20


class BlobDetector:
    """Finds a bright square as a person of eight keypoints: the last one's place first, else the brightest."""

    made = 0

    def __init__(self) -> None:
        type(self).made += 1
        self.at: Any = None
        self.forgot = 0

    def follow(self, image: np.ndarray) -> OneSeen | None:
        found = _squares(image)
        if not found:
            self.at = None
            return None
        order = sorted(found, key=lambda one: 0 if self.at is None else float(np.abs(one - self.at).sum()))
        if self.at is not None and np.abs(order[0] - self.at).max() > SIZE:
            self.at = None
            return None
        self.at = order[0]
        corners = np.array([(x, y) for x in (0, SIZE - 1) for y in (0, 6, 13, SIZE - 1)], np.float32)
        return OneSeen(self.at + corners, np.ones(8, np.float32), np.zeros((8, 3), np.float32))

    def forget(self) -> None:
        self.at, self.forgot = None, self.forgot + 1


def _squares(image: np.ndarray) -> list[np.ndarray]:
    """Corners (x, y) of whole white squares."""
    white = (image == 255).all(axis=-1)
    rows, columns = np.nonzero(white)
    found: list[np.ndarray] = []
    while len(rows):
        y, x = rows[0], columns[0]
        if white[y : y + SIZE, x : x + SIZE].sum() == SIZE * SIZE:
            found.append(np.array([x, y], np.float32))
        white[y : y + SIZE, x : x + SIZE] = False
        rows, columns = np.nonzero(white)
    return found


def picture(*corners: tuple[int, int]) -> np.ndarray:
    image = np.zeros((200, 400, 3), np.uint8)
    for x, y in corners:
        image[y : y + SIZE, x : x + SIZE] = 255
    return image


def places(slots: PeopleSlots, image: np.ndarray, at_s: float, **more: Any) -> dict[int, tuple[int, int]]:
    seen = slots.update(image, at_s, **more)
    if seen is None:
        return {}
    return {int(i): (int(p[0, 0]), int(p[0, 1])) for i, p in zip(seen.ids, seen.positions_px, strict=True)}


CELLS = st.lists(st.tuples(st.integers(0, 5), st.integers(0, 2)), max_size=5, unique=True)


@settings(max_examples=30)
@given(CELLS)
def test_everybody_is_found_once_and_followed(cells: list[tuple[int, int]]) -> None:
    slots = PeopleSlots(BlobDetector, SlotSettings(most_people=6, search_every_s=1.0))
    corners = [(20 + 60 * x, 10 + 60 * y) for x, y in cells]
    found: dict[int, tuple[int, int]] = {}
    for k in range(len(corners) + 1):
        found = places(slots, picture(*corners), k / 30)
    assert sorted(found.values()) == sorted(corners)
    moved = {i: (x + 5, y + 3) for i, (x, y) in found.items()}
    assert places(slots, picture(*moved.values()), 1.0) == moved


def test_no_more_instances_are_made_than_people_are_wanted() -> None:
    BlobDetector.made = 0
    slots = PeopleSlots(BlobDetector, SlotSettings(most_people=2))
    for k in range(5):
        found = places(slots, picture((20, 20), (100, 20), (200, 20), (300, 20)), k)
    assert len(found) == 2
    assert BlobDetector.made == 2


def test_who_is_lost_is_found_again_with_a_new_id() -> None:
    slots = PeopleSlots(BlobDetector, SlotSettings())
    assert places(slots, picture((20, 20)), 0.0) == {0: (20, 20)}
    assert places(slots, picture(), 0.1) == {}
    assert places(slots, picture((300, 100)), 0.2) == {1: (300, 100)}
    slots.reset()
    assert places(slots, picture((50, 50)), 0.3) == {0: (50, 50)}


def test_further_people_are_searched_at_intervals_only() -> None:
    slots = PeopleSlots(BlobDetector, SlotSettings(search_every_s=1.0))
    assert len(places(slots, picture((20, 20)), 0.0)) == 1
    assert len(places(slots, picture((20, 20)), 0.1)) == 1  # finds nobody else
    both = picture((20, 20), (200, 20))
    assert len(places(slots, both, 0.5)) == 1
    assert len(places(slots, both, 1.2)) == 2


def test_two_instances_never_follow_one_person() -> None:
    slots = PeopleSlots(BlobDetector, SlotSettings())
    for k in range(3):
        found = places(slots, picture((20, 20), (45, 20)), k)
    assert len(found) == 2
    assert len(places(slots, picture((30, 20)), 4.0)) == 1  # both are near it


def test_a_region_is_searched_before_the_rest() -> None:
    region = np.array([[280, 80, 340, 140]], np.float32)
    slots = PeopleSlots(BlobDetector, SlotSettings(most_people=1))
    assert places(slots, picture((20, 20), (300, 100)), 0.0, regions_px=region) == {0: (300, 100)}


@pytest.mark.parametrize(
    "wrong", [{"most_people": 0}, {"most_people": 21}, {"least_confidence": 1.1}, {"search_every_s": -1}]
)
def test_wrong_settings_of_slots_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        SlotSettings(**wrong)


def test_an_unsure_person_is_nobody() -> None:
    class Unsure(BlobDetector):
        def follow(self, image: np.ndarray) -> OneSeen | None:
            seen = super().follow(image)
            return None if seen is None else seen._replace(confidences=np.full(8, 0.4, np.float32))

    slots = PeopleSlots(Unsure, SlotSettings(least_confidence=0.5))
    assert places(slots, picture((20, 20)), 0.0) == {}
    assert places(PeopleSlots(Unsure, SlotSettings(least_confidence=0.3)), picture((20, 20)), 0.0) == {0: (20, 20)}


def test_a_person_who_was_lost_is_searched_at_once_where_expected() -> None:
    slots = PeopleSlots(BlobDetector, SlotSettings(most_people=3, search_every_s=5.0))
    places(slots, picture((20, 20), (220, 20)), -0.1)
    assert len(places(slots, picture((20, 20), (220, 20)), 0.0)) == 2
    assert len(places(slots, picture((20, 20)), 0.1)) == 1  # the other one is hidden
    box = np.array([[280, 60, 340, 120]], np.float32)
    assert len(places(slots, picture((20, 20), (300, 80)), 0.2)) == 1  # nobody says where
    assert len(places(slots, picture((20, 20), (300, 80)), 0.3, regions_px=box)) == 2


def test_where_nobody_is_found_is_not_searched_in_each_image() -> None:
    BlobDetector.made = 0
    slots = PeopleSlots(BlobDetector, SlotSettings(most_people=2, search_every_s=1.0))
    calls: list[int] = []
    search = slots._search
    slots._search = lambda image: (calls.append(1), search(image))[1]  # type: ignore[method-assign,func-returns-value]
    box = np.array([[280, 60, 340, 120]], np.float32)
    places(slots, picture((20, 20)), 0.0, regions_px=box)
    first = len(calls)
    for k in range(1, 10):
        places(slots, picture((20, 20)), 0.1 * k, regions_px=box)
    assert len(calls) - first <= 2
    full = PeopleSlots(BlobDetector, SlotSettings(most_people=1))
    places(full, picture((20, 20)), 0.0)
    full._search = lambda image: pytest.fail("there is no free instance")  # type: ignore[method-assign]
    places(full, picture((20, 20)), 1.0, regions_px=box)
