"""Track the arms of people with depth cameras beside body sensors, and assign each arm to a person.

A depth camera's pose is that of the body sensor it is a part of, or is given relative to one by a camera rig.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.arm_owners import ArmOwners, ArmOwnerSettings
from mocapella.errors import one_of
from mocapella.geometry.rigid import inverse
from mocapella.model.arms import ELBOW, PALM, ArmFrame
from mocapella.model.camera_rig_file import decode_camera_rig
from mocapella.model.hand import WRIST
from mocapella.model.memory import set_memory
from mocapella.model.scene import Person, TrackedArm
from mocapella.model.topology import Topology
from mocapella.settings import check
from mocapella.tracker.arm_tracks import REMEMBERED as TRACKS_REMEMBERED
from mocapella.tracker.arm_tracks import TO_SENSOR, ArmTracks, ArmTracksSettings
from mocapella.tracker.arrivals import time_problem

Float64 = NDArray[np.float64]

_ARM_JOINTS: Final = [ELBOW, WRIST, PALM]
_LIMB_JOINTS: Final = ("Elbow", "Wrist", "Hand")


@dataclass(frozen=True)
class PeopleArmsSettings:
    """Poses of depth cameras, and tracking of their arms.

    Attributes:
        depth_of: name of the body sensor that a depth camera is a part of, by camera name; both have one pose.
        rig: text of a camera rig file with one of the cameras of ``depth_of`` and others beside it; empty for none.
        tracks: tracking and fusion of arms.
        owners: assignment to people.

    Raises:
        InputError: ``rig`` is no camera rig.
        SettingsError: no camera of ``rig`` is in ``depth_of``; names the rig's cameras.
    """

    depth_of: dict[str, str] = field(default_factory=dict)
    rig: str = ""
    tracks: ArmTracksSettings = field(default_factory=ArmTracksSettings)
    owners: ArmOwnerSettings = field(default_factory=ArmOwnerSettings)

    def __post_init__(self) -> None:
        if self.rig:
            cameras = decode_camera_rig(self.rig).cameras
            fits = any(name in cameras for name in self.depth_of)
            check(fits, "depth_of", self.depth_of, f"of a camera of the rig: one of {', '.join(cameras)}")


class PeopleArms:
    """Tracker of the arms seen by depth cameras, each assigned to a tracked person. It is a part of `DefaultTracker`.

    Args:
        settings: poses of the cameras, and tracking; the defaults, without any camera, if None.
    """

    def __init__(self, settings: PeopleArmsSettings | None = None) -> None:
        self.settings = s = settings or PeopleArmsSettings()
        rig = decode_camera_rig(s.rig).cameras if s.rig else {}
        base = next((name for name in s.depth_of if name in rig), "")
        # T_sensor_camera of each camera, and the sensor.
        self._in: dict[str, tuple[str, Float64]] = {name: (sensor, TO_SENSOR) for name, sensor in s.depth_of.items()}
        for name, placed in rig.items():
            T_base_camera = rig[base].T_camera_world @ inverse(placed.T_camera_world)
            self._in.setdefault(name, (s.depth_of[base], TO_SENSOR @ T_base_camera))
        self._tracks, self._owners = ArmTracks(s.tracks), ArmOwners(s.owners)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._tracks.reset()
        self._owners.reset()
        self._newest: dict[str, tuple[int, int]] = {}

    def memory(self) -> Any:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        tracks = {name: value for name, value in vars(self._tracks).items() if name != "settings"}
        return [tracks, self._owners.limbs, self._newest]

    def recall(self, memory: Any) -> None:
        """Restore the state that `memory` returned for the same settings."""
        tracks, self._owners.limbs, self._newest = memory
        set_memory(self._tracks, tracks)

    def problem(self, frame: ArmFrame, sensors: Mapping[str, Float64]) -> str:
        """Return why a frame cannot be used; empty if it can.

        ``sensors`` are the calibrated poses ``T_world_sensor`` (4, 4), by body sensor.
        """
        if frame.sensor not in self._in:
            fix = f"""--set 'arms.depth_of={{"{frame.sensor}": "SENSOR"}}' names the sensor that it is a part of"""
            known = f"; configured cameras: {one_of(frame.sensor, self._in)}" if self._in else ""
            return f"it sends arms, and its pose is not configured: {fix}{known}"
        sensor = self._in[frame.sensor][0]
        if sensor not in sensors:
            return f"it sends arms, and the pose of {sensor} is not known yet"
        return time_problem(frame, self._newest.get(frame.sensor))

    def update(self, frame: ArmFrame, at_s: float, sensors: Mapping[str, Float64]) -> None:
        """Process a frame without a `problem`; `tracked_arms` returns the result.

        Args:
            frame: the arms of a depth camera.
            at_s: capture time, on the common clock [s].
            sensors: calibrated poses ``T_world_sensor`` (4, 4), by body sensor.
        """
        self._newest[frame.sensor] = (frame.node_id, frame.time_ns)
        places = {name: sensors[sensor] @ T for name, (sensor, T) in self._in.items() if sensor in sensors}
        self._tracks.update(frame.sensor, frame.arms, at_s, places)

    @property
    def there(self) -> bool:
        """Whether any arm is tracked."""
        return bool(self._tracks.tracks)

    def tracked_arms(self, people: Sequence[Person], topology: Topology | None, now_s: float) -> tuple[TrackedArm, ...]:
        """Predict the arms to a time, assign them to people, and return the present ones with their persons' ids.

        Args:
            people: the tracked people.
            topology: topology of the people's skeletons; if None, the arms have no persons.
            now_s: the scene's time on the server's clock [s]; it never decreases, an earlier one counts as the last.

        Returns:
            The arms seen lately, in the order of their ids, in the world; ``person`` is −1 for none.
        """
        self._tracks.advance(now_s)
        arms = self._tracks.tracked_arms()
        if not arms or topology is None:
            return arms
        owners = self._owners.update(
            [arm.id for arm in arms],
            np.array([arm.left for arm in arms]),
            np.array([arm.points[_ARM_JOINTS] for arm in arms]),
            [person.id for person in people],
            _limbs(people, topology),
        )
        return tuple(msgspec.structs.replace(arm, person=owner) for arm, owner in zip(arms, owners, strict=True))


def _limbs(people: Sequence[Person], topology: Topology) -> Float64:
    """Return elbow, wrist and hand (people, 2, 3, 3), left and right; NaN if the topology lacks them."""
    out = np.full((len(people), 2, 3, 3), np.nan)
    for i, side in enumerate(("Left", "Right")):
        for k, joint in enumerate(_LIMB_JOINTS):
            if f"{joint}{side}" in topology.joints:
                at = topology.index(f"{joint}{side}")
                for n, person in enumerate(people):
                    out[n, i, k] = person.positions[at]
    return out


REMEMBERED: Final = TRACKS_REMEMBERED
