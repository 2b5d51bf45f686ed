"""The bias of each joint in a depth sensor's skeletons, as a function of the person's facing.

In the axes of the body (x to its left, y up, z ahead), with α the facing from the direction towards the sensor,

    b(α) = Σₕ cos hα · aₕ + sin hα · cₕ        h = 1 … `HARMONICS`

The coefficients are linear in the velocity (ahead and to the left); for the first `FAR` harmonics, also in the
distance. Left and right are mirror images: b of a left joint at α is the mirrored b of the right joint at −α.

The body's axes are used because two views show only the difference of two biases: a component that is constant in the
body from all directions is the joint's position, not an error. Without a constant term, b has zero mean over α.

The shipped weights are learnt (`mocapella.fusion.joint_bias_training`).
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import FAULTS, decode_json, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.geometry.rigid import rotation_about_y
from mocapella.model.topology import Topology, topology

Float64 = NDArray[np.float64]

HARMONICS: Final = 3
"""Number of harmonics of the facing."""
FAR: Final = 1
"""Number of harmonics, from the first, whose coefficients depend on the distance."""
MIDDLE_M: Final = 2.5
"""Reference distance of the linear term [m]."""
NEAREST_M, FARTHEST_M = 1.0, 4.5
"""Distances are limited to this range, the range of the training data [m]."""
FASTEST_M_S: Final = 1.5
"""Upper bound of the speed [m/s]."""
TERMS: Final = 2 * (3 * HARMONICS + FAR)
"""Number of regressors, see `terms`."""
MIRRORED_AXES: Final = np.array([-1.0, 1.0, 1.0])
"""Signs of the body's axes under reflection of left and right."""
_OF_HARMONIC: Final = np.array([1.0, -1.0])
PARITY: Final = np.concatenate([np.tile(_OF_HARMONIC, 2 * HARMONICS + FAR), np.tile(-_OF_HARMONIC, HARMONICS)])
"""(TERMS,) sign of each term under reflection."""
_DECIMALS: Final = 4


class BiasInputs(NamedTuple):
    """State of the tracked people that the bias depends on, for the kernel.

    Attributes:
        positions, velocities: (people, joints, 3) in the tracker's frame, which all sensors share [m], [m/s].
        view_at: (people, sensors) capture time of each view on the common clock [s]; −inf where there is no view.
        view_positions: (people, sensors, joints, 3) in the same frame, with the sensor's labels [m].
        view_swapped: (people, sensors) whether left and right are to be swapped so that the sensors agree.
    """

    positions: Float64
    velocities: Float64
    view_at: Float64
    view_positions: Float64
    view_swapped: NDArray[np.bool_]


def terms(alpha: Float64, distance_m: Float64, ahead_m_s: Float64, left_m_s: Float64) -> Float64:
    """Return the regressors (..., TERMS) of the joint bias, which is their sum weighted by a model's ``weights``.

    The cosine and sine of each harmonic are given alone; then times distance − `MIDDLE_M`, for the first `FAR`
    harmonics; then times the velocity ahead; then times that to the left. Distance and speed are limited to the
    constants of this module.

    Args:
        alpha: (...,) the facing from the direction towards the sensor [rad].
        distance_m: (...,) horizontal distance of the person from the sensor [m].
        ahead_m_s, left_m_s: (...,) the person's velocity ahead and to the left of the body [m/s].
    """
    speed = np.hypot(ahead_m_s, left_m_s)
    slower = FASTEST_M_S / np.maximum(speed, FASTEST_M_S)
    far = np.clip(distance_m, NEAREST_M, FARTHEST_M) - MIDDLE_M
    waves = [wave(h * alpha) for h in range(1, HARMONICS + 1) for wave in (np.cos, np.sin)]
    ahead, left = slower * ahead_m_s, slower * left_m_s
    distant = [far * wave for wave in waves[: 2 * FAR]]
    moving = [by * wave for by in (ahead, left) for wave in waves]
    return np.stack([*waves, *distant, *moving], axis=-1)


def body_view(facing: Float64, position: Float64, velocity: Float64) -> tuple[Float64, Float64]:
    """Return `terms` (..., TERMS) of views, and the rotations (..., 3, 3) from the body's axes to ``position``'s.

    Args:
        facing: (...,) the facing from the direction towards the sensor [rad].
        position: (..., 3) position of the person in the sensor's space, rotated to y up [m].
        velocity: (..., 3) velocity of the person along the same axes [m/s].
    """
    yaw = facing + np.arctan2(-position[..., 0], -position[..., 2])
    sine, cosine = np.sin(yaw), np.cos(yaw)
    ahead = velocity[..., 0] * sine + velocity[..., 2] * cosine
    left = velocity[..., 0] * cosine - velocity[..., 2] * sine
    return terms(facing, np.hypot(position[..., 0], position[..., 2]), ahead, left), rotation_about_y(yaw)


def mirrored(weights: Float64, mirror: Sequence[int]) -> Float64:
    """Return the weights of the bias of the mirrored body; a symmetric body's weights equal their mirror image.

    ``weights`` and the result are (TERMS, joints, 3); ``mirror`` (joints,) has each joint's counterpart's index.
    """
    return np.asarray(PARITY[:, None, None] * MIRRORED_AXES * weights[:, list(mirror)])


class LeftOut(msgspec.Struct, frozen=True, eq=False):
    """Cross-validation fold: ``weights`` (TERMS, joints, 3) [m] learnt without the recordings of ``participants``."""

    participants: tuple[int, ...]
    weights: Float64


class JointBiasModel(msgspec.Struct, frozen=True, eq=False, dict=True):
    """Learnt bias of a sensor's joints by the facing, velocity and distance of a person.

    Attributes:
        topology: name of the topology of the joints.
        weights: (TERMS, joints, 3) coefficients of the bias along the body's axes [m], per unit of each of `terms`.
        trained_on: description of the training.
        left_out: weights learnt without some of the people, for cross-validation.
    """

    topology: str
    weights: Float64
    trained_on: Mapping[str, Any] = {}
    left_out: tuple[LeftOut, ...] = ()

    def __call__(self, sensor: str, facing: float, position: Float64, velocity: Float64) -> Float64:
        """Return the correction (joints, 3) to add to a view's joints, the negative bias, in ``position``'s space [m].

        It implements `mocapella.evaluation.protocol.JointBias`. NaN in an argument gives NaN.

        Args:
            sensor: not used.
            facing: the facing from the direction towards the sensor [rad].
            position: (3,) position of the person in the sensor's space, rotated to y up [m].
            velocity: (3,) velocity of the person in the same space [m/s].
        """
        del sensor  # one model serves all sensors of a kind
        of_view, R = body_view(np.asarray(facing), np.asarray(position), np.asarray(velocity))
        return np.asarray(-np.tensordot(of_view, self.weights, axes=1) @ R.T)

    @cached_property
    def flat(self) -> Float64:
        """(TERMS, joints · 3) weights of the correction, which is the negative bias, for the kernel [m]."""
        return np.ascontiguousarray(-self.weights.reshape(TERMS, -1))

    def without(self, participant: int) -> JointBiasModel:
        """Return the model learnt without a participant: leave-one-out, so that scores of the participant are fair.

        It is this model itself if the participant was not in its training data.

        Raises:
            SettingsError: the participant was in the training data of all models.
        """
        if participant not in self.trained_on.get("participants", ()):
            return self
        for fold in self.left_out:
            if participant in fold.participants:
                others = [p for p in self.trained_on["participants"] if p not in fold.participants]
                return JointBiasModel(self.topology, fold.weights, {**self.trained_on, "participants": others})
        raise SettingsError(
            f"the joint bias was learnt of participant {participant} and never without; "
            "make it with `mocapella lab train bias --folds 5`"
        )


class _File(msgspec.Struct, forbid_unknown_fields=True):
    """Layout of the file: a `JointBiasModel` with the left and middle joints only."""

    trained_on: dict[str, Any]
    topology: str
    terms: list[str]
    weights: dict[str, list[list[float]]]
    left_out: list[_Fold]


class _Fold(msgspec.Struct, forbid_unknown_fields=True):
    participants: list[int]
    weights: dict[str, list[list[float]]]


def _names() -> list[str]:
    of = [f"{wave} {h}α" for h in range(1, HARMONICS + 1) for wave in ("cos", "sin")]
    distant = [f"distance · {wave}" for wave in of[: 2 * FAR]]
    return of + distant + [f"{by} · {wave}" for by in ("ahead", "left") for wave in of]


def _stored(tree: Topology) -> list[int]:
    """Return the joints whose weights a file contains; the others are their mirror images."""
    right = {max(j, m) for j, m in enumerate(tree.mirror) if j != m}
    return [j for j in range(len(tree)) if j not in right]


def to_json(model: JointBiasModel) -> str:
    """Encode a model as the JSON text of a file for `read_model`, to a tenth of a millimetre."""
    tree = topology(model.topology)

    def by_joint(weights: Float64, indent: str) -> str:
        rows = {tree.joints[j]: np.round(weights[:, j], _DECIMALS).tolist() for j in _stored(tree)}
        lines = [f"{indent}{json.dumps(name)}: {json.dumps(row, separators=(',', ':'))}" for name, row in rows.items()]
        return "{\n" + ",\n".join(lines) + "\n" + indent[1:] + "}"

    folds = [
        f' {{"participants": {json.dumps(list(fold.participants))}, "weights": {by_joint(fold.weights, "  ")}}}'
        for fold in model.left_out
    ]
    return (
        "{\n"
        f'"trained_on": {json.dumps(dict(model.trained_on), indent=1, ensure_ascii=False)},\n'
        f'"topology": {json.dumps(model.topology)},\n'
        f'"terms": {json.dumps(_names(), ensure_ascii=False)},\n'
        f'"weights": {by_joint(model.weights, " ")},\n'
        '"left_out": [\n' + ",\n".join(folds) + "\n]\n}\n"
    )


def from_json(text: bytes | str, file: object) -> JointBiasModel:
    """Decode a model from the JSON text of `to_json`; ``file`` is the file's name for the error.

    Raises:
        InputError: it is no model of joint bias, or of another version; names ``file``.
    """
    fix = "make it with `mocapella lab train bias`"
    try:
        data = decode_json(text, _File)
        if data.terms != _names():
            raise ValueError("terms are not those of this version")
        tree = topology(data.topology)
        weights = _weights(data.weights, tree)
        folds = tuple(LeftOut(tuple(fold.participants), _weights(fold.weights, tree)) for fold in data.left_out)
        _check_folds(folds, data.trained_on.get("participants", []))
    except (*FAULTS, InputError, SettingsError) as error:
        raise InputError(f"is no model of joint bias: {error}", file=file, fix=fix) from error
    return JointBiasModel(data.topology, weights, data.trained_on, folds)


def _weights(rows: Mapping[str, list[list[float]]], tree: Topology) -> Float64:
    stored, weights = _stored(tree), np.zeros((TERMS, len(tree), 3))
    wanted = [tree.joints[j] for j in stored]
    if sorted(rows) != sorted(wanted):
        raise ValueError(f"joints are not those of {tree.name}: {', '.join(sorted(set(rows) ^ set(wanted)))}")
    for j in stored:
        of_joint = rows[tree.joints[j]]
        if [len(row) for row in of_joint] != [3] * TERMS:
            raise ValueError(f"{tree.joints[j]} has not {TERMS} rows of 3 weights")
        weights[:, j] = of_joint
    image = mirrored(weights, tree.mirror)
    right = [j for j in range(len(tree)) if j not in stored]
    weights[:, right] = image[:, right]
    return symmetric(weights, tree.mirror)


def symmetric(weights: Float64, mirror: Sequence[int]) -> Float64:
    """Symmetrise weights (TERMS, joints, 3): return their mean with their mirror image; ``mirror`` as in `mirrored`."""
    return (weights + mirrored(weights, mirror)) / 2


def _check_folds(folds: Collection[LeftOut], participants: Collection[int]) -> None:
    left = [participant for fold in folds for participant in fold.participants]
    if folds and sorted(left) != sorted(participants):
        raise ValueError(f"left out were {sorted(left)}, where it was trained on {sorted(participants)}")


def read_model(path: Path) -> JointBiasModel:
    """Read a model that `mocapella lab train bias` wrote.

    Raises:
        InputError: the file cannot be read, or is no model.
    """
    return from_json(read_whole(path, fix="check the name and the folder"), path)


@cache
def shipped_model() -> JointBiasModel | None:
    """Return the model that comes with this version; None without its file. It is read once, and shared."""
    source = files("mocapella.fusion").joinpath("data", "joint_bias.json")
    return from_json(source.read_bytes(), source) if source.is_file() else None
