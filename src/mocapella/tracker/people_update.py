"""Assign one frame's bodies to people, and fuse them.

Global nearest neighbour assigns a body to a track (`mocapella.association.tracks`); the person's views are then fused
and filtered (`mocapella.tracker.people`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocapella.association.tracks import Tracks
from mocapella.model.bodies import Bodies, id_array
from mocapella.model.observations import BodyFrame
from mocapella.tracker.people import People
from mocapella.tracker.people_memory import FrameViews

Float64 = NDArray[np.float64]


def associate_and_fuse(  # noqa: PLR0917 - one frame, as it comes
    tracks: Tracks,
    people: People,
    frame: BodyFrame,
    bodies: Bodies,
    T: Float64,
    corrections: Float64 | None = None,
    *,
    at_s: float,
    now_s: float,
) -> None:
    """Assign the bodies of a sensor's frame to people, and update all people; for each frame of a calibrated sensor.

    Args:
        tracks, people: identities of the tracked people, and their motion; both are updated in place.
        frame, bodies: a sensor's frame, and its tracked bodies, without rejected ones.
        T: (4, 4) from the sensor's camera space to the space of the people.
        corrections: (bodies, joints, 3) correction of the sensor's bias, to add to the joints in camera space [m]; None
            for none.
        at_s, now_s: capture time of the frame, and the newest capture time so far, on the common clock [s].
    """
    prepared = people.prepare(bodies, T, now_s)
    rows = tracks.update(bodies.sensor, bodies.ids, prepared.middles, prepared.expected, at_s, prepared.lengths)
    for stays, gone in tracks.merged:
        people.join(stays, gone)
    people.arrange(tracks.people)
    ids: Sequence[int] = bodies.ids
    positions, states, own = prepared.positions, bodies.states, bodies.positions
    if corrections is None:
        bias = np.zeros(positions.shape)
    else:
        bias = np.dot(corrections.reshape(-1, 3), T[:3, :3].T).reshape(positions.shape)
    if -1 in rows.tolist():
        shown = rows >= 0
        ids = [body for body, is_shown in zip(ids, shown.tolist(), strict=True) if is_shown]
        rows, positions, states, own, bias = rows[shown], positions[shown], states[shown], own[shown], bias[shown]
    clipped = np.zeros(len(rows), dtype=np.bool_)
    if any(frame.clipped_edges.tolist()):
        edges = dict(zip(frame.tracking_ids.tolist(), frame.clipped_edges.tolist(), strict=True))
        clipped[:] = [edges[body] > 0 for body in ids]
    new = FrameViews(
        rows, id_array(ids), people.column(bodies.sensor), at_s, positions, states, own, bias,
        np.ascontiguousarray(T[:3, 3]), clipped, frame.topology.noise, frame.topology.scale_sd,
    )  # fmt: skip
    people.update(new, now_s)
