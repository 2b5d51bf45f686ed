"""The founding experiment (KinectMultiTrack, 2015) in simulation: study logs as the thesis' program wrote them.

A participant stands still, which calibrates the method ``stand-still``, stands on (*stationary*), makes small steps
(*steps*) and walks the marked square and its diagonals (*walk*), before two sensors that are parallel, 45° or 90°
apart. The sensors have the errors that were measured on the study's own (docs/simulation.md). A seed is a participant:
height, phases of swaying and breathing, and the sensors' errors differ.
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

BLOCK_M: Final = (1.925, 1.87)
"""Width and depth of the marked block [m]."""
CENTRE_M: Final = (0.0, 2.8)
"""Centre of the block (world x, z) before the front sensor, which is at the origin [m]."""
FRONT: Final = "front"
"""Name of the reference sensor, as of the study's own logs."""
SECOND: Final = {
    "parallel": SensorSettings("side", position=(-0.5, 1.0, 0.0)),
    "right-45": SensorSettings("side", position=(-1.98, 1.0, 0.82), yaw_deg=45.0),
    "right-90": SensorSettings("side", position=(-2.8, 1.0, 2.8), yaw_deg=90.0),
}
"""The second sensor by placement, a key of `mocapella.model.session.PLACEMENTS`."""
STATURES_M: Final = (1.55, 1.9)
"""Smallest and greatest height of a participant [m]."""
LOGGED_EVERY: Final = 2
"""The thesis' program logs every other result."""
BEGINS_NS: Final = 1_425_200_400 * NS_PER_S
"""Unix time of the first frame of every session, a morning of March 2015 [ns]; the simulation has no date."""
ONE_CALIBRATION: Final = StandStillTrackerSettings(regain_within_m=float("inf"), centre_of="seen")
"""The thesis' logs have one calibration for each file: a lost participant is the same wherever seen again. The centre
is of all seen joints: of the tracked alone, Δy at 90° is larger than the recorded one (docs/evaluation.md)."""
MOST_SEEDS: Final = 1000
_STEP_M: Final = 0.35
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
    person = PersonSettings(CENTRE_M, "route", route=words, stature=float(rng.uniform(*STATURES_M)))
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
    x, z = CENTRE_M
    left, right = x - BLOCK_M[0] / 2, x + BLOCK_M[0] / 2
    front, back = z - BLOCK_M[1] / 2, z + BLOCK_M[1] / 2
    steps = []
    for dx, dz in ((0.0, -_STEP_M), (0.0, _STEP_M), (-_STEP_M, 0.0), (_STEP_M, 0.0)):
        for to in ((x + dx, z + dz), (x, z)):
            steps += [f"shift {to[0]} {to[1]}", "stand 0.6"]
    square = [(left, front), (right, front), (right, back), (left, back)]
    diagonals = [(right, front), (left, back), (left, front)]
    walk = [f"go {to[0]} {to[1]}" for to in square] + ["turn 180"] + [f"go {to[0]} {to[1]}" for to in diagonals]
    parts = {
        "": ["stand 0.1", f"stand {still_s}"],
        "stationary": [f"stand {_STATIONARY_S}"],
        "steps": steps * 2,
        " to the block's corner": [f"go {left} {back}", "turn 180", "stand 1"],
        "walk": [*walk, "turn 180"],
        " back": [f"go {x} {z}", "turn 180"],
    }
    words: list[str] = []
    tasks = []
    for name, part in parts.items():
        begins = written_route(CENTRE_M, words).seconds if words else 0.0
        words += part
        if name and not name.startswith(" "):
            tasks.append(TaskTimes(name, begins, written_route(CENTRE_M, words).seconds))
    return tuple(words), tuple(tasks)
