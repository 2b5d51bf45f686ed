"""Assign one frame's bodies to people, and fuse them.

Global nearest neighbour assigns a body to a track (`mocapella.association.tracks`); the person's views are then fused
and filtered (`mocapella.tracker.people`). Usually both are one compiled call. In a frame with a new, lost or doubtful
person, the tracks decide between its two parts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.association.tracks import UNASSIGNED, UNFINISHED, Tracks
from mocapella.model.bodies import Bodies, id_array
from mocapella.model.observations import BodyFrame
from mocapella.tracker.people import People
from mocapella.tracker.people_memory import Bools, SensorBodies

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
    sensor, ids = bodies.sensor, bodies.ids
    column, track_column = people.column(sensor), tracks.column(sensor, len(people.middle))
    if corrections is None:
        corrections = np.empty((0, *bodies.positions.shape[1:]))
    new = SensorBodies(
        id_array(ids), np.empty(len(ids), dtype=np.int64), False, column, track_column, at_s,
        np.ascontiguousarray(bodies.positions), np.ascontiguousarray(bodies.states), corrections,
        np.ascontiguousarray(T), _clipped(frame, bodies), frame.topology.noise, frame.topology.scale_sd,
    )  # fmt: skip
    events = UNASSIGNED
    if people.numbers == tracks.people:
        events = people.update(new, tracks.inputs, now_s)
    if not events & UNASSIGNED:
        rows = tracks.settle(sensor, ids, new.rows, events, at_s)
        if not events & UNFINISHED:
            return
    else:
        prepared = people.prepare(bodies, T, now_s)
        rows = tracks.update(sensor, ids, prepared.middles, prepared.expected, at_s, prepared.lengths)
    for stays, gone in tracks.merged:
        people.join(stays, gone)
    people.arrange(tracks.people)
    people.update(_assigned(new, rows), tracks.inputs, now_s)


def _clipped(frame: BodyFrame, bodies: Bodies) -> Bools:
    """Return which of the bodies are cut off at an edge of the image (bodies,)."""
    clipped = np.zeros(len(bodies.ids), dtype=np.bool_)
    if any(frame.clipped_edges.tolist()):
        edges = dict(zip(frame.tracking_ids.tolist(), frame.clipped_edges.tolist(), strict=True))
        clipped[:] = [edges[body] > 0 for body in bodies.ids]
    return clipped


def _assigned(bodies: SensorBodies, rows: NDArray[np.int64]) -> SensorBodies:
    """Return the bodies that have a row, with their rows (bodies,)."""
    shown = rows >= 0
    of_bodies = ("positions", "states", "clipped")
    parts = {name: getattr(bodies, name)[shown] for name in of_bodies}
    corrections = bodies.corrections[shown] if len(bodies.corrections) else bodies.corrections
    ids = id_array(bodies.ids[shown].tolist())
    return bodies._replace(ids=ids, rows=rows[shown], assigned=True, corrections=corrections, **parts)
