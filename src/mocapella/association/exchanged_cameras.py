"""Tell cameras of a rig whose images are exchanged, such as by swapped names, by the people that they see."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, permutations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.association.ray_agreement import AGREES, CONFIDENT, apart, cast, spread_of
from mocapella.model.camera import PlacedCamera
from mocapella.model.keypoints import KeypointFrame

Float64 = NDArray[np.float64]

ALL_ORDERS: Final = 5
"""Most cameras whose images are tried in all orders; of more, every two are exchanged."""
BETTER: Final = 2.0
"""The exchanged cameras disagree with the others at least so many times as much before the exchange."""
SURER: Final = 1.5
"""Orders that disagree at most so many times as much as the best agree alike. In a symmetric rig these are turned
orders, too: those that move the fewest cameras are meant."""
LEAST_PAIRS: Final = 6
"""Least number of detections of a camera that are compared with another camera's."""
MOST_PEOPLE: Final = 4
"""Number of people in an image that are compared, those with most confidence."""
MOST_ORDERS: Final = 2
"""Most orders that agree alike, above which none is named."""
UNLIKE: Final = 1.0
"""Disagreement, of two cameras that see nothing in common, at which larger ones are truncated."""


def exchanged_cameras(
    instants: Sequence[Mapping[str, KeypointFrame]], cameras: Mapping[str, PlacedCamera]
) -> tuple[dict[str, str], ...]:
    """Return whose images cameras have: the camera that each exchanged camera's images fit. Empty if none are.

    Images are exchanged if the cameras disagree about people, and agree in another order. In a rig with two equal
    halves, one of two orders is right, and nothing tells which: both are returned.

    Args:
        instants: frames with people by the camera's name, of some instants.
        cameras: the cameras of the rig.
    """
    names = sorted({name for seen in instants for name in seen} & set(cameras))
    if len(names) < 2:
        return ()
    pairs = _Pairs(instants, cameras)
    before = {pair: pairs.apart(*pair, *pair) for pair in combinations(names, 2)}
    if not any(value > AGREES for value in before.values()):
        return ()
    tried = [one for order in _orders(names) if (one := _try(pairs, before, order)) is not None]
    least = min((one.total for one in tried), default=math.inf)
    good = [one for one in tried if one.now < AGREES and one.was >= BETTER * one.now and one.total <= SURER * least]
    fewest = min((len(one.moved) for one in good), default=0)
    found = tuple(one.moved for one in good if len(one.moved) == fewest)
    return found if len(found) <= MOST_ORDERS else ()


class _Tried(NamedTuple):
    """An order of the cameras: the camera of each moved image, and how far the images disagree.

    Attributes:
        moved: by the camera that gave the images, the one that they fit.
        was, now: mean disagreement of the pairs with a moved camera, before and after.
        total: sum over all pairs, after.
    """

    moved: dict[str, str]
    was: float
    now: float
    total: float


def _try(pairs: _Pairs, before: Mapping[tuple[str, str], float], order: Mapping[str, str]) -> _Tried | None:
    """Return how far cameras disagree in an order of their images; None if nothing tells."""
    moved = {name: own for name, own in order.items() if own != name}
    touched = [pair for pair in before if not moved.keys().isdisjoint(pair)]
    now = [pairs.apart(*pair, order[pair[0]], order[pair[1]]) for pair in touched]
    known = [
        (was, is_now) for pair, is_now in zip(touched, now, strict=True) if np.isfinite((was := before[pair]) + is_now)
    ]
    if not known:
        return None
    was, is_now = np.mean(known, axis=0).tolist()
    rest = sum(value for pair, value in before.items() if pair not in touched and np.isfinite(value))
    return _Tried(moved, was, is_now, rest + is_now * len(known))


def exchange_text(exchanged: Sequence[Mapping[str, str]]) -> str:
    """Return what is exchanged, as a clause: ``cameras cam01 and cam02 seem exchanged``; empty if nothing is.

    Args:
        exchanged: of `exchanged_cameras`.
    """
    if not exchanged:
        return ""
    if all(len(one) == 2 for one in exchanged):
        return f"cameras {', or '.join(' and '.join(one) for one in exchanged)} seem exchanged"
    texts = [f"the images of {', '.join(one)} seem to be those of {', '.join(one.values())}" for one in exchanged]
    return ", or ".join(texts)


def _orders(names: Sequence[str]) -> Iterator[dict[str, str]]:
    """Yield the orders of cameras that are tried, apart from the given one."""
    if len(names) <= ALL_ORDERS:
        for some in permutations(names):
            if list(some) != list(names):
                yield dict(zip(names, some, strict=True))
        return
    for one, other in combinations(names, 2):
        yield {name: name for name in names} | {one: other, other: one}


class _Pairs:
    """Disagreements of two cameras' images, kept for the orders that share them."""

    def __init__(self, instants: Sequence[Mapping[str, KeypointFrame]], cameras: Mapping[str, PlacedCamera]) -> None:
        self._cameras = cameras
        self._pixels = {name: _pixels([seen.get(name) for seen in instants]) for name in cameras}
        self._rays: dict[tuple[str, str], tuple[Float64, Float64, Float64]] = {}
        self._found: dict[tuple[str, str, str, str], float] = {}

    def apart(self, one: str, other: str, first: str, second: str) -> float:
        """Return the median angle of people's rays out of the planes of the other image's rays; NaN without pairs.

        Angles are parts of the spread of the person's rays. Of the detections in the other image, the best one counts.

        Args:
            one, other: names of the cameras that gave the images.
            first, second: names of the cameras whose lenses and poses are tried for these images.
        """
        key = one, other, first, second
        if key not in self._found:
            (o, some, spread), (p, others, spread_of_other) = self._of(one, first), self._of(other, second)
            found = [_best(some, others, p - o, spread), _best(others, some, o - p, spread_of_other)]
            values = np.concatenate(found)
            self._found[key] = float(np.median(values)) if len(values) >= LEAST_PAIRS else float("nan")
        return self._found[key]

    def _of(self, name: str, camera: str) -> tuple[Float64, Float64, Float64]:
        """Return a camera's centre (3,), and of an image's people the directions and their spreads [rad]."""
        key = name, camera
        if key not in self._rays:
            origin, directions = cast(self._pixels[name], self._cameras[camera])
            shape = directions.shape
            spread = spread_of(directions.reshape(-1, *shape[2:])).reshape(shape[:2])
            self._rays[key] = origin, directions, spread
        return self._rays[key]


def _pixels(frames: Sequence[KeypointFrame | None]) -> Float64:
    """Return the sure keypoints (frames, `MOST_PEOPLE`, keypoints, 2) of the surest people [px]; NaN for others.

    Frames of another topology than the first one have none.
    """
    kinds = [one.topology for one in frames if one is not None]
    found = np.full((len(frames), MOST_PEOPLE, len(kinds[0]) if kinds else 0, 2), np.nan)
    for k, one in enumerate(frames):
        if one is None or one.topology.name != kinds[0].name:
            continue
        surest = np.argsort(-one.confidences.sum(axis=1), kind="stable")[:MOST_PEOPLE]
        sure = one.confidences[surest] > CONFIDENT
        found[k, : len(surest)] = np.where(sure[..., None], one.positions_px[surest], np.nan)
    return found


def _best(some: Float64, others: Float64, between: Float64, spread: Float64) -> Float64:
    """Return for people (n,) how far their rays are from crossing those of the best person in the other image.

    Args:
        some, others: (instants, people, keypoints, 3) directions of two cameras, world; NaN for others.
        between: (3,) from the one camera's centre to the other's [m].
        spread: (instants, people) of the directions in ``some`` [rad].
    """
    if some.shape[2] != others.shape[2]:  # another topology
        return np.empty(0)
    least = apart(some, others, between).min(axis=2) / np.maximum(spread, 1e-9)
    return np.asarray(np.minimum(least[np.isfinite(least)], UNLIKE))
