"""Collect one object's positions from the cameras and its poses from another tracker, for `space_alignment`.

A frame has the other tracker's own clock. The scene that the server makes of it gives the frame's time on the common
clock, even if the object is unchanged. So both are needed, in any order.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.space_alignment import Shortfall, SpaceAlignmentSettings, SpaceFit, align_space, try_to_align
from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, SettingsError, one_of
from mocapella.geometry.rigid import apply
from mocapella.model.observations import JointState
from mocapella.model.poses import PoseFrame
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame

Float64 = NDArray[np.float64]
_Key = tuple[str, int, int]

_AXIS_M: Final = 0.05
"""Distance of the points on an object's axes that represent its pose [m]."""
_LOCAL: Final = np.vstack([np.zeros(3), _AXIS_M * np.eye(3)])


class SpaceObservations:
    """Collects positions of an object, or of one marker, and poses of a body in another tracker's space.

    Args:
        body: the other tracker's name of the object.
        space: name of the other tracker's space; empty if there is only one.
        thing, marker: name of the tracked object, or of the marker on it; one of them is empty.
        source: origin of the messages, named in errors: a take's path, or None.

    Attributes:
        scenes: number of scenes so far.

    Raises:
        SettingsError: both or neither of thing and marker are given.
    """

    def __init__(self, body: str, *, space: str = "", thing: str = "", marker: str = "", source: Any = None) -> None:
        if bool(marker) == bool(thing):
            raise SettingsError("name what was fixed on it: either --marker or --object")
        self.body, self.thing, self.marker = body, thing, marker
        self.scenes = 0
        self._space, self._source = space, source
        self._at_ns: dict[_Key, int] = {}
        self._points: list[tuple[_Key, Float64]] = []
        self._known: set[str] = set()
        self._spaces: dict[str, set[str]] = {}
        self._pose_sensors: set[str] = set()
        self._poses: list[tuple[_Key, str, Float64]] = []

    def update(self, messages: Iterable[Scene | SensorFrame]) -> None:
        """Add the observations in scenes (the cameras' object or marker) and in `PoseFrame` (the other tracker's body).

        Messages may come in any order; other frames are ignored.
        """
        for message in messages:
            if isinstance(message, Scene):
                self._add_scene(message)
            elif isinstance(message, PoseFrame):
                self._add_poses(message)

    @property
    def space(self) -> str:
        """Name of the other tracker's space.

        Raises:
            InputError: no space has the required name, there is none at all, or there are several.
        """
        if not self._spaces:
            fix = "start mocapella node osc or openvr" if self._source is None else "record with node osc or openvr"
            raise InputError("has no poses of another tracker" if self._source else "no poses of another tracker came",
                             file=self._source, fix=fix)  # fmt: skip
        space = self._space or (next(iter(self._spaces)) if len(self._spaces) == 1 else "")
        if space not in self._spaces:
            problem = "there is no such space" if space else "there are several spaces"
            fix = f"--space is one of {', '.join(sorted(self._spaces))}"
            raise InputError(problem, file=self._source, value=space or None, fix=fix)
        return space

    def attempt(self, settings: SpaceAlignmentSettings) -> tuple[SpaceFit | None, tuple[Shortfall, ...]]:
        """Return the alignment from all observations so far, None if they do not suffice, and its shortfalls.

        The alignment is the pose of the other tracker's space in the cameras' world (`space_alignment.try_to_align`).

        Raises:
            InputError: the space or the body is unknown; lists the known ones.
            SettingsError: the object or the marker is unknown.
        """
        return try_to_align(*self._observed(), settings)

    def align(self, settings: SpaceAlignmentSettings) -> SpaceFit:
        """Estimate the pose of the other tracker's space in the cameras' world from all observations so far.

        Raises:
            InputError: the space or the body is unknown; lists the known ones.
            SettingsError: the object or the marker is unknown.
            CalibrationError: it cannot be estimated; says what to do.
        """
        return align_space(*self._observed(), settings)

    def _observed(self) -> tuple[Float64, Float64, Float64, Float64]:
        poses = self.poses()  # first, because its error is more informative
        return (*self.points(), *poses)

    def poses(self) -> tuple[Float64, Float64]:
        """Return increasing times (n,) on the common clock [s] and ``T_space_body`` (n, 4, 4).

        Frames whose scene has not come yet are left out, because their time is unknown.

        Raises:
            InputError: the space or the body is unknown; lists the known ones.
        """
        space = self.space
        if self.body not in self._spaces[space]:
            fix = f"--body is one of {one_of(self.body, sorted(self._spaces[space])) or 'none'}"
            raise InputError("there is no such body", file=self._source, value=self.body, fix=fix)
        at = {self._at_ns[key]: T for key, of, T in self._poses if of == space and key in self._at_ns}
        times = sorted(at)
        return np.array(times) / NS_PER_S, np.array([at[t] for t in times]).reshape(-1, 4, 4)

    def points(self) -> tuple[Float64, Float64]:
        """Return times (n,) on the common clock [s] and world points (n, m, 3) [m] of the marker or the object.

        m is 1 for a marker; the 4 points of an object are its origin, and one on each axis.

        Raises:
            SettingsError: the object or the marker is unknown.
        """
        wanted, what = (self.thing, "--object") if self.thing else (self.marker, "--marker")
        if wanted not in self._known:
            known = one_of(wanted, sorted(self._known)) or "none"
            raise SettingsError(f"{what} {wanted!r}: {'the take has' if self._source else 'there are'} {known}")
        # The scene of another tracker's frame repeats older results of the cameras.
        seen = [(self._at_ns[key], points) for key, points in self._points if key[0] not in self._pose_sensors]
        count = len(_LOCAL) if self.thing else 1
        return np.array([at for at, _ in seen]) / NS_PER_S, np.array([p for _, p in seen]).reshape(-1, count, 3)

    def _add_scene(self, scene: Scene) -> None:
        self.scenes += 1
        key = scene.sensor, scene.node_id, scene.sequence
        self._at_ns[key] = scene.at_ns
        if self.thing:
            self._known.update(one.name for one in scene.objects)
            found = next((one for one in scene.objects if one.name == self.thing), None)
            if found is not None and found.state == JointState.TRACKED and found.T_world_object is not None:
                self._points.append((key, apply(found.T_world_object, _LOCAL)))
        elif scene.points is not None:
            names = scene.points.names
            self._known.update(names)
            if self.marker in names and scene.points.cameras[k := names.index(self.marker)] >= 2:
                self._points.append((key, scene.points.positions[k : k + 1]))

    def _add_poses(self, frame: PoseFrame) -> None:
        self._pose_sensors.add(frame.sensor)
        self._spaces.setdefault(frame.space, set()).update(frame.names)
        if (T := frame.T_space_body(self.body)) is not None:
            self._poses.append((frame.key, frame.space, T))
