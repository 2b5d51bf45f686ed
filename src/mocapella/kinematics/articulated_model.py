"""Settings of the filter of articulated bodies, and body models packed into arrays for its kernels.

A body model is a kinematic tree of hinges and ball joints with limits (`mocapella.kinematics.body_model`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.articulated_memory import MemoryLayout, memory_layout
from mocapella.kinematics.body_model import AXES, MOTIONS, BodyModel, body_model
from mocapella.model.topology import Topology
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@dataclass(frozen=True)
class ArticulatedSettings:
    """Process noise of bodies, and thresholds at which one is initialised, lost and forgotten.

    The power spectral densities of the white-noise acceleration trade jitter for lag. They hold for a moving body; for
    a body at rest they are lowered.

    Attributes:
        root_acceleration: density of the root's white acceleration along an axis; larger: less lag, more jitter
            [m²/s³].
        root_turn: density of the root's white angular acceleration about an axis; larger: less lag, more jitter
            [rad²/s³].
        trunk_turn: density of the white angular acceleration of a joint of the trunk; larger: less lag, more jitter
            [rad²/s³].
        arm_turn: density of the white angular acceleration of a joint of an arm; larger: less lag, more jitter
            [rad²/s³].
        leg_turn: density of the white angular acceleration of a joint of a leg; larger: less lag, more jitter
            [rad²/s³].
        hand_turn: density of the white angular acceleration of a joint of a hand; larger: less lag, more jitter
            [rad²/s³].
        velocity_memory_s: time constant of the exponential decay of predicted velocities; larger: the motion is
            extrapolated farther [s].
        surprise_s: time constant over which the surprise is averaged: the ratio of the measured joints' squared
            innovations to the expected ones; larger: the densities rise and fall later [s].
        full_surprise: surprise above which the densities hold in full; below it they fall with its third power; larger:
            slow motion has less jitter and more lag [ratio].
        arm_surprise: the same for the joints of arms and hands, whose measurements flicker most [ratio].
        calm: smallest factor of the densities, for a body at rest; smaller: less jitter at rest, later to follow when
            it moves [ratio].
        noise_s: time constant over which each joint's noise is learnt [s].
        rest_sd: pull of every angle towards its rest; in one second it weighs as much as one measurement of the rest
            angle with this standard deviation; larger: a weaker pull [rad·√s].
        degrees_of_freedom: parameter of the Student-t weight of a joint; smaller: outliers count less; infinity makes
            the loss quadratic [degrees of freedom].
        length_memory_s: time over which bone lengths are averaged; larger: steadier lengths, slower to correct [s].
        scale_sd: standard deviation of the common factor of all bone lengths, for sensors whose skeletons change their
            size with the posture; larger: follows such a sensor; 0: bones keep their lengths [ratio].
        scale_s: time constant of that factor; larger: changes more slowly [s].
        stand_diffusion: diffusion of a foot in contact with the floor; smaller: the foot is held more firmly; infinity:
            contacts are not modelled [m²/s].
        stand_speed: speed of a foot at which the weight of its contact has fallen to a quarter; larger: moving feet are
            held, too [m/s].
        least_joints: number of measured joints that initialise a body; at least four of them belong to its torso
            [joints].
        lost_m: mean distance of measured from estimated joints, beyond their noise, above which a body counts as lost;
            larger: wrong bodies are corrected more rarely [m].
        lost_s: a body that has been lost for this long is initialised again [s].
        forget_after_s: time without a measurement after which a body is no longer predicted [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    root_acceleration: float = 30.0
    root_turn: float = 80.0
    trunk_turn: float = 80.0
    arm_turn: float = 400.0
    leg_turn: float = 400.0
    hand_turn: float = 300.0
    velocity_memory_s: float = 0.1
    surprise_s: float = 0.1
    full_surprise: float = 0.17
    arm_surprise: float = 0.8
    calm: float = 1e-3
    noise_s: float = 0.3
    rest_sd: float = 1.0
    degrees_of_freedom: float = 5.0
    length_memory_s: float = 20.0
    scale_sd: float = 0.0
    scale_s: float = 1.0
    stand_diffusion: float = 1e-5
    stand_speed: float = 0.4
    least_joints: int = 6
    lost_m: float = 0.06
    lost_s: float = 0.3
    forget_after_s: float = 1.0

    def __post_init__(self) -> None:
        for name in ("root_acceleration", "root_turn", "trunk_turn", "arm_turn", "leg_turn", "hand_turn"):
            check(0 < getattr(self, name) < 1e9, name, getattr(self, name), "above 0")
        for name in ("velocity_memory_s", "surprise_s", "noise_s", "length_memory_s", "scale_s"):
            check(0 < getattr(self, name) < 1e6, name, getattr(self, name), "above 0 s")
        for name in ("full_surprise", "arm_surprise"):
            check(0 < getattr(self, name) < 1e6, name, getattr(self, name), "above 0")
        check(0 < self.calm <= 1, "calm", self.calm, "above 0, at most 1")
        check(0 < self.rest_sd < 1e6, "rest_sd", self.rest_sd, "above 0 rad·√s")
        check(self.degrees_of_freedom > 0, "degrees_of_freedom", self.degrees_of_freedom, "above 0")
        check(0 <= self.scale_sd < 0.5, "scale_sd", self.scale_sd, "from 0 to below 0.5")
        check(self.stand_diffusion > 0, "stand_diffusion", self.stand_diffusion, "above 0 m²/s; infinity: none stands")
        check(0 < self.stand_speed < 1e6, "stand_speed", self.stand_speed, "above 0 m/s")
        check(self.least_joints >= 4, "least_joints", self.least_joints, "4 or more")
        check(0 < self.lost_m < 100, "lost_m", self.lost_m, "above 0 m")
        check(0 <= self.lost_s < 1e6, "lost_s", self.lost_s, "0 s or more")
        check(0 <= self.forget_after_s < 1e6, "forget_after_s", self.forget_after_s, "0 s or more")


ROOT_DOFS: Final = 6
TRANSLATION, ABOUT, OF_BALL = 0, 3, 6
"""Kinds of degree of freedom: translation, rotation of a hinge or of a ball joint; plus 0, 1, 2 for axis x, y, z."""


class BodyParameters(NamedTuple):
    """The settings that the kernels read, as floats; `ArticulatedSettings` describes them and their units."""

    velocity_memory_s: float
    rest_sd: float
    degrees_of_freedom: float
    length_memory_s: float
    scale_sd: float
    scale_s: float
    least_joints: float
    lost_m: float
    lost_s: float
    forget_after_s: float
    surprise_s: float
    calm: float
    stand_diffusion: float
    stand_speed: float
    noise_s: float


class BodyArrays(NamedTuple):
    """A body model as the kernels take it; `ArticulatedModel` describes the arrays.

    All arrays are contiguous.
    """

    layout: MemoryLayout
    dof_kind: Int64
    dof_values: Float64
    joint_table: Int64
    joint_values: Float64
    order: Int64
    parameters: BodyParameters


class ArticulatedModel(msgspec.Struct, frozen=True, eq=False):
    """A body model and its settings as arrays.

    Degrees of freedom are in the order of the tree, a parent before its children: three translations of the root along
    its own axes, three rotations about them, then each bone's.

    Attributes:
        body: the body model.
        settings: the settings.
        layout: counts, and the layout of a body's memory.
        dof_kind: (dofs,) `TRANSLATION`, `ABOUT` or `OF_BALL` plus its axis.
        dof_values: (dofs, 7) least and most angle, angle at rest [rad], density of its acceleration [m²/s³ or rad²/s³],
            limit of its predicted variance [m² or rad²], surprise above which the density holds in full, and stiffness
            [ratio].
            Ball joints' limits are in ``joint_values``.
        joint_table: (joints, 6) indices of parent joint and first degree of freedom, number of degrees of freedom, and
            indices of ball joint, bone length and contact; −1 for none.
        joint_values: (joints, 13) unit direction of the bone at rest (3), its length as a fraction of stature, axis of
            the ball joint's cone (3), its half angle, least and most twist [rad], 1 for the torso's joints, squared
            `Bone.misfit_m` [m²], 1 for firm joints.
        order: (joints,) the joints, a parent before its children.
        parameters: the settings that the kernels read.
    """

    body: BodyModel
    settings: ArticulatedSettings
    layout: MemoryLayout
    dof_kind: Int64
    dof_values: Float64
    joint_table: Int64
    joint_values: Float64
    order: Int64
    parameters: BodyParameters

    @property
    def arrays(self) -> BodyArrays:
        """The same arrays as a named tuple, for the kernels."""
        return BodyArrays(
            self.layout, self.dof_kind, self.dof_values, self.joint_table, self.joint_values, self.order,
            self.parameters,
        )  # fmt: skip

    @staticmethod
    def of(topology: Topology, settings: ArticulatedSettings | None = None) -> ArticulatedModel:
        """Make the model of a topology, with these settings, or the defaults if None.

        Raises:
            SettingsError: the topology has no body model.
        """
        return pack(body_model(topology.name), settings or ArticulatedSettings())


def memory_size(model: ArticulatedModel) -> int:
    """Return the length of the row that holds one person's filter state, laid out by `articulated_memory`."""
    return model.layout.size


def pack(body: BodyModel, settings: ArticulatedSettings) -> ArticulatedModel:
    """Pack a body model and settings into arrays."""
    tree = body.topology
    joints, root = len(tree), tree.parts["root"]
    table = np.full((joints, 6), -1, dtype=np.int64)
    values = np.zeros((joints, 13))
    values[list(body.torso), 10] = 1.0
    values[root, 11] = body.root_misfit_m**2
    values[root, 4:10] = 0.0, 0.0, 1.0, np.pi, -np.pi, np.pi
    kinds = [TRANSLATION + k for k in range(3)] + [OF_BALL + k for k in range(3)]
    density = {motion: getattr(settings, f"{motion}_turn") for motion in MOTIONS}
    surprise = dict.fromkeys(MOTIONS, settings.full_surprise) | dict.fromkeys(("arm", "hand"), settings.arm_surprise)
    rows = [(-np.inf, np.inf, 0.0, settings.root_acceleration, 1.0, settings.full_surprise, 0.0)] * 3
    rows += [(-np.inf, np.inf, 0.0, settings.root_turn, 1.0, settings.full_surprise, 0.0)] * 3
    table[root, :4] = -1, 0, ROOT_DOFS, 0
    table[list(body.contacts), 5] = range(len(body.contacts))
    balls, lengths = 1, 0
    order = [root, *(child for _, child in body.tree)]
    for parent, child in body.tree:
        bone = body.bones[child]
        length = float(np.linalg.norm(bone.offset))
        values[child, 11:13] = bone.misfit_m**2, bone.firm
        values[child, :4] = *(np.array(bone.offset) / length), length
        first = len(kinds)
        q, full = density[bone.motion], surprise[bone.motion]
        if bone.ball is not None:
            values[child, 4:7] = np.array(bone.ball.centre) / np.linalg.norm(bone.ball.centre)
            values[child, 7:10] = np.radians((bone.ball.cone_deg, *bone.ball.twist_deg))
            kinds += [OF_BALL + k for k in range(3)]
            rows += [(-np.inf, np.inf, 0.0, q, 1.0, full, bone.stiffness)] * 3
            table[child, 3], balls = balls, balls + 1
        for hinge in bone.hinges:
            kinds.append(ABOUT + AXES.index(hinge.axis))
            least, most = np.radians(hinge.limits_deg)
            rows.append((least, most, 0.0, q, min(1.0, (most - least) ** 2 / 4), full, bone.stiffness))
        other = tree.mirror[child]
        if table[other, 4] >= 0:
            table[child, 4] = table[other, 4]
        else:
            table[child, 4], lengths = lengths, lengths + 1
        table[child, :3] = parent, first, len(kinds) - first
    parameters = BodyParameters(*(float(getattr(settings, name)) for name in BodyParameters._fields))
    return ArticulatedModel(
        body, settings,
        memory_layout(len(kinds), balls, joints, lengths, len(body.contacts), ages=joints if body.by_rays else 0),
        np.array(kinds, dtype=np.int64), np.array(rows), table, values, np.array(order, dtype=np.int64), parameters,
    )  # fmt: skip
