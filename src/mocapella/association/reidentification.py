"""Recognise a body that a sensor lost and detects again under a new tracking id.

The thesis' logs show that its program did not recalibrate when a sensor lost a person behind an obstacle and detected
them again, although a Kinect assigns a new id then. Its method is not known; this is ours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocapella.geometry.rigid import apply
from mocapella.model.bodies import Bodies
from mocapella.model.observations import JointState
from mocapella.model.scene import Person


def reidentified(bodies: Bodies, people: Sequence[Person], within_m: float) -> dict[int, int]:
    """Match a sensor's new bodies with those it has lost.

    A new body is transformed to the world by each lost view's ``T_world_sensor``, and compared with that person's fused
    skeleton by the mean distance of the joints that both track. The closest are matched first, each body and person
    once. A pair without a common tracked joint is not matched.

    Args:
        bodies: bodies of the sensor's new frame, in its camera space.
        people: the people before that frame; a person whom the sensor has lost keeps a view of it.
        within_m: matches must be nearer than this; 0 matches none [m].

    Returns:
        The new tracking id of each lost one, by the lost tracking id; empty if no body is recognised.
    """
    candidates: list[tuple[float, int, int]] = []
    views = [(person, view) for person in people if (view := person.view_of(bodies.sensor)) is not None]
    known = {view.tracking_id for _, view in views}
    for person, view in views:
        if view.tracking_id in bodies.ids:
            continue
        for i, body in enumerate(bodies.ids):
            common = (bodies.states[i] == JointState.TRACKED) & (person.states == JointState.TRACKED)
            if body in known or not common.any():
                continue
            step = apply(view.T_world_sensor, bodies.positions[i, common]) - person.positions[common]
            candidates.append((float(np.sqrt((step * step).sum(axis=-1)).mean()), view.tracking_id, body))
    found: dict[int, int] = {}
    for distance_m, lost, body in sorted(candidates):
        if distance_m < within_m and lost not in found and body not in found.values():
            found[lost] = body
    return found
