"""Create the method ``silhouettes`` from plain settings, as stored in a take: rig, bodies, and tracking settings.

tracker = make_silhouettes({"rig": text, "bodies": [{"model": "male", "start": {"root_twist": […], "angles": {…}}}]})
"""

from __future__ import annotations

import base64
import binascii
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any, Final

import numpy as np

from mocapella.errors import SettingsError, one_of
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.model.body_proportions import AVERAGE
from mocapella.model.camera_rig_file import decode_camera_rig
from mocapella.model.rigged_mesh import RiggedMesh
from mocapella.model.rigged_mesh_file import decode_rigged_mesh
from mocapella.model.twist_tree import TreePose
from mocapella.settings import check, parse
from mocapella.tracker.frame_sync import FrameSyncSettings
from mocapella.tracker.initial_body import InitialBody, LaterJoints
from mocapella.tracker.silhouette_settings import SilhouetteSettings
from mocapella.tracker.silhouette_start import Body, body_again, check_apart
from mocapella.tracker.silhouettes import SilhouettesTracker

WHERE: Final = "settings of silhouettes"


@dataclass(frozen=True)
class BodyStartSetup:
    """Initial pose of a body.

    Attributes:
        root_twist: twist of T_world_model: translation part [m], then rotation vector [rad].
        angles: joint angles, by joint name; joints that are not named are at 0 [rad].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    root_twist: tuple[float, float, float, float, float, float]
    angles: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        numbers = (*self.root_twist, *self.angles.values())
        check(bool(np.isfinite(numbers).all()), "start", numbers, "finite numbers")


@dataclass(frozen=True)
class LaterJointsSetup:
    """Joints of a body at a later instant.

    Attributes:
        at_s: time since the first frame [s].
        joints: positions in the world, by landmark name [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    at_s: float
    joints: dict[str, tuple[float, float, float]]

    def __post_init__(self) -> None:
        numbers = [self.at_s, *(value for at in self.joints.values() for value in at)]
        check(bool(np.isfinite(numbers).all()), "later", numbers, "finite numbers")


@dataclass(frozen=True)
class BodySetup:
    """A tracked body.

    Attributes:
        start: initial pose.
        name: name of the person; may be empty if there is only one.
        model: male, female, legs, or the name of the file in ``mesh``.
        height_m: subject height; None if ``proportions`` give the size [m].
        proportions: lengths of segments, by name [m].
        mesh: content of a .glb file in base64; empty for a built-in model.
        later: joints at later instants, to find a lost body again.
    """

    start: BodyStartSetup
    name: str = ""
    model: str = "male"
    height_m: float | None = None
    proportions: dict[str, float] = field(default_factory=dict)
    mesh: str = ""
    later: tuple[LaterJointsSetup, ...] = ()


@dataclass(frozen=True)
class SilhouettesSetup:
    """Settings of the method besides `SilhouetteSettings`.

    Attributes:
        rig: the text of the camera rig file.
        bodies: the tracked bodies.
        empty_room_s: duration without people at first, to learn the room; then people are waited for [s].
        waiting: whether the room is empty at first.
        sync: grouping of the cameras' frames into simultaneous sets.
    """

    rig: str
    bodies: tuple[BodySetup, ...]
    empty_room_s: float = 0.0
    waiting: bool = False
    sync: FrameSyncSettings = field(default_factory=FrameSyncSettings)


def make_silhouettes(settings: Mapping[str, Any]) -> SilhouettesTracker:
    """Create a tracker of the method ``silhouettes`` from plain settings.

    Args:
        settings: the fields of `SilhouettesSetup` and of `SilhouetteSettings`, by name; ``rig`` and ``bodies`` are
            required, the others have defaults.

    Raises:
        SettingsError: an unknown key, a value out of range, or an impossible body; names valid values.
        InputError: the rig or a mesh cannot be read, or two bodies start at one position.
    """
    own, fit = (tuple(one.name for one in dataclasses.fields(kind)) for kind in (SilhouettesSetup, SilhouetteSettings))
    for key in settings:
        if key not in (*own, *fit):
            raise SettingsError(f"{WHERE}: unknown key {key!r}; known: {one_of(str(key), (*own, *fit))}")
    setup = parse(SilhouettesSetup, {key: value for key, value in settings.items() if key in own}, where=WHERE)
    values = parse(SilhouetteSettings, {key: value for key, value in settings.items() if key in fit}, where=WHERE)
    names = [body.name for body in setup.bodies]
    check(len(set(names)) == len(names), "names of bodies", names, "one for each")
    check(len(names) < 2 or all(names), "names of bodies", names, "given where there are several")
    bodies = {body.name: _starting(body) for body in setup.bodies}
    check_apart({name: (body.mesh, body.pose) for name, body in bodies.items()})
    return SilhouettesTracker(
        bodies,
        decode_camera_rig(setup.rig),
        values,
        sync=setup.sync,
        empty_room_s=setup.empty_room_s,
        waiting=setup.waiting,
    )


def body_setup(
    name: str, body: Body, pose: TreePose, mesh_file: bytes = b"", later: Sequence[LaterJoints] = ()
) -> dict[str, Any]:
    """Return a body as plain settings, one item of ``bodies`` for `make_silhouettes`.

    Args:
        name: name of the person.
        body: the body, with its mesh and proportions.
        pose: initial pose.
        mesh_file: content of the .glb file, if the body has one.
        later: joints at later instants; none are stored if there are none.
    """
    start = BodyStartSetup(
        tuple(log_motion(pose.T_world_model).tolist()),
        dict(zip(body.mesh.joint_names, pose.angles.tolist(), strict=True)),
    )
    mesh = base64.b64encode(mesh_file).decode("ascii")
    instants = tuple(
        LaterJointsSetup(one.at_s, {joint: tuple(at.tolist()) for joint, at in one.joints.items()}) for one in later
    )
    known = body.proportions.known
    plain = dataclasses.asdict(BodySetup(start, name, body.model, body.height_m, known, mesh, instants))
    if not later:
        del plain["later"]
    return plain


def _starting(setup: BodySetup) -> InitialBody:
    whose = f"{WHERE}: {setup.name or 'body'}"
    body = _of_file(setup, whose) if setup.mesh else body_again(setup.model, setup.height_m, setup.proportions)
    later = [LaterJoints(one.at_s, {k: np.array(at) for k, at in one.joints.items()}) for one in setup.later]
    return body.starting(_pose(setup.start, body.mesh, whose), later)


def _of_file(setup: BodySetup, whose: str) -> Body:
    check(setup.height_m is None and not setup.proportions, f"{whose}: height_m and proportions", "given", "left out: "
          "the mesh has its own size")  # fmt: skip
    try:
        data = base64.b64decode(setup.mesh, validate=True)
    except (ValueError, binascii.Error) as error:
        raise SettingsError(f"{whose}: mesh is no base64; encode the whole .glb file") from error
    return Body(setup.model, None, AVERAGE, decode_rigged_mesh(data, setup.model), sha256(data).hexdigest())


def _pose(start: BodyStartSetup, mesh: RiggedMesh, whose: str) -> TreePose:
    for joint in start.angles:
        if joint not in mesh.joint_names:
            raise SettingsError(
                f"{whose}: {mesh.name} has no joint {joint!r}; known: {one_of(joint, mesh.joint_names)}"
            )
    angles = np.array([start.angles.get(joint, 0.0) for joint in mesh.joint_names], np.float64)
    return TreePose(exp_twist(np.array(start.root_twist, np.float64)), angles)
