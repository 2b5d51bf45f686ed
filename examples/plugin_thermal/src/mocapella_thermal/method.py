"""The method `heat`: fuses spots that several cameras see at one position, and keeps their ids while they move."""

from dataclasses import dataclass, field
from math import dist

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.geometry.rigid import rigid, rotation_about_x
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackerState
from mocapella.settings import check, parse
from mocapella.tracker.method import Method, not_taken
from mocapella.tracker.protocol import TrackerReport, scene_at
from mocapella_thermal.frame import HeatFrame
from mocapella_thermal.spots import Spot

CEILING_M = 2.5


@dataclass(frozen=True)
class HeatSettings:
    """Positions of the cameras, and which spots are the same.

    Attributes:
        places: position (x, z) of each camera, by name [m].
        same_within_m: spots of two cameras are the same if they are nearer than this; larger: near ones are merged [m].
    """

    places: dict[str, tuple[float, float]] = field(default_factory=dict)
    same_within_m: float = 0.3

    def __post_init__(self) -> None:
        check(self.same_within_m > 0, "same_within_m", self.same_within_m, "above 0 m")


class Memory(msgspec.Struct):
    """State of the tracker."""

    steps: int = 0
    next_id: int = 0
    rejected: dict[str, int] = {}
    newest: dict[str, tuple[tuple[float, float, float], ...]] = {}
    spots: tuple[Spot, ...] = ()


class HeatTracker:
    """See `mocapella.tracker.protocol.Tracker`."""

    def __init__(self, settings: HeatSettings) -> None:
        self._settings = settings
        self.reset()

    def update(self, arrival: Arrival) -> Scene:
        m, frame = self._memory, arrival.frame
        problem = not_taken(frame, "heat")
        if problem:
            m.rejected[problem] = m.rejected.get(problem, 0) + 1
        else:
            m.newest[frame.sensor] = frame.spots
            m.spots = self._spots()
        m.steps += 1
        places = tuple(SensorPlace(camera, self._place(camera)) for camera in sorted(m.newest))
        return scene_at(arrival, m.steps - 1, TrackerState(Phase.TRACKING), {"spots": m.spots}, sensors=places)

    def _place(self, camera: str) -> NDArray[np.float64]:
        x, z = self._settings.places.get(camera, (0.0, 0.0))
        return rigid(rotation_about_x(np.pi / 2), (x, CEILING_M, z))  # it looks down

    def _spots(self) -> tuple[Spot, ...]:
        m, spots = self._memory, dict[int, Spot]()
        for camera, seen in sorted(m.newest.items()):
            x0, _, z0 = self._place(camera)[:3, 3].tolist()
            for x, z, celsius in seen:
                at = x0 + x, z0 + z
                same = self._nearest(at, list(spots.values()))
                was = self._nearest(at, [spot for spot in m.spots if spot.id not in spots])
                number = m.next_id if was is None else was.id
                if same is not None:
                    spots[same.id] = msgspec.structs.replace(same, cameras=(*same.cameras, camera))
                else:
                    spots[number] = Spot(number, *at, celsius, (camera,))
                    m.next_id = max(m.next_id, number + 1)
        return tuple(spots[number] for number in sorted(spots))

    def _nearest(self, at: tuple[float, float], among: list[Spot]) -> Spot | None:
        nearest = min(among, key=lambda spot: dist(at, (spot.x, spot.z)), default=None)
        return nearest if nearest and dist(at, (nearest.x, nearest.z)) < self._settings.same_within_m else None

    def recalibrate(self, reason: str) -> None:
        """Do nothing: the positions are settings."""

    def reset(self) -> None:
        self._memory = Memory()

    def snapshot(self) -> bytes:
        return msgspec.msgpack.encode(self._memory)

    def restore(self, data: bytes) -> None:
        try:
            self._memory = msgspec.msgpack.decode(data, type=Memory)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            self.reset()
            raise WireError(f"no memory of the method heat: {error}") from error

    @property
    def report(self) -> TrackerReport:
        m = self._memory
        return TrackerReport(m.steps, m.steps - sum(m.rejected.values()), m.rejected, 0, 0)


HEAT = Method(
    interface=1,
    name="heat",
    summary="hot spots on the floor, from heat cameras at the ceiling",
    settings=HeatSettings,
    frame_types=(HeatFrame,),
    parts=("spots",),
    make=lambda settings, *_: HeatTracker(parse(HeatSettings, settings, where="settings of heat")),
)
