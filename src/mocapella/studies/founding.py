"""The founding experiment (KinectMultiTrack, 2015) in simulation: study logs as the thesis' program wrote them.

A participant stands still, which calibrates the method ``stand-still``, stands on (*stationary*), makes steps
(*steps*) and walks the marked square and its diagonal (*walk*), before two sensors that are parallel, 45° or 90°
apart. Sensors and route are where the study's logs have them: the positions of `STEPS_M` and `WALK_M`, and the stops
there, are those of the logs' SpineBase relative to where a participant stood for the calibration, median over the
sessions, rounded to 5 cm and 0.1 s (docs/evaluation.md). The sensors have the errors that were measured on the study's
own (docs/simulation.md). A seed is a participant: height, phases of swaying and breathing, and the sensors' errors
differ.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.evaluation.calibration_in_place import INFERRED_S
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene
from mocapella.model.session import PLACEMENTS, Setup
from mocapella.model.study_log import YEAR_1_TO_1970_MS
from mocapella.recording.study_export import export_study_log
from mocapella.sources.simulate import (
    PersonSettings,
    Room,
    SceneSettings,
    SensorSettings,
    SimulatedSensor,
    build_room,
    merge,
)
from mocapella.sources.simulate.measured import KIND
from mocapella.sources.simulate.scenarios import written_route
from mocapella.tracker.stand_still import StandStillTracker, StandStillTrackerSettings

START_M: Final = (0.4, 2.4)
"""Where a participant stands for the calibration (world x, z); the front sensor is at the origin [m]."""
Stop = tuple[float, float, float]
"""Place to the right of the start, and towards the front sensor [m]; time for which the participant stops there [s]."""
STEPS_M: Final[tuple[Stop, ...]] = (
    (0.0, 0.0, 1.7), (0.0, 0.5, 1.8), (-0.6, 0.5, 1.8), (0.0, 0.5, 1.6), (0.0, 0.0, 1.6), (0.0, -0.4, 2.0),
    (-0.6, -0.3, 1.9), (-0.65, -0.7, 1.0),
)  # fmt: skip
"""Stops of *steps*: forward, left, right, backward, backward, left, backward; all facing the front sensor."""
WALK_M: Final[tuple[Stop, ...]] = (
    (0.0, -0.75, 1.4), (0.0, 0.0, 2.7), (0.6, 0.0, 0.0), (0.6, -0.75, 0.0), (-0.95, -0.8, 0.0), (-0.95, 0.7, 0.0),
    (0.6, 0.65, 0.0), (0.6, 0.0, 0.0), (0.0, 0.0, 3.2), (0.55, 0.65, 1.8), (-0.8, -0.8, 1.9), (-0.95, 0.65, 0.6),
)  # fmt: skip
"""Stops and corners of *walk*: forward to the start, around the square, the diagonal, and forward."""
FRONT: Final = "front"
"""Name of the reference sensor, as of the study's own logs."""
SECOND: Final = {
    "parallel": SensorSettings("side", position=(0.7, 1.0, 0.0)),
    "right-45": SensorSettings("side", position=(2.1, 1.0, 0.7), yaw_deg=-45.0),
    "right-90": SensorSettings("side", position=(2.8, 1.0, 2.4), yaw_deg=-90.0),
}
"""The second sensor by placement, a key of `mocapella.model.session.PLACEMENTS`; as far from the start as the first."""
STATURES_M: Final = (1.55, 1.9)
"""Smallest and greatest height of a participant [m]."""
LOGGED_EVERY: Final = 2
"""The thesis' program logs every other result."""
BEGINS_NS: Final = 1_425_200_400 * NS_PER_S
"""Unix time of the first frame of every session, a morning of March 2015 [ns]; the simulation has no date."""
ONE_CALIBRATION: Final = StandStillTrackerSettings(regain_within_m=float("inf"), centre_of="seen")
"""The thesis' logs have one calibration for each file: a lost participant is the same wherever seen again. The centre
is of all seen joints, because the logs do not say which were inferred (docs/evaluation.md)."""
MOST_SEEDS: Final = 1000
STILL_S: Final = (8.0, 16.0, 32.0)
"""Times for which participants stand for the calibration, one after the other until it succeeds [s]."""
_STATIONARY_S: Final = 5.0


class TaskTimes(msgspec.Struct, frozen=True):
    """When a task is done, in room time.

    Attributes:
        scenario: key of `mocapella.model.session.SCENARIOS`.
        begins_s, ends_s: its beginning and its end [s].
    """

    scenario: str
    begins_s: float
    ends_s: float


def founding_room(placement: str, seed: int, still_s: float = STILL_S[0]) -> tuple[Room, tuple[TaskTimes, ...]]:
    """Build the room of one participant and placement; return it and the times of the tasks.

    Args:
        placement: key of `SECOND`.
        seed: number of the participant, and random seed.
        still_s: time for which the participant stands for the calibration [s].
    """
    words, tasks = _route(still_s)
    rng = np.random.default_rng([seed, 2015])
    person = PersonSettings(START_M, "route", route=words, stature=float(rng.uniform(*STATURES_M)))
    front = SensorSettings(FRONT, clock_offset_s=1000.0, errors=KIND, forget_s=INFERRED_S)
    side = dataclasses.replace(
        SECOND[placement],
        phase_s=0.011, clock_offset_s=5321.25, latency_s=0.07, errors=KIND, forget_s=INFERRED_S,
    )  # fmt: skip
    settings = SceneSettings(f"founding-{placement}", (front, side), (person,), seed=seed)
    return build_room(settings), tasks


def write_founding_logs(
    folder: Path, seeds: Sequence[int], on_step: Callable[[str], None] = lambda text: None
) -> list[Path]:
    """Simulate all placements for each participant, and write a study log of each.

    Args:
        folder: existing folder; a log in it is never overwritten.
        seeds: numbers of the participants.
        on_step: called with the next session, in words.

    Returns:
        The files, ``Study_P_Kinect_C_Time_simulated.csv.gz``: P the participant, C the placement's number.

    Raises:
        SettingsError: no seed, or an invalid one.
        TakeExistsError, DiskFullError, RecordingError: as in `mocapella.recording.study_export.export_study_log`.
    """
    if not seeds or len(seeds) > MOST_SEEDS or len(set(seeds)) < len(seeds):
        wanted = f"up to {MOST_SEEDS} different ones of 0, 1, 2, …"
        raise SettingsError(f"seeds {list(seeds)[:20]} cannot be used; give {wanted}")
    files = []
    for seed in seeds:
        for placement in SECOND:
            on_step(f"participant {seed}, {placement}")
            path = folder / f"Study_{seed}_Kinect_{PLACEMENTS[placement]}_Time_simulated.csv.gz"
            export_study_log(founding_scenes(placement, seed), path, reference=FRONT, every=LOGGED_EVERY)
            files.append(path)
    return files


def founding_scenes(placement: str, seed: int) -> Iterator[tuple[Setup, Scene, int]]:
    """Yield the scenes of the method ``stand-still`` during the tasks, each with its labels and ``Tracker_Time`` [ms].

    As the researcher waits for the calibration, the participant stands for the first time of `STILL_S` that is enough.
    ``placement`` and ``seed`` are as in `founding_room`.
    """
    rooms = (founding_room(placement, seed, still_s) for still_s in STILL_S)
    room, tasks = next((one for one in rooms if _is_calibrated(*one)), founding_room(placement, seed))
    names = room.sensor_names
    tracker = StandStillTracker(ONE_CALIBRATION, sensors_expected=len(names))
    setups = {
        task.scenario: Setup("stand-still", len(names), participant=seed, placement=placement, scenario=task.scenario)
        for task in tasks
    }
    sensors = [SimulatedSensor(room, name) for name in names]
    for item in merge(sensors, 0.0, tasks[-1].ends_s):
        at_ns = BEGINS_NS + round(item.due_s * NS_PER_S)
        scene = tracker.update(Arrival(item.frame, at_ns))
        at_s = item.truth.room_ns / NS_PER_S
        task = next((task for task in tasks if task.begins_s <= at_s < task.ends_s), None)
        if task is not None:
            yield setups[task.scenario], scene, YEAR_1_TO_1970_MS + at_ns // 1_000_000


def _is_calibrated(room: Room, tasks: Sequence[TaskTimes]) -> bool:
    """Whether the method ``stand-still`` is calibrated when the first task begins."""
    names = room.sensor_names
    tracker = StandStillTracker(ONE_CALIBRATION, sensors_expected=len(names))
    sensors = [SimulatedSensor(room, name) for name in names]
    phase = Phase.WAITING_FOR_SENSORS
    for item in merge(sensors, 0.0, tasks[0].begins_s):
        at_ns = BEGINS_NS + round(item.due_s * NS_PER_S)
        phase = tracker.update(Arrival(item.frame, at_ns)).state.phase
    return phase is Phase.TRACKING


def _route(still_s: float) -> tuple[tuple[str, ...], tuple[TaskTimes, ...]]:
    """The words of a participant's route, and the times of the tasks in it."""
    walk = [word for stop in WALK_M[1:] for word in _walked(stop)]
    parts = {
        "": ["stand 0.1", f"stand {still_s}"],
        "stationary": [f"stand {_STATIONARY_S}"],
        "steps": [word for stop in STEPS_M for word in _stepped(stop)],
        " to the walk": [*_walked(WALK_M[0]), "turn 180"],
        "walk": [f"stand {WALK_M[0][2]}", *walk],
        " back": [*_walked((0.0, 0.0, 0.0)), "turn 180"],
    }
    words: list[str] = []
    tasks = []
    for name, part in parts.items():
        begins = written_route(START_M, words).seconds if words else 0.0
        words += part
        if name and not name.startswith(" "):
            tasks.append(TaskTimes(name, begins, written_route(START_M, words).seconds))
    return tuple(words), tuple(tasks)


def _stepped(stop: Stop) -> tuple[str, ...]:
    """The words that bring a participant to a stop without turning."""
    x, z = _place(stop)
    return f"shift {x} {z}", f"stand {stop[2]}"


def _walked(stop: Stop) -> tuple[str, ...]:
    """The words that bring a participant to a stop; at the start people turn to the front sensor."""
    x, z = _place(stop)
    turned = ("turn 180",) if stop[2] and stop[:2] == (0.0, 0.0) else ()
    return f"go {x} {z}", *turned, *((f"stand {stop[2]}",) if stop[2] else ())


def _place(stop: Stop) -> tuple[float, float]:
    """World (x, z) [m]; a person who faces the front sensor has +x to the right."""
    return round(START_M[0] + stop[0], 3), round(START_M[1] - stop[1], 3)
