"""The frame type of a heat camera: the hot spots below it."""

import msgspec

from mocapella.errors import WireError
from mocapella.model.frame_types import FrameType
from mocapella.model.sensor_frame import SensorFrame
from mocapella.schema.envelope import ENVELOPE, seal, unseal


class HeatFrame(SensorFrame, frozen=True, eq=False):
    """The hot spots that a camera sees: (x, z) on the floor, from the point below it [m], and the temperature [°C]."""

    spots: tuple[tuple[float, float, float], ...]

    @property
    def bodies(self) -> int:
        """Number of spots, for the table of sensors."""
        return len(self.spots)


def encode(frame: HeatFrame) -> bytes:
    """Encode a frame."""
    return seal(frame, "heat", msgspec.msgpack.encode(frame.spots))


def decode(data: bytes) -> HeatFrame:
    """Decode a frame; raise `WireError` if it is invalid."""
    identity, content = unseal(data)
    try:
        return HeatFrame(*identity, msgspec.msgpack.decode(content, type=tuple[tuple[float, float, float], ...]))
    except msgspec.DecodeError as error:
        raise WireError(f"heat: {error}") from error


HEAT = FrameType(
    interface=1,
    name="heat",
    type=HeatFrame,
    encode=encode,
    decode=decode,
    format=ENVELOPE,
    counted=("spot", "spots"),
    lane="mocapella_thermal.view:lane",
)
