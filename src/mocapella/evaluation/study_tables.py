"""The thesis' tables: Δx Δy Δz Δd between the two sensors' views, by task and placement (docs/evaluation.md).

Δ is the difference of one joint's position in two aligned views; smaller differences mean better extrinsics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import topology

Float64 = NDArray[np.float64]

_KINECT = topology("kinect_v2")
_TORSO_JOINTS = ("SpineBase", "SpineMid", "SpineShoulder", "Neck", "Head", "HipLeft", "HipRight")
TORSO: Final = tuple(_KINECT.index(joint) for joint in (*_TORSO_JOINTS, "ShoulderLeft", "ShoulderRight"))
MAX_WANDER: Final = 3.0
"""Largest `wander_m_per_min` of a valid row; fits to single frames wander more [m/min]."""
_CM: Final = 100.0


class Scored(msgspec.Struct, frozen=True, eq=False):
    """One participant's pairs of one task.

    Attributes:
        participant: Study_Id.
        raw_labels, repaired: (pairs, joints, 4) |Δx|, |Δy|, |Δz| and Δd between the two views [m], with the sensors'
            labels and with the method's; NaN where a view or joint is missing.
        swaps_per_min: number of changes of the method's label decision per minute.
        wander_m_per_min: wander of the estimated motions between the sensors over the whole run, see
            `mocapella.evaluation.causal_run.CausalRun` [m/min].
    """

    participant: int
    raw_labels: Float64
    repaired: Float64
    swaps_per_min: float = 0.0
    wander_m_per_min: float = 0.0


class Count(msgspec.Struct, frozen=True):
    """Amount of data that a row of the tables is computed from.

    Attributes:
        pairs: number of pairs with at least one joint in both views.
        finite_joints: number of such joints over all pairs.
    """

    pairs: int
    finite_joints: int


def differences(views: Float64) -> Float64:
    """Return |Δx|, |Δy|, |Δz| and the distance Δd, (..., joints, 4), between two views (..., 2, joints, 3) [m]."""
    first, second = views[..., 0, :, :], views[..., 1, :, :]
    apart = np.empty((4, *first.shape[:-1]))  # each of the four in one piece: twice as fast as side by side
    np.abs(np.moveaxis(first - second, -1, 0), out=apart[:3])
    np.sqrt(apart[0] * apart[0] + apart[1] * apart[1] + apart[2] * apart[2], out=apart[3])
    return np.moveaxis(apart, 0, -1)


def joint_means(scored: Sequence[Scored], repaired: bool) -> tuple[list[int], Float64]:
    """Compute the mean differences between the two views of each participant, over all of the participant's pairs.

    Args:
        scored: pairs of one task and placement, at least of one participant.
        repaired: whether to use the labels repaired by the method; otherwise the sensors' own.

    Returns:
        The participants' numbers, ascending; and the means (participants, joints, 4) of |Δx|, |Δy|, |Δz| and Δd [m],
        NaN for a joint that is missing in all pairs of a participant.
    """
    participants = sorted({one.participant for one in scored})
    means = []
    for participant in participants:
        all_pairs = np.concatenate(
            [one.repaired if repaired else one.raw_labels for one in scored if one.participant == participant]
        )
        finite = np.isfinite(all_pairs)
        counts = finite.sum(axis=0)
        sums = np.where(finite, all_pairs, 0.0).sum(axis=0)
        means.append(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))
    return participants, np.stack(means)


def count(scored: Sequence[Scored]) -> Count:
    """Count the pairs and joints that both views have, over all of ``scored``."""
    finite = [np.isfinite(one.raw_labels[..., 3]) for one in scored]
    return Count(sum(int(joints.any(axis=-1).sum()) for joints in finite), sum(int(joints.sum()) for joints in finite))


def figures(scored: Sequence[Scored], repaired: bool) -> dict[str, Any]:
    """Return ``dx_cm``, ``dy_cm``, ``dz_cm``, ``dd_cm`` and ``torso_dd_cm`` of one task and placement.

    Each has ``mean`` (over participants, then over joints), ``std`` (over the joints, with N − 1 as in the thesis) and
    ``worst_participant`` (largest mean over the joints) [cm]; NaN if a participant lacks a joint in all pairs.
    ``scored`` and ``repaired`` are as in `joint_means`.
    """
    _, means = joint_means(scored, repaired)
    return {
        **{name: _figure(means[:, :, i]) for i, name in enumerate(("dx_cm", "dy_cm", "dz_cm", "dd_cm"))},
        "torso_dd_cm": _figure(means[:, TORSO, 3]),
    }


def _figure(means: Float64) -> dict[str, float]:
    """Return the figures of means (participants, joints) [m] in cm, see `figures`."""
    mean, std = mean_and_std(means.mean(axis=0))
    return {"mean": mean, "std": std, "worst_participant": float(means.mean(axis=1).max() * _CM)}


def mean_and_std(values: Float64) -> tuple[float, float]:
    """Return the mean and the standard deviation (N − 1) of values (n,) [m] in cm; NaN of too few values."""
    mean = float(values.mean() * _CM) if len(values) else float("nan")
    return mean, float(values.std(ddof=1) * _CM) if len(values) > 1 else float("nan")


def row(scored: Sequence[Scored], as_logged: Count) -> dict[str, Any]:
    """Return a row of the tables: the figures of one task and placement, as a dictionary for JSON.

    Its keys are the keys of `figures`, with repaired labels; ``raw_labels``, the same figures with the sensors' labels;
    ``participants``, ``pairs`` and ``finite_joints``, the numbers of these; ``swaps_per_min``, the mean over the files;
    ``wander_m_per_min``, the largest of any file; and ``problem``, the reason if the row is not valid, else empty.
    Figures may be NaN until they are `rounded`.

    Args:
        scored: scored pairs of all files of this task and placement, at least of one.
        as_logged: numbers of pairs and joints in the logged rows.
    """
    found = count(scored)
    wander = max(one.wander_m_per_min for one in scored)
    return {
        **figures(scored, repaired=True),
        "raw_labels": figures(scored, repaired=False),
        "participants": len({one.participant for one in scored}),
        "pairs": found.pairs,
        "finite_joints": found.finite_joints,
        "swaps_per_min": float(np.mean([one.swaps_per_min for one in scored])),
        "wander_m_per_min": wander,
        "problem": problem(found, as_logged, wander),
    }


def problem(found: Count, as_logged: Count, wander_m_per_min: float) -> str:
    """Return why a row cannot be compared with the others; empty if it can.

    Args:
        found: numbers of the scored pairs and joints.
        as_logged: numbers of pairs and joints in the logged rows, which must be equal.
        wander_m_per_min: wander of the estimated motions between the sensors, at most `MAX_WANDER` [m/min].
    """
    if found != as_logged:
        return (
            f"{found.pairs} pairs and {found.finite_joints} joints, where the log has {as_logged.pairs} and "
            f"{as_logged.finite_joints}: a motion was not known in time"
        )
    if wander_m_per_min > MAX_WANDER:
        return f"the motion between the sensors wanders {wander_m_per_min:.1f} m a minute; {MAX_WANDER:g} is the most"
    return ""


def rounded(value: Any) -> Any:
    """Return a copy with floats rounded to 4 decimals, and non-finite ones as None: JSON has no NaN.

    Mappings, lists and tuples are copied with all they contain, tuples as lists; other values are returned unchanged.
    """
    if isinstance(value, Mapping):
        return {key: rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(inner) for inner in value]
    if isinstance(value, float):
        return round(value, 4) if np.isfinite(value) else None
    return value
