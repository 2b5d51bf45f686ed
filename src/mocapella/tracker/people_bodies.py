"""Fit bodies to cameras' images, beside body sensors, and assign each body to a person.

The method ``silhouettes`` tracks bodies in the frame of its camera rig. The rig's pose in the sensors' world is
estimated from people that both see (`mocapella.calibration.rig_in_world`); until then the scene has no bodies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.tracks import assign
from mocapella.calibration.rig_in_world import REMEMBERED as ALIGNMENT_REMEMBERED
from mocapella.calibration.rig_in_world import RigAlignment, RigInWorldSettings
from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply
from mocapella.model.memory import set_memory
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Person, SensorPlace, TrackedBody, TrackedBodyView
from mocapella.model.topology import Topology
from mocapella.settings import check

if TYPE_CHECKING:
    from mocapella.tracker.silhouettes import SilhouettesTracker

Float64 = NDArray[np.float64]

LIMBS: Final = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
"""Joints that sensors and fitted bodies both have, left and right."""
NOT_CONFIGURED: Final = (
    "it sends images, and neither rig nor bodies are configured: mocapella serve --rig RIG.toml "
    "--start JOINTS.json, or set up the method silhouettes"
)
WALK: Final = "walk where cameras and sensors both see you"


@dataclass(frozen=True)
class PeopleBodiesSettings:
    """Which bodies are fitted, and how they are assigned to people.

    Attributes:
        silhouettes: the settings of the method ``silhouettes``; if empty, no body is fitted, and images are counted as
            rejected frames.
        alignment: estimation of the rig's pose in the world.
        take_m: largest mean distance between a body and a person for the body to be assigned, over the joints `LIMBS`
            that the body has and that are tracked in the person [m].
        keep_m: largest mean distance, as ``take_m``, for a body to stay assigned; from ``take_m`` to 5 [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    silhouettes: dict[str, Any] = field(default_factory=dict)
    alignment: RigInWorldSettings = field(default_factory=RigInWorldSettings)
    take_m: float = 0.25
    keep_m: float = 0.5

    def __post_init__(self) -> None:
        fits = 0 < self.take_m <= self.keep_m <= 5
        check(fits, "take_m", self.take_m, "above 0 and at most keep_m, which is up to 5 m")


class PeopleBodies:
    """Tracker that fits body meshes to silhouettes and assigns them to tracked people; a part of `DefaultTracker`.

    Args:
        settings: the bodies, and their assignment; the defaults, without any body, if None.

    Raises:
        SettingsError, InputError: the settings of ``silhouettes`` cannot be used.
    """

    def __init__(self, settings: PeopleBodiesSettings | None = None) -> None:
        self.settings = s = settings or PeopleBodiesSettings()
        self._tracker: SilhouettesTracker | None = None
        if s.silhouettes:
            if find_spec("cv2") is None:
                raise SettingsError("bodies.silhouettes needs OpenCV: uv sync --extra cameras")
            from mocapella.tracker.silhouettes_setup import make_silhouettes

            self._tracker = make_silhouettes(s.silhouettes)
        self._alignment = RigAlignment(s.alignment)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        if self._tracker is not None:
            self._tracker.reset()
        self._alignment.reset()
        self._bodies: tuple[TrackedBody, ...] = ()
        self._reason = ""
        self._cameras: tuple[SensorPlace, ...] = ()
        self._owner: dict[int, int] = {}

    def memory(self) -> Any:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        inner = b"" if self._tracker is None else self._tracker.snapshot()
        return [inner, self._alignment.memory(), {name: getattr(self, name) for name in _OWN}]

    def recall(self, memory: Any) -> None:
        """Restore the state that `memory` returned for the same settings."""
        inner, alignment, own = memory
        if self._tracker is not None:
            self._tracker.restore(inner)
        self._alignment.recall(alignment)
        set_memory(self, own, _OWN)

    def see(self, arrival: Arrival, people: Sequence[Person], topology: Topology | None) -> str:
        """Process an image; return why it cannot be used, empty if it can. `tracked_bodies` returns the result.

        Args:
            arrival: a camera's frame with an image.
            people: the tracked people, in the world, for the pose of the rig.
            topology: topology of the people's skeletons; None, before the first body frame, keeps the rig's pose.
        """
        if self._tracker is None:
            return NOT_CONFIGURED
        before = self._tracker.report.rejected
        scene = self._tracker.update(arrival)
        after = self._tracker.report.rejected
        self._bodies, self._cameras, self._reason = scene.bodies, scene.sensors, scene.state.reason
        if topology is not None:
            there = {body.name: _joints_of_body(body) for body in self._bodies if not body.lost}
            seen = {person.id: _joints_of_person(person, topology) for person in people}
            self._alignment.update(there, seen, arrival.at_ns / NS_PER_S)
        return next((why for why, count in after.items() if count > before.get(why, 0)), "")

    @property
    def reason(self) -> str:
        """Problems and their remedies; empty if there is none, or no image."""
        if not self._cameras:
            return ""
        unknown = "" if self._alignment.found is not None else f"cameras: {WALK}"
        return "; ".join(part for part in (unknown, self._reason) if part)

    def places(self) -> tuple[SensorPlace, ...]:
        """Return the poses of the rig's cameras; empty before the first image, None poses before the rig's is known."""
        found = self._alignment.found
        if found is None:
            return tuple(SensorPlace(place.sensor, None, problem=WALK) for place in self._cameras)
        words = f"by people, joints {1e2 * found.residual_m:.0f} cm apart"
        return tuple(
            SensorPlace(place.sensor, found.T_world_rig @ place.T_world_sensor, quality=words)
            for place in self._cameras
            if place.T_world_sensor is not None
        )

    def tracked_bodies(self, people: Sequence[Person], topology: Topology | None) -> tuple[TrackedBody, ...]:
        """Return the bodies in the world with their persons' ids; none before the rig's pose is known.

        Bodies and people are assigned one to one by the mean distance of their limbs' joints; −1 for no person, and for
        a lost body.

        Args:
            people: the tracked people, in the world.
            topology: topology of the people's skeletons; None gives no bodies.
        """
        found = self._alignment.found
        if found is None or topology is None:
            return ()
        T = found.T_world_rig
        moved = [
            msgspec.structs.replace(body, T_world_model=T @ body.T_world_model, landmarks=apply(T, body.landmarks))
            for body in self._bodies
        ]
        owners = self._owners(moved, {person.id: _joints_of_person(person, topology) for person in people})
        return tuple(msgspec.structs.replace(body, person=owner) for body, owner in zip(moved, owners, strict=True))

    def _owners(self, bodies: Sequence[TrackedBody], people: Mapping[int, Float64]) -> list[int]:
        """Assign bodies to people one to one; a body keeps its person while it is near."""
        if not bodies or not people:
            return [-1] * len(bodies)
        ids, joints = list(people), np.array(list(people.values()))
        apart = np.linalg.norm(np.array([_joints_of_body(body) for body in bodies])[:, None] - joints[None], axis=-1)
        known = np.isfinite(apart)
        count = known.sum(axis=-1)
        mean = np.where(known, apart, 0.0).sum(axis=-1) / np.maximum(count, 1)
        own = np.array([[self._owner.get(body.id) == person for person in ids] for body in bodies])
        lost = np.array([body.lost for body in bodies])
        allowed = (count > 0) & ~lost[:, None] & (mean <= np.where(own, self.settings.keep_m, self.settings.take_m))
        chosen = assign(np.where(own, 0.5 * mean, mean), allowed).tolist()
        owners = [ids[column] if column >= 0 else -1 for column in chosen]
        self._owner = {body.id: owner for body, owner in zip(bodies, owners, strict=True) if owner >= 0}
        return owners


def _joints_of_person(person: Person, topology: Topology) -> Float64:
    """(12, 3) of `LIMBS`, left and right; NaN where the topology has none, or the joint is not tracked."""
    out = np.full((2 * len(LIMBS), 3), np.nan)
    for k, (limb, side) in enumerate(_SIDES):
        name = f"{limb}{side}"
        if name in topology.joints:
            at = topology.index(name)
            if person.states[at] == JointState.TRACKED:
                out[k] = person.positions[at]
    return out


def _joints_of_body(body: TrackedBody) -> Float64:
    """(12, 3) of `LIMBS`, left and right; NaN where the body has none."""
    out = np.full((2 * len(LIMBS), 3), np.nan)
    for k, (limb, side) in enumerate(_SIDES):
        name = f"{side.lower()} {limb.lower()}"
        if name in body.landmark_names:
            out[k] = body.landmarks[body.landmark_names.index(name)]
    return out


_SIDES: Final = tuple((limb, side) for limb in LIMBS for side in ("Left", "Right"))
_OWN: Final = ("_bodies", "_cameras", "_reason", "_owner")
REMEMBERED: Final = (*ALIGNMENT_REMEMBERED, TrackedBody, TrackedBodyView)
"""Classes in the state that `PeopleBodies.memory` returns, for `mocapella.model.memory`."""
