"""Assign each sensor's bodies to people by their predicted positions, frame by frame.

Global nearest neighbour with gates (Blackman, Popoli: Design and Analysis of Modern Tracking Systems, 1999, section
6.4), solved by `scipy.optimize.linear_sum_assignment` (Crouse: On implementing 2D rectangular assignment algorithms,
2016). Distances are between joints on the body's middle line, so that swapped left and right do not change a
person's identity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.proportions import known_size, size_difference, unknown_size
from mocapella.geometry.rigid import apply
from mocapella.model.bodies import id_array
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class TrackSettings:
    """Parameters of the assignment.

    Attributes:
        gate_m: largest distance of a body from the person's predicted position; larger: fast people keep their ids, but
            near people are confused more easily [m].
        stay_bonus_m: reduction of the distance for the body that the sensor last assigned to the person; larger: a
            sensor's own ids are followed more [m].
        speed_m_s: growth of the gate while the person is unseen; larger: people are found again farther away, and
            confused more easily [m/s].
        widest_gate_m: upper bound of the gate [m].
        confirm_after_s: a new person is reported after this time; larger: fewer short-lived false people, but later
            reports of true ones [s].
        forget_after_s: a person unseen for longer is dropped, and gets a new number on return [s].
        same_within_m: two tracks are merged if no sensor sees them together and they stay within this distance for
            ``same_after_s`` [m].
        same_after_s: time for which two tracks must stay within ``same_within_m`` before they are merged [s].
        by_place_s: a person unseen for longer is not recognised by position alone, if the body's lengths are known [s].
        size_after_s: while a person of known lengths is missing, a new one is reported after this time: as the missing
            one with the most similar lengths, if similar enough; larger: the lengths are known better [s].
        fastest_m_s: speed that bounds the distance of a missing person, beyond the gate; larger: people are recognised
            by their lengths farther away [m/s].
        same_size: largest mean squared difference of the lengths, in units of their variances, of a recognised person;
            twice as much if the position fits. On the KinectMultiTrack logs, it accepts 93 % of comparisons of a person
            with the same one in one session, and 38 % with another person (``told_apart_by_lengths``) [ratio].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
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

    @cached_property
    def gates(self) -> Gates:
        """The settings of the gating as floats, for the kernels."""
        return Gates(*(float(getattr(self, name)) for name in Gates._fields))


MAY_BE_ONE, MAY_BE_KNOWN, FORGOTTEN, CHANGED, EXPIRED, AMBIGUOUS, INCOMPLETE = (1 << n for n in range(7))
"""Events of a frame, which are added; `track_kernels.costs` and `track_kernels.take` describe them."""
UNFINISHED: Final = MAY_BE_ONE | MAY_BE_KNOWN | EXPIRED | AMBIGUOUS | INCOMPLETE
"""Events after which the rows of a frame's bodies are not final."""
UNASSIGNED: Final = EXPIRED | AMBIGUOUS | INCOMPLETE
"""Those after which the frame's bodies are not assigned at all, and the tracks are as before."""


class TrackArrays(NamedTuple):
    """The arrays of a `TrackMemory` without ``person``, not copies, for the kernels, which change them in place."""

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
        middles: (bodies, middle joints, 3), world [m]; NaN where not seen.
        lengths: (bodies, lengths) [m]; (0, 0) where not measured.
    """

    at_s: float
    column: int
    ids: Int64
    middles: Float64
    lengths: Float64


class Gates(NamedTuple):
    """The fields of `TrackSettings` for the gating, with the same meaning and units, as floats for the kernels."""

    gate_m: float
    stay_bonus_m: float
    speed_m_s: float
    widest_gate_m: float
    by_place_s: float
    forget_after_s: float


class TrackInputs(NamedTuple):
    """What the kernels take of `Tracks` for a frame.

    Attributes:
        gates: settings of the gating.
        same_within_m, confirm_after_s: the settings of these names, as floats [m], [s].
        arrays: the tracks, changed in place.
    """

    gates: Gates
    same_within_m: float
    confirm_after_s: float
    arrays: TrackArrays


class Assignment(NamedTuple):
    """Costs of a frame's bodies, written by the kernel.

    Attributes:
        cost: (bodies, tracks) cost of an assignment [m].
        allowed: (bodies, tracks) whether it passes the gates.
        unplaced: (bodies,) whether no middle joint is visible.
        rows: (bodies,) the cheapest allowed track of each body; −1 for none. Two bodies may have the same one.
    """

    cost: Float64
    allowed: Bools
    unplaced: Bools
    rows: Int64


class TrackMemory(msgspec.Struct, eq=False):
    """All tracks: a row for each, in the order of their numbers; a column for each sensor. `Tracks` changes the arrays.

    Attributes:
        person: (tracks,) number of the person; never reused.
        since_s, seen_s: (tracks,) capture times of the first and last view, on the common clock [s].
        confirmed: (tracks,) whether the track is reported as a person, not only a candidate.
        middle: (tracks, middle joints, 3) last seen position of each joint, world [m]; NaN where never seen.
        size: (tracks, 2, lengths) record of the body's lengths, see `mocapella.association.proportions.unknown_size`.
        body: (tracks, sensors) tracking id of the person's last body in each sensor.
        body_s: (tracks, sensors) capture time of that id's last view [s]; −inf where the sensor does not see the
            person.
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
        """Return unseen tracks, for numbers of tracks, sensors and joints on the body's middle line."""
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
        """Return a copy of the tracks ``rows``, given as indices (n,) or as a mask (tracks,)."""
        return TrackMemory(*(getattr(self, name)[rows] for name in self.__struct_fields__))

    def with_more(self, tracks: int = 0, sensors: int = 0) -> TrackMemory:
        """Return a copy with additional, unseen tracks and sensors."""
        rows, columns = self.body.shape
        new = TrackMemory.empty(rows + tracks, columns + sensors, self.middle.shape[1])
        for name in self.__struct_fields__:
            kept = (slice(rows), slice(columns)) if name.startswith("body") else slice(rows)
            getattr(new, name)[kept] = getattr(self, name)
        return new

    @property
    def arrays(self) -> TrackArrays:
        """The same arrays without ``person``, not copies, as a named tuple for the kernels."""
        return TrackArrays(self.since_s, self.seen_s, self.confirmed, self.middle, self.size, self.body, self.body_s)

    @property
    def present(self) -> Bools:
        """(tracks,) whether any sensor sees the person at present."""
        return np.asarray(np.isfinite(self.body_s).any(axis=1))


RECENT_S: Final = 0.25
"""Time since a sensor's last view of a person after which it counts as not seeing the person [s]."""


def distances(bodies: Float64, people: Float64) -> Float64:
    """Return the mean distance of each body from each person, over the joints that both have.

    Args:
        bodies: (n, joints, 3) [m]; NaN where not seen.
        people: (m, joints, 3), in the same frame [m]; NaN where not seen.

    Returns:
        (n, m) [m]; infinite without a common joint.
    """
    out = np.empty((len(bodies), len(people)))
    _kernels().distances(np.ascontiguousarray(bodies), np.ascontiguousarray(people), out)
    return out


def assign(cost: Float64, allowed: Bools) -> Int64:
    """Solve the linear assignment problem: as many allowed pairs as possible, one to one, at the smallest total cost.

    Args:
        cost: (n, m) cost of each pair, finite where allowed, in any unit; may be negative. n or m may be 0.
        allowed: (n, m) whether the pair is allowed.

    Returns:
        (n,) column of each row; −1 for a row without one.
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
    """Tracks of all people: assigns each sensor's bodies to people, frame by frame.

    The same frames in the same order give the same result.

    Args:
        settings: parameters of the assignment; the defaults if None.

    Attributes:
        memory: all tracks, including lost and unconfirmed ones; replaced or changed in place by each `update`.
        sensors: names of the sensors, in the order of the memory's columns.
        merged: (kept, dropped) numbers of the tracks merged in the last update.
    """

    def __init__(self, settings: TrackSettings | None = None) -> None:
        self.settings = settings or TrackSettings()
        self.reset()

    def reset(self) -> None:
        """Forget all people; the numbers restart at 0."""
        self.memory = TrackMemory.empty(0, 0, 0)
        self.sensors: list[str] = []
        self.merged: tuple[tuple[int, int], ...] = ()
        self._next = 0
        self._close_since_s: dict[tuple[int, int], float] = {}
        self._owners: dict[str, dict[int, int]] = {}

    @property
    def people(self) -> list[int]:
        """Numbers of all tracks, by row of `memory`; a new list."""
        people: list[int] = self.memory.person.tolist()
        return people

    def owners(self, sensor: str) -> Mapping[int, int]:
        """Return the number of the person of each body that the sensor sees, by tracking id; empty if it is unknown.

        Unconfirmed people are included. The same object is returned until an assignment changes.
        """
        if sensor not in self._owners:
            self._owners[sensor] = {}
            if sensor in self.sensors:
                m, column = self.memory, self.sensors.index(sensor)
                seen = np.isfinite(m.body_s[:, column])
                bodies, people = m.body[seen, column].astype(np.uint64).tolist(), m.person[seen].tolist()
                self._owners[sensor] = dict(zip(bodies, people, strict=True))
        return self._owners[sensor]

    def rows(self, sensor: str, ids: Sequence[int]) -> Int64:
        """Return the row in `memory` of each of the sensor's bodies (bodies,), as last assigned; −1 for unknown ones.

        ``ids`` (bodies,) are the sensor's tracking ids.
        """
        if sensor not in self.sensors:
            return np.full(len(ids), -1, dtype=np.int64)
        m, numbers, rows = self.memory, id_array(ids).view(np.int64), np.empty(len(ids), dtype=np.int64)
        _kernels().rows_of(numbers, self.sensors.index(sensor), m.body, m.body_s, rows)
        return rows

    @property
    def inputs(self) -> TrackInputs:
        """The settings and the tracks themselves, not copies, for the kernels."""
        s = self.settings
        return TrackInputs(s.gates, float(s.same_within_m), float(s.confirm_after_s), self.memory.arrays)

    def column(self, sensor: str, joints: int) -> int:
        """Return the sensor's column in `memory`; an unknown one gets a new column.

        If the number ``joints`` of joints on the body's middle line differs from before, all tracks are dropped first.
        """
        if self.memory.middle.shape[1] != joints:
            self.memory = TrackMemory.empty(0, len(self.sensors), joints)
        if sensor not in self.sensors:
            self.sensors = [*self.sensors, sensor]
            self.memory = self.memory.with_more(sensors=1)
        return self.sensors.index(sensor)

    def move(self, T_new_old: Float64) -> None:
        """Express all positions in another world frame, in `memory`; T_new_old is a rigid motion (4, 4)."""
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
        """Assign one frame's bodies to people, and update `memory`; a body without a person becomes a new one.

        If the number of middle joints differs from before, all tracks are dropped first.

        Args:
            sensor: name of the sensor; an unknown one gets a new column.
            ids: (bodies,) tracking ids.
            middles: (bodies, middle joints, 3) joints on the body's middle line, world [m]; NaN where not seen.
            expected: (tracks, middle joints, 3) predicted for all tracks, by row of `memory` before the call, world
                [m]; the last seen position is used for a track without a finite one, and for all if None.
            at_s: capture time, on the common clock [s].
            lengths: (bodies, lengths) of `mocapella.association.proportions.sizes` [m]; if None, people are not
                recognised by size.

        Returns:
            (bodies,) the row of each in `memory` after the call; −1 for a body without visible middle joints that is
            not known by its id.
        """
        column, numbers = self.column(sensor, middles.shape[1]), id_array(ids).view(np.int64)
        lengths = np.empty((0, 0)) if lengths is None else lengths
        where = np.empty((len(self.memory.person), 0, 3)) if expected is None else expected
        rows, events = self._assign(FrameBodies(at_s, column, numbers, middles, lengths), where)
        return self.settle(sensor, ids, rows, events, at_s)

    def settle(self, sensor: str, ids: Sequence[int], rows: Int64, events: int, at_s: float) -> Int64:
        """Merge tracks, and confirm new ones, after a frame's bodies were assigned and `memory` was updated by them.

        Args:
            sensor, ids, at_s: as in `update`.
            rows: (bodies,) the row of each body in `memory`; −1 for none.
            events: of the frame.

        Returns:
            (bodies,) the rows after the call.
        """
        m = self.memory
        if events & FORGOTTEN:
            self._owners = {}
        if events & UNASSIGNED:
            self._owners.pop(sensor, None)
        elif events & CHANGED or sensor not in self._owners:
            self._owners[sensor] = dict(zip(ids, m.person[rows].tolist(), strict=True))
        if not events & (MAY_BE_ONE | MAY_BE_KNOWN):
            self._close_since_s, self.merged = {}, ()
            return rows
        people = np.where(rows < 0, -1, m.person[rows])
        self._join(at_s)
        self._know_again(at_s)
        for stays, gone in self.merged:
            people[people == gone] = stays
            self._owners = {}
        return np.where(people < 0, -1, np.searchsorted(self.memory.person, people)).astype(np.int64)

    def _assign(self, frame: FrameBodies, expected: Float64) -> tuple[Int64, int]:
        """Drop expired tracks, assign the bodies, make new tracks of those without one, and update the memory.

        Returns:
            (bodies,) rows, −1 for none; and the frame's events, with those of `UNASSIGNED` that were dealt with here.
        """
        s, m, bodies = self.settings, self.memory, len(frame.ids)
        shape = bodies, len(m.person)
        rows, unplaced = np.empty(bodies, dtype=np.int64), np.empty(bodies, dtype=np.bool_)
        result = Assignment(np.empty(shape), np.empty(shape, dtype=np.bool_), unplaced, rows)
        events: int = _kernels().assign_and_take(frame, expected, self.inputs, result)
        if events & EXPIRED:
            patience_s = np.where(m.confirmed, s.forget_after_s, 2.0 * RECENT_S)
            stays = frame.at_s - m.seen_s <= patience_s
            self.memory = m.taken(stays)
            return self._assign(frame, expected[stays])
        if not events & UNASSIGNED:
            return rows, events
        if events & AMBIGUOUS:
            rows = assign(result.cost, result.allowed)
        new = np.flatnonzero((rows < 0) & ~unplaced)
        if len(new):
            rows[new] = len(m.person) + np.arange(len(new))
            m = self.memory = m.with_more(tracks=len(new))
            m.person[rows[new]] = self._next + np.arange(len(new))
            m.since_s[rows[new]] = frame.at_s
            self._next += len(new)
        inputs = self.inputs
        return rows, events | _kernels().take(frame, rows, inputs.same_within_m, inputs.confirm_after_s, inputs.arrays)

    def _know_again(self, at_s: float) -> None:
        """Confirm tracks that are old enough, or merge them into those of missing people with similar lengths."""
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
        """Return the difference of two tracks' lengths: infinite if too far apart, half if the position fits."""
        s, m = self.settings, self.memory
        away_s = float(m.since_s[new] - m.seen_s[gone])
        apart = float(_kernels().apart(m.middle[new], m.middle[gone]))
        difference = size_difference(m.size[new, 0], m.size[gone, 0])
        if apart > s.gate_m + s.fastest_m_s * away_s:
            return float("inf")
        return difference / 2 if apart <= min(s.gate_m + s.speed_m_s * away_s, s.widest_gate_m) else difference

    def _join(self, at_s: float) -> None:
        """Merge two tracks that have been at one position for long enough, and that no sensor sees together."""
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
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.association import track_kernels

    return track_kernels
