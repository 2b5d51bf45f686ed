"""The method `steady`: people of the method `default`, smoothed once more."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.model.observations import Arrival, BodyFrame
from mocapella.model.scene import Person, Scene
from mocapella.settings import check, parse
from mocapella.tracker import make_tracker
from mocapella.tracker.method import Method
from mocapella.tracker.protocol import TrackerReport


@dataclass(frozen=True)
class SteadySettings:
    """How much people are smoothed.

    Attributes:
        settles_s: time constant of the low pass; larger: less jitter, and more lag [s].
        default: settings of the method default, by name [1].
    """

    settles_s: float = 0.1
    default: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check(0 < self.settles_s < 60, "settles_s", self.settles_s, "above 0 s")


class Smoother:
    """A low pass of each person's joints; a joint that comes anew is not smoothed."""

    def __init__(self, settles_s: float) -> None:
        self._settles_s = settles_s
        self.reset()

    def update(self, person: Person, at_ns: int) -> Person:
        """Return the person with smoothed positions; ``at_ns`` is the capture time."""
        at_before_ns, before = self.memory.get(person.id, (at_ns, person.positions.tolist()))
        share = -np.expm1(-max(0, at_ns - at_before_ns) * 1e-9 / self._settles_s)
        last: NDArray[np.float64] = np.array(before)
        positions = np.where(np.isfinite(last), last + share * (person.positions - last), person.positions)
        self.memory[person.id] = at_ns, positions.tolist()
        return msgspec.structs.replace(person, positions=positions)

    def keep(self, people: set[int]) -> None:
        """Forget all other people."""
        self.memory = {number: values for number, values in self.memory.items() if number in people}

    def reset(self) -> None:
        self.memory = dict[int, tuple[int, list[list[float]]]]()


class SteadyTracker:
    """See `mocapella.tracker.protocol.Tracker`."""

    def __init__(self, settings: SteadySettings, sensors_expected: int, sensors: Mapping[str, Any]) -> None:
        self._inner = make_tracker(
            "default", settings=settings.default, sensors_expected=sensors_expected, sensors=sensors
        )
        self._smoother = Smoother(settings.settles_s)

    def update(self, arrival: Arrival) -> Scene:
        scene = self._inner.update(arrival)
        self._smoother.keep({person.id for person in scene.people})
        return scene.with_parts(people=tuple(self._smoother.update(one, scene.at_ns) for one in scene.people))

    def recalibrate(self, reason: str) -> None:
        self._inner.recalibrate(reason)

    def reset(self) -> None:
        self._inner.reset()
        self._smoother.reset()

    def snapshot(self) -> bytes:
        return msgspec.msgpack.encode((self._inner.snapshot(), [*self._smoother.memory.items()]))

    def restore(self, data: bytes) -> None:
        self.reset()
        try:
            inner, memory = msgspec.msgpack.decode(
                data, type=tuple[bytes, list[tuple[int, tuple[int, list[list[float]]]]]]
            )
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise WireError(f"no memory of the method steady: {error}") from error
        self._inner.restore(inner)
        self._smoother.memory = dict(memory)

    @property
    def report(self) -> TrackerReport:
        return self._inner.report


STEADY = Method(
    interface=1,
    name="steady",
    summary="people of the method default, smoothed once more",
    settings=SteadySettings,
    frame_types=(BodyFrame,),
    parts=("people",),
    make=lambda settings, *rest: SteadyTracker(parse(SteadySettings, settings, where="settings of steady"), *rest),
)
