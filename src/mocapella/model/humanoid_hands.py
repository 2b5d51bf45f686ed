"""Hands of people: the landmarks of tracked hands and arms as further keypoints of the person whose wrist is there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.hand import LANDMARKS
from mocapella.model.humanoid_joints import HAND_LANDMARKS, INDEX, joints_of
from mocapella.model.observations import JointState
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]

WITHIN_M: Final = 0.15
"""Largest distance between a person's wrist and the hand's [m]."""


def with_hands(people: Trajectories, found: Mapping[str, Trajectories]) -> Trajectories:
    """Return people with `HAND_LANDMARKS` where a hand or an arm of the same side is at the wrist.

    In each frame and side, the pairs of a wrist and a hand that are nearest go together, within `WITHIN_M`. People
    without known hands keep their keypoints, as do people whose keypoints no humanoid has.

    Args:
        people: the people.
        found: trajectories by kind, of the same frames; ``hands`` and ``arms`` are used.
    """
    sources = [found[kind] for kind in ("hands", "arms") if kind in found]
    if not sources:
        return people
    try:
        wrists = np.stack([joints_of(people.of(name))[0] for name in people.individuals], axis=1)
    except SettingsError:
        return people
    frames, count = len(people), len(people.individuals)
    positions = np.full((frames, count, len(HAND_LANDMARKS), 3), np.nan)
    states = np.zeros(positions.shape[:3], np.uint8)
    sd = np.full(positions.shape[:3], np.nan, np.float32)
    for k, side in enumerate(("left", "right")):
        hands, of_hands, sd_of_hands = _hands(sources, side, frames)
        apart = np.linalg.norm(wrists[:, :, INDEX[f"Wrist{side.title()}"], None] - hands[:, None, :, 0], axis=-1)
        to = slice(k * len(LANDMARKS), (k + 1) * len(LANDMARKS))
        for frame, person, hand in _nearest(apart):
            positions[frame, person, to] = hands[frame, hand]
            states[frame, person, to], sd[frame, person, to] = of_hands[frame, hand], sd_of_hands[frame, hand]
    if not np.isfinite(positions).any():
        return people
    return replace(
        people, keypoints=(*people.keypoints, *HAND_LANDMARKS),
        positions=np.concatenate([people.positions, positions], axis=2),
        states=np.concatenate([people.states, states], axis=2), sd=np.concatenate([people.sd, sd], axis=2),
    )  # fmt: skip


def _hands(
    sources: list[Trajectories], side: str, frames: int
) -> tuple[NDArray[np.floating], NDArray[np.uint8], NDArray[np.float32]]:
    """Return landmarks (frames, hands, 21, 3), states and sd (frames, hands, 21) of all hands of a side."""
    shape = (frames, 0, len(LANDMARKS))
    parts: list[tuple[NDArray[np.floating], NDArray[np.uint8], NDArray[np.float32]]] = [
        (np.empty((*shape, 3), np.float32), np.empty(shape, np.uint8), np.empty(shape, np.float32))
    ]
    for source in sources:
        own = [k for k, name in enumerate(source.individuals) if name.endswith(f"_{side}")]
        at = np.ix_(range(frames), own, [source.keypoints.index(name) for name in LANDMARKS])
        states = np.where(np.isfinite(source.positions[at]).all(axis=-1), source.states[at], JointState.NOT_TRACKED)
        parts.append((source.positions[at], states.astype(np.uint8), source.sd[at]))
    positions, states, sd = (np.concatenate([part[k] for part in parts], axis=1) for k in range(3))
    return positions, states, sd


def _nearest(apart: Float64) -> list[tuple[int, int, int]]:
    """Return (frame, person, hand) of the pairs, nearest first, each person and hand of a frame once.

    Args:
        apart: (frames, people, hands) distances [m]; NaN where unknown.
    """
    pairs: list[tuple[int, int, int]] = []
    taken: set[tuple[int, str, int]] = set()
    candidates = np.argwhere(apart <= WITHIN_M)
    for frame, person, hand in candidates[np.argsort(apart[tuple(candidates.T)], kind="stable")].tolist():
        if not {(frame, "person", person), (frame, "hand", hand)} & taken:
            taken |= {(frame, "person", person), (frame, "hand", hand)}
            pairs.append((frame, person, hand))
    return pairs
