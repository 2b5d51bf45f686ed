"""What a study's session shows: the present task and instruction, the progress, and the checks of the data."""

from __future__ import annotations

from typing import Literal

import msgspec

StudyPhase = Literal["waiting", "instruction", "running", "paused", "between", "done", "aborted"]
"""``waiting`` for a participant; ``instruction``: read, not begun; ``running``: logged; ``paused``; ``between`` two
tasks; ``done``; ``aborted``."""


class MapPoint(msgspec.Struct, frozen=True):
    """A named point of a `FloorMap` [m]: x to the right of a person who faces the sensors, y towards the sensors."""

    name: str
    x: float
    y: float


class FloorMap(msgspec.Struct, frozen=True):
    """The marked block on the floor, for the map of the participant's screen.

    Attributes:
        width, depth: size of the block along x and y of `MapPoint`, whose origin is its middle [m].
        points: its points.
        start: name of the point where people begin; empty if there is none.
        here, next: for each person, the name of the point to stand on, and of that where the next foot goes; empty
            names where it does not matter.
    """

    width: float
    depth: float
    points: tuple[MapPoint, ...] = ()
    start: str = ""
    here: tuple[str, ...] = ()
    next: tuple[str, ...] = ()


class PlannedPart(msgspec.Struct, frozen=True):
    """One task of the participant's plan.

    Attributes:
        title: name of the task.
        placement: name of the sensors' placement.
        repetition, repetitions: number of this repetition from 1, and how many there are.
        state: whether it lies behind, is the present one, or is to come.
    """

    title: str
    placement: str
    repetition: int
    repetitions: int
    state: Literal["done", "now", "later"]


class StudyStatus(msgspec.Struct, frozen=True):
    """State of a study's session.

    Attributes:
        title: of the study.
        participants: codes that the researcher can choose.
        participant, placement: code and name of the present ones; empty without a participant.
        advice: text for the researcher, such as how to place the sensors.
        phase: see `StudyPhase`.
        part: place of the present task in ``plan``, from 0.
        plan: all tasks of the participant, in their order.
        instruction: text for the participant, of the present step.
        following: text of the next step, or the next task's title; empty at the end.
        step, steps: number of the present step from 1, and how many the task has.
        elapsed_s: time that the present task has run [s].
        step_left_s: time until the step ends by itself [s]; None if it waits for *next*.
        step_s: duration of the step [s]; 0 if it waits.
        minimum_left_s: time until the task may end [s].
        block: the marked floor; None if the study has none.
        tone: whether the participant's plan has tones.
        tone_hz: frequency of the tone of the present step, or after a task of its last step [Hz]; None for silence.
        changes: number of changes of the instruction so far.
        logged: description of the present logging, in words; empty without logging.
        results: number of results of the present task so far.
        marks: number of events that the researcher has marked.
        actions: commands that can be used now, without ``study-``.
        notes: what the researcher must know, such as an edited protocol.
    """

    title: str
    participants: tuple[str, ...]
    participant: str = ""
    placement: str = ""
    advice: str = ""
    phase: StudyPhase = "waiting"
    part: int = 0
    plan: tuple[PlannedPart, ...] = ()
    instruction: str = ""
    following: str = ""
    step: int = 0
    steps: int = 0
    elapsed_s: float = 0.0
    step_left_s: float | None = None
    step_s: float = 0.0
    minimum_left_s: float = 0.0
    block: FloorMap | None = None
    tone: bool = False
    tone_hz: float | None = None
    changes: int = 0
    logged: str = ""
    results: int = 0
    marks: int = 0
    actions: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class LiveCheck(msgspec.Struct, frozen=True):
    """Quality of the data of the last second, while a study runs.

    Attributes:
        sensors: number of sensors that send.
        wanted: number of sensors that the session waits for.
        people: number of tracked people.
        inside: number of people whose pelvis is over the marked block; None without a block or its place.
        apart_cm: distance Δd of the views of a person, mean over joints, people and pairs of sensors [cm]; None if no
            two sensors see one person.
        whole_percent: share of views that have all joints measured [%]; None without a view.
    """

    sensors: int
    wanted: int
    people: int
    inside: int | None
    apart_cm: float | None
    whole_percent: float | None
