"""Decode the fused people of many scenes at once; their views, sensors and other parts are left out.

A scene is parsed, but its arrays stay bytes until all are joined and checked. This is several times as fast as
`decode_scene`, which makes an array of each.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from mocapella.errors import WireError
from mocapella.model.limits import SCENE_COORDINATE
from mocapella.model.names import distinct
from mocapella.model.trajectories import Block, TimeAxis, Trajectories, assembled, person_name
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import (
    F4,
    F8,
    MAX_SCENE_BYTES,
    STATES,
    U1,
    known_topology,
    parse,
    sensor_name,
)  # fmt: skip


class PeopleColumns:
    """Collects the fused people of scenes in the order of storage."""

    def __init__(self) -> None:
        self._times: list[tuple[int, int]] = []
        self._by_sensor: dict[tuple[int, str], list[int]] = {}
        self._rows: dict[tuple[int, str, str], tuple[list[int], list[bytes], list[bytes], list[bytes]]] = {}

    def add(self, run: int, wall_ns: int, data: bytes) -> None:
        """Add a scene.

        Args:
            run: number of the tracker's run.
            wall_ns: time to add to the scene's capture time, so that it is since 1970 [ns].
            data: the encoded scene.

        Raises:
            SchemaVersionError, WireError: as `decode_scene`, for these fields.
        """
        m = parse(pb.Scene, data, MAX_SCENE_BYTES)
        number, at_ns = len(self._times), m.at_ns + wall_ns
        self._times.append((run, at_ns))
        self._by_sensor.setdefault((run, m.sensor), []).append(at_ns)
        for name, person in zip(distinct(map(person_name, m.people)), m.people, strict=True):
            key = (run, name, m.topology)
            scenes, positions, states, sd = self._rows.setdefault(key, ([], [], [], []))
            scenes.append(number)
            positions.append(person.positions_m)
            states.append(person.joint_states)
            sd.append(person.joint_sd_m)

    def trajectories(self) -> Trajectories | None:
        """Return the trajectories of the people; None if no scene has any.

        Raises:
            WireError: a scene has an invalid value, which `decode_scene` names.
        """
        for _, sensor in self._by_sensor:
            sensor_name(sensor)
        blocks = [block for key, rows in self._rows.items() for block in _blocks(key, *rows)]
        return assembled("people", blocks, TimeAxis.of(self._times, self._by_sensor)) if blocks else None


def _blocks(
    key: tuple[int, str, str], scenes: list[int], positions: list[bytes], states: list[bytes], sd: list[bytes]
) -> Iterator[Block]:
    run, name, topology = key
    kind = known_topology(topology)
    known: dict[bool, list[int]] = {True: [], False: []}
    for k, one in enumerate(sd):
        known[bool(one)].append(k)
    for with_sd, rows in known.items():
        if rows:
            values = _array([positions[k] for k in rows], F8, 3 * len(kind), "Person.positions_m")
            if (np.abs(values) > SCENE_COORDINATE.high).any():
                raise WireError("Person.positions_m has a coordinate out of range")
            own = _array([states[k] for k in rows], U1, len(kind), "Person.joint_states")
            if not np.isin(own, np.frombuffer(STATES, np.uint8)).all():
                raise WireError("Person.joint_states has an unknown state")
            certain = _array([sd[k] for k in rows], F4, len(kind), "Person.joint_sd_m") if with_sd else None
            if certain is not None and ((certain < 0).any() or np.isinf(certain).any()):
                raise WireError("Person.joint_sd_m has a value that is no standard deviation")
            yield Block(
                run, name, np.array([scenes[k] for k in rows]), (kind.joints, kind.bones, ()),
                values.reshape(len(rows), len(kind), 3), own, certain,
            )  # fmt: skip


def _array(rows: list[bytes], dtype: np.dtype[Any], count: int, field: str) -> Any:
    if any(len(row) != count * dtype.itemsize for row in rows):
        raise WireError(f"{field} has not {count} values")
    return np.frombuffer(b"".join(rows), dtype).reshape(len(rows), count)
