"""Observations of a person's facing in one view: the yaw of the shoulders, and the shape of the body.

A Kinect-class sensor assumes that people face it, and mirrors the labels of turned backs. So labels do not distinguish
front from back, and nothing here depends on them. But the surface seen from behind differs, and knees bend the other
way. So a body's shape is measured along the normal of its shoulders *towards the sensor*, as means of left and right,
and a classifier (`ShapeClassifier`) distinguishes front and back.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology

Float64 = NDArray[np.float64]

FEATURES: Final[dict[str, dict[str, float]]] = {
    "hips before the spine's base": {"Hip": 1, "SpineBase": -1},
    "shoulders before the spine": {"Shoulder": 1, "SpineMid": -1},
    "neck before the spine": {"Neck": 1, "SpineMid": -1},
    "head before the spine": {"Head": 1, "SpineMid": -1},
    "head before the neck": {"Head": 1, "Neck": -1},
    "hands before the spine": {"Hand": 1, "SpineMid": -1},
    "elbows before shoulders and wrists": {"Elbow": 1, "Shoulder": -0.5, "Wrist": -0.5},
    "knees before hips and ankles": {"Knee": 1, "Hip": -0.5, "Ankle": -0.5},
    "ankles before the knees": {"Ankle": 1, "Knee": -1},
    "feet before the ankles": {"Foot": 1, "Ankle": -1},
}
"""Features of a body's shape by name: weights of joints' coordinates towards the sensor, averaged over both sides.

One joint is *before* another if it is nearer to the sensor.
"""
MOST_SPREADS: Final = 1.5
"""Bound ± to which a standardised feature is clipped: larger values are errors of joints."""
UNLIKE_FROM: Final = 12.0
UNLIKE_TO: Final = 16.0
"""A body's mean square of the standardised features: up to the first it is like the training data, from the second on
fully unlike them. In the training data it is 1 on average, and below the first in every view.
"""
FADES_FROM: Final = 3.0
FADES_TO: Final = 5.0
"""Absolute standardised feature of an unlike body: up to the first it has its full weight, from the second on none."""
LEANS_FROM: Final = np.radians(12.0)
LEANS_TO: Final = np.radians(18.0)
"""Angle of SpineBase to head towards or away from the sensor, about the vertical: up to the first, the shape counts in
full, from the second on not at all [rad]. A trunk that leans back before the sensor looks like one that leans forward
with its back to it; in the training data, hardly anybody does either.
"""
LENGTHS_M: Final = (0.2, 1.5)
"""Plausible distances of head and SpineBase [m]."""
NARROWEST_M: Final = 1e-6
"""Least horizontal distance of left and right with a defined direction [m]."""


class View(msgspec.Struct, frozen=True, eq=False):
    """Observations of a person's facing in views; (...,) are the leading axes.

    Attributes:
        reported: (...,) yaw that the sensor's own labels imply, world [rad]; NaN if none of `pairs_across` is seen.
        seen: (...,) that yaw relative to the direction towards the sensor, folded into [−π/2, π/2), so that exchanged
            labels do not change it [rad].
        features: (..., `FEATURES`) how much nearer to the sensor joints are than others, along the shoulders' normal,
            in units of the distance of head and SpineBase; NaN where a joint is missing.
    """

    reported: Float64
    seen: Float64
    features: Float64


def view_of(positions: Float64, toward_sensor: Float64, topology: Topology) -> View:
    """Compute the yaw of the labels and the features of the body's shape in views, the evidence of the facing.

    Args:
        positions: (..., joints, 3) with the sensor's own labels, world, y up [m]; NaN where not seen.
        toward_sensor: (...,) yaw from the person to the sensor, world [rad]; NaN where unknown: then only ``reported``
            is known.
        topology: the joints' topology; if it lacks a joint of `FEATURES`, all features are NaN.
    """
    reported = np.full(positions.shape[:-2], np.nan)
    for left, right in pairs_across(topology):
        across = positions[..., left, :] - positions[..., right, :]
        wide = np.isnan(reported) & (np.hypot(across[..., 0], across[..., 2]) > NARROWEST_M)
        reported = np.where(wide, np.arctan2(-across[..., 2], across[..., 0]), reported)
    seen = np.asarray((reported - toward_sensor + np.pi / 2) % np.pi - np.pi / 2)
    return View(reported, seen, _features(positions, toward_sensor + seen, topology))


def pairs_across(topology: Topology) -> list[tuple[int, int]]:
    """Return pairs of indices of left and right joints that give the yaw, in the order of preference.

    The shoulders; without them, the hips; then one shoulder or hip and the spine between them, because in a side view
    one side is hidden.
    """
    parents = {child: parent for parent, child in topology.bones}
    pairs = [(topology.parts["shoulder_left"], topology.parts["shoulder_right"])]
    if {"HipLeft", "HipRight"} <= set(topology.joints):
        pairs.append((topology.index("HipLeft"), topology.index("HipRight")))
    halves = [half for left, right in pairs for half in ((left, parents[left]), (parents[right], right))]
    return pairs + halves


def _features(positions: Float64, yaw: Float64, topology: Topology) -> Float64:
    sums = feature_sums(topology)
    if sums is None:
        return np.full((*yaw.shape, len(FEATURES)), np.nan)
    trunk = positions[..., topology.index("Head"), :] - positions[..., topology.index("SpineBase"), :]
    length = np.sqrt((trunk * trunk).sum(axis=-1))
    length = np.where((length > LENGTHS_M[0]) & (length < LENGTHS_M[1]), length, np.nan)
    before = positions[..., 0] * np.sin(yaw)[..., None] + positions[..., 2] * np.cos(yaw)[..., None]
    missing = np.isnan(before)
    values = np.where(missing, 0.0, before) @ sums.T
    if missing.any():
        values = np.where(missing @ (sums != 0).T, np.nan, values)
    return np.asarray(values / length[..., None])


@cache
def _sums_by_name(joints: tuple[str, ...]) -> Float64 | None:
    sums = np.zeros((len(FEATURES), len(joints)))
    for row, parts in zip(sums, FEATURES.values(), strict=True):
        for name, weight in parts.items():
            places = [i for i, joint in enumerate(joints) if joint in (name, f"{name}Left", f"{name}Right")]
            if not places:
                return None
            row[places] += weight / len(places)
    return sums


def feature_sums(topology: Topology) -> Float64 | None:
    """Return each joint's weight in each shape feature (`FEATURES`, joints); None if the topology lacks a joint."""
    return _sums_by_name(topology.joints)


class ShapeClassifier(msgspec.Struct, frozen=True, eq=False):
    """A logistic regression on the features and their squares: above 0, the person faces the sensor.

    Attributes:
        mean, spread: (`FEATURES`,) mean and standard deviation of each feature, for standardising.
        weights: (2 · `FEATURES` + 1,) weights of the standardised features, of their squares less 1, and the constant.
    """

    mean: Float64
    spread: Float64
    weights: Float64

    def score(self, features: Float64) -> tuple[Float64, Float64]:
        """Return the log-odds of facing the sensor (...,), and the usable fraction of the features (...,), 0 to 1.

        ``features`` (..., `FEATURES`): see `View`. A missing feature (NaN) contributes nothing.
        """
        design, seen = design_matrix(features, self.mean, self.spread)
        return np.asarray(design @ self.weights), seen

    def unlike(self, features: Float64) -> Float64:
        """Return how unlike the training data bodies with these features are: (...,) from 0 to 1; see `UNLIKE_FROM`."""
        return _unlike((features - self.mean) / self.spread)


def _unlike(z: Float64) -> Float64:
    """Return how unlike standardised features z (..., `FEATURES`) are to the training data, (...,) from 0 to 1."""
    known = np.isfinite(z)
    square = np.where(known, z * z, 0.0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
    return np.asarray(np.clip((square - UNLIKE_FROM) / (UNLIKE_TO - UNLIKE_FROM), 0.0, 1.0))


def design_matrix(features: Float64, mean: Float64, spread: Float64) -> tuple[Float64, Float64]:
    """Return the regressors (..., 2 · `FEATURES` + 1) of features (..., `FEATURES`), and their usable fraction (...,).

    ``mean`` and ``spread`` (`FEATURES`,) standardise the features, which are clipped to ±`MOST_SPREADS`. The regressors
    of a missing feature (NaN) are 0; large ones of an unlike body fade, see `FADES_FROM`.
    """
    z = (features - mean) / spread
    known = np.isfinite(z)
    unlike = _unlike(z)[..., None]
    fades = np.clip((np.abs(z) - FADES_FROM) / (FADES_TO - FADES_FROM), 0.0, 1.0)
    told = np.where(known, 1.0 - unlike * fades, 0.0)
    z = np.nan_to_num(np.clip(z, -MOST_SPREADS, MOST_SPREADS))
    ones = np.ones((*z.shape[:-1], 1))
    return np.concatenate([told * z, told * (z * z - 1.0), ones], axis=-1), told.mean(axis=-1)


def fit_classifier(features: Float64, faces: NDArray[np.bool_], penalty: float) -> ShapeClassifier:
    """Fit the classifier by Newton's method, with equal weights of both classes.

    Args:
        features: (views, `FEATURES`) without NaN.
        faces: (views,) whether the person faces the sensor; both classes must occur.
        penalty: λ of the ridge term λ/2 · Σ w², for standardised features and a loss that is a mean over views.

    Source:
        Hastie, Tibshirani, Friedman, *The Elements of Statistical Learning* (2009), sections 4.4.1 and 4.4.4.
    """
    share = np.where(faces, 0.5 / faces.sum(), 0.5 / (~faces).sum())
    mean = share @ features
    spread = np.sqrt(share @ (features - mean) ** 2)
    X, _ = design_matrix(features, mean, spread)
    ridge = penalty * np.eye(X.shape[1])
    ridge[-1, -1] = 1e-9
    w = np.zeros(X.shape[1])
    for _ in range(25):
        p = 1 / (1 + np.exp(-X @ w))
        gradient = X.T @ (share * (p - faces)) + ridge @ w
        step = np.linalg.solve((X * (share * p * (1 - p))[:, None]).T @ X + ridge, gradient)
        w = w - step
        if np.abs(step).max() < 1e-9:
            break
    return ShapeClassifier(mean, spread, w)
