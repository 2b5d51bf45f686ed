"""Access rights on the bus: its users, their rights, and zenoh's access control made of them.

A *user* is no person but a role that a key gives: ``sensor``, ``sensor.NAME`` (only that sensor), ``reader`` or
``operator``, the last two also with ``+pictures``. Whatever no rule allows is denied, in both directions, and only the
server may publish scenes and status, and answer commands. docs/wire.md has the table for other languages.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

from mocapella.errors import SettingsError
from mocapella.model.observations import check_sensor_name

SENSOR: Final = "sensor"
READER: Final = "reader"
OPERATOR: Final = "operator"
PICTURES: Final = "+pictures"
EVERYTHING: Final = OPERATOR + PICTURES
"""The user with all rights of readers; readers that hold the session's own key are admitted as it."""
READERS: Final = (EVERYTHING, OPERATOR, READER + PICTURES, READER)
"""Users that may read results, the one with most rights first."""

_MOST_OWN_NAME: Final = 64 - len(f"{SENSOR}.")
"""A common name has at most 64 letters."""
_ROOT: Final = "mocapella/v1"
_IN: Final = "ingress"
_OUT: Final = "egress"


class _Right(NamedTuple):
    """Messages on keys that may pass in one direction, seen from the server; ``{s}`` is the sensor's name or ``*``."""

    flow: str
    messages: tuple[str, ...]
    keys: tuple[str, ...]


_FRAMES: Final = ("live/{s}/*", "truth/{s}/*")
_EXPECTED: Final = ("expect/{s}/*",)
_ANSWERS: Final = ("clock/{s}/*", "ask/{s}/*", "record/{s}/*")
_RIGHTS: Final[dict[str, tuple[_Right, ...]]] = {
    SENSOR: (
        _Right(_IN, ("put",), _FRAMES),
        _Right(_IN, ("declare_queryable", "reply"), _ANSWERS),
        _Right(_IN, ("liveliness_token",), ("alive/sensor/{s}/*",)),
        _Right(_IN, ("declare_subscriber",), _EXPECTED),
        _Right(_OUT, ("put",), _EXPECTED),
        _Right(_IN, ("query",), ("join/{s}/*", "leave/{s}/*")),
        _Right(_OUT, ("declare_subscriber",), _FRAMES),
        _Right(_OUT, ("query",), _ANSWERS),
        _Right(_OUT, ("liveliness_query", "declare_liveliness_subscriber"), ("alive/sensor/{s}/*",)),
    ),
    "joining": (
        _Right(_IN, ("liveliness_query", "declare_liveliness_subscriber"), ("alive/server",)),
        _Right(_OUT, ("reply", "declare_queryable"), ("join/*/*", "leave/*/*")),
        _Right(_OUT, ("liveliness_token",), ("alive/server",)),
        _Right(_OUT, ("declare_subscriber",), ("live/*/*", "truth/*/*")),
        _Right(_OUT, ("liveliness_query", "declare_liveliness_subscriber"), ("alive/sensor/*/*",)),
    ),
    READER: (
        _Right(_IN, ("declare_subscriber",), ("scene", "status")),
        _Right(_OUT, ("put",), ("scene", "status")),
        _Right(_IN, ("query",), ("command/status",)),
        _Right(_OUT, ("reply", "declare_queryable"), ("command/*",)),
        _Right(_IN, ("liveliness_query", "declare_liveliness_subscriber"), ("alive/server",)),
        _Right(_OUT, ("liveliness_token",), ("alive/server",)),
    ),
    OPERATOR: (_Right(_IN, ("query",), ("command/*",)),),
    PICTURES: (
        _Right(_IN, ("declare_subscriber",), ("live/*/*",)),
        _Right(_OUT, ("put",), ("live/*/*",)),
    ),
    EVERYTHING: (
        _Right(_IN, ("query",), ("ask/*/*",)),
        _Right(_OUT, ("reply", "declare_queryable"), ("ask/*/*",)),
        _Right(_IN, ("liveliness_query", "declare_liveliness_subscriber"), ("alive/sensor/*/*",)),
        _Right(_OUT, ("liveliness_token",), ("alive/sensor/*/*",)),
    ),
}
"""Rights by the part of a user's name that gives them."""


def check_user(name: str) -> str:
    """Return ``name`` unchanged if it is a user: ``sensor``, ``sensor.NAME``, or one of `READERS`.

    Raises:
        SettingsError: it is not; names the valid ones.
    """
    role, dot, sensor = name.partition(".")
    if role == SENSOR:
        if dot and len(check_sensor_name(sensor)) > _MOST_OWN_NAME:
            raise SettingsError(f"a sensor with a key of its own has a name of at most {_MOST_OWN_NAME} letters")
        return name
    if name not in READERS:
        known = ", ".join((SENSOR, f"{SENSOR}.NAME", *reversed(READERS)))
        raise SettingsError(f"unknown role {name[:80]!r}; known: {known}")
    return name


def sensor_of(user: str) -> str:
    """Return NAME for the user ``sensor.NAME``; an empty text for every other user."""
    role, _, sensor = user.partition(".")
    return sensor if role == SENSOR else ""


def users_of(sensors: Iterable[str]) -> tuple[str, ...]:
    """Return all users of a session whose sensors of these names have keys of their own."""
    return (SENSOR, *(f"{SENSOR}.{name}" for name in sensors), *READERS)


def access_control(sensors: Sequence[str]) -> dict[str, Any]:
    """Return zenoh's configuration ``access_control`` of a session's server; users are certificates' common names.

    Args:
        sensors: names of the sensors that have keys of their own; the key of all sensors does not serve these.
    """
    rules: list[dict[str, Any]] = []
    policies = []
    for user in users_of(sensors):
        own = [_rule(f"{user} {number}", "allow", right) for number, right in enumerate(_rights_of(user))]
        if user == SENSOR:
            own += _denials(sensors)
        rules += own
        policies.append({"subjects": [user], "rules": [rule["id"] for rule in own]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": user, "cert_common_names": [user]} for user in users_of(sensors)],
        "policies": policies,
    }


def _rights_of(user: str) -> Iterator[_Right]:
    sensor = sensor_of(user) or "*"
    parts = [SENSOR, "joining"] if user.partition(".")[0] == SENSOR else [READER]
    if user.startswith(OPERATOR):
        parts.append(OPERATOR)
    if user.endswith(PICTURES):
        parts.append(PICTURES)
    if user == EVERYTHING:
        parts.append(EVERYTHING)
    for part in parts:
        for right in _RIGHTS[part]:
            yield right._replace(keys=tuple(key.format(s=sensor) for key in right.keys))


def _denials(sensors: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield rules that deny the user ``sensor`` to serve sensors that have keys of their own."""
    for name in sensors:
        for number, right in enumerate(right for right in _RIGHTS[SENSOR] if right.flow == _IN):
            keys = tuple(key.format(s=name) for key in right.keys)
            yield _rule(f"not {name} {number}", "deny", right._replace(keys=keys))
        asked = _Right(_OUT, ("query",), tuple(key.format(s=name) for key in _ANSWERS))
        yield _rule(f"not {name} asked", "deny", asked)
        told = _Right(_OUT, ("put",), tuple(key.format(s=name) for key in _EXPECTED))
        yield _rule(f"not {name} told", "deny", told)


def _rule(name: str, permission: str, right: _Right) -> dict[str, Any]:
    return {
        "id": name,
        "permission": permission,
        "flows": [right.flow],
        "messages": list(right.messages),
        "key_exprs": [f"{_ROOT}/{key}" for key in right.keys],
    }
