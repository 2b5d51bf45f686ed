"""Keys (addresses of messages) on the bus, as zenoh key expressions. `docs/wire.md` lists them for other languages.

``v1`` is the version of these keys; the messages carry the schema's own.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from mocapella.errors import SettingsError, WireError
from mocapella.model.observations import check_sensor_name

_ROOT = "mocapella/v1"
SCENE = f"{_ROOT}/scene"
STATUS = f"{_ROOT}/status"
SERVER_ALIVE = f"{_ROOT}/alive/server"
ALL_LIVE = f"{_ROOT}/live/*/*"
ALL_RECORD = f"{_ROOT}/record/*/*"
ALL_TRUTH = f"{_ROOT}/truth/*/*"
ALL_JOIN = f"{_ROOT}/join/*/*"
ALL_LEAVE = f"{_ROOT}/leave/*/*"
ALL_SENSORS_ALIVE = f"{_ROOT}/alive/sensor/*/*"
ALL_COMMANDS = f"{_ROOT}/command/*"

_NODE_ID = re.compile(r"[0-9a-f]{16}")


class NodeKey(NamedTuple):
    """A sensor and the process (node) that serves it.

    Attributes:
        sensor: name of the sensor.
        node_id: random number, from 1 to 2**63, that the node draws at its start.
    """

    sensor: str
    node_id: int


def of_node(kind: str, node: NodeKey) -> str:
    """Return ``mocapella/v1/<kind>/<sensor>/<node id as 16 hex digits>``; kind: live, record, truth, clock, ask,
    expect, join, leave, alive/sensor.

    Raises:
        SettingsError: the sensor's name is invalid.
    """
    return f"{_ROOT}/{kind}/{check_sensor_name(node.sensor)}/{node.node_id:016x}"


def asking(sensor: str) -> str:
    """Return ``mocapella/v1/ask/<sensor>/*``: the queryable of whichever node serves a sensor.

    Raises:
        SettingsError: the sensor's name is invalid.
    """
    return f"{_ROOT}/ask/{check_sensor_name(sensor)}/*"


def node_of(key: str) -> NodeKey:
    """Return the sensor and node of a key made by `of_node`.

    Raises:
        WireError: the key has another form, or an invalid sensor name.
    """
    try:
        sensor, node_id = key.split("/")[-2:]
        return NodeKey(check_sensor_name(sensor), parse_node_id(node_id))
    except (ValueError, SettingsError, WireError) as error:
        raise WireError(f"key {key[:120]!r} does not end in /<sensor>/<node id as 16 hex digits>") from error


def parse_node_id(text: str) -> int:
    """Return the node id from its text at the end of a key. Only one form is valid, so that a node has one key.

    Raises:
        WireError: the text is not 16 lower-case hex digits.
    """
    if not _NODE_ID.fullmatch(text):
        raise WireError(f"node id {text[:40]!r} is not 16 lower-case hex digits, such as 00000000000000ff")
    return int(text, 16)


def of_command(verb: str) -> str:
    """Return the key of a command, ``mocapella/v1/command/<verb>``."""
    return f"{_ROOT}/command/{verb}"
