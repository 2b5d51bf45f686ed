"""The session around the tracker: what was set up, how the sensors do, what is being recorded.

These values travel as JSON on the bus and stand in a take, so that a take says how it was made.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from mocapella.conventions import NOT_AVAILABLE
from mocapella.settings import check

PLACEMENTS: dict[str, int] = {"parallel": 0, "right-45": 1, "right-90": 2, "left-45": 3, "left-90": 4}
"""How two sensors stand, seen from the reference sensor, and the study log's number (Kinect_Config) for it."""

SCENARIOS: dict[str, int] = {
    "stationary": 1,
    "steps": 2,
    "walk": 3,
    "around-first": 4,
    "exchange": 5,
    "obstacle": 6,
    "free": 7,
    "around-second": 8,
}
"""What the people do, and the study log's number (Scenario_Id) for it."""


LONGEST_NAME = 40
"""Characters of a person's name."""


@dataclass(frozen=True)
class PersonName:
    """What somebody calls a person.

    Attributes:
        person: number of the person.
        name: empty takes the name away.
    """

    person: int
    name: str

    def __post_init__(self) -> None:
        check(0 <= self.person < 2**64, "person", self.person, "a person's number, 0 or more")
        fits = len(self.name) <= LONGEST_NAME and self.name.isprintable() and self.name == self.name.strip()
        wanted = f"up to {LONGEST_NAME} characters on one line, without space around them"
        check(fits, "name", self.name[:80], wanted)


@dataclass(frozen=True)
class SensorPose:
    """How a sensor stands, as the person who put it there measured it."""

    tilt: float = 0.0
    """Upwards positive [rad]."""
    height: float = 0.0
    """Over the floor [m]."""

    def __post_init__(self) -> None:
        check(-1.6 < self.tilt < 1.6, "tilt", self.tilt, "within ±1.6 rad")
        check(0 <= self.height <= 10, "height", self.height, "from 0 to 10 m")


@dataclass(frozen=True)
class Setup:
    """What is chosen before a start.

    Attributes:
        method: name of the tracker's method.
        sensors_expected: how many sensors to wait for before calibrating.
        participant: the study's number of the person, or −9999.
        placement: key of `PLACEMENTS`, or empty.
        scenario: key of `SCENARIOS`, or empty.
        sensors: pose by sensor name; overrides what the frames say.
    """

    method: str = "default"
    sensors_expected: int = 1
    participant: int = NOT_AVAILABLE
    placement: str = ""
    scenario: str = ""
    sensors: dict[str, SensorPose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check(self.sensors_expected >= 1, "sensors_expected", self.sensors_expected, "1 or more")
        placements, scenarios = ["", *PLACEMENTS], ["", *SCENARIOS]
        check(self.placement in placements, "placement", self.placement, "one of " + ", ".join(PLACEMENTS))
        check(self.scenario in scenarios, "scenario", self.scenario, "one of " + ", ".join(SCENARIOS))


@dataclass(frozen=True)
class SensorHealth:
    """One row of the table of sensors.

    Attributes:
        name, node_id: the sensor, and the process that serves it.
        connected: its node is alive on the bus.
        silent: connected or not, no frame has come for longer than the limit.
        local: the node runs on the server's machine.
        bodies: in its newest frame: people, or what else it sends.
        rate_hz: frames a second, over the last seconds.
        latency: from publish to result, median of the last seconds [s]; None where unknown.
        frames: live frames tracked.
        dropped: live frames passed over because a fresher one was there, or lost on the way.
        rejected: messages refused at the door.
        clock_offset: node's monotonic clock minus the server's [s]; None until measured.
        clock_bound: half the round trip: how wrong the offset can be [s].
        stored: frames of the record path that are in the take.
        lost: frames of the record path that are known to be missing from the take.
        tilt: as set up, or else as its frames say, upwards positive [rad].
        height: likewise, over the floor [m]; 0 where unknown.
        problem: what is wrong with it, for a person; empty when nothing is.
        pictures: whether it is a camera that can be asked for its picture.
        capture_offset: server's monotonic clock minus the clock of its captures, by arrivals alone, the smallest
            latency included [s]; None before the first frame.
        sends: the name of its frames' type, such as skeletons.
    """

    name: str
    node_id: int
    connected: bool
    silent: bool
    local: bool
    bodies: int
    rate_hz: float
    latency: float | None
    frames: int
    dropped: int
    rejected: int
    clock_offset: float | None
    clock_bound: float | None
    stored: int
    lost: int
    tilt: float
    height: float
    problem: str = ""
    pictures: bool = False
    capture_offset: float | None = None
    sends: str = "skeletons"


@dataclass(frozen=True)
class RecordingHealth:
    """What is being recorded, or how the last recording ended.

    Attributes:
        active: whether it goes on.
        path: of the take; empty where nothing was recorded yet.
        frames, scenes: that are safe on the disk.
        lost: frames that are known to be missing.
        size_bytes: of the file.
        seconds: how long it has gone on, or how long the take is [s].
        problem: why it stopped by itself; empty where it did not.
    """

    active: bool = False
    path: str = ""
    frames: int = 0
    scenes: int = 0
    lost: int = 0
    size_bytes: int = 0
    seconds: float = 0.0
    problem: str = ""


@dataclass(frozen=True)
class SessionStatus:
    """Everything a view or a script needs to know of the server, as one value.

    Attributes:
        revision: grows by one with every command carried out, so that two views can tell which came last.
        running: whether frames are tracked.
        phase, sensors_missing, frames_remaining, frames_wanted, reason: as in `mocapella.model.scene.TrackerState`.
        counts: how many parts there are in the newest scene, by the name of their type.
        scenes: results so far.
        scenes_hz: results a second, over the last seconds.
        setup: what was set up last.
        sensors: one row each, by name.
        recording: the present take, or the last one.
        next_take: a name that no take in the server's folder has, for the one after that.
        notices: the newest last: refused nodes, changes of state, what a person should know.
        uptime: of the server [s].
        version: of Mocapella.
    """

    revision: int
    running: bool
    phase: str
    sensors_missing: int
    frames_remaining: int
    frames_wanted: int
    reason: str
    scenes: int
    scenes_hz: float
    setup: Setup
    sensors: tuple[SensorHealth, ...]
    recording: RecordingHealth
    notices: tuple[str, ...]
    uptime: float
    version: str
    next_take: str = ""
    counts: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class CommandReply:
    """What became of a command.

    Attributes:
        ok: whether it was carried out.
        message: what was done, or why not and what would have worked.
        status: the session right after it.
    """

    ok: bool
    message: str = ""
    status: SessionStatus | None = None
