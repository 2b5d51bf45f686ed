"""What a scene is made of: a descriptor for each type of part, looked up by name.

People, hands, arms, bodies, objects and points are part types. A method may bring one of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from mocapella.registry import Table


@dataclass(frozen=True)
class PartType:
    """A type of scene part.

    Attributes:
        interface: of `mocapella.registry`.
        name: key in `Scene.parts`, in the plural: ``people``.
        type: class of the parts.
        encode: a part as its message, or as bytes where ``field`` is empty.
        decode: the message or bytes, and the scene's topology, as a part, checked; raises `WireError`.
        field: of the message ``Scene`` that has them; empty where they travel in ``Scene.parts``, as a plug-in's do.
        counted: one and many, for the view and the summary; None where they are not counted.
        none: what an empty stage says.
        there: whether a part is there at this instant; a part that only waits is not counted.
        drawing: ``module:name`` of a `mocapella.viewer.room.DrawPart`, which draws them life-size; may be empty.
        meter: ``module:name`` of a class with ``update(parts, at_s)`` and ``quality.as_json()``, or empty: how good
            they are.
        meter_name: under which the summary has what the meter says.
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
"""By name."""
