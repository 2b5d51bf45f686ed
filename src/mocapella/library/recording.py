"""A recording as Python opens it: the motion of people, hands, arms, bodies, objects and points."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from mocapella.errors import InputError, SettingsError
from mocapella.library.motion_tracks import MotionTracks, MotionView
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
}
"""Readers of files with trajectories of one kind, by suffix."""


class Recording:
    """A recording; `mocapella.load` opens it. Its motion is read when it is first asked for, and kept.

    Attributes:
        path: the file.
        take: the take, for its raw content; None for a file of another type.
    """

    def __init__(self, path: Path, take: Take | None, found: Mapping[str, Trajectories] | None = None) -> None:
        self.path, self.take = path, take
        self._given = found

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
        found = {} if self.take is None else take_trajectories(self.take, (VIEWS,))
        return MotionTracks.of_file(found[VIEWS], str(self.path)) if found else None

    def seen_from(self, sensor: str, kinds: Sequence[str] = tuple(PARTS)) -> dict[str, MotionTracks]:
        """Return the motion in a sensor's camera space, by kind; unknown while the sensor's pose is.

        Raises:
            SettingsError: the recording is no take, or no result has a pose of the sensor; lists the sensors.
        """
        if self.take is None:
            raise SettingsError(f"{self.path.name} has no sensors: only a take has")
        found = take_trajectories(self.take, kinds, sensor=sensor)
        return {kind: MotionTracks.of_file(some, str(self.path)) for kind, some in found.items()}

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors with frames in the recording; none for a file of trajectories."""
        return () if self.take is None else self.take.sensors

    @property
    def seconds(self) -> float:
        """Duration of the recording [s]."""
        if self.take is not None:
            return self.take.seconds
        return max((float(one.times_s[-1] - one.times_s[0]) for one in self._all.values()), default=0.0)

    @property
    def labels(self) -> dict[int, dict[str, Any]]:
        """Participant, placement, scenario and method of each run of a take, by the run's number."""
        return {} if self.take is None else labels_of(self.take)

    @property
    def problems(self) -> tuple[str, ...]:
        """Faults of the file, a line each; what could be read is there."""
        if self.take is None:
            return tuple(note for one in self._all.values() for note in one.notes)
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
        if self.take is not None:
            yield from (scene for _, _, scene in timed_scenes(self.take))

    @cached_property
    def _all(self) -> dict[str, MotionTracks]:
        found = self._given
        if found is None:
            assert self.take is not None
            found = take_trajectories(self.take)
        return {kind: MotionTracks.of_file(some, str(self.path)) for kind, some in found.items()}

    def __repr__(self) -> str:
        lines = [f"<Recording {self.path.name}: {self.seconds:.1f} s"]
        if self.sensors:
            lines[0] += f", sensors: {', '.join(self.sensors)}"
        lines += [f"  .{kind}: {some!r}" for kind, some in self._all.items()]
        lines += [f"  problem: {problem}" for problem in self.problems]
        return "\n".join(lines) + ">"

    def _repr_html_(self) -> str:
        about = f"{self.path.name}: {self.seconds:.1f} s" + (
            f", sensors: {', '.join(self.sensors)}" if self.sensors else ""
        )
        problems = "".join(f"<li>{html.escape(problem)}</li>" for problem in self.problems)
        return f"<p><b>{html.escape(about)}</b></p>{''.join(one._repr_html_() for one in self._all.values())}" + (
            f"<ul>{problems}</ul>" if problems else ""
        )


def load(path: Path | str) -> Recording:
    """Open a recording: a take (.mcap), a result of silhouette tracking (.json), or points as .trc or .c3d.

    What is damaged in a take is left out, and named in `Recording.problems`.

    Raises:
        InputError: the file is missing, or of another type; names the types.
        SchemaVersionError: the take was made with another message schema.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in READERS:
        found = READERS[suffix](path)
        return Recording(path, None, {found.kind: found})
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
