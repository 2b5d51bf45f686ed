"""Store the recently shown scenes, so that each browser can pause, go back and replay them."""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import StrEnum
from typing import Any, Final

import msgspec
import numpy as np

from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import Topology
from mocapella.viewer.perspective import Perspectives
from mocapella.viewer.picture_plane import SizedPicture
from mocapella.viewer.stage import Stage

KEPT_BYTES: Final = 300_000_000
"""Largest memory of the timeline, in bytes: first images and frames of the oldest moments are dropped, then moments."""
KEPT_FRAMES: Final = 36_000
"""Number of moments that are kept at least, memory permitting; at `LET_GO` more, the oldest `LET_GO` are dropped."""
LET_GO: Final = 1_000
LATEST_S: Final = 0.5
"""Largest age at which a camera's last image is shown in a run on files, if the scene has no image of it [s]."""
BACK_S: Final = 1.0
"""A scene that is older than the last one by more than this begins another timeline [s]."""
_VALUE_BYTES: Final = 120
"""Approximate memory of an array or structure besides its content, in bytes."""


@dataclass(frozen=True, eq=False)
class ShownPicture:
    """A camera image, and the scene of its capture time.

    Attributes:
        picture: the encoded image.
        scene: scene to draw over the image; None if no scene of that time is known.
        at_s: time of the image [s]: in a run on files the scene's time, on the scenes' common clock; else the arrival,
            on this process's monotonic clock.
    """

    picture: SizedPicture
    scene: Scene | None
    at_s: float


@dataclass(frozen=True, eq=False)
class Moment:
    """Everything that is shown at one time.

    Attributes:
        at_s: capture time of the scene, on the scenes' common clock [s].
        scene: the tracker's result; None before the first.
        frames: newest frame of each sensor, by sensor.
        stage: the stage that shows the scene.
        shown: value that the stage's memory derived from the scene (`StageMemory.update`).
        seen: poses of the sensors and of each person's views at that time.
        pictures: newest image of each camera, by camera.
    """

    at_s: float
    scene: Scene | None
    frames: Mapping[str, SensorFrame]
    stage: Stage
    shown: Any
    seen: Perspectives
    pictures: Mapping[str, ShownPicture]


class Timeline:
    """The stored moments, numbered from 0; the numbers do not change when old moments are dropped.

    ``timeline[number]`` is the stored moment nearest to a number; without moments, it raises `IndexError`. ``len`` is
    the number of stored moments. Times are on the scenes' common clock.

    Attributes:
        done: whether no more moments follow, because a run on files has ended.
        world: number of times that the timeline began again, because a scene was much older than the last one.
        first: number of the oldest stored moment.
    """

    def __init__(self) -> None:
        self.done, self.world = False, 0
        self._clear()

    def _clear(self) -> None:
        self._moments: list[Moment] = []
        self._at_s: list[float] = []
        self._scene_bytes: list[int] = []
        self._other_bytes: list[int] = []
        self._bytes, self._thin, self.first = 0, 0, 0

    def __len__(self) -> int:
        return len(self._moments)

    @property
    def last(self) -> int:
        """Number of the newest moment; −1 before the first."""
        return self.first + len(self._moments) - 1

    def __getitem__(self, number: int) -> Moment:
        return self._moments[self.nearest(number) - self.first]

    def nearest(self, number: int) -> int:
        """Return the number of the stored moment nearest to ``number``; −1 if no moment is stored."""
        return min(max(number, self.first), self.last)

    def add(self, moment: Moment) -> None:
        """Store a moment, unless it has no scene or the last moment's scene; ``moment.frames`` is not copied.

        A time more than `BACK_S` before the last moment's drops all moments and begins the numbers at 0 again; a
        smaller step back is stored with the last moment's time. Beyond `KEPT_BYTES` or `KEPT_FRAMES`, old moments are
        dropped.
        """
        before = self._moments[-1] if self._moments else None
        if moment.scene is None or (before is not None and before.scene is moment.scene):
            return
        at_s = moment.at_s
        if before is not None and at_s < before.at_s - BACK_S:
            self._clear()
            self.world, before = self.world + 1, None
        at_s = at_s if before is None else max(at_s, before.at_s)
        moment = replace(moment, at_s=at_s)
        scene_bytes = size_of(moment.scene) + size_of(moment.shown if moment.shown is not moment.scene else None)
        other = _fresh_bytes(moment, before)
        self._moments.append(moment)
        self._at_s.append(at_s)
        self._scene_bytes.append(scene_bytes)
        self._other_bytes.append(other)
        self._bytes += scene_bytes + other
        while self._bytes > KEPT_BYTES and self._thin < len(self._moments) - 1:
            self._make_thin(self._thin)
        if len(self._moments) >= KEPT_FRAMES + LET_GO:
            self._let_go(LET_GO)
        elif self._bytes > KEPT_BYTES and len(self._moments) > 1:
            self._let_go(max(1, min(LET_GO, len(self._moments) // 10)))

    def number_at(self, at_s: float) -> int:
        """Return the number of the last moment up to a time [s]; of the first stored moment if all are later."""
        return self.first + max(0, bisect.bisect_right(self._at_s, at_s) - 1)

    def scene_near(self, at_s: float, within_s: float) -> Scene | None:
        """Return the scene nearest to a time ``at_s`` [s]; None if its distance is above ``within_s`` [s]."""
        k = bisect.bisect_left(self._at_s, at_s)
        around = [n for n in (k - 1, k) if 0 <= n < len(self._at_s)]
        best = min(around, key=lambda n: abs(self._at_s[n] - at_s), default=None)
        return None if best is None or abs(self._at_s[best] - at_s) > within_s else self._moments[best].scene

    def lately(self, number: int, seconds: float) -> tuple[list[float], list[Scene]]:
        """Return the times [s] and scenes of the last ``seconds`` up to the stored moment nearest to ``number``.

        Both lists are new and equally long, oldest first, and empty if no moment is stored.
        """
        if not self._moments:
            return [], []
        end = self.nearest(number) - self.first + 1
        begin = bisect.bisect_left(self._at_s, self._at_s[end - 1] - seconds)
        scenes = [moment.scene for moment in self._moments[begin:end] if moment.scene is not None]
        return self._at_s[begin:end], scenes

    def _make_thin(self, k: int) -> None:
        """Drop the images and frames of stored moment ``k``; all that the next moment shares then count for it."""
        old, after = self._moments[k], self._moments[k + 1]
        self._moments[k] = replace(old, frames={}, pictures={})
        moved = _fresh_bytes(after, None) - _fresh_bytes(after, old)
        self._bytes += moved - self._other_bytes[k]
        self._other_bytes[k + 1] += moved
        self._other_bytes[k] = 0
        self._thin = k + 1

    def _let_go(self, count: int) -> None:
        for k in range(self._thin, count):
            self._make_thin(k)
        self._bytes -= sum(self._scene_bytes[:count])
        for values in (self._moments, self._at_s, self._scene_bytes, self._other_bytes):
            del values[:count]
        self._thin, self.first = max(0, self._thin - count), self.first + count


class PlayState(StrEnum):
    """State of a browser on the timeline; the values are the texts for the user."""

    NOTHING = "Getting ready"
    FOLLOWING = "Following"
    PLAYING = "Playing"
    PAUSED = "Paused"
    END = "End"


class Playhead:
    """Position of one browser on a timeline.

    Callbacks of the browser set ``playing``, ``wish`` and ``newest``; the drawing loop calls `update`. At first it
    follows the newest moment.

    Args:
        timeline: the stored moments.

    Attributes:
        playing: whether the position advances by itself.
        wish: number of the moment that the user chose, until `update` uses it.
        newest: whether the user asked to follow live scenes, until `update` does so.
        number: number of the shown moment; None to follow the newest moment.
    """

    def __init__(self, timeline: Timeline) -> None:
        self._timeline, self._world = timeline, timeline.world
        self.playing, self.newest = True, False
        self.wish: int | None = None
        self.number: int | None = None
        self._played_s: float | None = None
        self._rested = False

    @property
    def shown(self) -> int:
        """Number of the moment that the browser shows; −1 before the first."""
        return self._timeline.last if self.number is None else self._timeline.nearest(self.number)

    @property
    def state(self) -> PlayState:
        """State of the browser on the timeline, such as paused."""
        timeline = self._timeline
        if not len(timeline):
            return PlayState.NOTHING
        if timeline.done and self.shown == timeline.last:
            return PlayState.END
        if not self.playing:
            return PlayState.PAUSED
        return PlayState.FOLLOWING if self.number is None else PlayState.PLAYING

    @property
    def behind_s(self) -> float:
        """Age of the shown moment relative to the newest [s]."""
        timeline = self._timeline
        return 0.0 if not len(timeline) else timeline[timeline.last].at_s - timeline[self.shown].at_s

    def update(self, now_s: float) -> None:
        """Move to the moment that the user chose, or else advance at the recorded speed while playing.

        While playing, a position that reaches the newest moment follows new ones again. If no more come
        (``timeline.done``), it stops there, and playing again begins at the first. If the timeline began again, the
        newest moment is followed.

        Args:
            now_s: the present time on this process's monotonic clock [s].
        """
        timeline = self._timeline
        if timeline.world != self._world:
            self._world, self.number, self.wish = timeline.world, None, None
        wish, self.wish = self.wish, None
        if self.newest:
            self.newest, self.playing, self.number, wish = False, True, None, None
        if not len(timeline):
            return
        if wish is not None:
            self.number = timeline.nearest(wish)
        if not self.playing:
            self.number = self.shown
            self._played_s, self._rested = None, True
            return
        rested, self._rested = self._rested, False
        if self.shown >= timeline.last:
            self._at_the_end(now_s, rested=rested)
            return
        if self._played_s is not None:
            due_s = timeline[self.shown].at_s + (now_s - self._played_s)
            self.number = max(self.shown, timeline.number_at(due_s))
            now_s -= max(0.0, due_s - timeline[self.number].at_s)  # the remaining time counts in the next update
        self._played_s = now_s

    def _at_the_end(self, now_s: float, *, rested: bool) -> None:
        timeline, self._played_s = self._timeline, None
        if not timeline.done:
            self.number = None
        elif rested:  # Play was pressed at the end
            self.number, self._played_s = timeline.first, now_s
        else:
            self.number, self.playing = timeline.last, False


def size_of(value: Any) -> int:
    """Return the approximate memory of a value in bytes, such as a scene, including all values that it contains."""
    if isinstance(value, np.ndarray | bytes | str):
        return _VALUE_BYTES + (value.nbytes if isinstance(value, np.ndarray) else len(value))
    if isinstance(value, int | float | bool | Topology) or value is None:  # all scenes have the same topologies
        return 16
    inside: Iterable[Any] = ()
    if isinstance(value, Mapping):
        inside = value.values()
    elif isinstance(value, tuple | list):
        inside = value
    elif isinstance(value, msgspec.Struct):
        inside = (getattr(value, name) for name in value.__struct_fields__)
    elif is_dataclass(value) and not isinstance(value, type):
        inside = (getattr(value, one.name) for one in fields(value))
    return _VALUE_BYTES + sum(size_of(one) for one in inside)


def _fresh_bytes(moment: Moment, before: Moment | None) -> int:
    """Return the memory of the frames and images that the moment before does not have, in bytes."""
    frames, pictures = (before.frames, before.pictures) if before is not None else ({}, {})
    size = sum(size_of(frame) for name, frame in moment.frames.items() if frames.get(name) is not frame)
    for camera, shown in moment.pictures.items():
        if camera not in pictures or pictures[camera].picture is not shown.picture:
            size += len(shown.picture.image) + _VALUE_BYTES
    return size
