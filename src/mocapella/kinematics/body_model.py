"""Body models: types and limits of the joints of a topology's skeleton, read from data files.

A body model is a TOML file in ``models/``, named as its topology; ``kinect_v2.toml`` explains the keys.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any, Final

from mocapella.decoding import decode_toml
from mocapella.errors import SettingsError, one_of
from mocapella.model.topology import Topology, topology
from mocapella.settings import check, parse

AXES: Final = "xyz"
MOTIONS: Final = ("trunk", "arm", "leg", "hand")
_MIRROR_SIGN: Final = {"x": 1.0, "y": -1.0, "z": -1.0}
"""Sign of an angle about an axis when left and right are exchanged."""


@dataclass(frozen=True)
class Hinge:
    """A revolute joint.

    Attributes:
        name: name of its angle.
        axis: axis of rotation in the frame of the previous hinge, or of the parent bone: ``x``, ``y`` or ``z``.
        limits_deg: (least, most) angle [°].
    """

    name: str
    axis: str
    limits_deg: tuple[float, float]

    def __post_init__(self) -> None:
        check(self.axis in tuple(AXES), "axis", self.axis, "x, y or z")
        least, most = self.limits_deg
        check(-180 <= least <= 0 <= most <= 180, "limits_deg", self.limits_deg, "around 0, within ±180")

    def mirrored(self) -> Hinge:
        """Return the hinge mirrored to the other side of the body, with the same name."""
        least, most = sorted(_MIRROR_SIGN[self.axis] * limit for limit in self.limits_deg)
        return replace(self, limits_deg=(least, most))


@dataclass(frozen=True)
class BallJoint:
    """A ball joint.

    Attributes:
        name: name of the joint, and prefix of its angles.
        centre: (3,) axis of the cone of allowed bone directions, in the parent bone's frame; of any length.
        cone_deg: half angle of the cone [°].
        twist_deg: (least, most) twist of the bone about its own axis, without the swing from its rest direction [°].
    """

    name: str
    centre: tuple[float, float, float]
    cone_deg: float
    twist_deg: tuple[float, float]

    def __post_init__(self) -> None:
        check(sum(c * c for c in self.centre) > 0.0, "centre", self.centre, "a direction")
        check(0 < self.cone_deg <= 180, "cone_deg", self.cone_deg, "above 0, at most 180")
        least, most = self.twist_deg
        check(-180 <= least <= 0 <= most <= 180, "twist_deg", self.twist_deg, "around 0, within ±180")

    def mirrored(self) -> BallJoint:
        """Return the ball joint mirrored to the other side of the body, with the same name."""
        x, y, z = self.centre
        least, most = self.twist_deg
        return replace(self, centre=(-x, y, z), twist_deg=(-most, -least))


@dataclass(frozen=True)
class Bone:
    """A bone of a body model and the joint at its beginning.

    Attributes:
        offset: (3,) vector from the parent joint to the bone's end in the rest pose, as a fraction of stature.
        motion: group of its joint, one of `MOTIONS`; ``arm`` takes the acceleration density ``arm_turn``.
        misfit_m: standard deviation of a sensor's joint at the bone's end from the model's, apart from noise [m].
        hinges: revolute joints from the parent outwards.
        ball: a ball joint, instead of hinges; None without one. Without either, the bone is fixed to its parent.
        firm: whether limits and length also hold against measurements that contradict them for long.
        parent: name of the joint that the bone hangs at; empty for the topology's parent of its end.
        stiffness: factor of the pull towards rest (`ArticulatedSettings.rest_sd`) of its joint; larger: nearer to rest
            where it is not measured; only in bodies that are measured by rays [ratio].
    """

    offset: tuple[float, float, float]
    motion: str
    misfit_m: float = 0.01
    hinges: tuple[Hinge, ...] = ()
    ball: BallJoint | None = None
    firm: bool = False
    parent: str = ""
    stiffness: float = 1.0

    def __post_init__(self) -> None:
        check(sum(c * c for c in self.offset) > 0.0, "offset", self.offset, "not zero")
        check(0 <= self.misfit_m < 10, "misfit_m", self.misfit_m, "0 m or more")
        check(0 <= self.stiffness < 1e6, "stiffness", self.stiffness, "0 or more")
        check(self.motion in MOTIONS, "motion", self.motion, "one of " + ", ".join(MOTIONS))
        check(len(self.hinges) <= 3, "hinges", len(self.hinges), "at most 3 for a bone")
        check(not (self.hinges and self.ball), "ball", self.ball, "absent where there are hinges")

    def mirrored(self) -> Bone:
        """Return the bone and its joint mirrored to the other side of the body, with the same names."""
        x, y, z = self.offset
        hinges = tuple(hinge.mirrored() for hinge in self.hinges)
        return replace(self, offset=(-x, y, z), hinges=hinges, ball=self.ball and self.ball.mirrored())

    def of_side(self, side: str) -> Bone:
        """Return the bone with ``left`` or ``right`` put before the names of its joints."""
        hinges = tuple(replace(hinge, name=f"{side} {hinge.name}") for hinge in self.hinges)
        return replace(self, hinges=hinges, ball=self.ball and replace(self.ball, name=f"{side} {self.ball.name}"))


@dataclass(frozen=True)
class BodyModel:
    """Joint types and limits of a topology's skeleton.

    Attributes:
        topology: the skeleton.
        bones: the bone that ends at each joint, by joint index; for every joint but the root.
        torso: indices of the joints that determine the root's pose at initialisation.
        contacts: indices of the joints that may stand on the floor, such as ankles.
        tree: (parent, child) indices of the bones, a parent before its children.
        by_rays: whether its joints are measured by rays of cameras, rather than by points.
        root_misfit_m: `Bone.misfit_m` of the root [m].
    """

    topology: Topology
    bones: Mapping[int, Bone]
    torso: tuple[int, ...]
    contacts: tuple[int, ...]
    tree: tuple[tuple[int, int], ...]
    by_rays: bool = False
    root_misfit_m: float = 0.01


@dataclass(frozen=True)
class _Tables:
    """The content of a body model's TOML."""

    bones: dict[str, dict[str, Any]]
    torso: tuple[str, ...]
    contacts: tuple[str, ...] = ()
    by_rays: bool = False


@cache
def body_model_names() -> tuple[str, ...]:
    """Return the names of the topologies that have a body model."""
    folder = files("mocapella.kinematics").joinpath("models")
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


@cache
def body_model(name: str) -> BodyModel:
    """Return the body model of a topology; the same object each time.

    Raises:
        SettingsError: there is none; lists those there are.
    """
    if name not in body_model_names():
        raise SettingsError(f"topology {name!r} has no body model; there are {one_of(name, body_model_names())}")
    source = files("mocapella.kinematics").joinpath("models", f"{name}.toml")
    return body_model_from_toml(source.read_text(encoding="utf-8"), topology(name))


def body_model_from_toml(text: str, of: Topology) -> BodyModel:
    """Read and check a body model.

    Args:
        text: TOML, as in ``models/kinect_v2.toml``.
        of: the topology whose skeleton the model describes.

    Raises:
        InputError: the text is not TOML.
        SettingsError: an unknown joint, a missing, unknown or mistyped field, a missing bone, a value out of range, or
            a torso with fewer than four joints or without a joint's mirror image.
    """
    where = f"body model {of.name}"
    data = parse(_Tables, decode_toml(text), where=where)
    bones: dict[int, Bone] = {}
    for name, fields in data.bones.items():
        joint = of.index(name)
        bone = parse(Bone, fields, where=f"{where}, bone {name}")
        other = of.mirror[joint]
        if other == joint:
            bones[joint] = bone
        else:
            mirrored = bone.mirrored().of_side("right")
            if bone.parent:
                mirrored = replace(mirrored, parent=of.joints[of.mirror[of.index(bone.parent)]])
            bones[joint], bones[other] = bone.of_side("left"), mirrored
    root = of.parts["root"]
    missing = [of.joints[child] for _, child in of.bones if child not in bones]
    if missing or root in bones:
        wrong = f"no bone {missing[0]}" if missing else f"a bone that ends at the root {of.joints[root]}"
        raise SettingsError(f"{where}: {wrong}; it wants one for every joint but the root, or for its mirror image")
    torso = tuple(of.index(name) for name in data.torso)
    if len(set(torso)) < 4 or len({of.mirror[j] for j in torso} - set(torso)) > 0:
        raise SettingsError(f"{where}: torso wants four joints or more, each with its mirror image")
    contacts = tuple(of.index(name) for name in data.contacts)
    return BodyModel(of, bones, torso, contacts, _tree(of, bones, where), data.by_rays)


def _tree(of: Topology, bones: Mapping[int, Bone], where: str) -> tuple[tuple[int, int], ...]:
    """Return (parent, child) of all bones, a parent before its children, in the topology's order where possible."""
    parents: dict[int, int] = {}
    for parent, child in of.bones:
        named = bones[child].parent
        parents[child] = of.index(named) if named else parent
    reached, tree = {of.parts["root"]}, []
    while parents:
        free = [child for child, parent in parents.items() if parent in reached]
        if not free:
            loose = of.joints[min(parents)]
            raise SettingsError(f"{where}: bone {loose} hangs at no bone that reaches the root; name another parent")
        reached.add(free[0])
        tree.append((parents.pop(free[0]), free[0]))
    return tuple(tree)
