"""Topologies: the joints and bones that a sensor reports, defined by data files.

A topology is a TOML file in ``topologies/``. A new sensor needs a new file and nothing else. Its table
``mapping.kinect_v2`` states where the joints of tracked people are; see `mocapella.model.skeleton`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from importlib.resources import files
from typing import Any, Final

import msgspec

from mocapella.decoding import convert, decode_toml
from mocapella.errors import SettingsError, one_of
from mocapella.settings import check

UNKNOWN_FIELD_OF_VIEW_DEG = (60.0, 45.0)
"""Default field of view, horizontal and vertical [°], at most as large as that of common depth cameras."""


MOST_WEIGHT: Final = 4.0
"""Largest absolute weight of a joint in a mapping."""

Weights = Mapping[int, Mapping[int, float]]
"""Index of a joint of another topology → index of each contributing joint → its weight."""

Shifts = Mapping[int, tuple[int, float]]
"""Index of a joint of another topology → index of the joint that it is shifted towards, and the share of the way."""
MOST_SHIFT: Final = 0.3
"""Largest share of the way to another joint that a joint is shifted [ratio]."""


@dataclass(frozen=True)
class Topology:
    """Joints, bones, mirror pairs and named parts of a sensor's skeletons.

    Attributes:
        name: name in messages and files, such as ``kinect_v2``.
        joints: the joints' names in the sensor's own order, which is the order of every joint axis.
        bones: (parent, child) indices; a tree that reaches every joint from ``root``.
        mirror: for each joint, the index of its mirror image (itself for central joints).
        parts: joint index by role: ``root``, where the bones begin, ``head``, ``shoulder_left``, ``hand_right``, ….
        field_of_view_deg: horizontal and vertical field of view of the sensors with this topology [°].
        noise: scatter of the proportions of their skeletons' bones, relative to a Kinect v2's [ratio].
        scale_sd: standard deviation of the size of their skeletons, which changes with the posture [ratio].
        mappings: weights by the name of another topology: each of its joints that this one determines is a weighted
            mean of this one's joints. Weights of a joint sum to 1; they may be negative.
        shifts: by the name of another topology: its joints that are not exactly at the single joint of the mapping, but
            a share of the way from it to another joint, as detectors define some joints differently.
    """

    name: str
    joints: tuple[str, ...]
    bones: tuple[tuple[int, int], ...]
    mirror: tuple[int, ...]
    parts: dict[str, int]
    field_of_view_deg: tuple[float, float] = UNKNOWN_FIELD_OF_VIEW_DEG
    noise: float = 1.0
    scale_sd: float = 0.0
    mappings: Mapping[str, Weights] = field(default_factory=dict)
    shifts: Mapping[str, Shifts] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.joints)

    def index(self, joint: str) -> int:
        """Return the index of a joint.

        Raises:
            SettingsError: unknown joint; lists the known ones.
        """
        if joint not in self._index:
            raise SettingsError(f"{self.name} has no joint {joint!r}; it has {one_of(joint, self.joints)}")
        return self._index[joint]

    def single_joints(self, other: str) -> dict[int, int]:
        """Return the joints of another topology that are single joints of this one: index there → index here.

        Joints that are a mean of several joints are left out. The result is empty without a mapping to ``other``, and
        has all joints if ``other`` is this topology.

        Args:
            other: name of the other topology.
        """
        if other == self.name:
            return {joint: joint for joint in range(len(self))}
        table = self.mappings.get(other, {})
        return {joint: next(iter(weights)) for joint, weights in table.items() if len(weights) == 1}

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.joints)}


class _Shift(msgspec.Struct, forbid_unknown_fields=True):
    towards: str
    share: float


class _TopologyFile(msgspec.Struct, forbid_unknown_fields=True):
    """Content of a topology's TOML file; see docs/sensors.md."""

    joints: list[str]
    bones: list[tuple[str, str]]
    mirror: list[tuple[str, str]]
    parts: dict[str, str]
    field_of_view_deg: tuple[float, float] = UNKNOWN_FIELD_OF_VIEW_DEG
    noise: float = 1.0
    scale_sd: float = 0.0
    mapping: dict[str, dict[str, str | dict[str, float]]] = {}
    shift: dict[str, dict[str, _Shift]] = {}


def topology_from_toml(text: str, name: str) -> Topology:
    """Read and validate a topology from the text of its TOML file; ``name`` becomes its name.

    Raises:
        InputError: the text is no TOML, or a field is missing, unknown or of another type.
        SettingsError: a bone, pair or mapping names an unknown joint, there is no root, the bones are not a tree from
            it, a joint has two mirror images, the field of view, noise or size is impossible, or a mapping's weights do
            not sum to 1 or differ between left and right; or a shift has no single joint in the mapping.
    """
    file = convert(decode_toml(text), _TopologyFile, what=f"topology {name}")
    joints = tuple(file.joints)
    place = {joint: i for i, joint in enumerate(joints)}

    def at(joint: str, what: str) -> int:
        if joint not in place:
            raise SettingsError(f"topology {name}: {what} names {joint!r}; joints are {one_of(joint, joints)}")
        return place[joint]

    bones = tuple((at(a, "a bone"), at(b, "a bone")) for a, b in file.bones)
    mirror = list(range(len(joints)))
    for left, right in file.mirror:
        i, j = at(left, "a mirror pair"), at(right, "a mirror pair")
        if mirror[i] != i or mirror[j] != j or i == j:
            raise SettingsError(f"topology {name}: {left} and {right} cannot be a mirror pair, one is paired already")
        mirror[i], mirror[j] = j, i
    parts = {part: at(joint, f"part {part}") for part, joint in file.parts.items()}
    if "root" not in parts:
        raise SettingsError(f"topology {name}: parts has no root; it is the joint at which the bones begin")
    reached = {parts["root"]}
    for parent, child in bones:
        if parent not in reached or child in reached:
            raise SettingsError(
                f"topology {name}: bone {joints[parent]}–{joints[child]} does not continue the tree; "
                "list bones from the root outwards, each joint once as a child"
            )
        reached.add(child)
    if len(reached) != len(joints):
        missing = ", ".join(joint for i, joint in enumerate(joints) if i not in reached)
        raise SettingsError(f"topology {name}: no bone reaches {missing}")
    across, high = file.field_of_view_deg
    check(
        0 < across < 180 and 0 < high < 180, f"topology {name}: field_of_view_deg", [across, high], "above 0, below 180"
    )
    check(0.01 <= file.noise <= 100, f"topology {name}: noise", file.noise, "from 0.01 to 100")
    check(0 <= file.scale_sd < 0.5, f"topology {name}: scale_sd", file.scale_sd, "from 0 to below 0.5")
    made = Topology(name, joints, bones, tuple(mirror), parts, (across, high), file.noise, file.scale_sd)
    mappings = {other: weights_from_table(made, topology(other), table) for other, table in file.mapping.items()}
    made = replace(made, mappings=mappings)
    return replace(made, shifts={other: _shifts(made, topology(other), table) for other, table in file.shift.items()})


def weights_from_table(own: Topology, other: Topology, table: Mapping[str, Any]) -> Weights:
    """Return the weights of the joints of ``own`` for the joints of ``other``, from a table of a TOML file.

    A joint is written as a table of weights, or as the name of the one joint at its position.

    Raises:
        SettingsError: an unknown joint, or weights that do not sum to 1 or differ between left and right.
    """
    where = f"topology {own.name}: mapping.{other.name}"
    weights: dict[int, dict[int, float]] = {}
    for joint, written in table.items():
        terms = {written: 1.0} if isinstance(written, str) else written
        unknown = [name for name in terms if name not in own.joints]
        if joint not in other.joints or unknown:
            wrong, known = (unknown[0], own.joints) if unknown else (joint, other.joints)
            raise SettingsError(f"{where} names {wrong!r}; joints are {one_of(wrong, known)}")
        values = [float(weight) for weight in terms.values()]
        fits = all(0 < abs(weight) <= MOST_WEIGHT for weight in values) and math.isclose(sum(values), 1, abs_tol=1e-9)
        check(fits, f"{where}.{joint}", values, f"weights up to {MOST_WEIGHT:g}, not 0, that sum to 1")
        weights[other.index(joint)] = {own.index(name): float(weight) for name, weight in terms.items()}
    for target, terms in weights.items():
        mirrored = {own.mirror[joint]: weight for joint, weight in terms.items()}
        if weights.get(other.mirror[target]) != mirrored:
            raise SettingsError(f"{where}: {other.joints[target]} has other weights than its mirror image")
    return weights


def _shifts(own: Topology, other: Topology, table: Mapping[str, _Shift]) -> Shifts:
    """Return the shifts of the joints of ``other``, from a table of a TOML file; see `topology_from_toml`."""
    where, single = f"topology {own.name}: shift.{other.name}", own.single_joints(other.name)
    known, found = [other.joints[joint] for joint in single], dict[int, tuple[int, float]]()
    for joint, shift in table.items():
        if joint not in known:
            raise SettingsError(f"{where} names {joint!r}; single joints of the mapping are {one_of(joint, known)}")
        if shift.towards not in own.joints:
            raise SettingsError(f"{where} names {shift.towards!r}; joints are {one_of(shift.towards, own.joints)}")
        check(0 < shift.share <= MOST_SHIFT, f"{where}.{joint}", shift.share, f"above 0 and at most {MOST_SHIFT:g}")
        found[other.index(joint)] = own.index(shift.towards), shift.share
    for target, (towards, share) in found.items():
        if found.get(other.mirror[target]) != (own.mirror[towards], share):
            raise SettingsError(f"{where}: {other.joints[target]} has another shift than its mirror image")
    return found


@cache
def topology_names() -> tuple[str, ...]:
    """Return the names of all topologies of the package, sorted."""
    folder = files("mocapella.model").joinpath("topologies")
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


@cache
def topology(name: str) -> Topology:
    """Return the topology of a name, from a file of the package; the same object at each call.

    Raises:
        SettingsError: unknown topology; lists the known ones.
    """
    if name not in topology_names():
        raise SettingsError(f"unknown topology {name!r}; known: {one_of(name, topology_names())}")
    source = files("mocapella.model").joinpath("topologies", f"{name}.toml")
    return topology_from_toml(source.read_text(encoding="utf-8"), name)
