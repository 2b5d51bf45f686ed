"""The session around the tracker: setup, health of the sensors, and recording.

These values are sent as JSON on the bus and stored in a take, which so documents its origin.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from mocapella.conventions import NOT_AVAILABLE
from mocapella.model.scene import Phase
from mocapella.settings import check

PLACEMENTS: dict[str, int] = {"parallel": 0, "right-45": 1, "right-90": 2, "left-45": 3, "left-90": 4}
"""Placements of two sensors, seen from the reference sensor, and their study log numbers (Kinect_Config)."""

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
"""Scenarios, and their study log numbers (Scenario_Id)."""


LONGEST_NAME = 40
"""Most characters of a person's name."""


@dataclass(frozen=True)
class PersonName:
    """A name given to a person.

    Attributes:
        person: number of the person.
        name: empty removes the name.
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
    """A sensor's tilt and height, as measured by the user."""

    tilt: float = 0.0
    """Upwards positive [rad]."""
    height: float = 0.0
    """Over the floor [m]."""

    def __post_init__(self) -> None:
        check(-1.6 < self.tilt < 1.6, "tilt", self.tilt, "within ±1.6 rad")
        check(0 <= self.height <= 10, "height", self.height, "from 0 to 10 m")


@dataclass(frozen=True)
class Setup:
    """Configuration of a session.

    Attributes:
        method: name of the tracker's method.
        sensors_expected: number of sensors to wait for before calibrating.
        participant: the participant's number in the study, or −9999.
        placement: key of `PLACEMENTS`, or empty.
        scenario: key of `SCENARIOS`, or empty.
        sensors: pose by sensor name; overrides the poses in the frames.
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
    """State of one sensor, for the table of sensors.

    Attributes:
        name, node_id: the sensor, and the process that serves it.
        connected: whether its node is connected to the bus.
        silent: whether no frame has arrived for longer than the limit, connected or not.
        local: whether the node runs on the server's machine.
        bodies: number of items, such as people, in its newest frame.
        rate_hz: frame rate over the last seconds.
        latency: from publication to result, median of the last seconds [s]; None if unknown.
        frames: number of tracked live frames.
        dropped: number of live frames that were skipped for a newer one, or lost in transfer.
        rejected: number of rejected messages.
        clock_offset: node's monotonic clock minus the server's [s]; None until measured.
        clock_bound: largest error of the offset, half the round trip [s].
        stored: number of frames of the record path that are in the take.
        lost: number of frames of the record path that are known to be missing from the take.
        tilt: upward tilt, as configured, or else from its frames [rad].
        height: height above the floor, from the same source [m]; 0 if unknown.
        problem: a message for users; empty if there is none.
        pictures: whether it is a camera that answers requests for its image.
        capture_offset: server's monotonic clock minus the clock of its captures, by arrivals alone, the smallest
            latency included [s]; None before the first frame.
        sends: the name of its frames' type, such as skeletons.
        frames_before, dropped_before: of ``frames`` and ``dropped``, those before tracking began.
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
    frames_before: int = 0
    dropped_before: int = 0


@dataclass(frozen=True)
class RecordingHealth:
    """State of the present recording, or of the last one.

    Attributes:
        active: whether it is running.
        path: of the take; empty before the first recording.
        frames, scenes: number on the disk.
        lost: frames that are known to be missing.
        size_bytes: of the file.
        seconds: duration so far, or of the take [s].
        problem: why it stopped by itself; empty if it did not.
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
    """The server's complete state for views and scripts.

    Attributes:
        revision: number of commands carried out, from which a view knows the newest status.
        running: whether frames are tracked.
        phase, sensors_missing, frames_remaining, frames_wanted, reason: as in `mocapella.model.scene.TrackerState`.
        counts: number of parts in the newest scene, by the name of their type.
        scenes: number of scenes so far.
        scenes_hz: rate of scenes over the last seconds.
        setup: the present setup.
        sensors: state of each sensor, by name.
        recording: state of the present take, or of the last one.
        next_take: proposed name for the next take, which no take in the server's folder has.
        notices: messages for users, the newest last, such as refused nodes and changes of state.
        uptime: time since the server started [s].
        version: of Mocapella.
        refused: number of times that a program with a key of another session has asked to be let in.
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
    refused: int = 0

    @property
    def getting_ready(self) -> bool:
        """Whether the server prepares the method: it does not track yet, refuses ``start``, and gives the reason."""
        return self.phase == Phase.STOPPED and bool(self.reason)


@dataclass(frozen=True)
class CommandReply:
    """The reply to a command.

    Attributes:
        ok: whether it was carried out.
        message: the result, or the error and a remedy.
        status: the session right after it.
    """

    ok: bool
    message: str = ""
    status: SessionStatus | None = None
