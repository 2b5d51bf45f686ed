"""Score study logs with two people: identity switches at hand-labelled crossings, and Δd of both people.

At a crossing two people pass closely, which is where trackers exchange ids. Identity switches are CLEAR MOT's
(`identity`); Δd is the distance between two sensors' views of a joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import own_toml
from mocapella.evaluation.causal_run import CausalRun
from mocapella.evaluation.identity import IdentityFrame, identity_switches
from mocapella.evaluation.scored_views import TOPOLOGY
from mocapella.evaluation.study_pairs import StudySession

Float64 = NDArray[np.float64]

NEAR: Final = 0.5
"""Largest distance of a person from a matching label [m]; labelled people are 0.48 m apart or more."""
FRESH: Final = 0.3
"""Largest age of a row that defines a person's position [s]."""
_ROOT = TOPOLOGY.parts["root"]
_HORIZONTAL = [0, 2]


class Label(msgspec.Struct, frozen=True, eq=False):
    """People's hand-labelled positions at one instant.

    Attributes:
        at_s: time since the file's first frame [s].
        place: x and z of the joint SpineBase, by person (0 = A, 1 = B), in the reference sensor's camera space [m];
            hidden people are left out.
    """

    at_s: float
    place: Mapping[int, tuple[float, float]]


@cache
def crossings() -> dict[str, tuple[Label, ...]]:
    """Return the labels of all files, by the file's name without its endings."""
    data = own_toml("mocapella.evaluation", "crossings.toml")
    return {name: tuple(_label(*label) for label in entry["labels"]) for name, entry in data.items()}


def _label(at_s: float, *places: Sequence[float]) -> Label:
    return Label(at_s, {person: (place[0], place[1]) for person, place in enumerate(places) if place})


def labels_of(session: StudySession) -> tuple[Label, ...]:
    """Return a file's labels; empty if it is not labelled."""
    return crossings().get(session.name.removesuffix(".gz").removesuffix(".csv"), ())


def people_as_logged(session: StudySession, at_s: float) -> dict[int, Float64]:
    """Return the people's positions at a time, as logged in 2015.

    Args:
        session: the study log.
        at_s: the time since the file's first frame [s].

    Returns:
        Position (3,) of SpineBase by Person_Id, in the reference sensor's camera space [m]: the mean over the sensors
        of the newest row with a finite position. Rows after ``at_s``, or more than `FRESH` s before it, do not count;
        a person without a row is left out.
    """
    found = {}
    recent = (session.at_s <= at_s + 1e-9) & (session.at_s >= at_s - FRESH)
    for person in np.unique(session.log.person_id[recent]).tolist():
        newest = []
        for sensor in range(len(session.replay.sensors)):
            rows = np.flatnonzero(recent & (session.log.person_id == person) & (session.sensor == sensor))
            rows = rows[np.isfinite(session.log.positions[rows, _ROOT, 0])]
            if len(rows):
                row = rows[np.argmax(session.at_s[rows])]
                newest.append(session.log.positions[row, _ROOT].astype(np.float64))
        if newest:
            found[int(person)] = np.mean(newest, axis=0)
    return found


def people_of_run(run: CausalRun, at_s: float) -> dict[int, Float64]:
    """Return the people's positions in the newest scene of a run at a time.

    Args:
        run: a method's estimates.
        at_s: the time since the file's first frame [s].

    Returns:
        Position (3,) of SpineBase by person's id, in the reference sensor's camera space [m]; people without a finite
        one are left out.
    """
    step = int(np.searchsorted(run.at_ns, run.at_ns[0] + round(at_s * 1e9), side="right")) - 1
    found = {person.id: person.positions[_ROOT] for person in run.people[step]}
    return {person: place for person, place in found.items() if np.isfinite(place).all()}


def label_frame(label: Label, found: Mapping[int, Float64]) -> IdentityFrame:
    """Return a label and the people found at its instant as a frame of the identity metrics.

    The similarity is max(0, 1 − d / (2·`NEAR`)) for a horizontal distance d.

    Args:
        label: the true positions.
        found: position (3,) of SpineBase by the tracker's id, in the reference sensor's camera space [m].
    """
    true = np.array(list(label.place.values())).reshape(-1, 1, 2)
    places = np.array([place[_HORIZONTAL] for place in found.values()]).reshape(1, -1, 2)
    alike = np.maximum(0.0, 1 - np.linalg.norm(true - places, axis=-1) / (2 * NEAR))
    return IdentityFrame(tuple(label.place), tuple(found), alike)


def identity_figures(frames: Sequence[IdentityFrame]) -> dict[str, int]:
    """Return the numbers of labelled people (``labels``), of these not found (``missed``), and ``identity_switches``.

    A person is found within `NEAR` of the label. ``frames`` are results of `label_frame` for a file, in order of time.
    """
    labels = sum(len(frame.true_ids) for frame in frames)
    missed = sum(int((frame.similarity.max(axis=1, initial=0.0) < 0.5).sum()) for frame in frames)
    return {"labels": labels, "missed": missed, "identity_switches": identity_switches(frames)}


def distance_figures(apart: Float64) -> dict[str, float]:
    """Return median, mean and 95th percentile of Δd over pairs of views: ``median_cm``, ``mean_cm`` and ``p95_cm``.

    Δd of a pair is the mean over its joints. All three figures are NaN if no pair counts.

    Args:
        apart: (pairs, joints) distance Δd between both views of a joint [m]; joints that are NaN or infinite, and pairs
            without any other, do not count.
    """
    finite = np.isfinite(apart)
    some = finite.any(axis=1)
    means = np.where(finite, apart, 0.0)[some].sum(axis=1) / finite[some].sum(axis=1) * 100
    if not len(means):
        return dict.fromkeys(("median_cm", "mean_cm", "p95_cm"), float("nan"))
    figures: dict[str, Any] = {
        "median_cm": np.median(means),
        "mean_cm": means.mean(),
        "p95_cm": np.percentile(means, 95),
    }
    return {name: float(value) for name, value in figures.items()}
