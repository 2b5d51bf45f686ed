"""Part types: a descriptor for each type of scene content, found by name.

People, hands, arms, bodies, objects and points are part types. A method may add its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from mocapella.registry import Table


@dataclass(frozen=True)
class PartType:
    """The descriptor of a type of scene part.

    Attributes:
        interface: of `mocapella.registry`.
        name: key in `Scene.parts`, in the plural: ``people``.
        type: class of the parts.
        encode: returns a part's message, or bytes if ``field`` is empty.
        decode: returns the part of such a message or bytes and the scene's topology, validated; raises `WireError`.
        field: of the message ``Scene`` that has them; empty if they are in ``Scene.parts``, like a plug-in's.
        counted: singular and plural noun, for the view and the summary; None if they are not counted.
        none: text that the view shows while there are no parts.
        there: whether a part is present at this instant; parts that only wait are not counted.
        drawing: ``module:name`` of a `mocapella.viewer.room.DrawPart`, which draws them life-size; may be empty.
        meter: ``module:name`` of a class with ``update(parts, at_s)`` and ``quality.as_json()``, or empty: their
            quality.
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
