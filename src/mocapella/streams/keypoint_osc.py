"""Keypoints of scenes as OSC messages, in the world: right-handed, metres, y up.

| address | arguments |
|---|---|
| ``/mocapella/KIND`` | names of the individuals that are there now, one text each; none if nobody is |
| ``/mocapella/KIND/NAME/KEYPOINT`` | x y z [m], state (2 measured, 1 inferred), standard deviation [m], −1 if unknown |

KIND is ``people``, ``hands``, ``arms``, ``bodies``, ``objects`` or ``points``. Keypoints that are not tracked are not
sent. Characters that OSC reserves, such as spaces, are ``_`` in addresses.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mocapella.model.names import distinct
from mocapella.model.scene import Scene
from mocapella.model.trajectories import PARTS, IndividualRow
from mocapella.schema.osc_messages import osc_bundles, osc_message, osc_name


class KeypointOsc:
    """Encoder of all individuals of a scene, or of named ones.

    Args:
        individuals: names of the individuals, such as ``person_0``; empty for all.
    """

    def __init__(self, individuals: tuple[str, ...] = ()) -> None:
        self._individuals = individuals
        self._sent: set[str] = set()

    def datagrams(self, scene: Scene) -> list[bytes]:
        """Return the bundles of a scene. A kind without individuals is named once more, empty, after it had some."""
        return list(osc_bundles(self._messages(scene)))

    def _messages(self, scene: Scene) -> Iterator[bytes]:
        for kind, rows in PARTS.items():
            there = [row for row in rows(scene) if not self._individuals or row.name in self._individuals]
            if there or kind in self._sent or kind in scene.parts:
                names = list(distinct(row.name for row in there))
                yield osc_message(f"/mocapella/{kind}", *names)
                for name, row in zip(names, there, strict=True):
                    yield from _keypoints(f"/mocapella/{kind}/{osc_name(name)}", row)
            (self._sent.add if there else self._sent.discard)(kind)


def _keypoints(address: str, row: IndividualRow) -> Iterator[bytes]:
    known = np.isfinite(row.positions).all(axis=1) & (row.states > 0)
    sd = np.full(len(known), -1.0) if row.sd is None else np.where(np.isfinite(row.sd), row.sd, -1.0)
    for k in np.flatnonzero(known).tolist():
        x, y, z = row.positions[k].tolist()
        yield osc_message(f"{address}/{osc_name(row.keypoints[k])}", x, y, z, int(row.states[k]), float(sd[k]))
