"""Calibrate cameras from people while they walk about: a rig appears after seconds and gets better."""

from __future__ import annotations

from dataclasses import dataclass

from mocapella.calibration.keypoint_tracks import CameraTracks
from mocapella.calibration.people_rig import RigFromPeople, RigScale, place_rig
from mocapella.calibration.rig_from_people import RigFromPeopleSettings, solve_people
from mocapella.errors import CalibrationError
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.settings import check

WALK: str = "walk about: the cameras calibrate themselves"
"""Advice while there is no rig."""


@dataclass(frozen=True)
class LiveRigSettings:
    """When a live calibration estimates the cameras.

    Attributes:
        first_s: time that all cameras have in common before the first estimate; larger: later, more often good [s].
        growth: an estimate follows when the time has grown by this share; larger: less work, later results [ratio].
        longest_s: time that is remembered; larger: more accurate, more memory and time [s].
        instants: most instants of an estimate; larger: more accurate, takes longer [instants].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    first_s: float = 6.0
    growth: float = 0.3
    longest_s: float = 90.0
    instants: int = 80

    def __post_init__(self) -> None:
        check(2.5 <= self.first_s <= 600, "first_s", self.first_s, "from 2.5 to 600 s")
        check(0.01 <= self.growth <= 10, "growth", self.growth, "from 0.01 to 10")
        check(self.first_s <= self.longest_s <= 3600, "longest_s", self.longest_s, "from first_s to 3600 s")
        check(10 <= self.instants <= 5000, "instants", self.instants, "from 10 to 5000")


class LiveRigFromPeople:
    """Estimates a rig from the frames of free-running cameras.

    An estimate takes a second or more of the processor, in the call of `update` where it is due.

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
        self._tracks: dict[str, CameraTracks] = {}
        self._found: RigFromPeople | None = None
        self._due_s = self.settings.first_s
        self._kept_s = 0.0
        self.problem = WALK

    def update(self, frame: KeypointFrame, at_s: float) -> bool:
        """Take a frame, and estimate the rig if it is due.

        Args:
            frame: the detections of one camera.
            at_s: capture time on a clock that all cameras share to about 0.1 s [s].

        Returns:
            Whether `rig` has changed.
        """
        name = frame.sensor
        if name not in self._tracks:
            self._tracks[name] = CameraTracks(name, frame.size_px)
        try:
            self._tracks[name].update(frame, at_s)
        except CalibrationError as error:
            self.problem = str(error)
            return False
        if len(self._tracks) < self._cameras:
            self.problem = f"{len(self._tracks)} of {self._cameras} cameras are there; {WALK}"
            return False
        first = max(camera.first_s for camera in self._tracks.values())
        common = min(camera.last_s for camera in self._tracks.values()) - first
        if common < self._due_s:
            return False
        return self._estimate(first, common)

    def _estimate(self, first: float, common: float) -> bool:
        s = self.settings
        self._due_s = min(common * (1 + s.growth), s.longest_s)
        if common >= s.longest_s:
            for camera in self._tracks.values():
                camera.forget(first + common * s.growth / (1 + s.growth))
        known = {} if self._old is None else {name: one.camera for name, one in self._old.cameras.items()}
        tracks = dict(sorted(self._tracks.items()))
        try:
            solved = solve_people(tracks, known, RigFromPeopleSettings(instants=s.instants))
            found = place_rig(solved, self._scale, self._old)
        except CalibrationError as error:
            self.problem = str(error)
            return False
        self.problem = ""
        if self._found is not None and _sd(found) > _sd(self._found):
            return False
        self._found = found
        return True

    def rig(self) -> RigFromPeople | None:
        """Return the best estimate: that with the smallest standard deviations; None before there is one."""
        return self._found


def _sd(found: RigFromPeople) -> float:
    """Return the worst standard deviation of a camera's position [mm]."""
    return max(camera.position_sd_mm for camera in found.cameras.values())
