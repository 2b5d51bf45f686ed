"""A board that is carried about before running cameras, look by look: what was seen, what is missing, and the rig.

Cameras that are not triggered together see a moving board at different times. How far it moved in the pictures between
two looks says how far it moved between two cameras' pictures of one look: where that is little, they are of one
instant.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mocapella.calibration.cameras import CameraCalibration, Origin, calibrate_cameras
from mocapella.calibration.hints import Hint, coverage
from mocapella.errors import CalibrationError, one_of
from mocapella.model.board import Board, BoardView
from mocapella.model.camera import Camera
from mocapella.settings import check

Float64 = NDArray[np.float64]

LATELY: Final = 4
"""Looks after which a board that never holds still is said to move."""


@dataclass(frozen=True)
class BoardRunSettings:
    """Which pictures are of one instant, and which are kept.

    Attributes:
        tolerance_s: pictures that are farther apart are never of one instant.
        most_moved_px: nor those between which the board moved farther in a picture.
        least_moved: share of the picture's width; a look in which the board has moved less in every camera since the
            look before says nothing new.
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
    """What one camera saw when it was asked.

    Attributes:
        at_s: when its picture was captured, on one clock for all cameras [s]; NaN where it gave none.
        view: of the board; None where it does not see it.
        problem: why there is no view, in words.
    """

    at_s: float = float("nan")
    view: BoardView | None = None
    problem: str = ""


@dataclass
class BoardRunReport:
    """What became of all looks.

    Attributes:
        looks: at all cameras.
        kept: of which views are kept.
        unseen: in which no camera saw the board.
        still: that said nothing new.
        unanswered: by camera, how often it gave no picture.
        apart_s, moved_px: of each kept instant of two cameras or more: how far apart its pictures were, and how far the
            board moved meanwhile in one of them.
        split: looks in which two cameras or more saw the board, but not at one instant.
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
        """How far the pictures of one instant were apart; empty where there is none."""
        if not self.apart_s:
            return ""
        apart, moved = 1e3 * np.array(self.apart_s), np.array(self.moved_px)
        text = f"pictures of one instant: {np.median(apart):.1f} ms apart (median), at most {apart.max():.1f} ms"
        if np.isfinite(moved).any():
            text += f"; the board moved {np.nanmedian(moved):.1f} px meanwhile"
        return text + (f"; looks that were not of one instant: {self.split}" if self.split else "")


@dataclass(frozen=True, eq=False)
class _Round:
    """One look at all cameras: which views there are, and which instant of this look each belongs to."""

    views: Mapping[str, BoardView]
    instant: Mapping[str, int]
    apart_s: float
    moved_px: float

    @property
    def shared(self) -> bool:
        """Whether all views are of one instant."""
        return len(set(self.instant.values())) == 1


class BoardRun:
    """Collects looks, and makes a rig of them. One thread at a time.

    Args:
        board: see there.
        cameras: all names.
        known: cameras whose lens is given, and stays.
        settings: see there.

    Attributes:
        newest: the last look of each camera.
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
        """Take in one look at all cameras; those that are not in it gave no picture.

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
        """All that are kept; the frame's number is that of the look."""
        return [replace(view, frame=k) for k, of in enumerate(self._rounds) for view in of.views.values()]

    @property
    def instants(self) -> dict[tuple[str, int], int]:
        """The instant of each view."""
        of_all = len(self.cameras)
        return {
            (name, k): k * of_all + group for k, of in enumerate(self._rounds) for name, group in of.instant.items()
        }

    @property
    def shared(self) -> int:
        """Instants at which two cameras or more saw the board."""
        return sum(len(of.instant) > len(set(of.instant.values())) for of in self._rounds)

    @property
    def report(self) -> BoardRunReport:
        """What became of all looks so far."""
        several = [of for of in self._rounds if len(of.views) > 1]
        shared = [of for of in several if np.isfinite(of.apart_s)]
        return BoardRunReport(
            self._looks, len(self._rounds), self._unseen, self._still, dict(self._unanswered),
            [of.apart_s for of in shared], [of.moved_px for of in shared],
            sum(not of.shared for of in several),
        )  # fmt: skip

    def hints(self) -> list[Hint]:
        """What is missing yet, the most urgent first."""
        hints = coverage(self.views, self.board, self.cameras, self.instants, lens_known=list(self._known))
        if len(self._lately) == LATELY and not any(self._lately):
            text = "hold the board still for a second: it moves too far between the cameras' pictures"
            hints.insert(0, Hint("moving", "", text))
        return hints

    def calibrate(self, origin: Origin | None = None) -> CameraCalibration:
        """The rig of all cameras.

        Raises:
            CalibrationError: the views do not say it; names the camera and what to film.
        """
        return calibrate_cameras(self.seen_by_all(), self.board, self.instants, known=self._known, origin=origin)

    def seen_by_all(self) -> list[BoardView]:
        """The views, when every camera has some.

        Raises:
            CalibrationError: one has none; says why.
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
        said = [look.problem for look in self.newest.values() if look.problem]
        return "; ".join(said) or "check its kind, columns, rows and dictionary"

    def _round(self, seen: Mapping[str, BoardLook], before: Mapping[str, BoardLook]) -> _Round:
        s = self.settings
        speeds = [_speed(before.get(name, BoardLook()), look) for name, look in seen.items()]
        speed = max(speeds)  # [px/s]; infinite where a camera saw it for the first time
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
    """How far the corners that both have moved, in the median [px]; infinite where there are none."""
    _, i, j = np.intersect1d(old.ids, new.ids, return_indices=True)
    if not len(i) or old.size_px != new.size_px:
        return np.inf
    return float(np.median(np.linalg.norm(new.corners_px[j] - old.corners_px[i], axis=1)))


def _speed(old: BoardLook, new: BoardLook) -> float:
    """[px/s]; infinite where the board was not seen before."""
    if old.view is None or new.view is None:
        return np.inf
    moved, took = _moved(old.view, new.view), new.at_s - old.at_s
    if moved == 0:
        return 0.0
    return moved / took if took > 0 else np.inf
