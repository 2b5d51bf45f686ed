"""Which way a person faces, whose labels are mirrored, and what each view is worth for it.

    p        ← turned_on(p, Δt)                                         somebody turns by up to two bins a step
    log p   += Σ_views w_yaw·yaw(α, β) + w_shape·shape(α, score)        α = facing − direction to the sensor
    log p   += w_motion·motion(speed, facing − heading)

The weights are far below 1 because what one frame says, the next one says again. Estimated is the facing of the
person, not that of one view; a view's labels are mirrored where its own yaw is more than 90° from it, with hysteresis.
See docs/methods/facing.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.fusion.facing_grid import STEP_S, circular_sd, most_likely, turned, turned_on, unknown
from mocapella.fusion.facing_model import FacingModel, shipped_model
from mocapella.fusion.facing_shape import View, mirrored_yaw, view_of
from mocapella.geometry.angles import wrap
from mocapella.model.topology import Topology
from mocapella.settings import check

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class FacingSettings:
    """How much each witness counts, and when labels are swapped.

    Attributes:
        yaw_weight: of the logarithm of a view's yaw.
        shape_weight: of that of a body's shape.
        motion_weight: of that of the motion. More makes whoever walks backward face the other way.
        hysteresis_deg: labels are swapped where they are farther than 90° and this from the facing, and back where they
            are nearer than 90° less this.
        least_weight: of a view in the fusion, before the weights are made to sum to 1.
    """

    yaw_weight: float = 0.1
    shape_weight: float = 0.2
    motion_weight: float = 0.1
    hysteresis_deg: float = 10.0
    least_weight: float = 0.01

    def __post_init__(self) -> None:
        for name in ("yaw_weight", "shape_weight", "motion_weight"):
            check(0 <= getattr(self, name) <= 1, name, getattr(self, name), "from 0 to 1")
        check(0 <= self.hysteresis_deg < 90, "hysteresis_deg", self.hysteresis_deg, "from 0° to below 90°")
        check(0 < self.least_weight <= 1, "least_weight", self.least_weight, "above 0, up to 1")


class FacingState(msgspec.Struct, frozen=True, eq=False):
    """All that is remembered of a person.

    Attributes:
        p: (BINS,) probability of each facing, see `mocapella.fusion.facing_grid`.
        at_s: of the newest frame [s].
        seen_s: when each sensor last said something.
        mirrored: whether a sensor's labels were mirrored when it last said something.
    """

    p: Float64
    at_s: float
    seen_s: Mapping[str, float]
    mirrored: Mapping[str, bool]


class Facing(msgspec.Struct, frozen=True, eq=False):
    """What is known after a frame; views in the order in which they were given.

    Attributes:
        yaw: of the person, world: 0 along +z, π/2 along +x [rad].
        sd: circular standard deviation [rad]; it grows without bound while nothing is seen.
        mirrored: (views,) whether left and right must be swapped.
        weights: (views,) what a view is worth, in sum 1: cos²α · cos⁴ of how far its repaired labels are off.
        yaw_used, shape_used: (views,) whether the view's yaw and shape said something.
        motion_used: whether the motion did.
    """

    yaw: float
    sd: float
    mirrored: Bools
    weights: Float64
    yaw_used: Bools
    shape_used: Bools
    motion_used: bool


def evidence(
    view: View, toward_sensor: Float64, model: FacingModel, settings: FacingSettings, scale: Float64
) -> Float64:
    """(..., BINS) what views say of the facing in the world, each for itself.

    Args:
        view: leading axes (...,).
        toward_sensor: (...,) yaw from the person to the sensor [rad].
        model, settings: see there.
        scale: (...,) how much of a `STEP_S` the view stands for, so that a quicker sensor does not count more.
    """
    about = settings.yaw_weight * model.yaw_evidence(view.seen)
    shape = model.shape_evidence(view.features)
    if shape is not None:
        about += settings.shape_weight * shape
    return turned(about * scale[..., None], toward_sensor)


def believed(p: Float64, log_evidence: Float64) -> Float64:
    """Bayes' rule, (..., BINS)."""
    after = p * np.exp(log_evidence - log_evidence.max(axis=-1, keepdims=True))
    return np.asarray(after / after.sum(axis=-1, keepdims=True))


def labels_mirrored(reported: Float64, yaw: float, before: Bools, settings: FacingSettings) -> Bools:
    """(views,) whether labels that say ``reported`` are mirrored, by the person's yaw; where NaN, as before."""
    off = np.degrees(np.abs(wrap(reported - yaw)))
    limit = np.where(before, 90 - settings.hysteresis_deg, 90 + settings.hysteresis_deg)
    return np.where(np.isnan(off), before, off > limit)


def view_weights(yaw: float, toward_sensor: Float64, repaired: Float64, settings: FacingSettings) -> Float64:
    """(views,) what views are worth, in sum 1; as `Facing.weights` says.

    Args:
        yaw: of the person [rad].
        toward_sensor: (views,) [rad].
        repaired: (views,) the yaw that the labels say once they are repaired [rad]; NaN where unknown.
        settings: see there.
    """
    off = np.maximum(np.cos(repaired - yaw), 0.0)
    worth = np.nan_to_num(np.cos(yaw - toward_sensor) ** 2 * off**4)
    worth = np.maximum(worth, settings.least_weight)
    return np.asarray(worth / worth.sum()) if worth.size else worth


class PersonFacing:
    """The facing of one person over time.

    Attributes:
        state: what is remembered; None before the first frame. It can be kept and put back.
    """

    def __init__(
        self, topology: Topology, settings: FacingSettings | None = None, model: FacingModel | None = None
    ) -> None:
        """A person of whom nothing is known.

        Args:
            topology: of the joints.
            settings: see there.
            model: what was learnt; the shipped one where not given.
        """
        self.settings = settings or FacingSettings()
        self.topology = topology
        model = model or shipped_model()
        if model.topology != topology.name:
            model = msgspec.structs.replace(model, classifier=None, shape=None)
        self.model = model
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.state: FacingState | None = None

    def update(
        self,
        sensors: tuple[str, ...],
        positions: Float64,
        toward_sensor: Float64,
        at_s: float,
        velocity: Float64 | None = None,
    ) -> Facing:
        """Take in what is seen of the person at an instant: by all sensors, some or none.

        Args:
            sensors: (views,) names.
            positions: (views, joints, 3) with the sensors' own labels, world [m]; NaN where not seen.
            toward_sensor: (views,) yaw from the person to the sensor, as the calibration knows it [rad].
            at_s: the capture; a time that is not after the last one counts as the same instant [s].
            velocity: (3,) of the person, world [m/s]; None or NaN where it is not known.
        """
        s, model = self.settings, self.model
        before = self.state or FacingState(unknown(), at_s, {}, {})
        at_s = max(at_s, before.at_s)
        elapsed = (at_s - before.at_s) / STEP_S
        p = turned_on(before.p, elapsed) if elapsed > 0 else before.p
        view = view_of(np.asarray(positions, dtype=np.float64), np.asarray(toward_sensor), self.topology)
        yaw_used = np.isfinite(view.reported) & np.isfinite(toward_sensor)
        told = {sensor: at_s for sensor, used in zip(sensors, yaw_used.tolist(), strict=True) if used}
        motion_used = False
        if told:
            last = [before.seen_s.get(sensor, -np.inf) for sensor in sensors]
            scale = np.where(yaw_used, np.clip((at_s - np.array(last)) / STEP_S, 0.0, 1.0), 0.0)
            log_evidence = evidence(view, np.nan_to_num(toward_sensor), model, s, scale).sum(axis=0)
        else:
            log_evidence = np.zeros_like(p)
        if velocity is not None and told:
            motion = model.motion_evidence(np.asarray(velocity, dtype=np.float64))
            motion_used = bool(motion.any())
            log_evidence = log_evidence + s.motion_weight * min(elapsed, 1.0) * motion
        p = believed(p, log_evidence)
        yaw = float(most_likely(p))
        was = np.array([before.mirrored.get(sensor, False) for sensor in sensors], dtype=np.bool_)
        mirrored = labels_mirrored(view.reported, yaw, was, s)
        weights = view_weights(yaw, np.asarray(toward_sensor), mirrored_yaw(view.reported, mirrored), s)
        labels = dict(zip(sensors, mirrored.tolist(), strict=True))
        self.state = FacingState(p, at_s, {**before.seen_s, **told}, {**before.mirrored, **labels})
        shape_used = yaw_used & np.isfinite(view.features).any(axis=-1) & (model.shape is not None)
        return Facing(yaw, float(circular_sd(p)), mirrored, weights, yaw_used, shape_used, motion_used)
