"""The session around the tracker: setup, health of the sensors, and recording.

These values are sent as JSON on the bus and stored in a take, which so documents its origin.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Final

from mocapella.conventions import NOT_AVAILABLE
from mocapella.errors import one_of
from mocapella.model.limits import MOST_SENSORS, PARTICIPANT, SENSOR_HEIGHT, SENSORS_EXPECTED, TILT
from mocapella.model.observations import check_sensor_name
from mocapella.model.scene import Phase
from mocapella.model.study_status import StudyStatus
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


STUDY_EVENT: Final = "study-event"
"""Name of the entries of a take that are events of a study's session; a tracker does nothing at them."""
LABEL: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}")
LABEL_RULE: Final = "up to 40 letters, digits, _ and -, such as walk"
LONGEST_NAME = 40
"""Most characters of a person's name."""


@dataclass(frozen=True)
class PersonName:
    """A name given to a person.

    Attributes:
        person: number of the person.
        name: at most `LONGEST_NAME` printable characters, without space around them; empty removes the name.

    Raises:
        SettingsError: an invalid number or name.
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
    """A sensor's tilt and height above the floor, as measured by the user.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    tilt: float = 0.0
    """Upwards positive [rad]."""
    height: float = 0.0
    """Over the floor [m]; 0 if unknown."""

    def __post_init__(self) -> None:
        check(self.tilt in TILT, "tilt", self.tilt, str(TILT))
        check(self.height in SENSOR_HEIGHT, "height", self.height, str(SENSOR_HEIGHT))


@dataclass(frozen=True)
class Setup:
    """Configuration of a session.

    Attributes:
        method: name of the tracker's method.
        sensors_expected: number of sensors to wait for before calibrating.
        participant: the participant's number in the study, or −9999.
        placement: key of `PLACEMENTS`, another name that a study's protocol defines, or empty.
        scenario: key of `SCENARIOS`, the name of a study's task, or empty.
        sensors: tilt and height by sensor name; they override those in the frames.

    Raises:
        SettingsError: a value is invalid; states the valid ones. Whether the method exists is not checked.
    """

    method: str = "default"
    sensors_expected: int = 1
    participant: int = NOT_AVAILABLE
    placement: str = ""
    scenario: str = ""
    sensors: dict[str, SensorPose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check(
            self.sensors_expected in SENSORS_EXPECTED, "sensors_expected", self.sensors_expected, str(SENSORS_EXPECTED)
        )
        wanted = f"{PARTICIPANT}; {NOT_AVAILABLE} if there is none"
        check(self.participant in PARTICIPANT, "participant", self.participant, wanted)
        check(len(self.sensors) <= MOST_SENSORS, "number of sensors", len(self.sensors), f"at most {MOST_SENSORS}")
        for name in self.sensors:
            check_sensor_name(name)
        for name in ("placement", "scenario"):
            label = getattr(self, name)
            check(not label or LABEL.fullmatch(label) is not None, name, label[:80], LABEL_RULE)

    def check_usual_labels(self) -> None:
        """Check that placement and scenario are the study log's, so that a wrong letter is noticed.

        Raises:
            SettingsError: one of them is another name; lists the known ones.
        """
        for name, label, known in (
            ("placement", self.placement, PLACEMENTS),
            ("scenario", self.scenario, SCENARIOS),
        ):
            check(label in ("", *known), name, label, f"one of {one_of(label, known)}")

    def labelled_as(self, other: Setup) -> Setup:
        """Return this setup with the labels of another: participant, placement and scenario."""
        return replace(self, participant=other.participant, placement=other.placement, scenario=other.scenario)

    def labels_in_words(self) -> str:
        """Return the labels, such as ``participant 7, right-90, walk``; ``no labels`` without any."""
        who = "" if self.participant == NOT_AVAILABLE else f"participant {self.participant}"
        return ", ".join(filter(None, (who, self.placement, self.scenario))) or "no labels"


@dataclass(frozen=True)
class SensorHealth:
    """State of one sensor, for the table of sensors.

    Attributes:
        name, node_id: the sensor, and the process that serves it.
        connected: whether its node is connected to the bus.
        silent: whether no frame has arrived yet, or none for longer than the limit (`mocapella.model.pace`).
        local: whether the node runs on the server's machine.
        bodies: number of items, such as people, in its newest frame; 0 if it is silent.
        rate_hz: frame rate over the last seconds [Hz].
        latency: from publication to result, median of the last seconds [s]; None if unknown.
        frames: number of tracked live frames.
        dropped: number of live frames that were skipped for a newer one, or lost in transfer.
        rejected: number of rejected messages.
        clock_offset: node's monotonic clock minus the server's [s]; None until measured.
        clock_bound: largest error of the offset, None until measured [s]; it grows while the node does not answer.
        stored: number of its frames that are in the present or last take.
        lost: number of its frames that are known to be missing from that take.
        tilt: upward tilt, as configured, or else from its frames [rad].
        height: height above the floor, from the same source [m]; 0 if unknown.
        problem: a message for users; empty if there is none.
        pictures: whether it is a camera that answers requests for its image.
        capture_offset: estimate of the server's monotonic clock minus the clock of its capture times [s]: the smallest
            difference of arrival and capture time, so too large by the smallest latency; None before the first frame.
        sends: the name of its frames' type, such as skeletons.
        frames_before, dropped_before: the parts of ``frames`` and ``dropped`` before tracking began.
        behind: the part of ``dropped`` skipped because the tracker was too slow, rather than lost in transfer.
        calibration: quality of its calibrated pose, or its problem; empty if the method has none.
        clock_drift_ppm: mean rate of change of ``clock_offset`` over the last minute or so [µs/s]; None until known.
        clock_drift_bound_ppm: largest error of the drift [µs/s]; None until known.
        clock_poor: whether ``clock_bound`` is above 10 ms.
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
    behind: int = 0
    calibration: str = ""
    clock_drift_ppm: float | None = None
    clock_drift_bound_ppm: float | None = None
    clock_poor: bool = False


@dataclass(frozen=True)
class UnknownEnd:
    """A node that never said which frame was its last: nothing is known of frames after number ``after``.

    ``after`` is −1 if not even one frame is known. ``sensor`` and ``node_id`` name the node.
    """

    sensor: str
    node_id: int
    after: int

    def __str__(self) -> str:
        return f"{self.sensor}: unknown after frame {self.after}, because its node ended without saying its last one"


@dataclass(frozen=True)
class RecordingHealth:
    """State of the present recording, or of the last one.

    Attributes:
        active: whether it is running.
        path: path of the take; empty before the first recording.
        frames, scenes: numbers of frames and scenes on the disk.
        lost: number of frames that are known to be missing.
        size_bytes: size of the file [bytes].
        seconds: duration so far, or of the ended take [s].
        problem: why it stopped by itself; empty if it did not.
        unknown: nodes of the ended take whose last frame is not known.
        unwritten: entries that could not be written, such as an invalid one; frames among them count as lost.
    """

    active: bool = False
    path: str = ""
    frames: int = 0
    scenes: int = 0
    lost: int = 0
    size_bytes: int = 0
    seconds: float = 0.0
    problem: str = ""
    unknown: tuple[UnknownEnd, ...] = ()
    unwritten: int = 0


@dataclass(frozen=True)
class Descriptors:
    """File descriptors of the server's process: number of open ones, and the system's limit."""

    used: int
    limit: int

    @property
    def scarce(self) -> bool:
        """Whether less than a tenth is left."""
        return self.used > 0.9 * self.limit


@dataclass(frozen=True)
class ServerHealth:
    """State of the server itself.

    Attributes:
        errors: number of unexpected errors that were caught, by reason.
        turned_away: number of refused messages, sensors, commands, notices and connections, by kind and reason.
        latency_ms: percentiles of the latency from sent frame to scene [ms]: ``p50``, ``p90``, ``p99`` and ``max``;
            empty while no clock offset is known.
        disk_free_bytes: free space where takes are recorded; None if unknown.
        reserve_bytes: free space at which a recording stops.
        ended: parts of the session that have ended by themselves, such as ``view``.
        log: file of the structured log on the server's machine; empty if there is none.
        descriptors: file descriptors of the process, which each connection and each take needs; None if unknown.
    """

    errors: dict[str, int] = field(default_factory=dict)
    turned_away: dict[str, int] = field(default_factory=dict)
    latency_ms: dict[str, float] = field(default_factory=dict)
    disk_free_bytes: int | None = None
    reserve_bytes: int = 0
    ended: tuple[str, ...] = ()
    log: str = ""
    descriptors: Descriptors | None = None

    def problems(self) -> tuple[str, ...]:
        """Return the problems, one line each: ended parts, errors, scarce disk and descriptors, refusals."""
        lines = [f"the {part} has ended" for part in self.ended]
        if self.errors:
            lines.append(f"{sum(self.errors.values())} unexpected errors; the first: {next(iter(self.errors))}")
        free = self.disk_free_bytes
        if free is not None and free < 2 * self.reserve_bytes:
            stops = f"a recording stops at {self.reserve_bytes / 1e9:.1f} GB"
            lines.append(f"{free / 1e9:.1f} GB of disk are left; {stops}")
        files = self.descriptors
        if files is not None and files.scarce:
            lines.append(f"{files.used} of {files.limit} file descriptors are in use; new sensors are refused")
        if self.turned_away:
            lines.append("turned away: " + ", ".join(f"{count} {what}" for what, count in self.turned_away.items()))
        return tuple(lines)


@dataclass(frozen=True)
class PersonCondition:
    """A condition of one person in the newest scene (`mocapella.model.scene.Person.condition`).

    Attributes:
        person: the person's id.
        condition: text for users, such as ``left knee: sensors and body model disagree by 50°``.
    """

    person: int
    condition: str

    @property
    def text(self) -> str:
        """The condition with the person's id, such as ``person 2: left knee: …``."""
        return f"person {self.person}: {self.condition}"


@dataclass(frozen=True)
class SessionStatus:
    """The server's complete state for views and scripts.

    Attributes:
        revision: number of commands carried out; of two statuses, the one with the larger number is newer.
        running: whether frames are tracked.
        phase: the tracker's state.
        sensors_missing, frames_remaining, frames_wanted: numbers of sensors that it waits for, and of frames that the
            calibration still needs and needs in total.
        reason: why the calibration restarted, or what to do; empty if there is neither.
        counts: number of parts in the newest scene, by the name of their type.
        people_conditions: conditions of people in the newest scene, in its order.
        scenes: number of scenes so far.
        scenes_hz: rate of scenes over the last seconds [Hz].
        setup: the present setup.
        sensors: state of each sensor, by name.
        recording: state of the present take, or of the last one.
        next_take: proposed name for the next take, which no take in the server's folder has.
        notices: messages for users, the newest last, such as refused nodes and changes of state.
        uptime: time since the server started [s].
        version: Mocapella's version.
        health: state of the server itself.
        study: the study that the session runs; None if it runs none.
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
    people_conditions: tuple[PersonCondition, ...] = ()
    health: ServerHealth = field(default_factory=ServerHealth)
    study: StudyStatus | None = None

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
        status: the session right after it; None if the reply does not give it.
    """

    ok: bool
    message: str = ""
    status: SessionStatus | None = None
