"""Choose the kind of results on both sides, and match the individuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocapella.comparison.estimate import JointPaths, candidates
from mocapella.comparison.joint_names import MatchedJoint, Terms, matched_joints, weighted
from mocapella.comparison.smooth_paths import without_spikes
from mocapella.errors import EvaluationError, SettingsError, one_of
from mocapella.model.resampling import LONGEST_GAP_FRAMES, LONGEST_GAP_S, Between
from mocapella.model.trajectories import Trajectories

CLEARLY: Final = 0.05
"""Least difference of the mean correlation between the best pairs and others."""
NEAR_M: Final = 0.5
"""Distance of two individuals' joints within which they may be one person [m]; larger: pairs that agree less."""
_UNLIKE: Final = -10.0

Float64 = NDArray[np.float64]


def chosen_kinds(
    recording: Mapping[str, Trajectories], reference: Mapping[str, Trajectories], kind: str | None,
    table: Mapping[str, Terms] | None,
) -> tuple[Trajectories, Trajectories, tuple[MatchedJoint, ...]]:  # fmt: skip
    """Return the trajectories of both sides with most joints in common, and these joints.

    Args:
        recording, reference: trajectories by kind.
        kind: kind of the recording's; None for the one with most joints in common, people before others.
        table: pairs of joints, as in `matched_joints`.

    Raises:
        SettingsError: a side has no results, the kind is unknown, or no joints match; lists both sides' names.
    """
    for what, found in (("recording", recording), ("reference", reference)):
        if not found:
            raise SettingsError(f"the {what} has no people, hands, arms, bodies, objects or points")
    if kind is not None and kind not in recording:
        raise SettingsError(f"--kind {kind!r}: the recording has {one_of(kind, recording)}")
    best: tuple[Trajectories, Trajectories, tuple[MatchedJoint, ...]] | None = None
    first: SettingsError | None = None
    for own in [recording[kind]] if kind is not None else recording.values():
        for other in sorted(reference.values(), key=lambda one: one.kind != own.kind):
            try:
                joints = matched_joints(own.keypoints, other.keypoints, table)
            except SettingsError as error:
                first = first or error
                continue
            if best is None or len(joints) > len(best[2]):
                best = own, other, joints
    if best is None:
        assert first is not None
        raise first
    return best


def paths_of(trajectories: Trajectories, individuals: Sequence[str], joints: Sequence[Terms]) -> JointPaths:
    """Return the paths of some individuals' joints, individual by individual."""
    own = trajectories.of(individuals)
    parts = [weighted(own.positions, own.states, own.keypoints, terms)[0] for terms in joints]
    positions = np.stack(parts, axis=2).reshape(len(own), -1, 3)
    groups = np.repeat(np.arange(len(individuals)), len(joints))
    return JointPaths(own.times_s, positions, groups, clock=bool(np.isfinite(own.rate_hz)), sensors=own.sensors)


def pairs_of_text(text: str | None) -> dict[str, str]:
    """Return the pairs of ``--pairs OURS=THEIRS,…``.

    Raises:
        SettingsError: it has no such pairs, or one name twice.
    """
    if text is None:
        return {}
    pairs = [tuple(part.strip() for part in one.partition("=")[::2]) for one in text.split(",") if one.strip()]
    fits = bool(pairs) and all(all(pair) for pair in pairs)
    if not fits or any(len({pair[k] for pair in pairs}) < len(pairs) for k in (0, 1)):
        raise SettingsError(f"--pairs {text!r}: write OURS=THEIRS, such as person_1=anna,person_2=ben, each name once")
    return {ours: theirs for ours, theirs in pairs}  # noqa: C416 - tuples of any length to mypy


def matched_people(
    ours: Trajectories, theirs: Trajectories, joints: Sequence[MatchedJoint], chosen: Mapping[str, str]
) -> dict[str, str]:
    """Return the reference's individual of each individual of the recording.

    If there are several, those belong together whose motion correlates most, at any time.

    Args:
        ours, theirs: the trajectories.
        joints: the joints in common.
        chosen: the user's pairs; none to find them.

    Raises:
        SettingsError: an individual is unknown; lists the known ones.
        EvaluationError: the match is ambiguous; lists both sides.
    """
    if chosen:
        for some, names in ((ours, chosen.keys()), (theirs, chosen.values())):
            some.of(list(names))  # unknown names
        return dict(chosen)
    if len(ours.individuals) == len(theirs.individuals) == 1:
        return {ours.individuals[0]: theirs.individuals[0]}
    sure = np.array([[_likeness(ours, theirs, joints, a, b) for b in theirs.individuals] for a in ours.individuals])
    rows, columns = linear_sum_assignment(-sure)
    used = [(a, b) for a, b in zip(rows, columns, strict=True) if sure[a, b] > _UNLIKE]
    total = sum(sure[a, b] for a, b in used)
    others = []
    for a, b in used:
        without = sure.copy()
        without[a, b] = 2 * _UNLIKE
        again = linear_sum_assignment(-without)
        others.append(float(without[again].sum()))
    if not used or any(other > total - CLEARLY * len(used) for other in others):
        raise EvaluationError(
            f"the match of individuals is ambiguous: the recording has {', '.join(ours.individuals)}, the reference "
            f"{', '.join(theirs.individuals)}; name pairs with --pairs, such as "
            f"{ours.individuals[0]}={theirs.individuals[0]}"
        )
    return {ours.individuals[a]: theirs.individuals[b] for a, b in used}


def near_people(ours: Trajectories, theirs: Trajectories, joints: Sequence[MatchedJoint]) -> dict[str, str]:
    """Return the reference's individual of each individual of the recording, by distance at the same times.

    Each frame in which two are near counts for them, the more the nearer they are.

    Raises:
        EvaluationError: no two are within `NEAR_M` at the same time.
    """
    x, y = (
        paths_of(one, one.individuals, [getattr(joint, side) for joint in joints]).positions
        .reshape(len(one), len(one.individuals), len(joints), 3)
        for one, side in ((ours, "ours"), (theirs, "theirs"))
    )  # fmt: skip
    y = sampled(theirs.times_s, y, np.asarray(np.isfinite(y).all(axis=3)), ours.times_s)
    near = np.zeros((x.shape[1], y.shape[1]))
    for a, b in np.ndindex(near.shape):
        apart = np.linalg.norm(x[:, a] - y[:, b], axis=2)
        near[a, b] = np.nan_to_num(np.maximum(0.0, 1.0 - apart / NEAR_M)).sum()
    found = [(a, b) for a, b in zip(*linear_sum_assignment(-near), strict=True) if near[a, b] > 0]
    if not found:
        raise EvaluationError(
            f"no individuals are within {NEAR_M:g} m of each other at the same time; leave --same-space or "
            "--same-clock out, or name pairs with --pairs"
        )
    return {ours.individuals[a]: theirs.individuals[b] for a, b in found}


def sampled(times_s: Float64, values: Float64, known: NDArray[np.bool_], at: Float64) -> Float64:
    """Interpolate values (frames, individuals, n, …) at other times, linearly and over short gaps only."""
    longest = max(LONGEST_GAP_S, LONGEST_GAP_FRAMES * float(np.median(np.diff(times_s))))
    out = np.full((len(at), *values.shape[1:]), np.nan)
    for i, k in np.ndindex(known.shape[1:]):
        between = Between.of(times_s, known[:, i, k], at, longest)
        if between is not None:
            out[between.to, i, k] = between.mixed(values[:, i, k])
    return out


def _likeness(ours: Trajectories, theirs: Trajectories, joints: Sequence[MatchedJoint], a: str, b: str) -> float:
    """Return how surely two individuals move alike at some time; `_UNLIKE` if they cannot be compared."""
    own = paths_of(ours, [a], [joint.ours for joint in joints])
    other = paths_of(theirs, [b], [joint.theirs for joint in joints])
    if min(len(own.times_s), len(other.times_s)) < 2:
        return _UNLIKE
    clean = [JointPaths(one.times_s, without_spikes(one.positions), one.groups, one.clock) for one in (own, other)]
    found = candidates(clean[0], clean[1])
    return max((one.sure for one in found), default=_UNLIKE)
