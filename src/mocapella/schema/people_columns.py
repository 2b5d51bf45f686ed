"""Decode the fused people of many scenes at once, by compiled kernels. Importing this imports numba.

Views, sensors and other parts are left out. This is many times as fast as `decode_scene`, which makes an array of each.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import SCHEMA_VERSION
from mocapella.errors import WireError
from mocapella.model.limits import SCENE_COORDINATE
from mocapella.model.topology import Topology
from mocapella.model.trajectories import Block, person_name
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import F4, F8, MAX_SCENE_BYTES, STATES, U1, known_topology
from mocapella.schema.people_kernels import (
    COLUMNS,
    ID,
    NAME,
    POSITIONS,
    SCENE,
    SD,
    TOPOLOGY,
    gather,
    list_people,
    number_texts,
)
from mocapella.schema.people_kernels import STATES as JOINT_STATES
from mocapella.schema.wire_kernels import BYTES, MESSAGE
from mocapella.schema.wire_shapes import shapes_of

Int64 = NDArray[np.int64]

_WHOLE: Final = shapes_of(pb.Scene, pb.Person)
_SHAPES: Final = np.where(_WHOLE >= MESSAGE, np.int8(BYTES), _WHOLE)
"""Messages within a scene or person are not read, because the take's index has checked them."""
_KINDS: Final = np.array([0, 1])
_FIELDS: Final = np.array(
    [pb.Scene.DESCRIPTOR.fields_by_name[name].number for name in ("schema_version", "topology", "people")]
    + [
        pb.Person.DESCRIPTOR.fields_by_name[name].number
        for name in ("id", "name", "positions_m", "joint_states", "joint_sd_m")
    ]
)
_MOST_TEXTS: Final = 256
_PEOPLE_A_SCENE: Final = 4


def people_blocks(run: int, scenes: Int64, data: bytes, begins: Int64, lengths: Int64) -> Iterator[Block]:
    """Yield the rows of the people of some scenes of one run.

    Args:
        run: number of the tracker's run.
        scenes: (n,) numbers of the scenes.
        data: bytes with the encoded scenes.
        begins, lengths: (n,) first byte and size of each; within ``data``.

    Raises:
        WireError: a scene or a value is unusual or invalid, or two people of a scene have the same name; `decode_scene`
            reads the one, and names the other.
    """
    array = np.frombuffer(data, np.uint8)
    rows = np.empty((_PEOPLE_A_SCENE * len(begins), COLUMNS), np.int64)
    while (count := list_people(array, begins, begins + lengths, _SHAPES, _KINDS, _FIELDS, SCHEMA_VERSION, rows)) == -2:
        rows = np.empty((2 * len(rows), COLUMNS), np.int64)
    if count < 0 or lengths.max(initial=0) > MAX_SCENE_BYTES:
        raise WireError("Scene is unusual")
    rows = rows[:count]
    topologies, topology = _texts(array, rows, TOPOLOGY)
    names, name = _texts(array, rows, NAME)
    ids, person_of = np.unique(np.where(rows[:, NAME + 1] > 0, 0, rows[:, ID]), return_inverse=True)
    key = (topology * len(names) + name) * len(ids) + person_of
    used: set[tuple[int, str]] = set()
    for one in np.unique(key).tolist():
        kind, called = divmod(one // len(ids), len(names))
        person = int(ids[one % len(ids)])
        own = rows[key == one]
        who = person_name(names[called], person % (1 << 64))
        if (kind, who) in used or (np.diff(own[:, SCENE]) <= 0).any():
            raise WireError("Person.name is not unique in its scene")
        used.add((kind, who))
        for some in (own[own[:, SD + 1] > 0], own[own[:, SD + 1] == 0]):
            if len(some):
                found = _decoded(array, some, known_topology(topologies[kind]))
                yield Block(run, who, scenes[some[:, SCENE]], *found)


def _texts(data: NDArray[np.uint8], rows: Int64, column: int) -> tuple[list[str], Int64]:
    """Return the different texts in a column, and the index of each row's."""
    first, out = np.empty(_MOST_TEXTS, np.int64), np.empty(len(rows), np.int64)
    places, sizes = rows[:, column], rows[:, column + 1]
    count = number_texts(data, places, sizes, first, out)
    if count < 0:
        raise WireError(f"Scene has more than {_MOST_TEXTS} different names")
    return [data[places[i] : places[i] + sizes[i]].tobytes().decode() for i in first[:count].tolist()], out


def _decoded(data: NDArray[np.uint8], rows: Int64, kind: Topology) -> tuple[Any, NDArray[Any], NDArray[Any], Any]:
    """Return layout, positions, states and standard deviations of rows with equal sizes."""
    values = _values(data, rows, POSITIONS, 3 * len(kind) * F8.itemsize, "Person.positions_m").view(F8)
    if (np.abs(values) > SCENE_COORDINATE.high).any():
        raise WireError("Person.positions_m has a coordinate out of range")
    states = _values(data, rows, JOINT_STATES, len(kind) * U1.itemsize, "Person.joint_states")
    if states.max(initial=0) > max(STATES):
        raise WireError("Person.joint_states has an unknown state")
    sd = None
    if rows[0, SD + 1]:
        sd = _values(data, rows, SD, len(kind) * F4.itemsize, "Person.joint_sd_m").view(F4)
        if (sd < 0).any() or np.isinf(sd).any():
            raise WireError("Person.joint_sd_m has a value that is no standard deviation")
    return (kind.joints, kind.bones, ()), values.reshape(len(rows), len(kind), 3), states, sd


def _values(data: NDArray[np.uint8], rows: Int64, column: int, size: int, field: str) -> NDArray[np.uint8]:
    if (rows[:, column + 1] != size).any():
        raise WireError(f"{field} has not {size} bytes")
    out = np.empty((len(rows), size), np.uint8)
    gather(data, rows[:, column], out)
    return out
