"""Calibrate cameras from people while they walk about: a rig appears after seconds and gets better.

An estimate takes seconds of the processor. It is done in short steps, one with each frame that is due, so that whoever
tracks with the same frames is not delayed. No clock is read: the same frames give the same rigs after the same frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from mocapella.calibration.keypoint_tracks import CameraTracks
from mocapella.calibration.people_rig import PlacedByPeople, RigFromPeople, RigScale, place_rig
from mocapella.calibration.rig_from_people import PeopleSolution, RigFromPeopleSettings, solving_people
from mocapella.calibration.stepwise import Steps
from mocapella.errors import CalibrationError
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.keypoints import KeypointFrame
from mocapella.settings import check

WALK: Final = "walk about: the cameras calibrate themselves"
"""Advice while there is no rig."""
_EVERY_S: Final = 0.2
"""Shortest interval between instants, so that early estimates are short [s]."""
GONE_S: Final = 3.0
"""A camera without a frame for this long is not calibrated [s]."""


@dataclass(frozen=True)
class LiveRigSettings:
    """When a live calibration estimates the cameras.

    Attributes:
        first_s: time that all cameras have in common before the first estimate; larger: later, more often good [s].
        growth: an estimate follows when the time has grown by this share; larger: less work, later results [ratio].
        longest_s: time that is remembered; larger: more accurate, more memory and time [s].
        instants: most instants of an estimate; larger: more accurate, takes longer [instants].
        rate_hz: frames of a camera beyond this rate are left out; larger: more memory and time [Hz].
        step_s: least time between two frames that an estimate goes on with; larger: less work, later results [s].
        steps: number of steps that an estimate does with such a frame; larger: more work at once, earlier results
            [steps].
        same_lenses: whether all cameras of one image size are of one model, with equal focal lengths and k1.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    first_s: float = 6.0
    growth: float = 0.3
    longest_s: float = 90.0
    instants: int = 60
    rate_hz: float = 15.0
    step_s: float = 0.03
    steps: int = 1
    same_lenses: bool = False

    def __post_init__(self) -> None:
        check(2.5 <= self.first_s <= 600, "first_s", self.first_s, "from 2.5 to 600 s")
        check(0.01 <= self.growth <= 10, "growth", self.growth, "from 0.01 to 10")
        check(self.first_s <= self.longest_s <= 3600, "longest_s", self.longest_s, "from first_s to 3600 s")
        check(10 <= self.instants <= 5000, "instants", self.instants, "from 10 to 5000")
        check(7 <= self.rate_hz <= 240, "rate_hz", self.rate_hz, "from 7 to 240 Hz")
        check(0 <= self.step_s <= 1, "step_s", self.step_s, "from 0 to 1 s")
        check(1 <= self.steps <= 10_000, "steps", self.steps, "from 1 to 10000")


class LiveRigFromPeople:
    """Estimates a rig from the frames of free-running cameras.

    Args:
        cameras: number of cameras to wait for.
        scale: a stated length; None for a guess.
        old: an older rig, whose lenses and world are kept; None without.
        settings: when; the defaults if None.

    Attributes:
        problem: why there is no rig, or no better one, and what to do; empty if the last estimate succeeded.
    """

    def __init__(
        self, cameras: int, scale: RigScale | None = None, old: CameraRig | None = None,
        settings: LiveRigSettings | None = None,
    ) -> None:  # fmt: skip
        check(cameras >= 2, "cameras", cameras, "2 or more")
        self.settings = settings or LiveRigSettings()
        self._cameras, self._scale, self._old = cameras, scale, old
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._found: RigFromPeople | None = None
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget the people seen so far, but not the rig: the next estimate replaces it even if it is less certain."""
        self._tracks: dict[str, CameraTracks] = {}
        self._due_s = self.settings.first_s
        self._replaces = True
        self.problem = WALK
        self._stop()

    def _stop(self) -> None:
        """End an estimate that is under way."""
        self._inputs: dict[str, CameraTracks] | None = None
        self._done, self._step_at_s = 0, float("-inf")
        self._steps: Steps[PeopleSolution] | None = None

    @property
    def progress(self) -> tuple[float, float]:
        """Time that all cameras have in common, and the time at which the next estimate begins [s]."""
        if len(self._tracks) < self._cameras:
            return 0.0, self._due_s
        first, last = self._common()
        return min(max(last - first, 0.0), self._due_s), self._due_s

    @property
    def cameras(self) -> int:
        """Number of cameras that are there."""
        return len(self._tracks)

    @property
    def estimating(self) -> bool:
        """Whether an estimate is under way."""
        return self._inputs is not None

    def _common(self) -> tuple[float, float]:
        """Return the begin and the end of the time that all cameras have in common [s]."""
        of = self._tracks.values()
        return max(camera.first_s for camera in of), min(camera.last_s for camera in of)

    def update(self, frame: KeypointFrame, at_s: float) -> bool:
        """Take a frame, and do one step of an estimate if one is due.

        Args:
            frame: the detections of one camera.
            at_s: capture time on a clock that all cameras share to about 0.1 s [s].

        Returns:
            Whether `rig` has changed.
        """
        name = frame.sensor
        if name not in self._tracks:
            self._tracks[name] = CameraTracks(name, frame.size_px)
            self._due_s = self.settings.first_s
        mine = self._tracks[name]
        if not at_s - mine.last_s < 1.0 / self.settings.rate_hz - 1e-4:  # NaN before the first
            try:
                mine.update(frame, at_s)
            except CalibrationError as error:
                self.problem = str(error)
                return False
            self._tracks = {key: one for key, one in self._tracks.items() if at_s - one.last_s <= GONE_S}
        if self._inputs is not None:
            return self._step(at_s)
        if len(self._tracks) < self._cameras:
            self.problem = f"{len(self._tracks)} of {self._cameras} cameras are there; {WALK}"
            return False
        if self.problem.endswith(WALK):
            self.problem = WALK
        first, last = self._common()
        if last - first >= self._due_s:
            self._begin(first, last - first)
        return False

    def _begin(self, first: float, common: float) -> None:
        s = self.settings
        self._due_s = min(common * (1 + s.growth), s.longest_s)
        if common >= s.longest_s:
            for camera in self._tracks.values():
                camera.forget(first + common * s.growth / (1 + s.growth))
        self._stop()
        self._inputs = {name: CameraTracks.recalled(camera.memory()) for name, camera in sorted(self._tracks.items())}

    def _step(self, at_s: float) -> bool:
        if self._inputs is None or at_s - self._step_at_s < self.settings.step_s - 1e-4:
            return False
        self._step_at_s = at_s
        if self._steps is None:
            self._steps = self._solving()
            for _ in range(self._done):  # the steps done before a snapshot was restored
                next(self._steps)
        try:
            for _ in range(self.settings.steps):
                next(self._steps)
                self._done += 1
        except StopIteration as end:
            self._stop()
            return self._use(end.value)
        except CalibrationError as error:
            self._stop()
            self.problem = str(error)
        return False

    def _solving(self) -> Steps[PeopleSolution]:
        assert self._inputs is not None
        known = {} if self._old is None else {name: one.camera for name, one in self._old.cameras.items()}
        s = self.settings
        settings = RigFromPeopleSettings(instants=s.instants, every_s=_EVERY_S, same_lenses=s.same_lenses)
        return solving_people(self._inputs, known, settings)

    def _use(self, solved: PeopleSolution) -> bool:
        try:
            found = place_rig(solved, self._scale, self._old)
        except CalibrationError as error:
            self.problem = str(error)
            return False
        self.problem = ""
        better = self._found is None or self._replaces or _rank(found) < _rank(self._found)
        if better:
            self._found, self._replaces = found, False
        return better

    def rig(self) -> RigFromPeople | None:
        """Return the best estimate: that with the smallest standard deviations; None before there is one."""
        return self._found

    def memory(self) -> dict[str, Any]:
        """Return all state, copied as far as it changes, for `recall`; its classes are `REMEMBERED`."""
        inputs = self._inputs
        return {
            "tracks": [camera.memory() for camera in self._tracks.values()],
            "inputs": None if inputs is None else [camera.memory() for camera in inputs.values()],
            "found": self._found, "due_s": float(self._due_s), "replaces": self._replaces, "problem": self.problem,
            "done": self._done, "step_at_s": float(self._step_at_s),
        }  # fmt: skip

    def recall(self, memory: dict[str, Any]) -> None:
        """Restore the state that `memory` returned; the steps of an estimate under way are repeated with the next."""
        self._stop()
        self._tracks = {one["name"]: CameraTracks.recalled(one) for one in memory["tracks"]}
        inputs = memory["inputs"]
        self._inputs = None if inputs is None else {one["name"]: CameraTracks.recalled(one) for one in inputs}
        self._found, self._due_s, self._replaces = memory["found"], memory["due_s"], memory["replaces"]
        self.problem, self._done, self._step_at_s = memory["problem"], memory["done"], memory["step_at_s"]


REMEMBERED: Final = (RigFromPeople, CameraRig, PlacedCamera, Camera, PlacedByPeople)
"""Classes in the state of a `LiveRigFromPeople`, see `mocapella.model.memory`."""


def _rank(found: RigFromPeople) -> tuple[int, float]:
    """Return a key that is smaller for a better rig: fewer cameras missing, then the worst standard deviation [mm]."""
    return -len(found.cameras), max(camera.position_sd_mm for camera in found.cameras.values())
