"""Match skeletons by repeatedly joining the closest pair of different sensors (KinectMultiTrack thesis, 2015).

The thesis matches at calibration, while all people stand still, and keeps the matches by tracking id until the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.bodies import BodyKey
from mocapella.model.observations import JointState
from mocapella.model.scene import PotentialSkeleton

Float64 = NDArray[np.float64]


class PersonViews(msgspec.Struct, frozen=True, eq=False):
    """One person of `HeldPairs.update`: the person's number, and the views in the order of their sensors' names."""

    person: int
    views: tuple[PotentialSkeleton, ...]


def skeleton_distances(positions: Float64, states: NDArray[np.uint8]) -> Float64:
    """Return the mean distance between every two skeletons, over the joints that both track (not infer).

    Args:
        positions: (n, joints, 3), all in one frame [m].
        states: (n, joints) `JointState`.

    Returns:
        (n, n) [m]; infinite without a common joint.
    """
    tracked = states == JointState.TRACKED
    common = tracked[:, None] & tracked[None, :]
    step = np.where(common[..., None], positions[:, None] - positions[None, :], 0.0)
    counts = common.sum(axis=-1)
    total = np.sqrt((step * step).sum(axis=-1)).sum(axis=-1)
    return np.where(counts > 0, total / np.maximum(counts, 1), np.inf)


def closest_pairs(
    skeletons: Sequence[PotentialSkeleton], max_distance_m: float = np.inf
) -> tuple[tuple[PotentialSkeleton, ...], ...]:
    """Group skeletons by person.

    The closest two of different sensors are joined first, with the groups they are in, as long as no group gets two
    skeletons of one sensor; this repeats until nothing can be joined. Skeletons without a common tracked joint are not
    joined directly. The remaining skeletons are people seen by one sensor. The order of ``skeletons`` does not matter.

    Args:
        skeletons: all sensors' skeletons, in the world.
        max_distance_m: pairs farther apart, by `skeleton_distances`, are not joined; the thesis has no such limit [m].

    Returns:
        Groups, each in the order of its sensors' names, ordered by their first (sensor, tracking id); empty without
        skeletons.
    """
    ordered = sorted(skeletons, key=_key)
    if not ordered:
        return ()
    distance = skeleton_distances(np.stack([s.positions for s in ordered]), np.stack([s.states for s in ordered]))
    first, second = np.triu_indices(len(ordered), k=1)
    group = [[i] for i in range(len(ordered))]
    for pair in np.argsort(distance[first, second], kind="stable"):
        i, j = int(first[pair]), int(second[pair])
        if not (np.isfinite(distance[i, j]) and distance[i, j] <= max_distance_m):
            break
        sensors = [ordered[k].sensor for k in (*group[i], *group[j])]
        if len(set(sensors)) == len(sensors):
            joined = sorted(group[i] + group[j])
            for k in joined:
                group[k] = joined
    return tuple(tuple(ordered[k] for k in members) for i, members in enumerate(group) if members[0] == i)


class HeldPairs:
    """Groups skeletons once per calibration, and keeps the groups by (sensor, tracking id) until the next.

    Persons are numbered 0, 1, 2, … and numbers are not reused. A person with a known tracking id keeps the number
    through a recalibration.

    Args:
        max_distance_m: pairs of skeletons further apart are not joined; infinite for no limit [m].
    """

    def __init__(self, max_distance_m: float = np.inf) -> None:
        self.max_distance_m = max_distance_m
        self.reset()

    def reset(self) -> None:
        """Forget all people; the numbers restart at 0."""
        self._calibration = 0
        self._next = 0
        self._person: dict[BodyKey, int] = {}

    def update(self, skeletons: Sequence[PotentialSkeleton], calibration: int) -> tuple[PersonViews, ...]:
        """Return the people with a visible (tracked or inferred) joint, in the order of their numbers.

        Args:
            skeletons: all skeletons of calibrated sensors, in the world.
            calibration: number of the calibration that they use, from 1; with a new one, all skeletons are grouped
                again, and the ids of missing ones are forgotten.

        Raises:
            KeyError: a skeleton's (sensor, tracking id) was not grouped by this calibration; `rename` changes ids.
        """
        if calibration != self._calibration:
            self._calibration = calibration
            self._pair(skeletons)
        views: dict[int, list[PotentialSkeleton]] = {}
        for skeleton in sorted(skeletons, key=_key):
            views.setdefault(self._person[_key(skeleton)], []).append(skeleton)
        return tuple(
            PersonViews(person, tuple(of_person))
            for person, of_person in sorted(views.items())
            if any(view.states.any() for view in of_person)
        )

    def rename(self, sensor: str, new_ids: Mapping[int, int]) -> None:
        """Replace tracking ids of a sensor, so that a body with a new id keeps its person.

        ``new_ids`` maps each old id to the new id of the same body; unknown old ids are ignored.
        """
        people = {new: self._person.pop((sensor, old)) for old, new in new_ids.items() if (sensor, old) in self._person}
        self._person.update({(sensor, new): person for new, person in people.items()})

    def _pair(self, skeletons: Sequence[PotentialSkeleton]) -> None:
        before, self._person = self._person, {}
        taken: set[int] = set()
        for group in closest_pairs(skeletons, self.max_distance_m):
            keys = [_key(skeleton) for skeleton in group]
            known = {before[key] for key in keys if key in before} - taken
            person = min(known, default=self._next)
            self._next = max(self._next, person + 1)
            taken.add(person)
            self._person.update(dict.fromkeys(keys, person))


def _key(skeleton: PotentialSkeleton) -> BodyKey:
    return skeleton.sensor, skeleton.tracking_id
