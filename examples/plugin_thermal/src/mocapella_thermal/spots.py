"""The part type of the method: hot spots in the world."""

import msgspec

from mocapella.errors import WireError
from mocapella.model.part_types import PartType


class Spot(msgspec.Struct, frozen=True):
    """A hot spot: (x, z) on the floor [m], the temperature [°C], and the cameras that see it."""

    id: int
    x: float
    z: float
    celsius: float
    cameras: tuple[str, ...]


def decode(content: bytes, _topology: object) -> Spot:
    """Decode a spot; raise `WireError` if it is invalid."""
    try:
        return msgspec.msgpack.decode(content, type=Spot)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise WireError(f"spots: {error}") from error


SPOTS = PartType(
    interface=1,
    name="spots",
    type=Spot,
    encode=msgspec.msgpack.encode,
    decode=decode,
    counted=("spot", "spots"),
    none="Nothing is hot",
    drawing="mocapella_thermal.view:draw",
)
