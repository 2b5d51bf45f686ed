"""A recording as Python opens it: the motion of people, hands, arms, bodies, objects and points."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from mocapella.errors import SettingsError
from mocapella.library.motion_tracks import MotionTracks, MotionView
from mocapella.library.study_views import read_study_views
from mocapella.library.tracked_scenes import TrackedScenes
from mocapella.model.scene import Scene
from mocapella.model.trajectories import PARTS, VIEWS, Trajectories
from mocapella.recording.body_csv import is_body_csv
from mocapella.recording.study_log import is_study_log
from mocapella.recording.take_reader import Take
from mocapella.recording.take_trajectories import labels_of, take_trajectories, timed_scenes
from mocapella.recording.trajectory_files import open_trajectories


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
        return self.motion.get("people")

    @property
    def hands(self) -> MotionTracks | None:
        """The hands; None if the recording has none."""
        return self.motion.get("hands")

    @property
    def arms(self) -> MotionTracks | None:
        """The arms that depth cameras see; None if the recording has none."""
        return self.motion.get("arms")

    @property
    def bodies(self) -> MotionTracks | None:
        """The bodies fitted to silhouettes; None if the recording has none."""
        return self.motion.get("bodies")

    @property
    def objects(self) -> MotionTracks | None:
        """The rigid objects; None if the recording has none."""
        return self.motion.get("objects")

    @property
    def points(self) -> MotionTracks | None:
        """The named 3D points, such as the markers of a TRC or C3D; None if the recording has none."""
        return self.motion.get("points")

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
        if not self.motion:
            raise SettingsError(f"{self.path.name} has no motion that could be shown")
        return next(iter(self.motion.values())).show(height_px)

    def scenes(self) -> Iterator[Scene]:
        """Yield the tracker's results one by one, with everything in them; none for a file of trajectories."""
        if self._tracked is not None:
            yield from self._tracked.scenes()
        elif self.take is not None:
            yield from (scene for _, _, scene in timed_scenes(self.take))

    @cached_property
    def motion(self) -> dict[str, MotionTracks]:
        """All motion by kind, such as ``people``."""
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
        return self.motion if views is None else {**self.motion, VIEWS: views}

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


def load(path: Path | str, *, unit: str | None = None) -> Recording:
    """Open a recording: a take (.mcap), a result of silhouette tracking (.json), or a file of points or joints.

    These are .trc, .c3d, .bvh, and .csv: a study log, a table of ``mocapella export csv``, one sensor's bodies, or
    markers in millimetres. What is damaged in a take is left out, and named in `Recording.problems`.

    Args:
        path: the file; the suffix of a take may be left out, and the folder ``takes``.
        unit: unit of a BVH, which does not state it: m, dm, cm, mm or in; None for cm.

    Raises:
        InputError: the file is missing, damaged, or of another type; names the types.
        SettingsError: the unit is unknown, or the file is no BVH.
        SchemaVersionError: the take was made with another message schema.
    """
    path = Path(path)
    if path.name.lower().endswith((".csv", ".csv.gz")) and path.is_file() and is_study_log(path):
        if unit is not None:
            raise SettingsError(f"unit {unit!r}: {path.name} is no BVH; leave the unit out")
        return Recording(path, None, {VIEWS: read_study_views(path)}, has_frames=True)
    file, found = open_trajectories(path, unit)
    if isinstance(found, Take):
        return Recording(file, found)
    return Recording(file, None, {found.kind: found}, has_frames=is_body_csv(file))
