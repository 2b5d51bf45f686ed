"""Scores people in space against the ground truth of simulated crowds.

True and found people are matched in each scored instant by the mean distance of their keypoints. A person is *expected*
from one second on while two cameras or more see at least `LEAST_SEEN` of the keypoints; others may be found or not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocapella.evaluation.body_parts import joints_of_halpe, pcp
from mocapella.evaluation.identity import IdentityFrame, hota, identity_switches, similarity
from mocapella.model.observations import JointState
from mocapella.model.scene import Person

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

LEAST_SEEN: Final = 8
"""Least number of visible keypoints for which a camera counts as seeing a person."""
SAME_M: Final = 0.5
"""Largest mean distance of a true and a found person that are matched [m]."""
WRONG_M: Final = 0.05
"""A measured joint farther off than this is falsely measured [m]."""
AFTER_NS: Final = 1_000_000_000
"""Time after which people are expected and false people are counted [ns]."""
_FAR_M: Final = 9.0
"""Mean distance that people without a common keypoint get [m]."""


def match_people(apart: Float64) -> dict[int, int]:
    """Match true and found people one to one, so that most are matched and their distances have the least sum.

    Args:
        apart: (true, found, joints) distances [m]; NaN where a joint is not known.

    Returns:
        The found person of each matched true one, at a mean distance of at most `SAME_M`.
    """
    known = np.isfinite(apart)
    mean = np.where(
        known.any(axis=-1), np.where(known, apart, 0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1), _FAR_M
    )
    rows, columns = linear_sum_assignment(np.where(mean <= SAME_M, mean - 100.0, 0.0)) if mean.size else ((), ())
    return {int(i): int(j) for i, j in zip(rows, columns, strict=True) if mean[i, j] <= SAME_M}


def expected_people(cameras: NDArray[Any], room_ns: int) -> NDArray[np.bool_]:
    """Return whether each person (people,) is expected.

    Args:
        cameras: (cameras, people, 26) whether each keypoint is visible.
        room_ns: time since the beginning [ns].
    """
    seen = (cameras.sum(axis=-1) >= LEAST_SEEN).sum(axis=0) >= 2
    return np.asarray(seen & (room_ns >= AFTER_NS))


class PeopleFigures(msgspec.Struct, frozen=True):
    """Figures of one run; NaN where there is nothing to score.

    Attributes:
        instants: number of scored instants.
        hota: HOTA, 0 to 1.
        switches: number of identity switches.
        found_percent: share of the expected people who are found [%].
        phantoms_percent: instants × false people, relative to the instants × expected people [%].
        visible_mm: mean distance of the joints that two or more cameras see [mm].
        all_mm: mean distance of all joints that the method gives [mm].
        p95_mm: 95th percentile of the distance of joints that two or more cameras see [mm].
        false_percent: measured joints that are more than `WRONG_M` off, of all measured joints [%].
        measured_percent: joints given as measured, of all joints of found people [%].
        normalised: root mean square of the error over its stated standard deviation, measured joints; 1 is consistent.
        normalised_median: median of that ratio's length over its expected median; 1 is consistent, without outliers.
        pcp_percent: percentage of correct parts of expected people [%].
    """

    instants: int
    hota: float
    switches: int
    found_percent: float
    phantoms_percent: float
    visible_mm: float
    all_mm: float
    p95_mm: float
    false_percent: float
    measured_percent: float
    normalised: float
    normalised_median: float
    pcp_percent: float


_MEDIAN_CHI3: Final = 1.5382
"""Median length of a Gaussian vector of three coordinates with variance 1."""


class PeopleScore:
    """Collects instants, and computes `PeopleFigures`."""

    def __init__(self) -> None:
        self._frames: list[IdentityFrame] = []
        self._visible: list[Float64] = []
        self._all: list[Float64] = []
        self._measured: list[Float64] = []
        self._ratio: list[Float64] = []
        self._joints = self._expected = self._found = self._phantoms = 0
        self._true: list[Float64] = []
        self._people: list[Float64] = []

    def update(self, room_ns: int, numbers: Int64, true: Float64, cameras: Int64, people: Sequence[Person]) -> None:
        """Add an instant.

        Args:
            room_ns: time since the beginning [ns].
            numbers: (people,) numbers of the true people.
            true: (people, 26, 3) keypoints, world [m].
            cameras: (cameras, people) numbers of visible keypoints; or (cameras, people, 26) whether each is visible.
            people: the found people, in the true world's frame.
        """
        seen = cameras.sum(axis=0)
        expected = expected_people(cameras, room_ns)
        found = np.array([person.positions for person in people]).reshape(len(people), true.shape[1], 3)
        apart = np.linalg.norm(true[:, None] - found[None], axis=-1)
        pairs = match_people(apart)
        self._expected += int(expected.sum())
        self._found += sum(bool(expected[i]) for i in pairs)
        if room_ns >= AFTER_NS:
            self._phantoms += len(people) - len(pairs)
        for i, j in pairs.items():
            self._add_pair(apart[i, j], seen[i], people[j])
        kept_true = [i for i in range(len(true)) if expected[i] or i in pairs]
        shape = len(kept_true), len(people)
        near = similarity(true[kept_true], found) if all(shape) else np.zeros(shape)
        ids = tuple(person.id for person in people)
        self._frames.append(IdentityFrame(tuple(int(numbers[i]) for i in kept_true), ids, near))
        self._true.append(joints_of_halpe(np.where(expected[:, None, None], true, np.nan)))
        self._people.append(joints_of_halpe(found))

    def _add_pair(self, apart: Float64, seen: Int64, person: Person) -> None:
        known = np.isfinite(apart)
        self._visible.append(apart[known & (seen >= 2)])
        self._all.append(apart[known])
        measured = known & (person.states == JointState.TRACKED)
        self._measured.append(apart[measured])
        self._joints += len(apart)
        if person.sd is not None:
            self._ratio.append(apart[measured] / np.maximum(person.sd[measured].astype(np.float64), 1e-9))

    def figures(self) -> PeopleFigures:
        """Return the figures of all instants so far."""
        visible, every, measured, ratio = (
            _joined(of) for of in (self._visible, self._all, self._measured, self._ratio)
        )
        true = np.stack(self._true, axis=1) if self._true else np.zeros((0, 0, 14, 3))
        p95 = float(np.percentile(visible, 95)) if len(visible) else np.nan
        return PeopleFigures(
            len(self._frames), hota(self._frames).hota, identity_switches(self._frames),
            100 * _over(self._found, self._expected), 100 * _over(self._phantoms, self._expected),
            1e3 * _mean(visible), 1e3 * _mean(every), 1e3 * p95,
            100 * _mean((measured > WRONG_M).astype(np.float64)), 100 * _over(len(measured), self._joints),
            float(np.sqrt(_mean(ratio**2) / 3)),
            float(np.median(ratio) / _MEDIAN_CHI3) if len(ratio) else np.nan, 100 * pcp(true, self._people).mean,
        )  # fmt: skip


def _joined(parts: list[Float64]) -> Float64:
    return np.concatenate(parts) if parts else np.zeros(0)


def _mean(values: Float64) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _over(a: int, b: int) -> float:
    return a / b if b else float("nan")
