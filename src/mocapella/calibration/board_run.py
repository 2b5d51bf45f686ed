"""Collect views of a board that is carried before running cameras, guide the user, and calibrate the rig.

Cameras that are not triggered together see a moving board at different times. The board's speed in the images between
two rounds of requests limits how far apart in time two cameras' images may be to count as simultaneous.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mocapella.calibration.board_guidance import Hint, coverage
from mocapella.calibration.cameras import CameraCalibration, Origin, calibrate_cameras
from mocapella.errors import CalibrationError, one_of
from mocapella.model.board import Board, BoardView
from mocapella.model.camera import Camera
from mocapella.settings import check

Float64 = NDArray[np.float64]

LATELY: Final = 4
"""Number of rounds in a row with a moving board after which this is reported."""


@dataclass(frozen=True)
class BoardRunSettings:
    """Which images count as simultaneous, and which views are kept. A round is one image of each camera.

    Attributes:
        tolerance_s: largest time difference of simultaneous images [s].
        most_moved_px: largest motion of the board in an image within that time [px].
        least_moved: a round is dropped if the board has moved less than this since the previous one in every camera, as
            a fraction of the image width.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    tolerance_s: float = 0.1
    most_moved_px: float = 2.0
    least_moved: float = 0.01

    def __post_init__(self) -> None:
        check(0 <= self.tolerance_s <= 10, "tolerance_s", self.tolerance_s, "from 0 to 10 s")
        check(0 < self.most_moved_px <= 1000, "most_moved_px", self.most_moved_px, "above 0, at most 1000 px")
        check(0 <= self.least_moved < 1, "least_moved", self.least_moved, "0 or more and below 1")


@dataclass(frozen=True, eq=False)
class BoardLook:
    """One camera's answer to a request for an image.

    Attributes:
        at_s: capture time, on one clock for all cameras [s]; NaN without an image.
        view: the detected board; None if it is not detected.
        problem: reason why there is no view.
    """

    at_s: float = float("nan")
    view: BoardView | None = None
    problem: str = ""


@dataclass
class BoardRunReport:
    """Counts of all rounds, each of one image per camera.

    Attributes:
        looks: number of rounds.
        kept: number of rounds whose views are kept.
        unseen: number of rounds without a detection of the board.
        still: number of rounds dropped because the board had hardly moved.
        unanswered: number of missing images, by camera.
        apart_s: for each kept round with simultaneous views, the largest time between these [s].
        moved_px: for each of these rounds, the largest motion of the board in an image meanwhile [px]; NaN if unknown.
        split: number of kept rounds with views of two or more cameras that are not all simultaneous.
    """

    looks: int
    kept: int
    unseen: int
    still: int
    unanswered: dict[str, int]
    apart_s: list[float]
    moved_px: list[float]
    split: int

    def words(self) -> str:
        """Describe the time between simultaneous images for users; empty if there are none."""
        if not self.apart_s:
            return ""
        apart, moved = 1e3 * np.array(self.apart_s), np.array(self.moved_px)
        text = f"simultaneous images: {np.median(apart):.1f} ms apart (median), at most {apart.max():.1f} ms"
        if np.isfinite(moved).any():
            text += f"; the board moved {np.nanmedian(moved):.1f} px meanwhile"
        return text + (f"; rounds that were not simultaneous: {self.split}" if self.split else "")


@dataclass(frozen=True, eq=False)
class _Round:
    """One image of each camera: the views, and the simultaneous group each belongs to."""

    views: Mapping[str, BoardView]
    instant: Mapping[str, int]
    apart_s: float
    moved_px: float

    @property
    def shared(self) -> bool:
        """Whether all views are simultaneous."""
        return len(set(self.instant.values())) == 1


class BoardRun:
    """Collects views of a board and calibrates a rig from them. Not thread-safe.

    Args:
        board: the calibration board.
        cameras: all names.
        known: cameras with a given lens, which stays fixed.
        settings: which images count as simultaneous, and which views are kept.

    Attributes:
        newest: the last answer of each camera, by name; empty before the first round.

    Raises:
        SettingsError: no cameras.
    """

    def __init__(
        self,
        board: Board,
        cameras: Sequence[str],
        *,
        known: Mapping[str, Camera] | None = None,
        settings: BoardRunSettings | None = None,
    ) -> None:
        check(len(cameras) > 0, "cameras", len(cameras), "one or more")
        self.board, self.cameras, self.settings = board, tuple(sorted(cameras)), settings or BoardRunSettings()
        self._known = dict(known or {})
        self.newest: dict[str, BoardLook] = {}
        self._rounds: list[_Round] = []
        self._looks = self._unseen = self._still = 0
        self._unanswered: dict[str, int] = dict.fromkeys(self.cameras, 0)
        self._lately: deque[bool] = deque(maxlen=LATELY)

    def add(self, looks: Mapping[str, BoardLook]) -> None:
        """Add one round of images; cameras that are missing gave no image.

        The round is not kept if no camera detected the board, or if the board hardly moved since the last kept one; but
        a round whose views are all simultaneous replaces one whose views are not.

        Raises:
            CalibrationError: a camera that the run does not have.
        """
        for name in looks:
            if name not in self._unanswered:
                raise CalibrationError(f"camera {name} is not calibrated here: {one_of(name, self.cameras)}")
        before = self.newest
        self.newest = {name: looks.get(name, BoardLook()) for name in self.cameras}
        self._looks += 1
        for name, look in self.newest.items():
            self._unanswered[name] += not np.isfinite(look.at_s)
        seen = {name: look for name, look in self.newest.items() if look.view is not None and np.isfinite(look.at_s)}
        if not seen:
            self._unseen += 1
            return
        now = self._round(seen, before)
        if len(seen) > 1:
            self._lately.append(now.shared)
        if self._rounds and self._barely_moved(self._rounds[-1], now):
            if self._rounds[-1].shared or not now.shared:
                self._still += 1
                return
            self._rounds.pop()
            self._still += 1
        self._rounds.append(now)

    @property
    def views(self) -> list[BoardView]:
        """All kept views, in the order of their rounds, as copies; their frame number is the index of that round."""
        return [replace(view, frame=k) for k, of in enumerate(self._rounds) for view in of.views.values()]

    @property
    def instants(self) -> dict[tuple[str, int], int]:
        """The number of the group of simultaneous images of each view, by camera and frame number."""
        of_all = len(self.cameras)
        return {
            (name, k): k * of_all + group for k, of in enumerate(self._rounds) for name, group in of.instant.items()
        }

    @property
    def shared(self) -> int:
        """Number of kept rounds with simultaneous views of two or more cameras."""
        return sum(len(of.instant) > len(set(of.instant.values())) for of in self._rounds)

    @property
    def report(self) -> BoardRunReport:
        """Counts of all rounds of images so far: kept, without the board, still, not simultaneous."""
        several = [of for of in self._rounds if len(of.views) > 1]
        shared = [of for of in several if np.isfinite(of.apart_s)]
        return BoardRunReport(
            self._looks, len(self._rounds), self._unseen, self._still, dict(self._unanswered),
            [of.apart_s for of in shared], [of.moved_px for of in shared],
            sum(not of.shared for of in several),
        )  # fmt: skip

    def hints(self) -> list[Hint]:
        """Return hints about missing views, the most urgent first: coverage of the images, tilt, shared views.

        The first one is to hold the board still if none of the last `LATELY` rounds was simultaneous.
        """
        hints = coverage(self.views, self.board, self.cameras, self.instants, lens_known=list(self._known))
        if len(self._lately) == LATELY and not any(self._lately):
            text = "hold the board still for a second: it moves too far between the cameras' pictures"
            hints.insert(0, Hint("moving", "", text))
        return hints

    def calibrate(self, origin: Origin | None = None) -> CameraCalibration:
        """Calibrate all cameras (intrinsics, extrinsics) from the views so far, which are kept, by bundle adjustment.

        The world frame is that of ``origin``; if None, the first camera's by name.

        Raises:
            CalibrationError: the views do not determine it; names the camera and what to film.
        """
        return calibrate_cameras(self.seen_by_all(), self.board, self.instants, known=self._known, origin=origin)

    def seen_by_all(self) -> list[BoardView]:
        """Return the views if every camera has some.

        Raises:
            CalibrationError: a camera has none; says why.
        """
        views = self.views
        if not views:
            raise CalibrationError("no camera has seen the board: " + self._why_unseen())
        for name in self.cameras:
            if not any(view.camera == name for view in views):
                why = self.newest[name].problem or "hold it where it sees it"
                raise CalibrationError(f"camera {name} has not seen the board: {why}")
        return views

    def _why_unseen(self) -> str:
        problems = [look.problem for look in self.newest.values() if look.problem]
        return "; ".join(problems) or "check its kind, columns, rows and dictionary"

    def _round(self, seen: Mapping[str, BoardLook], before: Mapping[str, BoardLook]) -> _Round:
        s = self.settings
        speeds = [_speed(before.get(name, BoardLook()), look) for name, look in seen.items()]
        speed = max(speeds)  # [px/s]; infinite at a camera's first detection
        allowed = min(s.tolerance_s, s.most_moved_px / speed if speed > 0 else np.inf)
        order = sorted(seen, key=lambda name: (seen[name].at_s, name))
        group, began = -1, -np.inf
        instant, apart = {}, []
        for name in order:
            if seen[name].at_s - began > allowed:
                group, began = group + 1, seen[name].at_s
            elif name != order[0]:
                apart.append(seen[name].at_s - began)
            instant[name] = group
        views = {name: look.view for name, look in seen.items() if look.view is not None}
        widest = max(apart, default=np.nan)
        return _Round(views, instant, widest, widest * speed if np.isfinite(speed) else np.nan)

    def _barely_moved(self, old: _Round, new: _Round) -> bool:
        if set(new.views) - set(old.views):
            return False
        return all(
            _moved(old.views[name], view) < self.settings.least_moved * view.size_px[0]
            for name, view in new.views.items()
        )


def _moved(old: BoardView, new: BoardView) -> float:
    """Return the median motion of the common corners [px]; infinite without any."""
    _, i, j = np.intersect1d(old.ids, new.ids, return_indices=True)
    if not len(i) or old.size_px != new.size_px:
        return np.inf
    return float(np.median(np.linalg.norm(new.corners_px[j] - old.corners_px[i], axis=1)))


def _speed(old: BoardLook, new: BoardLook) -> float:
    """Return the speed of the board in the image [px/s]; infinite if it was not seen before."""
    if old.view is None or new.view is None:
        return np.inf
    moved, took = _moved(old.view, new.view), new.at_s - old.at_s
    if moved == 0:
        return 0.0
    return moved / took if took > 0 else np.inf
