"""Learn the joint bias of sensors from two views of one person, without ground truth.

The length, not its square, of each frame's difference (view 1 − b₁) − (view 2 − b₂) in the reference sensor's space is
minimised by iteratively reweighted least squares with a ridge (Hastie, Tibshirani, Friedman, 2009, sections
3.4.1; Huber 1981, 7.8). The second sensor's pose is known only from these joints, so its rigid motion is fitted to the
corrected views, alternating with the bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.fusion.joint_bias import MIRRORED_AXES, PARITY, TERMS, body_view
from mocapella.geometry.alignment import robust_align
from mocapella.geometry.rigid import apply
from mocapella.model.topology import Topology
from mocapella.settings import check

Float64 = NDArray[np.float64]


class ViewPairs(msgspec.Struct, frozen=True, eq=False):
    """Two sensors' views of one person in one session.

    Attributes:
        positions: (frames, 2, joints, 3) each in its own sensor's space, rotated to y up, with labels that agree [m];
            NaN where missing.
        facing: (frames, 2) facing of the fused person, from the direction towards each sensor [rad]; NaN where unknown.
        position, velocity: (frames, 2, 3) those of the fused person in each sensor's space, rotated to y up [m, m/s].
        weight: (frames,) weight of each frame in the fit.
    """

    positions: Float64
    facing: Float64
    position: Float64
    velocity: Float64
    weight: Float64


@dataclass(frozen=True)
class BiasTrainingSettings:
    """Parameters of the training. Chosen by cross-validation over people.

    Attributes:
        ridge: factor λ of the ridge penalty λ·Σ weights², beside the reweighted mean of the squared residuals.
        rounds: number of alternating fits of rigid motions and bias.
        steps: number of reweightings.
        least_m: least residual in the reweighting by 1/residual, which bounds a frame's weight [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    ridge: float = 0.03
    rounds: int = 3
    steps: int = 4
    least_m: float = 0.02

    def __post_init__(self) -> None:
        check(0 < self.ridge < 1e6, "ridge", self.ridge, "above 0")
        check(1 <= self.rounds <= 100, "rounds", self.rounds, "from 1 to 100")
        check(1 <= self.steps <= 100, "steps", self.steps, "from 1 to 100")
        check(0 < self.least_m <= 1, "least_m", self.least_m, "above 0, up to 1 m")


def train(sessions: Sequence[ViewPairs], tree: Topology, settings: BiasTrainingSettings | None = None) -> Float64:
    """Learn the weights (TERMS, joints, 3) of a `mocapella.fusion.joint_bias.JointBiasModel` [m].

    Args:
        sessions: views of some people; the first view of each is the reference sensor's.
        tree: topology of the joints.
        settings: parameters of the training; the defaults if None. Frames with an unknown facing or velocity are left
            out.

    Raises:
        InputError: no session has a frame with a known facing.
    """
    settings = settings or BiasTrainingSettings()
    sessions = [_known(session) for session in sessions]
    if not sum(len(session.weight) for session in sessions):
        raise InputError("no frame has two views of a person whose facing is known", fix="add sessions of two sensors")
    views = [body_view(s.facing, s.position, s.velocity) for s in sessions]
    weight = np.concatenate([session.weight for session in sessions])
    weights = np.zeros((TERMS, len(tree), 3))
    for _ in range(settings.rounds):
        apart, designs = [], []
        for session, (of_view, R) in zip(sessions, views, strict=True):
            T = second_to_first(session, of_view, R, weights)
            apart.append(session.positions[:, 0] - apply(T, session.positions[:, 1]))
            axes = (R[:, 0], -T[:3, :3] @ R[:, 1])
            design = np.asarray(sum(a[:, :, None, :] * of_view[:, v, None, :, None] for v, a in enumerate(axes)))
            designs.append(design.reshape(len(design), 3, -1))
        weights = _solve(np.concatenate(apart), np.concatenate(designs), weight / weight.mean(), tree, settings)
    return weights


def _known(session: ViewPairs) -> ViewPairs:
    known = np.isfinite(session.facing).all(axis=1) & np.isfinite(session.velocity).all(axis=(1, 2))
    return msgspec.structs.replace(
        session, **{name: getattr(session, name)[known] for name in session.__struct_fields__}
    )


def second_to_first(session: ViewPairs, of_view: Float64, R: Float64, weights: Float64) -> Float64:
    """Fit the transform (4, 4) from the second sensor's space to the first's to the corrected views.

    Args:
        session: the views.
        of_view: (frames, 2, TERMS) regressors of each view's bias.
        R: (frames, 2, 3, 3) rotations from the body's axes to the sensor's space.
        weights: (TERMS, joints, 3) weights of the bias [m].
    """
    bias = np.tensordot(of_view, weights, axes=1)
    first, second = np.moveaxis(session.positions - bias @ np.swapaxes(R, -1, -2), 1, 0).reshape(2, -1, 3)
    seen = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    each = np.repeat(session.weight, session.positions.shape[2])[seen]
    return robust_align(first[seen], second[seen], each)


def _solve(apart: Float64, design: Float64, weight: Float64, tree: Topology, settings: BiasTrainingSettings) -> Float64:
    """Solve for weights (TERMS, joints, 3): left joints together with their mirror images, middle ones alone.

    Args:
        apart: (frames, joints, 3) first view − second [m].
        design: (frames, 3, TERMS · 3) regressors of a joint's weights.
        weight: (frames,), of mean 1.
        tree, settings: as in `train`.
    """
    signs = (PARITY[:, None] * MIRRORED_AXES).ravel()
    weights = np.zeros((TERMS, len(tree), 3))
    for j, m in enumerate(tree.mirror):
        if m < j:
            continue
        free = signs > 0 if m == j else np.ones(len(signs), dtype=np.bool_)
        parts = [(design[..., free], apart[:, j])]
        if m != j:
            parts.append((design * signs, apart[:, m]))
        A, d = (np.concatenate(part) for part in zip(*parts, strict=True))
        of_joint = np.zeros(len(signs))
        of_joint[free] = _robust_ridge(A, d, np.tile(weight, len(parts)), settings)
        weights[:, j] = of_joint.reshape(TERMS, 3)
        weights[:, m] = (signs * of_joint).reshape(TERMS, 3)
    return weights


def _robust_ridge(A: Float64, d: Float64, weight: Float64, settings: BiasTrainingSettings) -> Float64:
    """Return x that minimises Σ w |d − A x| / mean |d| + ridge |x|², without rows where d is not finite.

    The division by mean |d| makes the penalty equally strong for joints with large and small differences.
    """
    seen = np.isfinite(d).all(axis=1)
    A, d, weight = A[seen], d[seen], weight[seen]
    x = np.zeros(A.shape[-1])
    flat = A.reshape(-1, A.shape[-1])
    for _ in range(settings.steps):
        residual = np.maximum(np.linalg.norm(d - A @ x, axis=-1), settings.least_m)
        w = np.repeat(weight * (1.0 / np.maximum((weight / residual).sum(), 1e-12)) / residual, 3)
        normal = flat.T @ (flat * w[:, None]) + settings.ridge * np.eye(len(x))
        x = np.linalg.solve(normal, flat.T @ (w * d.ravel()))
    return x
