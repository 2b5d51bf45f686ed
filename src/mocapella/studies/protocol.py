"""The protocol of a study, a readable TOML file, and each participant's plan that follows from it.

docs/studies-protocol.md describes the file; ``studies/protocols`` has the protocols that ship.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final

import msgspec

from mocapella.decoding import decode_toml, read_whole
from mocapella.errors import InputError, SettingsError, one_of
from mocapella.model.limits import MOST_SENSORS, PARTICIPANT
from mocapella.model.names import is_device
from mocapella.studies.file_values import of_tables
from mocapella.studies.orders import Order, balanced_square, ordered, square_rows
from mocapella.studies.participants import CODE_RULE, code_problem, number_of

FIX: Final = "docs/studies-protocol.md describes the file"
SHIPPED: Final = ("kinectmultitrack",)
"""Names of the protocols that ship with Mocapella."""
MOST_PARTICIPANTS: Final = 10_000

Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$")]
"""Name of a placement, task or point: it becomes part of the names of files."""
Text = Annotated[str, msgspec.Meta(max_length=2000)]
Seconds = Annotated[float, msgspec.Meta(gt=0, le=3600)]
OptionalSeconds = Annotated[float, msgspec.Meta(ge=0, le=3600)]
Count = Annotated[int, msgspec.Meta(ge=1, le=100)]
Number = Annotated[int, msgspec.Meta(ge=0, le=2**31 - 1)]
Metres = Annotated[float, msgspec.Meta(ge=-100, le=100)]
Length = Annotated[float, msgspec.Meta(gt=0, le=100)]
Frequency = Annotated[float, msgspec.Meta(ge=50, le=8000)]


class FloorPoint(msgspec.Struct, frozen=True, omit_defaults=True):
    """A named point on the floor.

    Attributes:
        name: its name, such as ``front-left``.
        x_m, y_m: where it is [m]: x to the right of a person who faces the reference sensor, y towards that sensor,
            from the middle of the marked block.
    """

    name: Name
    x_m: Metres
    y_m: Metres


class FloorBlock(msgspec.Struct, frozen=True, omit_defaults=True):
    """The marked block on the floor, for the map of the participant's screen.

    Attributes:
        width_m, depth_m: its size along x and y of `FloorPoint` [m]; its middle is the origin.
        start: name of the point that is marked in green; empty if none is.
        points: the points that steps name; they may be outside of the block.
    """

    width_m: Length
    depth_m: Length
    start: str = ""
    points: tuple[FloorPoint, ...] = ()

    def point(self, name: str) -> FloorPoint:
        """Return the point of that name.

        Raises:
            KeyError: there is none; `protocol_from_toml` refuses steps that name one.
        """
        return {point.name: point for point in self.points}[name]


class Instruction(msgspec.Struct, frozen=True, omit_defaults=True):
    """One instruction of a task.

    Attributes:
        text: what the participant reads.
        seconds: how long it lasts [s]; None until the researcher goes on.
        stand: for each person, the name of the floor point to stand on; empty if it does not matter.
        foot: for each person, the name of the floor point where the next foot goes; empty for nowhere.
        tone_hz: frequency of a tone at its beginning, and at the end of a task that it ends [Hz]; None for silence.
    """

    text: Text
    seconds: Seconds | None = None
    stand: tuple[str, ...] = ()
    foot: tuple[str, ...] = ()
    tone_hz: Frequency | None = None


class Placement(msgspec.Struct, frozen=True, omit_defaults=True):
    """A placement of the sensors, a condition of the study.

    Attributes:
        name: its name, such as ``right-45``; a key of `mocapella.model.session.PLACEMENTS` if it is one of the thesis'.
        number: its number in the study log (``Kinect_Config``).
        text: what the researcher reads before it.
        sensors: number of sensors to expect.
    """

    name: Name
    number: Number
    text: Text = ""
    sensors: Annotated[int, msgspec.Meta(ge=1, le=MOST_SENSORS)] = 2


class Task(msgspec.Struct, frozen=True, omit_defaults=True):
    """A task of the study.

    Attributes:
        name: its name, such as ``walk``.
        scenario: its number in the study log (``Scenario_Id``).
        steps: the instructions, at least one.
        text: what the participant reads before the first step.
        minimum_s: shortest duration [s]: the last step does not end before it, pauses not counted.
        pause_s: pause after it [s]; 0 until the researcher goes on.
        repetitions: how often it is done in a row.
        people: number of people who do it together.
        placements: names of the task's placements; empty for all.
        groups: names of the groups of participants who do it; empty for all.
    """

    name: Name
    scenario: Number
    steps: Annotated[tuple[Instruction, ...], msgspec.Meta(min_length=1, max_length=200)]
    text: Text = ""
    minimum_s: OptionalSeconds = 0.0
    pause_s: OptionalSeconds = 0.0
    repetitions: Count = 1
    people: Count = 1
    placements: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()

    @property
    def timed_s(self) -> float:
        """Sum of the durations of the steps that have one, or ``minimum_s`` if that is longer [s]."""
        return max(sum(step.seconds or 0.0 for step in self.steps), self.minimum_s)


class ParticipantGroup(msgspec.Struct, frozen=True, omit_defaults=True):
    """Participants who do the same tasks.

    Attributes:
        name: name of the group, which tasks name.
        codes: a code for each participant, or for each pair who come together (`mocapella.studies.participants`).
    """

    name: Name
    codes: Annotated[tuple[str, ...], msgspec.Meta(min_length=1, max_length=MOST_PARTICIPANTS)]


class Participants(msgspec.Struct, frozen=True, omit_defaults=True):
    """Who takes part: a count, or codes, or groups of codes.

    Attributes:
        count: how many; their codes are P01, P02 and so on. 0 if there are ``codes`` or ``groups``.
        codes: a code for each.
        groups: the groups, if not all do the same tasks.
    """

    count: Annotated[int, msgspec.Meta(ge=0, le=MOST_PARTICIPANTS)] = 0
    codes: Annotated[tuple[str, ...], msgspec.Meta(max_length=MOST_PARTICIPANTS)] = ()
    groups: Annotated[tuple[ParticipantGroup, ...], msgspec.Meta(max_length=100)] = ()

    @property
    def all(self) -> tuple[ParticipantGroup, ...]:
        """All participants by group; one group without a name if there are no groups."""
        if self.groups:
            return self.groups
        digits = max(2, len(str(self.count)))
        return (ParticipantGroup("", self.codes or tuple(f"P{n:0{digits}}" for n in range(1, self.count + 1))),)


class StudyProtocol(msgspec.Struct, frozen=True, omit_defaults=True):
    """The plan of a study.

    Attributes:
        title: its title.
        participants: who takes part.
        placements, tasks: the conditions, at least one of each; each participant does each task in each placement.
        seed: number that determines the order ``random``, together with the participant's code.
        task_order, placement_order: how their order is chosen for each participant.
        retention_days: how long a participant's data may be kept, from the consent on [days]; 0 without limit.
        consent: the text that participants agree to.
        block: the marked block on the floor; None if there is none.
    """

    title: Annotated[str, msgspec.Meta(min_length=1, max_length=200)]
    participants: Participants
    placements: Annotated[tuple[Placement, ...], msgspec.Meta(min_length=1, max_length=100)]
    tasks: Annotated[tuple[Task, ...], msgspec.Meta(min_length=1, max_length=100)]
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)] = 0
    task_order: Order = "fixed"
    placement_order: Order = "fixed"
    retention_days: Annotated[int, msgspec.Meta(ge=0, le=36_525)] = 0
    consent: Annotated[str, msgspec.Meta(max_length=20_000)] = ""
    block: FloorBlock | None = None

    @property
    def codes(self) -> tuple[str, ...]:
        """The codes of all participants, group after group."""
        return tuple(code for group in self.participants.all for code in group.codes)

    @property
    def checksum(self) -> str:
        """SHA-256 of what the protocol says, in hexadecimal digits; comments and codes do not change it."""
        groups = [(group.name, len(group.codes)) for group in self.participants.all]
        plain = msgspec.structs.replace(self, participants=Participants())
        return hashlib.sha256(msgspec.json.encode((plain, groups))).hexdigest()

    @property
    def consent_checksum(self) -> str:
        """SHA-256 of the text of consent, in hexadecimal digits."""
        return hashlib.sha256(self.consent.encode()).hexdigest()


class PlannedTask(msgspec.Struct, frozen=True):
    """One task of a participant's plan.

    Attributes:
        placement: the sensors' placement.
        task: the task.
        repetition: number of the repetition, from 1.
    """

    placement: Placement
    task: Task
    repetition: int


def plan(protocol: StudyProtocol, participant: str) -> tuple[PlannedTask, ...]:
    """Return a participant's tasks in their order: all of a placement, then all of the next.

    Repetitions of a task follow each other. Counterbalanced orders are dealt out within each group, in the order of its
    codes. The result depends on the protocol and the code only.

    Args:
        protocol: the study.
        participant: the participant's code.

    Raises:
        SettingsError: the study has no such participant.
    """
    group = next((group for group in protocol.participants.all if participant in group.codes), None)
    if group is None:
        known = one_of(participant[:40], protocol.codes)
        raise SettingsError(f"the study has no participant {participant[:40]!r}; it has {known}")
    tasks = [task for task in protocol.tasks if not task.groups or group.name in task.groups]
    rows = square_rows(
        group.codes.index(participant),
        len(balanced_square(len(protocol.placements))),
        len(balanced_square(len(tasks))) or 1,
    )
    seed = f"{protocol.seed}/{participant}"
    order = partial(ordered, tasks, protocol.task_order, row=rows[1])
    return tuple(
        PlannedTask(placement, task, repetition)
        for placement in ordered(protocol.placements, protocol.placement_order, row=rows[0], seed=f"{seed}/placements")
        for task in order(seed=f"{seed}/{placement.name}")
        if not task.placements or placement.name in task.placements
        for repetition in range(1, task.repetitions + 1)
    )


def load_protocol(name: Path | str) -> StudyProtocol:
    """Read a protocol: one that ships, by its name, such as ``kinectmultitrack``, or a file.

    Raises:
        InputError: as in `protocol_from_toml`, or the file cannot be read.
    """
    return protocol_from_toml(protocol_bytes(name), file=name)


def protocol_bytes(name: Path | str) -> bytes:
    """Return the TOML text of a protocol that ships, or of a file.

    Raises:
        InputError: the file cannot be read.
    """
    if str(name) in SHIPPED:
        return files("mocapella.studies").joinpath("protocols", f"{name}.toml").read_bytes()
    fix = f"name a file, or one that ships: {one_of(str(name), SHIPPED)}"
    return read_whole(name, fix=fix)


def protocol_from_toml(data: bytes | str, *, file: object = None) -> StudyProtocol:
    """Read a protocol from TOML.

    Args:
        data: the text.
        file: the file that errors name.

    Raises:
        InputError: it is no TOML; a key is unknown or missing; a value has a wrong type or is out of range; names are
            used twice or are not defined. It names the field, its value and the remedy.
    """
    tables = decode_toml(data, file=file, fix=FIX)
    protocol = of_tables(tables, StudyProtocol, what="study protocol", file=file, fix=FIX)
    for field, value, problem, fix in _faults(protocol):
        raise InputError(problem, file=file, field=field, value=value, fix=fix)
    return protocol


def to_toml(protocol: StudyProtocol) -> str:
    """Return a protocol as a TOML text that `protocol_from_toml` reads back to an equal value."""
    import tomli_w

    return tomli_w.dumps(msgspec.to_builtins(protocol), multiline_strings=True)


Fault = tuple[str, object, str, str]
"""Field, value, problem and remedy."""


def _faults(protocol: StudyProtocol) -> Iterator[Fault]:
    """Yield what contradicts itself in a protocol whose values are each in range."""
    yield from _faults_of_participants(protocol)
    yield from _repeated("placements", "name", [one.name.casefold() for one in protocol.placements])
    yield from _repeated("placements", "number", [one.number for one in protocol.placements])
    yield from _repeated("tasks", "name", [one.name.casefold() for one in protocol.tasks])
    points = [] if protocol.block is None else [point.name for point in protocol.block.points]
    yield from _repeated("block.points", "name", points)
    named = [(f"placements[{place}].name", one.name) for place, one in enumerate(protocol.placements)]
    named += [(f"tasks[{place}].name", one.name) for place, one in enumerate(protocol.tasks)]
    for field, name in named:
        if is_device(name):
            yield field, name, "Windows has a device of this name", "choose another name"
    if protocol.block is not None and protocol.block.start:
        yield from _unknown("block.start", [protocol.block.start], points, "block.points")
    names = [placement.name for placement in protocol.placements]
    groups = [group.name for group in protocol.participants.groups]
    for number, task in enumerate(protocol.tasks):
        yield from _unknown(f"tasks[{number}].placements", task.placements, names, "placements")
        yield from _unknown(f"tasks[{number}].groups", task.groups, groups, "participants.groups")
        for at, step in enumerate(task.steps):
            field = f"tasks[{number}].steps[{at}]"
            yield from _unknown(f"{field}.stand", step.stand, ["", *points], "block.points")
            yield from _unknown(f"{field}.foot", step.foot, ["", *points], "block.points")
            for key, given in (("stand", step.stand), ("foot", step.foot)):
                if len(given) > task.people:
                    fix = f"name at most {task.people}, or set the task's people"
                    yield f"{field}.{key}", list(given), "it names more points than people", fix
    yield from _faults_of_texts(protocol)


def _faults_of_participants(protocol: StudyProtocol) -> Iterator[Fault]:
    given = protocol.participants
    if bool(given.count) + bool(given.codes) + bool(given.groups) != 1:
        yield "participants", None, "it must have one of count, codes and groups", "keep one of them"
    yield from _repeated("participants.groups", "name", [group.name for group in given.groups])
    numbers: dict[int, str] = {}
    for place, group in enumerate(given.all):
        field = f"participants.groups[{place}].codes" if given.groups else "participants.codes"
        for at, code in enumerate(group.codes):
            problem = code_problem(code)
            if problem:
                yield f"{field}[{at}]", code, problem, f"a code has {CODE_RULE}"
            elif number_of(code) not in PARTICIPANT:
                yield f"{field}[{at}]", code, "its digits are too large a number for the study log", "use fewer digits"
            elif number_of(code) in numbers:
                problem = f"{numbers[number_of(code)]!r} has the same number in the study log, {number_of(code)}"
                yield f"{field}[{at}]", code, problem, "give it other digits"
            else:
                numbers[number_of(code)] = code


def _faults_of_texts(protocol: StudyProtocol) -> Iterator[Fault]:
    """Yield texts with characters that a page cannot show or that would not be kept by a TOML file."""
    texts = [("title", protocol.title), ("consent", protocol.consent)]
    texts += [(f"placements[{place}].text", one.text) for place, one in enumerate(protocol.placements)]
    for place, task in enumerate(protocol.tasks):
        texts.append((f"tasks[{place}].text", task.text))
        texts += [(f"tasks[{place}].steps[{at}].text", step.text) for at, step in enumerate(task.steps)]
    for field, text in texts:
        if not all(letter.isprintable() or letter == "\n" for letter in text):
            yield field, text, "it has characters that cannot be shown", "use letters, spaces and line breaks (\\n)"


def _repeated(field: str, key: str, values: Sequence[object]) -> Iterator[Fault]:
    for place, value in enumerate(values):
        if value in values[:place]:
            problem = f"{field}[{values.index(value)}] has the same {key}"
            yield f"{field}[{place}].{key}", value, problem, f"give each its own {key}"


def _unknown(field: str, given: Iterable[str], known: Sequence[str], where: str) -> Iterator[Fault]:
    """Yield the names that are not known; an empty one is known if ``known`` has it."""
    for name in given:
        if name not in known:
            yield field, name, f"it is not in {where}", f"known: {one_of(name, filter(None, known)) or 'none'}"
