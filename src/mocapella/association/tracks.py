"""Who is who, frame by frame: each sensor's bodies are given to the people where they were expected.

Global nearest neighbour with gates (Blackman, Popoli: Design and Analysis of Modern Tracking Systems, 1999, section
6.4); the assignment that costs least is found by `scipy.optimize.linear_sum_assignment` (Crouse: On implementing 2D
rectangular assignment algorithms, 2016). Distances are those of the joints in the middle of the body, so that a sensor
that mixes up left and right does not make somebody else of a person.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.proportions import known_size, learn_size, size_difference, unknown_size
from mocapella.geometry.rigid import apply
from mocapella.model.bodies import BodyKey
from mocapella.settings import check

Float64 = NDArray[np.float64]


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


class Track(msgspec.Struct, frozen=True, eq=False):
    """One person, as far as identity goes.

    Attributes:
        person: number of the person; never given to somebody else.
        since_s, seen_s: first and last seen, on the common clock.
        confirmed: whether the person is told of.
        bodies: tracking id by sensor, of the sensors that saw the person within the last `_RECENT_S`.
        seen_by_s: when each of those did.
        middle: (middle joints, 3) where the person was last seen, world [m].
        size: (2, lengths) of `mocapella.association.proportions.learn_size`.
    """

    person: int
    since_s: float
    seen_s: float
    confirmed: bool
    bodies: Mapping[str, int]
    seen_by_s: Mapping[str, float]
    middle: Float64
    size: Float64


_RECENT_S = 0.25
"""A sensor that has not seen a person for so long does not see them."""


def distances(bodies: Float64, people: Float64) -> Float64:
    """Mean distance of the joints that both have.

    Args:
        bodies: (n, joints, 3) [m]; NaN where not seen.
        people: (m, joints, 3), in the same frame.

    Returns:
        (n, m) [m]; infinite where two have no joint in common.
    """
    apart = np.sqrt(((bodies[:, None] - people[None, :]) ** 2).sum(axis=-1))
    common = np.isfinite(apart)
    counts = common.sum(axis=-1)
    total = np.where(common, apart, 0.0).sum(axis=-1)
    return np.where(counts > 0, total / np.maximum(counts, 1), np.inf)


def assign(cost: Float64, allowed: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Rows and columns in pairs, as many as are allowed and of those the ones that cost least together.

    Args:
        cost: (n, m).
        allowed: (n, m).

    Returns:
        (row, column), by rows.
    """
    if not allowed.any():
        return []
    if cost.shape == (1, 1):
        return [(0, 0)]
    from scipy.optimize import linear_sum_assignment

    finite = cost[allowed]
    too_much = 1.0 + min(cost.shape) * (float(finite.max()) - min(0.0, float(finite.min())) + 1.0)
    rows, columns = linear_sum_assignment(np.where(allowed, cost, too_much))
    return [(r, c) for r, c in zip(rows.tolist(), columns.tolist(), strict=True) if allowed[r, c]]


class Tracks:
    """Everybody who is known. The same frames in the same order give the same people.

    Attributes:
        tracks: in the order of the people's numbers, also those who are lost for now and those not confirmed yet.
        merged: (kept, given up) numbers of those who turned out to be one person in the last update.
    """

    def __init__(self, settings: TrackSettings | None = None) -> None:
        self.settings = settings or TrackSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everybody; the numbers begin at 0."""
        self.tracks: tuple[Track, ...] = ()
        self.merged: tuple[tuple[int, int], ...] = ()
        self._next = 0
        self._close_since_s: dict[tuple[int, int], float] = {}

    def move(self, T_new_old: Float64) -> None:
        """Everything is told in another frame from now on."""
        self.tracks = tuple(
            msgspec.structs.replace(track, middle=apply(T_new_old, track.middle)) for track in self.tracks
        )

    def update(  # noqa: PLR0917 - one frame, as it comes
        self,
        sensor: str,
        ids: Sequence[int],
        middles: Float64,
        expected: Mapping[int, Float64],
        at_s: float,
        lengths: Float64 | None = None,
    ) -> tuple[int, ...]:
        """Give one frame's bodies to people.

        Args:
            sensor: whose frame it is.
            ids: (bodies,) its tracking ids.
            middles: (bodies, middle joints, 3), world [m].
            expected: by person, (middle joints, 3) where they are expected now [m]; who is not in it is expected where
                they were last seen.
            at_s: when the frame was captured, on the common clock.
            lengths: (bodies, lengths) of `mocapella.association.proportions.sizes` [m]; without them nobody who comes
                back elsewhere is known again.

        Returns:
            (bodies,) the person of each; −1 for a body of whose middle nothing is seen, where it is nobody known.
        """
        s = self.settings
        known = [track for track in self.tracks if at_s - track.seen_s <= _patience_s(track, s)]
        people: list[Track | None] = [None] * len(ids)
        unplaced = ~np.isfinite(middles).all(axis=-1).any(axis=-1)
        if known and ids:
            where = np.stack([expected.get(track.person, track.middle) for track in known])
            apart = distances(middles, where)
            unseen_s = np.array([max(0.0, at_s - track.seen_s - _RECENT_S) for track in known])
            gates = np.minimum(s.gate_m + s.speed_m_s * unseen_s, s.widest_gate_m)
            held = np.array([[track.bodies.get(sensor) == body for track in known] for body in ids])
            cost = apart - s.stay_bonus_m * held + 0.5 * (gates - s.gate_m)  # who is seen comes before who is lost
            by_size = np.array([lengths is not None and known_size(t.size) for t in known]) & (unseen_s > s.by_place_s)
            allowed = ((apart <= gates) & ~by_size) | (held & unplaced[:, None])
            for body, column in assign(np.where(np.isfinite(cost), cost, s.gate_m), allowed):
                people[body] = known[column]
        found = {track.person: track for track in known}
        sizes = None
        if lengths is not None and ids:
            sizes = learn_size(np.stack([unknown_size() if track is None else track.size for track in people]), lengths)
        for body, (tracking_id, track) in enumerate(zip(ids, people, strict=True)):
            if track is None and unplaced[body]:
                continue
            before = track or self._somebody(at_s)
            size = before.size if sizes is None else sizes[body]
            person = _seen(before, (sensor, tracking_id), middles[body], at_s, size)
            people[body], found[person.person] = person, person
        seen = {track.person for track in people if track is not None}
        self.tracks = tuple(
            track if track.person in seen else _without(track, sensor, at_s) for _, track in sorted(found.items())
        )
        self._join(at_s)
        self._know_again(at_s)
        kept = {gone: stays for stays, gone in self.merged}
        return tuple(-1 if track is None else kept.get(track.person, track.person) for track in people)

    def _somebody(self, at_s: float) -> Track:
        self._next += 1
        return Track(self._next - 1, at_s, at_s, False, {}, {}, np.empty((0, 3)), unknown_size())

    def _know_again(self, at_s: float) -> None:
        """Tell of those who are new for long enough, or find out that they are somebody who was missing."""
        s, tracks = self.settings, {track.person: track for track in self.tracks}
        missing = {
            track.person: track
            for track in self.tracks
            if track.confirmed and not track.bodies and at_s - track.seen_s > _RECENT_S
        }
        for new in self.tracks:
            seen_for_s = new.seen_s - new.since_s
            if new.confirmed or not new.bodies or seen_for_s < s.confirm_after_s:
                continue
            difference = sorted((self._difference(new, gone), person) for person, gone in missing.items())
            least, nearest = difference[0] if difference else (np.inf, -1)
            sure = 2 * least <= min([s.same_size, *(other for other, _ in difference[1:])])
            sized = any(known_size(gone.size) for gone in missing.values())
            if sized and not sure and seen_for_s < s.size_after_s:
                continue
            if least > s.same_size:
                tracks[new.person] = msgspec.structs.replace(new, confirmed=True)
                continue
            back = missing.pop(nearest)
            self.merged = (*self.merged, (nearest, new.person))
            del tracks[new.person]
            tracks[nearest] = msgspec.structs.replace(
                new, person=nearest, since_s=back.since_s, confirmed=True, size=back.size
            )
        self.tracks = tuple(track for _, track in sorted(tracks.items()))

    def _difference(self, new: Track, gone: Track) -> float:
        """Of their lengths: infinite where nobody gets so far, half where the place fits."""
        s, away_s = self.settings, new.since_s - gone.seen_s
        apart = float(distances(new.middle[None], gone.middle[None])[0, 0])
        difference = size_difference(new.size[0], gone.size[0])
        if apart > s.gate_m + s.fastest_m_s * away_s:
            return float("inf")
        return difference / 2 if apart <= min(s.gate_m + s.speed_m_s * away_s, s.widest_gate_m) else difference

    def _join(self, at_s: float) -> None:
        """Make one of two who have been in one place for long enough, where no sensor says that they are two."""
        s, merged = self.settings, []
        present = [track for track in self.tracks if track.bodies]
        close: dict[tuple[int, int], float] = {}
        for i, one in enumerate(present):
            for other in present[i + 1 :]:
                if set(one.bodies) & set(other.bodies):
                    continue
                if distances(one.middle[None], other.middle[None])[0, 0] > s.same_within_m:
                    continue
                pair = one.person, other.person
                close[pair] = self._close_since_s.get(pair, at_s)
                if at_s - close[pair] >= s.same_after_s:
                    merged.append((one, other))
        self._close_since_s = close
        gone: set[int] = set()
        by_person = {track.person: track for track in self.tracks}
        pairs = []
        for one, other in merged:
            if {one.person, other.person} & gone:
                continue
            gone.add(other.person)
            pairs.append((one.person, other.person))
            by_person[one.person] = msgspec.structs.replace(
                one,
                since_s=min(one.since_s, other.since_s),
                seen_s=max(one.seen_s, other.seen_s),
                confirmed=one.confirmed or other.confirmed,
                bodies={**one.bodies, **other.bodies},
                seen_by_s={**one.seen_by_s, **other.seen_by_s},
                size=one.size if one.confirmed or not other.confirmed else other.size,
            )
        self.merged = tuple(pairs)
        self.tracks = tuple(track for person, track in by_person.items() if person not in gone)


def _patience_s(track: Track, settings: TrackSettings) -> float:
    return settings.forget_after_s if track.confirmed else 2.0 * _RECENT_S


def _seen(track: Track, body: BodyKey, middle: Float64, at_s: float, size: Float64) -> Track:
    sensor, tracking_id = body
    at_s = max(at_s, track.seen_s)  # frames of several sensors come a little out of order
    if len(track.middle) == len(middle):
        middle = np.where(np.isfinite(middle), middle, track.middle)
    return msgspec.structs.replace(
        track,
        seen_s=at_s,
        bodies={**track.bodies, sensor: tracking_id},
        seen_by_s={**track.seen_by_s, sensor: at_s},
        middle=middle,
        size=size,
    )


def _without(track: Track, sensor: str, at_s: float) -> Track:
    """The track after a frame of a sensor that does not show the person; who is silent is forgotten, too."""
    gone = [name for name, seen_s in track.seen_by_s.items() if name == sensor or at_s - seen_s > _RECENT_S]
    if not gone:
        return track
    return msgspec.structs.replace(
        track,
        bodies={name: body for name, body in track.bodies.items() if name not in gone},
        seen_by_s={name: seen_s for name, seen_s in track.seen_by_s.items() if name not in gone},
    )
