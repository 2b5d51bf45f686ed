"""A recording as Python opens it: the motion of people, hands, arms, bodies, objects and points."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from mocapella.errors import InputError, SettingsError
from mocapella.library.motion_tracks import MotionTracks, MotionView
from mocapella.library.study_views import read_study_views
from mocapella.library.tracked_scenes import TrackedScenes
from mocapella.model.scene import Scene
from mocapella.model.trajectories import PARTS, VIEWS, Trajectories
from mocapella.recording.bodies_trajectories import read_bodies
from mocapella.recording.c3d_file import read_c3d
from mocapella.recording.disk import SUFFIX
from mocapella.recording.take_reader import Take, read_take
from mocapella.recording.take_trajectories import labels_of, take_trajectories, timed_scenes
from mocapella.recording.trc_file import read_trc

READERS: Final[Mapping[str, Callable[[Path], Trajectories]]] = {
    ".trc": read_trc,
    ".c3d": read_c3d,
    ".json": read_bodies,
    ".csv": read_study_views,
    ".gz": read_study_views,
}
"""Readers of files with trajectories of one kind, by suffix; .csv and .csv.gz are study logs."""


class Recording:
    """A recording; `mocapella.load` opens it. Its motion is read when it is first asked for, and kept.

    Attributes:
        path: the file.
        take: the take, for its raw content; None for a file of another type.
    """

    def __init__(
        self,
        path: Path,
        take: Take | None,
        found: Mapping[str, Trajectories] | None = None,
        *,
        tracked: TrackedScenes | None = None,
        has_frames: bool = False,
    ) -> None:
        self.path, self.take = path, take
        self._given, self._tracked = found or {}, tracked
        self._has_frames = has_frames

    @property
    def people(self) -> MotionTracks | None:
        """The fused people; None if the recording has none."""
        return self._all.get("people")

    @property
    def hands(self) -> MotionTracks | None:
        """The hands; None if the recording has none."""
        return self._all.get("hands")

    @property
    def arms(self) -> MotionTracks | None:
        """The arms that depth cameras see; None if the recording has none."""
        return self._all.get("arms")

    @property
    def bodies(self) -> MotionTracks | None:
        """The bodies fitted to silhouettes; None if the recording has none."""
        return self._all.get("bodies")

    @property
    def objects(self) -> MotionTracks | None:
        """The rigid objects; None if the recording has none."""
        return self._all.get("objects")

    @property
    def points(self) -> MotionTracks | None:
        """The named 3D points, such as the markers of a TRC or C3D; None if the recording has none."""
        return self._all.get("points")

    @cached_property
    def views(self) -> MotionTracks | None:
        """Each sensor's own skeletons in the world, such as ``person_1@front``; None if the recording has none."""
        found = self._trajectories((VIEWS,))
        return MotionTracks.of_file(found[VIEWS], str(self.path)) if found else None

    def seen_from(self, sensor: str, kinds: Sequence[str] = tuple(PARTS)) -> dict[str, MotionTracks]:
        """Return the motion in a sensor's camera space, by kind; unknown while the sensor's pose is.

        Raises:
            SettingsError: the recording is no take, or no result has a pose of the sensor; lists the sensors.
        """
        if self.take is None and self._tracked is None:
            raise SettingsError(f"{self.path.name} has no sensors: only a take has")
        found = self._trajectories(kinds, sensor=sensor)
        return {kind: MotionTracks.of_file(some, str(self.path)) for kind, some in found.items()}

    @property
    def has_frames(self) -> bool:
        """Whether the file has the sensors' raw frames, which `mocapella.track` tracks again."""
        return self.take is not None or self._has_frames

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors with frames in the recording; none for a file of trajectories."""
        if self._tracked is not None:
            return self._tracked.sensors
        return () if self.take is None else self.take.sensors

    @property
    def seconds(self) -> float:
        """Duration of the recording [s]."""
        if self._tracked is not None:
            return self._tracked.seconds
        if self.take is not None:
            return self.take.seconds
        return max((float(one.times_s[-1] - one.times_s[0]) for one in self._given.values()), default=0.0)

    @property
    def labels(self) -> dict[int, dict[str, Any]]:
        """Participant, placement, scenario and method of each run of a take, by the run's number."""
        if self.take is not None:
            return labels_of(self.take)
        labels = self._tracked.labels if self._tracked is not None else self._given_labels()
        return {run: dict(own) for run, own in labels.items()}

    def _given_labels(self) -> Mapping[int, Mapping[str, Any]]:
        return next((one.labels for one in self._given.values()), {})

    @property
    def problems(self) -> tuple[str, ...]:
        """Faults of the file, a line each; what could be read is there."""
        if self._tracked is not None:
            return self._tracked.problems
        if self.take is None:
            return tuple(note for one in self._given.values() for note in one.notes)
        return self.take.problems

    def show(self, height_px: int = 480) -> MotionView:
        """Return a view in 3D of the first kind of motion that the recording has; see `MotionTracks.show`.

        Raises:
            SettingsError: it has none, or as in `MotionTracks.show`.
        """
        if not self._all:
            raise SettingsError(f"{self.path.name} has no motion that could be shown")
        return next(iter(self._all.values())).show(height_px)

    def scenes(self) -> Iterator[Scene]:
        """Yield the tracker's results one by one, with everything in them; none for a file of trajectories."""
        if self._tracked is not None:
            yield from self._tracked.scenes()
        elif self.take is not None:
            yield from (scene for _, _, scene in timed_scenes(self.take))

    @cached_property
    def _all(self) -> dict[str, MotionTracks]:
        found = self._trajectories(tuple(PARTS))
        return {kind: MotionTracks.of_file(some, str(self.path)) for kind, some in found.items()}

    def _trajectories(self, kinds: Sequence[str], *, sensor: str | None = None) -> dict[str, Trajectories]:
        if self._tracked is not None:
            return self._tracked.trajectories(kinds, sensor=sensor)
        if self.take is not None:
            return take_trajectories(self.take, kinds, sensor=sensor)
        return {kind: some for kind, some in self._given.items() if kind in kinds}

    def _shown(self) -> dict[str, MotionTracks]:
        views = self.views if VIEWS in self._given else None
        return self._all if views is None else {**self._all, VIEWS: views}

    def __repr__(self) -> str:
        lines = [f"<Recording {self.path.name}: {self.seconds:.1f} s"]
        if self.sensors:
            lines[0] += f", sensors: {', '.join(self.sensors)}"
        lines += [f"  .{kind}: {some!r}" for kind, some in self._shown().items()]
        lines += [f"  problem: {problem}" for problem in self.problems]
        return "\n".join(lines) + ">"

    def _repr_html_(self) -> str:
        about = f"{self.path.name}: {self.seconds:.1f} s" + (
            f", sensors: {', '.join(self.sensors)}" if self.sensors else ""
        )
        problems = "".join(f"<li>{html.escape(problem)}</li>" for problem in self.problems)
        return f"<p><b>{html.escape(about)}</b></p>{''.join(one._repr_html_() for one in self._shown().values())}" + (
            f"<ul>{problems}</ul>" if problems else ""
        )


def load(path: Path | str) -> Recording:
    """Open a recording: a take (.mcap), a study log (.csv), a result of silhouette tracking (.json), .trc or .c3d.

    What is damaged in a take is left out, and named in `Recording.problems`.

    Raises:
        InputError: the file is missing, or of another type; names the types.
        SchemaVersionError: the take was made with another message schema.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in READERS:
        found = READERS[suffix](path)
        return Recording(path, None, {found.kind: found}, has_frames=found.kind == VIEWS)
    if suffix != SUFFIX and path.with_name(path.name + SUFFIX).is_file():
        path = path.with_name(path.name + SUFFIX)
    elif suffix != SUFFIX and not path.exists():
        raise InputError(
            "there is no such file", file=path, fix=f"name a file that is there, such as {path.name}{SUFFIX}"
        )
    elif suffix != SUFFIX:
        known = ", ".join((SUFFIX, *READERS))
        raise InputError("is no recording that can be loaded", file=path, fix=f"give a file that ends with {known}")
    take = read_take(path)
    take.skips = True
    return Recording(path, take)
