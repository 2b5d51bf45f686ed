"""Identify people in all cameras: join the matches of pairs of cameras to people, passage by passage.

A person keeps its number from one passage to the next while most of its cameras' tracks go on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec

from mocapella.calibration.keypoint_pairs import CameraPair

Node = tuple[int, int]
"""A camera's number and the number of a track in it."""
FEWEST_CAMERAS: Final = 2


class PersonPassage(msgspec.Struct, frozen=True):
    """One person in one passage.

    Attributes:
        passage: number of the passage.
        person: number of the person.
        tracks: track of the person in each camera that sees it, by the camera's number.
    """

    passage: int
    person: int
    tracks: dict[int, int]


def join_people(pairs: Mapping[tuple[int, int], CameraPair]) -> list[PersonPassage]:
    """Return the people of each passage, sorted by passage and person.

    Pairs of cameras with a higher score decide first. A match that would give a person two tracks in one camera is not
    used.

    Args:
        pairs: the matches of pairs of cameras, by their numbers.
    """
    groups: dict[int, list[dict[int, int]]] = {}
    for (a, b), pair in sorted(pairs.items(), key=lambda item: (-item[1].score, item[0])):
        for passage, matches in pair.matches.items():
            for i, j in matches:
                _join(groups.setdefault(passage, []), (a, i), (b, j))
    return _numbered(groups)


def _join(groups: list[dict[int, int]], one: Node, other: Node) -> None:
    first = next((group for group in groups if group.get(one[0]) == one[1]), None)
    second = next((group for group in groups if group.get(other[0]) == other[1]), None)
    first, second = first or dict([one]), second or dict([other])
    if first is second or first.keys() & second.keys():
        return
    groups[:] = [group for group in groups if group is not first and group is not second]
    groups.append(first | second)


def _numbered(groups: Mapping[int, list[dict[int, int]]]) -> list[PersonPassage]:
    sightings, count = list[PersonPassage](), 0
    last: list[PersonPassage] = []
    for passage in sorted(groups):
        here: list[PersonPassage] = []
        left = sorted(
            (group for group in groups[passage] if len(group) >= FEWEST_CAMERAS),
            key=lambda group: sorted(group.items()),
        )
        votes = [
            (-len(before.tracks.items() & group.items()), n, k)
            for n, before in enumerate(last)
            for k, group in enumerate(left)
        ]
        person: dict[int, int] = {}
        for common, n, k in sorted(votes):
            taken = last[n].person in person.values() or k in person
            if not taken and -2 * common >= min(len(last[n].tracks), len(left[k])):
                person[k] = last[n].person
        for k, group in enumerate(left):
            if k not in person:
                person[k], count = count, count + 1
            here.append(PersonPassage(passage, person[k], dict(sorted(group.items()))))
        sightings += sorted(here, key=lambda sighting: sighting.person)
        last = here
    return sightings
