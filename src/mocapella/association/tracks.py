"""Who is who, frame by frame: each sensor's bodies are given to the people where they were expected.

Global nearest neighbour with gates (Blackman, Popoli: Design and Analysis of Modern Tracking Systems, 1999, section
6.4); the assignment that costs least is found by `scipy.optimize.linear_sum_assignment` (Crouse: On implementing 2D
rectangular assignment algorithms, 2016). Distances are those of the joints in the middle of the body, so that a sensor
that mixes up left and right does not make somebody else of a person.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.proportions import known_size, size_difference, unknown_size
from mocapella.geometry.rigid import apply
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class TrackSettings:
    """When a body is somebody who is known.

    Attributes:
        gate_m: a body further from where a person is expected is not that person.
        stay_bonus_m: how much further away the body may be that its sensor took for that person just before.
        speed_m_s: how much the gate widens for each second in which nobody has seen the person.
        widest_gate_m: and how far at most.
        confirm_after_s: somebody new is told of when seen for so long; a sensor's phantoms rarely last.
        forget_after_s: who was not seen for longer is gone, and will be somebody new.
        same_within_m: two of whom no sensor sees both, and who stay closer than this, are one person.
        same_after_s: for how long they must.
        by_place_s: who was not seen for longer is not known again by the place alone, if the body's lengths are
            known.
        size_after_s: while somebody who was known is missing, who is new is told of when seen for so long, and then is
            the missing one whose lengths are nearest, if near enough.
        fastest_m_s: nobody gets farther than this while missing, beyond the gate.
        same_size: mean squared difference of the lengths, in standard deviations, up to which that is; twice as much
            where the place fits. On the KinectMultiTrack logs 93 % of the people are nearer to themselves in the same
            session, and 38 % of others are, too (``told_apart_by_lengths``).
    """

    gate_m: float = 0.6
    stay_bonus_m: float = 0.2
    speed_m_s: float = 1.5
    widest_gate_m: float = 2.0
    confirm_after_s: float = 0.15
    forget_after_s: float = 60.0
    same_within_m: float = 0.3
    same_after_s: float = 0.5
    by_place_s: float = 2.0
    size_after_s: float = 1.2
    fastest_m_s: float = 3.0
    same_size: float = 2.0

    def __post_init__(self) -> None:
        check(0 < self.gate_m < 100, "gate_m", self.gate_m, "above 0 m")
        check(0 <= self.stay_bonus_m < 100, "stay_bonus_m", self.stay_bonus_m, "0 m or more")
        check(0 <= self.speed_m_s < 100, "speed_m_s", self.speed_m_s, "0 m/s or more")
        check(self.widest_gate_m >= self.gate_m, "widest_gate_m", self.widest_gate_m, f"{self.gate_m:g} m or more")
        check(0 <= self.confirm_after_s < 60, "confirm_after_s", self.confirm_after_s, "0 s or more")
        check(0 < self.forget_after_s < 1e6, "forget_after_s", self.forget_after_s, "above 0 s")
        check(0 <= self.same_within_m < 100, "same_within_m", self.same_within_m, "0 m or more")
        check(0 <= self.same_after_s < 60, "same_after_s", self.same_after_s, "0 s or more")
        check(0 <= self.by_place_s < 1e6, "by_place_s", self.by_place_s, "0 s or more")
        check(0 <= self.size_after_s < 60, "size_after_s", self.size_after_s, "0 s or more")
        check(0 <= self.fastest_m_s < 100, "fastest_m_s", self.fastest_m_s, "0 m/s or more")
        check(0 <= self.same_size < 1e6, "same_size", self.same_size, "0 or more")


class TrackArrays(NamedTuple):
    """The arrays of a `TrackMemory`, for the kernels."""

    since_s: Float64
    seen_s: Float64
    confirmed: Bools
    middle: Float64
    size: Float64
    body: Int64
    body_s: Float64


class FrameBodies(NamedTuple):
    """One frame's bodies.

    Attributes:
        at_s: capture time, on the common clock [s].
        column: column of the sensor in the memory.
        ids: (bodies,) tracking ids.
        middles: (bodies, middle joints, 3), world [m].
        lengths: (bodies, lengths) [m]; (0, 0) where not measured.
    """

    at_s: float
    column: int
    ids: Int64
    middles: Float64
    lengths: Float64


class Gates(NamedTuple):
    """`TrackSettings` of the gating, for the kernels."""

    gate_m: float
    stay_bonus_m: float
    speed_m_s: float
    widest_gate_m: float
    by_place_s: float
    forget_after_s: float


class Assignment(NamedTuple):
    """Costs of a frame's bodies, written by the kernel.

    Attributes:
        cost, allowed: (bodies, tracks) cost of an assignment, and whether it passes the gates.
        unplaced: (bodies,) whether no middle joint is visible.
        rows: (bodies,) the cheapest allowed track; −1 for none.
    """

    cost: Float64
    allowed: Bools
    unplaced: Bools
    rows: Int64


class TrackMemory(msgspec.Struct, eq=False):
    """All who are known: a row for each, in the order of their numbers; a column for each sensor.

    Attributes:
        person: (tracks,) number of the person; never given to somebody else.
        since_s, seen_s: (tracks,) first and last seen, on the common clock [s].
        confirmed: (tracks,) whether the person is told of.
        middle: (tracks, middle joints, 3) where the person was last seen, world [m].
        size: (tracks, 2, lengths) of `mocapella.association.proportions.learn_size`.
        body: (tracks, sensors) tracking id under which a sensor saw the person last …
        body_s: (tracks, sensors) … and when [s]; −inf where it does not see the person.
    """

    person: Int64
    since_s: Float64
    seen_s: Float64
    confirmed: Bools
    middle: Float64
    size: Float64
    body: Int64
    body_s: Float64

    @classmethod
    def empty(cls, tracks: int, sensors: int, joints: int) -> TrackMemory:
        """Rows of whom nothing is known."""
        return cls(
            np.zeros(tracks, dtype=np.int64),
            np.zeros(tracks),
            np.full(tracks, -np.inf),
            np.zeros(tracks, dtype=np.bool_),
            np.full((tracks, joints, 3), np.nan),
            np.tile(unknown_size(), (tracks, 1, 1)),
            np.zeros((tracks, sensors), dtype=np.int64),
            np.full((tracks, sensors), -np.inf),
        )

    def taken(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> TrackMemory:
        """These rows, as a memory of its own."""
        return TrackMemory(*(getattr(self, name)[rows] for name in self.__struct_fields__))

    def with_more(self, tracks: int = 0, sensors: int = 0) -> TrackMemory:
        """With so many rows and columns more."""
        rows, columns = self.body.shape
        new = TrackMemory.empty(rows + tracks, columns + sensors, self.middle.shape[1])
        for name in self.__struct_fields__:
            kept = (slice(rows), slice(columns)) if name.startswith("body") else slice(rows)
            getattr(new, name)[kept] = getattr(self, name)
        return new

    @property
    def arrays(self) -> TrackArrays:
        """The fields without ``person``, for the kernels."""
        return TrackArrays(self.since_s, self.seen_s, self.confirmed, self.middle, self.size, self.body, self.body_s)

    @property
    def present(self) -> Bools:
        """(tracks,) whether a sensor sees them."""
        return np.asarray(np.isfinite(self.body_s).any(axis=1))


RECENT_S: Final = 0.25
"""A sensor that has not seen a person for so long does not see them."""


def distances(bodies: Float64, people: Float64) -> Float64:
    """Mean distance of the joints that both have.

    Args:
        bodies: (n, joints, 3) [m]; NaN where not seen.
        people: (m, joints, 3), in the same frame.

    Returns:
        (n, m) [m]; infinite where two have no joint in common.
    """
    out = np.empty((len(bodies), len(people)))
    _kernels().distances(np.ascontiguousarray(bodies), np.ascontiguousarray(people), out)
    return out


def assign(cost: Float64, allowed: Bools) -> Int64:
    """(n,) the column of each row, −1 for none: as many as are allowed, and of those the ones that cost least together.

    Args:
        cost: (n, m).
        allowed: (n, m).
    """
    from scipy.optimize import linear_sum_assignment

    columns = np.full(len(cost), -1, dtype=np.int64)
    if allowed.any():
        finite = cost[allowed]
        too_much = 1.0 + min(cost.shape) * (float(finite.max()) - min(0.0, float(finite.min())) + 1.0)
        rows, chosen = linear_sum_assignment(np.where(allowed, cost, too_much))
        columns[rows] = np.where(allowed[rows, chosen], chosen, -1)
    return columns


class Tracks:
    """Everybody who is known. The same frames in the same order give the same people.

    Attributes:
        memory: everybody, also those who are lost for now and those not confirmed yet.
        merged: (kept, given up) numbers of those who turned out to be one person in the last update.
    """

    def __init__(self, settings: TrackSettings | None = None) -> None:
        self.settings = settings or TrackSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everybody; the numbers begin at 0."""
        self.memory = TrackMemory.empty(0, 0, 0)
        self.sensors: list[str] = []
        self.merged: tuple[tuple[int, int], ...] = ()
        self._next = 0
        self._close_since_s: dict[tuple[int, int], float] = {}
        self._owners: dict[str, dict[int, int]] = {}

    @property
    def people(self) -> list[int]:
        """Numbers of everybody, by row."""
        return list(self.memory.person.tolist())

    def owners(self, sensor: str) -> Mapping[int, int]:
        """The person of each body that the sensor sees; the same object for as long as nobody's change."""
        if sensor not in self._owners:
            self._owners[sensor] = {}
            if sensor in self.sensors:
                m, column = self.memory, self.sensors.index(sensor)
                seen = np.isfinite(m.body_s[:, column])
                bodies, people = m.body[seen, column].astype(np.uint64).tolist(), m.person[seen].tolist()
                self._owners[sensor] = dict(zip(bodies, people, strict=True))
        return self._owners[sensor]

    def rows(self, sensor: str, ids: Sequence[int]) -> Int64:
        """(bodies,) the row in `memory` of whoever the sensor's bodies are; −1 of nobody known."""
        if sensor not in self.sensors:
            return np.full(len(ids), -1, dtype=np.int64)
        m, numbers = self.memory, np.array(ids, dtype=np.uint64).astype(np.int64)
        return np.asarray(_kernels().rows_of(numbers, self.sensors.index(sensor), m.body, m.body_s))

    def move(self, T_new_old: Float64) -> None:
        """Everything is told in another frame from now on."""
        self.memory.middle = apply(T_new_old, self.memory.middle)

    def update(  # noqa: PLR0917 - one frame, as it comes
        self,
        sensor: str,
        ids: Sequence[int],
        middles: Float64,
        expected: Float64 | None,
        at_s: float,
        lengths: Float64 | None = None,
    ) -> Int64:
        """Give one frame's bodies to people.

        Args:
            sensor: whose frame it is.
            ids: (bodies,) its tracking ids.
            middles: (bodies, middle joints, 3), world [m].
            expected: (tracks, middle joints, 3) where everybody in `memory` is expected now [m]; who is NaN is expected
                where they were last seen, and so is everybody where None is given.
            at_s: when the frame was captured, on the common clock.
            lengths: (bodies, lengths) of `mocapella.association.proportions.sizes` [m]; without them nobody who comes
                back elsewhere is known again.

        Returns:
            (bodies,) the row of each in `memory`; −1 for a body of whose middle nothing is seen, where it is nobody
            known.
        """
        if self.memory.middle.shape[1] != middles.shape[1]:
            self.memory = TrackMemory.empty(0, len(self.sensors), middles.shape[1])
        column, numbers = self._column(sensor), np.array(ids, dtype=np.uint64).astype(np.int64)
        lengths = np.empty((0, 0)) if lengths is None else lengths
        where = np.empty((len(self.memory.person), 0, 3)) if expected is None else expected
        rows, unplaced, nobody = self._assign(column, numbers, middles, where, at_s, lengths)
        new = np.flatnonzero((rows < 0) & ~unplaced) if nobody else ()
        if len(new):
            rows[new] = len(self.memory.person) + np.arange(len(new))
            self.memory = self.memory.with_more(tracks=len(new))
            m = self.memory
            m.person[rows[new]] = self._next + np.arange(len(new))
            m.since_s[rows[new]] = at_s
            self._next += len(new)
        s, m = self.settings, self.memory
        frame = FrameBodies(at_s, column, numbers, middles, lengths)
        events = _kernels().take(frame, rows, float(s.same_within_m), float(s.confirm_after_s), m.arrays)
        if events & _kernels().FORGOTTEN:
            self._owners = {}
        if nobody:
            self._owners.pop(sensor, None)
        elif (owners := dict(zip(ids, m.person[rows].tolist(), strict=True))) != self._owners.get(sensor):
            self._owners[sensor] = owners
        if not events & (_kernels().MAY_BE_ONE | _kernels().MAY_BE_KNOWN):
            self._close_since_s, self.merged = {}, ()
            return rows
        people = np.where(rows < 0, -1, m.person[rows])
        self._join(at_s)
        self._know_again(at_s)
        for stays, gone in self.merged:
            people[people == gone] = stays
            self._owners = {}
        return np.where(people < 0, -1, np.searchsorted(self.memory.person, people)).astype(np.int64)

    def _column(self, sensor: str) -> int:
        if sensor not in self.sensors:
            self.sensors = [*self.sensors, sensor]
            self.memory = self.memory.with_more(sensors=1)
        return self.sensors.index(sensor)

    def _assign(  # noqa: PLR0917
        self, column: int, ids: Int64, middles: Float64, expected: Float64, at_s: float, lengths: Float64
    ) -> tuple[Int64, Bools, bool]:
        """Who is lost for too long is gone.

        Returns:
            (bodies,) rows, −1 for nobody; (bodies,) whether nothing of the middle is seen; whether anybody is nobody.
        """
        s, m = self.settings, self.memory
        numbers = (s.gate_m, s.stay_bonus_m, s.speed_m_s, s.widest_gate_m, s.by_place_s, s.forget_after_s)
        shape = len(ids), len(m.person)
        cost, allowed = np.empty(shape), np.empty(shape, dtype=np.bool_)
        rows, unplaced = np.empty(len(ids), dtype=np.int64), np.empty(len(ids), dtype=np.bool_)
        frame, result = FrameBodies(at_s, column, ids, middles, lengths), Assignment(cost, allowed, unplaced, rows)
        outcome = _kernels().costs(frame, expected, Gates(*map(float, numbers)), m.arrays, result)
        if outcome == _kernels().EXPIRED:
            patience_s = np.where(m.confirmed, s.forget_after_s, 2.0 * RECENT_S)
            stays = at_s - m.seen_s <= patience_s
            self.memory = m.taken(stays)
            return self._assign(column, ids, middles, expected[stays], at_s, lengths)
        if outcome == _kernels().AMBIGUOUS:
            rows = assign(cost, allowed)
        return rows, unplaced, outcome != _kernels().COMPLETE

    def _know_again(self, at_s: float) -> None:
        """Tell of those who are new for long enough, or find out that they are somebody who was missing."""
        s, m = self.settings, self.memory
        present = m.present
        missing = np.flatnonzero(m.confirmed & ~present & (at_s - m.seen_s > RECENT_S)).tolist()
        kept = np.ones(len(m.person), dtype=np.bool_)
        seen_for_s = m.seen_s - m.since_s
        for new in np.flatnonzero(present & ~m.confirmed & (seen_for_s >= s.confirm_after_s)).tolist():
            difference = sorted((self._difference(new, gone), gone) for gone in missing)
            least, nearest = difference[0] if difference else (np.inf, -1)
            sure = 2 * least <= min([s.same_size, *(other for other, _ in difference[1:])])
            sized = any(known_size(m.size[gone]) for gone in missing)
            if sized and not sure and seen_for_s[new] < s.size_after_s:
                continue
            m.confirmed[new] = True
            if least > s.same_size:
                continue
            missing.remove(nearest)
            self.merged = (*self.merged, (int(m.person[nearest]), int(m.person[new])))
            kept[new] = False
            for values in (m.seen_s, m.middle, m.body, m.body_s):
                values[nearest] = values[new]
        self._keep(kept)

    def _keep(self, kept: Bools) -> None:
        if not kept.all():
            self.memory = self.memory.taken(kept)

    def _difference(self, new: int, gone: int) -> float:
        """Of their lengths: infinite where nobody gets so far, half where the place fits."""
        s, m = self.settings, self.memory
        away_s = float(m.since_s[new] - m.seen_s[gone])
        apart = float(_kernels().apart(m.middle[new], m.middle[gone]))
        difference = size_difference(m.size[new, 0], m.size[gone, 0])
        if apart > s.gate_m + s.fastest_m_s * away_s:
            return float("inf")
        return difference / 2 if apart <= min(s.gate_m + s.speed_m_s * away_s, s.widest_gate_m) else difference

    def _join(self, at_s: float) -> None:
        """Make one of two who have been in one place for long enough, where no sensor says that they are two."""
        s, m = self.settings, self.memory
        close: dict[tuple[int, int], float] = {}
        kept = np.ones(len(m.person), dtype=np.bool_)
        sees = np.isfinite(m.body_s)
        merged = []
        for one, other in combinations(np.flatnonzero(sees.any(axis=1)).tolist(), 2):
            share = (sees[one] & sees[other]).any()
            if share or _kernels().apart(m.middle[one], m.middle[other]) > s.same_within_m:
                continue
            pair = int(m.person[one]), int(m.person[other])
            close[pair] = self._close_since_s.get(pair, at_s)
            if at_s - close[pair] >= s.same_after_s and kept[one] and kept[other]:
                kept[other] = False
                merged.append(pair)
                if m.confirmed[other] and not m.confirmed[one]:
                    m.size[one] = m.size[other]
                m.since_s[one] = min(m.since_s[one], m.since_s[other])
                m.seen_s[one] = max(m.seen_s[one], m.seen_s[other])
                m.confirmed[one] |= m.confirmed[other]
                m.body[one, sees[other]] = m.body[other, sees[other]]
                m.body_s[one, sees[other]] = m.body_s[other, sees[other]]
        self._close_since_s, self.merged = close, tuple(merged)
        self._keep(kept)


@cache
def _kernels() -> Any:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.association import track_kernels

    return track_kernels
