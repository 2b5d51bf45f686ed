"""Assign each arm that depth cameras track to the person whose elbow, wrist and hand of that side are nearest.

Body sensors swap left and right at times, so the other side is accepted if it is much nearer. An arm stays with its
person while it is near, unless it is nearer to another one by a margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.association.tracks import assign
from mocapella.settings import check

Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class ArmOwnerSettings:
    """Parameters of the assignment.

    Attributes:
        take_m: largest mean distance of elbow, wrist and hand for an arm to be assigned to a person; larger: arms are
            assigned in spite of larger errors, also to wrong people [m].
        keep_m: largest mean distance, as ``take_m``, for an arm to stay with its present person [m].
        other_side_m: penalty, added to the distance, of assigning the arm to a limb of the other side; larger: the
            sides are trusted more [m].
        switch_m: penalty, added to the distance, of changing the arm's present limb; larger: arms change their limbs
            more rarely [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    take_m: float = 0.2
    keep_m: float = 0.35
    other_side_m: float = 0.1
    switch_m: float = 0.1

    def __post_init__(self) -> None:
        check(
            0 < self.take_m <= self.keep_m <= 5, "take_m", self.take_m, "above 0 and at most keep_m, which is up to 5"
        )
        for name in ("other_side_m", "switch_m"):
            check(0 <= getattr(self, name) <= 5, name, getattr(self, name), "from 0 to 5 m")


class ArmOwners:
    """Assigns tracked arms of depth cameras to tracked people, over time.

    The same input in the same order gives the same result.

    Args:
        settings: gates and penalties; the defaults if None.

    Attributes:
        limbs: present limb of each arm, by the arm's id: the person's id, and whether it is the person's left limb.
    """

    def __init__(self, settings: ArmOwnerSettings | None = None) -> None:
        self.settings = settings or ArmOwnerSettings()
        self.reset()

    def reset(self) -> None:
        """Forget all assignments."""
        self.limbs: dict[int, tuple[int, bool]] = {}

    def update(
        self, arms: Sequence[int], lefts: Bools, joints: Float64, people: Sequence[int], limbs: Float64
    ) -> list[int]:
        """Assign the arms of one instant to people, each limb to at most one arm.

        An arm that is near no free limb gets −1; if its last person is missing from ``people``, it is remembered as
        that person's, otherwise forgotten. An arm that is missing from ``arms`` is forgotten.

        Args:
            arms: ids of the n arms; may be empty.
            lefts: (n,) whether they are left arms.
            joints: (n, 3, 3) elbow, wrist and palm of each, world [m]; NaN where not known. Distances are means over
                the joints that arm and limb both have; without one, the pair is not assigned.
            people: ids of the m people; may be empty.
            limbs: (m, 2, 3, 3) elbow, wrist and hand of each person's left and right limb, world [m]; NaN if unknown.

        Returns:
            (n,) id of each arm's person, −1 for none.
        """
        s = self.settings
        if not arms:
            self.limbs = {}
            return []
        apart = np.linalg.norm(joints[:, None, None] - limbs[None], axis=-1)  # (n, m, 2, 3)
        known = np.isfinite(apart)
        count = known.sum(axis=-1)
        mean = np.where(known, apart, 0.0).sum(axis=-1) / np.maximum(count, 1)
        owner = np.zeros(mean.shape, dtype=np.bool_)
        own_limb = np.zeros(mean.shape, dtype=np.bool_)
        for i, arm in enumerate(arms):
            person, left = self.limbs.get(arm, (-1, False))
            if person in people:
                k = list(people).index(person)
                owner[i, k], own_limb[i, k, 0 if left else 1] = True, True
        other_side = np.stack([~lefts, lefts], axis=-1)[:, None, :]  # limbs are left, right
        cost = mean + np.where(other_side, s.other_side_m, 0.0) + np.where(own_limb, 0.0, s.switch_m)
        allowed = (count > 0) & (mean <= np.where(owner, s.keep_m, s.take_m))
        chosen = assign(cost.reshape(len(arms), -1), allowed.reshape(len(arms), -1))
        found: dict[int, tuple[int, bool]] = {}
        for arm, column in zip(arms, chosen.tolist(), strict=True):
            if column >= 0:
                found[arm] = people[column // 2], column % 2 == 0
            elif arm in self.limbs and self.limbs[arm][0] not in people:
                found[arm] = self.limbs[arm]  # the person is not visible now
        self.limbs = found
        return [found[arm][0] if column >= 0 else -1 for arm, column in zip(arms, chosen.tolist(), strict=True)]
