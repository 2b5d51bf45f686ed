"""Part types: a descriptor for each type of scene content, found by name.

People, hands, arms, bodies, objects and points are part types. A method may add its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from mocapella.model.names import plural
from mocapella.registry import Table


@dataclass(frozen=True)
class PartType:
    """The descriptor of a type of scene part.

    Attributes:
        interface: version of the descriptor's interface, see `mocapella.registry`.
        name: key in `Scene.parts`, in the plural: ``people``.
        type: class of the parts.
        encode: function that encodes a part as a message, or as bytes if ``field`` is empty.
        decode: function of a message or bytes and the scene's topology that returns the validated part; raises
            `WireError`.
        field: field of the protobuf message ``Scene`` that contains the parts; empty if they are in its ``parts``, like
            a plug-in's.
        counted: singular and plural noun, for the view and the summary; None if they are not counted.
        none: text that the view shows while there are no parts.
        there: function that returns whether a part is present now; others, such as a body that has not appeared yet,
            are not counted.
        drawing: ``module:name`` of a `mocapella.viewer.room.DrawPart`, which draws them life-size; may be empty.
        meter: ``module:name`` of a class that measures the parts' quality, with ``update(parts, at_s)`` and
            ``quality.as_json()``; may be empty.
        meter_name: key of the meter's values in the summary.
    """

    interface: int
    name: str
    type: type
    encode: Callable[[Any], Any]
    decode: Callable[[Any, Any], Any]
    field: str = ""
    counted: tuple[str, str] | None = None
    none: str = ""
    there: Callable[[Any], bool] = lambda part: True
    drawing: str = ""
    meter: str = ""
    meter_name: str = ""


PART_TYPES: Final = Table("mocapella.part_types", PartType, "part type")
"""Part types by name."""


def counted(count: int, name: str) -> str:
    """Return a number of parts with the noun of their type, such as ``1 person``.

    Args:
        count: number of parts.
        name: name of the type, which is itself the noun of an unknown type and of one without a noun.
    """
    kind = PART_TYPES.get(name)
    return f"{count} {name}" if kind is None or kind.counted is None else plural(count, *kind.counted)
