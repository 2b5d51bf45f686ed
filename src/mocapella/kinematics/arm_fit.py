"""Model of an arm and a hand whose pose and sizes are fitted to a depth image, and the values of a fit.

`arm_fit_kernels` describes the cost function and its sources.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from types import ModuleType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rigid
from mocapella.kinematics.arm_arrays import ArmArrays, FitParameters
from mocapella.kinematics.hand_settings import HandSettings
from mocapella.kinematics.hand_solvers import digit_rows
from mocapella.kinematics.hand_tracker import angle_prior, free_angles
from mocapella.model.hand import DIGIT_ANGLES, HandModel, HandShape
from mocapella.settings import check

Float64 = NDArray[np.float64]

_DIGIT_RADII_M: Final = (
    (0.0132, 0.0120, 0.0103, 0.0083),
    (0.0102, 0.0092, 0.0081, 0.0070),
    (0.0102, 0.0092, 0.0082, 0.0071),
    (0.0096, 0.0087, 0.0076, 0.0066),
    (0.0089, 0.0078, 0.0069, 0.0060),
)
"""Radii at the joints from the base outwards, of a hand of the reference length; our own figures."""
_ARM_RADII_M: Final = (0.0165, 0.0100, 0.0400, 0.0430, 0.0025)
"""Radius of the forearm at the wrist, half the distance of its two bones there, radii at the elbow and of the upper
arm; and the distance of the centre of a fingertip's round end from the landmark."""
_ELBOW_M: Final = (0.008, 0.012)
"""Distance of the elbow joint beyond the end of the forearm's flesh, and behind it where the elbow is bent; from
rendered arms (seeds below 100)."""
_FOREARM_OF_HAND: Final = 1.33
"""Forearm's length over the hand's: Winter, *Biomechanics and Motor Control of Human Movement* (2009), figure 4.1."""


@dataclass(frozen=True)
class ArmFitSettings:
    """Noise, priors and iterations of the fit.

    Attributes:
        point_scale_m: scale of the robust loss of points; larger: points far from the arm count more [m].
        silhouette_scale_m: scale of the robust loss of capsules outside the silhouette or in front of the surface [m].
        point_sd_m: standard deviation of a point's distance from the capsules; errors of points are correlated [m].
        silhouette_sd_m: standard deviation of a capsule's distance outside the silhouette or before the surface [m].
        collision_sd_m: standard deviation of the overlap of digits beyond ``overlap_m`` [m].
        sharp_sd_m: ``silhouette_sd_m`` in the last third of a fit [m].
        ahead_m: allowed distance of capsules in front of the measured surface [m].
        overlap_m: allowed overlap of digits [m].
        size_sd: standard deviation of a hand's size, relative to the average [ratio].
        thickness_sd: standard deviation of a hand's thickness, relative to the average [ratio].
        digit_sd: standard deviation of a finger's length, relative to the usual one for the hand's size [ratio].
        thumb_sd: the same of the thumb's length, which varies more [ratio].
        forearm_sd: standard deviation of the forearm's length, relative to the usual one for the hand's size [ratio].
        deviation_sd_deg: standard deviation of the wrist's deviation to the thumb's or little finger's side [°].
        flexion_sd_deg: standard deviation of the wrist's flexion about the straight wrist [°].
        angle_rate_deg_s: largest growth per second of a predicted angle's standard deviation [°/s].
        palm_rate_m_s: growth per second of the standard deviation of the palm's predicted position [m/s].
        palm_rate_deg_s: growth per second of the standard deviation of the palm's predicted orientation [°/s].
        edge: distance of the silhouette's edge from the nearest pixel on its other side [grid pixels].
        loose: factor of the robust scales in the first iteration, which improves poor starts [ratio].
        iterations: largest number of iterations while tracking; larger: more accurate, at more work [iterations].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    point_scale_m: float = 0.010
    silhouette_scale_m: float = 0.015
    point_sd_m: float = 0.012
    silhouette_sd_m: float = 0.015
    sharp_sd_m: float = 0.006
    collision_sd_m: float = 0.002
    ahead_m: float = 0.008
    overlap_m: float = 0.002
    size_sd: float = 0.2
    thickness_sd: float = 0.08
    digit_sd: float = 0.05
    thumb_sd: float = 0.10
    forearm_sd: float = 0.07
    deviation_sd_deg: float = 15.0
    flexion_sd_deg: float = 35.0
    angle_rate_deg_s: float = 1500.0
    palm_rate_m_s: float = 3.0
    palm_rate_deg_s: float = 800.0
    edge: float = 0.3
    loose: float = 2.5
    iterations: int = 10

    def __post_init__(self) -> None:
        for name in (
            *("point_scale_m", "silhouette_scale_m", "point_sd_m", "silhouette_sd_m", "sharp_sd_m", "collision_sd_m"),
            *("size_sd", "thickness_sd", "digit_sd", "thumb_sd", "forearm_sd"),
        ):
            check(0 < getattr(self, name) < 1, name, getattr(self, name), "above 0, below 1")
        for name in ("ahead_m", "overlap_m"):
            check(0 <= getattr(self, name) < 0.1, name, getattr(self, name), "from 0 to below 0.1 m")
        for name in ("deviation_sd_deg", "flexion_sd_deg", "angle_rate_deg_s", "palm_rate_deg_s", "palm_rate_m_s"):
            check(0 < getattr(self, name) < 1e5, name, getattr(self, name), "above 0")
        check(-1 <= self.edge <= 1, "edge", self.edge, "from -1 to 1 pixel")
        check(1 <= self.loose <= 10, "loose", self.loose, "from 1 to 10")
        check(1 <= self.iterations <= 100, "iterations", self.iterations, "1 to 100")


class ArmPose(NamedTuple):
    """Pose and sizes of an arm, as the kernels take them.

    Attributes:
        R, t: (9,), (3,) motion from the palm's frame to the camera frame: rotation row by row, translation [m].
        z: (n,) free angles of the hand, of `free_angles` [rad].
        v: (STATE,) sizes, and directions of forearm and upper arm in the palm's frame, see `arm_flesh_kernels`.
    """

    R: Float64
    t: Float64
    z: Float64
    v: Float64

    def copied(self) -> ArmPose:
        """Return a copy that shares no arrays."""
        return ArmPose(*(a.copy() for a in self))

    @property
    def T_camera_palm(self) -> Float64:  # noqa: N802 - the field's notation
        """Motion (4, 4) from the palm's frame to the camera frame."""
        return rigid(self.R.reshape(3, 3), self.t)


class ArmEvidence(NamedTuple):
    """Measurements of one depth image, in the camera frame [m].

    Attributes:
        points: (m, 3) points of the arm's surface [m].
        weights: (m,) weights of the points, 0 to 1.
        front: (h, w) depth of the arm's surface, the negative depth of other objects, 0 where nothing was measured [m].
        opposite: (h, w) int64, in the same row, the column of the nearest arm pixel for a pixel off the arm, and of the
            nearest pixel off the arm for an arm pixel; −1 for none.
        lens: (4,) fx, fy, cx, cy of these pixels [px].
    """

    points: Float64
    weights: Float64
    front: Float64
    opposite: NDArray[np.int64]
    lens: Float64


class ArmPrior(NamedTuple):
    """Gaussian prior of usual postures and sizes, and prediction from earlier images, as the kernels take them.

    Attributes:
        mean, precision: (n,), (n, n) mean and inverse covariance of the free angles in usual postures.
        pose, certainty, steady: as of `Expected`; ``certainty`` 0: no prediction.
        v, information: (STATE,) expected sizes and directions, and their inverse variances.
    """

    mean: Float64
    precision: Float64
    pose: ArmPose
    certainty: Float64
    steady: Float64
    v: Float64
    information: Float64


class Fitted(NamedTuple):
    """A fitted pose and its costs.

    Attributes:
        pose: the pose.
        costs: (7,) mean robust cost of points and of capsules, 0 to 1; sum of digits' squared overlaps [cm²]; squared
            Mahalanobis distance of the hand's sizes and angles from the prior; share of the surface that is occluded;
            mean cost of stray points near the arm, 0 to 1; number of these points.
    """

    pose: ArmPose
    costs: Float64

    @property
    def cost(self) -> float:
        """Weighted sum of the costs of points, capsules, overlaps and prior, for comparing poses; smaller is better."""
        points, flesh, overlap, unusual = kernels().COSTS
        c = self.costs
        return float(points * c[0] + flesh * c[1] + overlap * min(c[2], 2.0) + unusual * c[3])


class HeldOtherwise(NamedTuple):
    """The best of a table of postures of one digit.

    Attributes:
        gain: how much it lowers the cost, 0 or more.
        pose: the pose with it.
        clearness: how much more than the pose the best posture costs whose tip is more than 25 mm away; below 0 if it
            costs less, ∞ if there is none.
    """

    gain: float
    pose: ArmPose
    clearness: float


@dataclass(frozen=True, eq=False)
class Expected:
    """Prediction of an arm's pose and Gaussian prior of its sizes; `ArmModel` adds the prior of usual postures.

    Attributes:
        pose: the predicted pose.
        certainty: (6 + n,) inverse variances of the palm's twist and of the free angles about ``pose``; 0: unknown.
        steady: (6 + n,) inverse variances to add for parts at rest, with a robust loss (Geman and McClure, 1987), so
            that a part that moves is released; 0: none. The palm's translation is one part, its rotation another, and
            each angle, too. Without ``certainty`` of the palm, not used for the palm.
        v, information: (STATE,) expected sizes (forearm's length over hand's size), directions, and inverse variances.
    """

    pose: ArmPose
    certainty: Float64
    steady: Float64
    v: Float64
    information: Float64


class ArmModel:
    """Model of one arm, whose pose and sizes are fitted to depth images.

    Args:
        model, shape: the hand's joints and limits, and side and lengths of a hand of relative size 1, which fits scale.
        settings: noise, priors and iterations.

    Attributes:
        arrays: the model for the kernels; its fields are also attributes of this object.
        angle_of, natural: (n,) the free angles' indices in `ANGLES`, and their values at rest [rad].
        ways: of each digit, postures (k, 5) that `held_otherwise` tries, the first a placeholder for the present [rad].
        prior: (n, n) inverse covariance of the free angles about ``natural`` [1/rad²].
        length_m, forearm_m: length of the hand ``shape`` from wrist to middle fingertip, and of its forearm [m].
    """

    def __init__(self, model: HandModel, shape: HandShape, settings: ArmFitSettings | None = None) -> None:
        self.model, self.shape, self.settings = model, shape, settings or ArmFitSettings()
        self.digits = digit_rows(model, shape)
        self.mirror = float(shape.mirror[0])
        self.columns, self.gains, self.angle_of = free_angles(model)
        self.rising = np.ascontiguousarray(np.argsort(self.columns, axis=1, kind="stable"))
        self.natural = model.natural[self.angle_of]
        self.prior = angle_prior(model, _HABITS, self.columns)
        self.c_max = float(model.limits[DIGIT_ANGLES[0, 4], 1])
        length = float(shape.lengths[2].sum() + np.linalg.norm(shape.bases[2]))
        big = length / model.hand_length_m
        self.radii = big * np.vstack([np.hstack([_DIGIT_RADII_M, np.zeros((5, 1))]), _ARM_RADII_M])
        self.palm = _palm(shape, big)
        self.owners = np.array(
            [(d, bone) for d in range(5) for bone in range(3)] + [(-1, 0)] * len(self.palm) + [(-2, 0)] * 2 + [(-3, 0)]
        )
        self.arrays = ArmArrays(
            self.digits, self.mirror, self.radii, self.palm, self.owners, self.columns, self.gains, self.rising,
            self.c_max,
        )  # fmt: skip
        s = self.settings
        self.sizes = np.zeros(kernels().STATE)
        self.sizes[:2], self.sizes[10:] = (1 / s.size_sd**2, 1 / s.thickness_sd**2), 1 / s.digit_sd**2
        self.sizes[10] = 1 / s.thumb_sd**2
        self.length_m = length
        arm = 15 + len(self.palm)
        joints = [(3 * digit + bone, 0.0, 0) for digit in range(5) for bone in range(3)]
        for digit in range(5):
            joints.insert(4 * digit + 3, (3 * digit + 2, 1.0, 1))
        self._places = np.array([(arm, 0.0, 0), *joints, (16, 0.5, 0), (arm, 1.0, 0)])
        self.ways = [np.vstack([np.zeros((1, 5)), _ways(model, digit)]) for digit in range(5)]
        self.forearm_m = _FOREARM_OF_HAND * length

    def state(self) -> Float64:
        """Return the sizes and limb directions (STATE,) of an average straight arm, as `arm_flesh_kernels` has them."""
        v = np.empty(kernels().STATE)
        v[:4] = 1.0, 1.0, self.forearm_m, 1.0
        v[4:7] = v[7:10] = 0.0, 0.0, -1.0
        v[10:] = 1.0
        return v

    def unexpected(self, pose: ArmPose, *, usual: bool = False) -> Expected:
        """Return the prior of a new arm: average sizes, straight wrist, no prediction but the upper arm's direction.

        Args:
            pose: its upper arm's direction is kept.
            usual: the thumb's length is as near the usual one as a finger's; for fits from poor starts, in which a
                short thumb would make up for a wrong posture.
        """
        s = self.settings
        v = self.state()
        v[7:10] = pose.v[7:10]
        information = np.zeros(len(v))
        information[:4] = 1 / s.size_sd**2, 1 / s.thickness_sd**2, 1 / (s.forearm_sd * self.forearm_m) ** 2, 1 / 0.15**2
        information[4:6] = 1 / np.sin(np.radians([s.deviation_sd_deg, s.flexion_sd_deg])) ** 2
        information[7:10] = 0.2
        information[10:] = self.sizes[10:]
        if usual:
            information[10] = information[11]
        nothing = np.zeros(6 + len(self.natural))
        return Expected(pose, nothing, nothing.copy(), v, information)

    def rigid(self, pose: ArmPose, sd: float) -> Expected:
        """Return the prior for a rigid fit: sizes and angles about a pose's; the palm's pose is unknown.

        Args:
            pose: means of sizes, directions and angles.
            sd: standard deviation of angles [rad] and of relative sizes.
        """
        base = self.unexpected(pose)
        certainty, v, information = base.certainty.copy(), pose.v.copy(), base.information.copy()
        certainty[6:] = information[:2] = information[3] = information[10:] = 1 / sd**2
        v[2] /= v[0]  # the forearm's length is relative to the hand's
        return replace(base, certainty=certainty, v=v, information=information)

    def fit(
        self, start: ArmPose, expected: Expected, evidence: ArmEvidence, *, iterations: int | None = None,
        loose: float | None = None, tips: Float64 | None = None, keep: float = 0.67,
    ) -> Fitted:  # fmt: skip
        """Fit a pose, from a start near it; return it with its costs, in new arrays; with 0 iterations, the start.

        Args:
            start: the initial pose; not changed.
            expected: prior and prediction.
            evidence: measurements of the image.
            iterations, loose: most iterations, and factor of the robust scales in the first; the settings' if None.
            tips: (5, 3) approximate fingertips, camera frame [m], NaN where unknown, None if all are; they help the
                first iterations.
            keep: share of the iterations, from the first on, that use ``tips``.
        """
        s, k = self.settings, kernels()
        pose = start.copied()
        total = max(float(evidence.weights.sum()), 1.0)
        parameters = self._parameters(pose, evidence, total)
        costs = np.empty(k.COST_TERMS)
        e = expected
        prior = ArmPrior(self.natural, self.prior, e.pose, e.certainty, e.steady, e.v, e.information)
        k.fit(
            self.arrays, evidence, prior, pose, parameters, s.loose if loose is None else loose,
            s.iterations if iterations is None else iterations, costs, _NOWHERE if tips is None else tips, keep,
        )  # fmt: skip
        costs[0] /= total
        costs[1] /= max(costs[3], 1e-4)
        costs[4] /= max(costs[3], 1e-4)
        costs[5] /= max(costs[6], 1.0)
        off = pose.z - self.natural
        v = (pose.v - e.v) * np.sqrt(self.sizes)
        costs[3] = off @ self.prior @ off + v[:2] @ v[:2] + v[10:] @ v[10:]
        return Fitted(pose, costs)

    def _parameters(self, pose: ArmPose, evidence: ArmEvidence, total: float) -> FitParameters:
        """Return the parameters that the kernels take."""
        s = self.settings
        # At most the information of a hand at arm's length: more points add none.
        share = min(400.0 / total, 2.0)
        return FitParameters(
            s.point_scale_m, s.silhouette_scale_m, share / s.point_sd_m**2, 1 / s.silhouette_sd_m**2,
            1 / s.collision_sd_m**2, float(s.ahead_m), float(s.overlap_m), len(self.owners),
            s.edge * float(pose.t[2] / evidence.lens[0]), (s.silhouette_sd_m / s.sharp_sd_m) ** 2,
        )  # fmt: skip

    def held_otherwise(self, pose: ArmPose, evidence: ArmEvidence, digit: int) -> HeldOtherwise:
        """Try a table of postures of one digit; return the best one, and how clear it is that the tip is where it is.

        Args:
            pose, evidence: as for `fit`; the pose is not refitted.
            digit: index of the digit, 0 for the thumb.
        """
        columns = self.columns[digit]
        free = columns >= 0
        tries = self.ways[digit].copy()
        tries[0, free] = pose.z[columns[free]]
        costs = np.empty(len(tries))
        parameters = self._parameters(pose, evidence, max(float(evidence.weights.sum()), 1.0))
        kernels().swept(self.arrays, evidence, self.natural, self.prior, pose, parameters, digit, tries, costs)
        best = int(np.argmin(costs))
        z = pose.z.copy()
        z[columns[free]] = tries[best, free]
        tip, scale = self.pieces(pose)[1][digit, 3], float(pose.v[0])
        elsewhere = np.linalg.norm(scale * self._way_tips[digit] - tip, axis=1) > _ELSEWHERE_M
        clearness = float(costs[1:][elsewhere].min(initial=np.inf) - costs[0])
        return HeldOtherwise(float(costs[0] - costs[best]), pose._replace(z=z), clearness)

    @cached_property
    def _way_tips(self) -> list[Float64]:
        """Of each digit, the tips (k, 3) in ``ways`` but the first, palm's frame, of an average hand [m]."""
        tips, at_origin = [], ArmPose(np.eye(3).ravel(), np.zeros(3), self.natural, self.state())
        for digit, columns in enumerate(self.columns):
            free, rows = columns >= 0, []
            for way in self.ways[digit][1:]:
                z = self.natural.copy()
                z[columns[free]] = way[free]
                rows.append(self.pieces(at_origin._replace(z=z))[1][digit, 3])
            tips.append(np.array(rows))
        return tips

    def exchanged(self, pose: ArmPose) -> Iterator[ArmPose]:
        """Yield starts for a fit whose fingers were mixed up: copies with neighbours' angles exchanged or shifted."""
        columns = [self.columns[digit][self.columns[digit] >= 0] for digit in range(1, 5)]
        held = np.array([pose.z[c] for c in columns])
        for order in ((1, 0, 2, 3), (0, 2, 1, 3), (0, 1, 3, 2), (0, 0, 1, 2), (1, 2, 3, 3)):
            if np.abs(held[list(order)] - held).max() > _UNLIKE:
                z = pose.z.copy()
                for c, row in zip(columns, held[list(order)], strict=True):
                    z[c] = row
                yield pose._replace(z=z)

    def alike(self, pose: ArmPose) -> Iterator[ArmPose]:
        """Yield starts for a fit in a local minimum: copies with all fingers equally bent, from straight to a fist."""
        for flexion, middle in _ALIKE_DEG:
            z = pose.z.copy()
            for digit in range(1, 5):
                self.hold(z, digit, flexion, None, middle)
            yield pose._replace(z=z)

    def hold(self, z: Float64, digit: int, flexion: float, abduction: float | None, middle: float) -> None:
        """Write a digit's posture into free angles, in place; its last joint follows the one before.

        Args:
            z: (n,) free angles [rad].
            digit: index of the digit, 0 for the thumb.
            flexion, abduction: angles of the first joint [°]; with None, its abduction is kept.
            middle: flexion of the second joint [°].
        """
        columns = self.columns[digit]
        for k, value in ((0, flexion), (1, abduction), (2, middle), (3, middle * self.model.coupling[digit])):
            if columns[k] >= 0 and value is not None:
                z[columns[k]] = np.radians(value)

    def spheres(self, pose: ArmPose, spacing_m: float = 0.025) -> Float64:
        """Return spheres (k, 5) along the capsules: centre (3), camera frame, and radius [m], 1 for hand or 0 for arm.

        Args:
            pose: the pose.
            spacing_m: least distance between the spheres' centres along a capsule; both its ends have one [m].
        """
        out = np.empty((400, 5))
        return out[: kernels().balls(self.pieces(pose)[0], self.owners, pose.R, pose.t, spacing_m, out)]

    def relevance(self, points: Float64, pose: ArmPose, beyond: float = 0.05) -> Float64:
        """Return weights (m,) of points: 0.5 near a predicted forearm, else 1 near its hand, else ``beyond``.

        Near the forearm is within 0.07 m of its axis, from the wrist to 0.05 m beyond its end. Near the hand is within
        0.85 hand lengths of the point 0.45 hand lengths from the wrist, on the palm's z axis. All these lengths are
        multiplied by the pose's hand size.

        Args:
            points: (m, 3) camera frame [m]; a NaN point gets ``beyond``.
            pose: the predicted pose.
            beyond: weight of all other points, such as near the upper arm.
        """
        out = np.empty(len(points))
        kernels().relevance(points, pose.R, pose.t, pose.v, self.length_m, self.forearm_m, beyond, out)
        return out

    def pieces(self, pose: ArmPose) -> tuple[Float64, Float64]:
        """Return the capsules (k, PIECE) of `arm_flesh_kernels`, and digits' joints (5, 4, 3), palm's frame [m]."""
        k = kernels()
        pieces = np.empty((len(self.owners), k.PIECE))
        rows, joints, axes = np.empty((5, k.DIGIT)), np.empty((5, 4, 3)), np.empty((5, 5, 3))
        k.flesh(
            self.digits, self.mirror, self.radii, self.palm, self.columns, self.gains, pose.z, pose.v, rows, joints,
            axes, pieces,
        )  # fmt: skip
        return pieces, joints

    def points(self, pose: ArmPose) -> Float64:
        """Return the points (23, 3) of `mocapella.model.arms.ARM_POINTS`, camera frame [m]."""
        joints = self.pieces(pose)[1].reshape(20, 3)
        x = np.empty((23, 3))
        x[0] = 0.0
        x[1:21] = joints
        x[21] = 0.5 * x[9]
        f, u = pose.v[4:7], pose.v[7:10]
        bent = u - (u @ f) * f
        along, behind = pose.v[0] * np.array(_ELBOW_M)
        x[22] = (pose.v[2] + along) * f + behind * bent / max(float(np.linalg.norm(bent)), 0.3)
        return np.asarray(x @ pose.R.reshape(3, 3).T + pose.t)

    def last_bones(self, pose: ArmPose) -> Float64:
        """Return (5, 8) the flesh about each digit's last bone: its axis' begin and end, camera frame, and radii [m].

        The landmark of the fingertip is beyond the axis' end, by less than the radius there.
        """
        k = kernels()
        last = self.pieces(pose)[0][2:15:3]
        begin, along = last[:, k.FROM : k.FROM + 3], last[:, k.LENGTH, None] * last[:, k.U : k.U + 3]
        axes = np.stack([begin, begin + along], axis=1) @ pose.R.reshape(3, 3).T + pose.t
        return np.hstack([axes.reshape(5, 6), last[:, [k.RA, k.RB]]])

    def tip_ends(self, pose: ArmPose) -> Float64:
        """Return (5, 3) where the flesh of each fingertip ends along its last bone, camera frame [m]."""
        bones = self.last_bones(pose)
        along = bones[:, 3:6] - bones[:, :3]
        return np.asarray(bones[:, 3:6] + bones[:, 7:] * along / np.linalg.norm(along, axis=1, keepdims=True))

    def visible(self, pose: ArmPose, front: Float64, lens: Float64) -> Float64:
        """Return for each landmark (23,) the fraction of the camera-facing surface around it that the image confirms.

        It is 0 if no surface around the landmark faces the camera.

        Args:
            pose: the pose.
            front, lens: (h, w) [m] and (4,) [px] of `ArmEvidence`.
        """
        out = np.empty(23)
        kernels().visible(
            self.pieces(pose)[0], self.owners, self._places, pose.R, pose.t, front, lens, _NEAR_M, out
        )  # fmt: skip
        return out

    def angles(self, pose: ArmPose) -> Float64:
        """Return the hand's angles (21,) in the order of `ANGLES` [rad]."""
        out = np.zeros(21)
        for digit in range(5):
            for k in range(5):
                if self.columns[digit, k] >= 0:
                    out[DIGIT_ANGLES[digit, k]] = self.gains[digit, k] * pose.z[self.columns[digit, k]]
        return out


def _ways(model: HandModel, digit: int) -> Float64:
    """Return postures (k, 5) of a digit [rad]; the last joint follows the one before."""
    if digit == 0:
        ways = [(f, a, m, last, 0) for f in (-28, 0, 28) for a in (-24, 0, 24) for m in (5, 40) for last in (5, 55)]
    else:
        ways = [
            (f, a, m, m * model.coupling[digit], 0)
            for f in (-12, 15, 40, 65, 88)
            for a in ((-16, 0, 16) if f < 60 else (0,))
            for m in (5, 40, 75, 104)
        ]
    return np.radians(np.array(ways, dtype=np.float64))


_HABITS: Final = replace(HandSettings(), flexion_sd_deg=120.0, abduction_sd_deg=12.0, thumb_sd_deg=25.0)
_NEAR_M: Final = 0.010
"""Distance from the image's surface within which flesh is confirmed."""
_ELSEWHERE_M: Final = 0.025
"""Distance between a fingertip's positions above which they are different ones."""
_UNLIKE: Final = np.radians(40)
"""Difference of angles below which fingers count as equally bent."""
_ALIKE_DEG: Final = ((-5, 5), (15, 30), (40, 40), (20, 80), (65, 70), (85, 100))
"""Flexion of knuckles and of middle joints."""
_NOWHERE: Final = np.full((5, 3), np.nan)


def _palm(shape: HandShape, big: float) -> Float64:
    """(k, 8) of a right hand: two points and the radii there [m]."""
    thumb, index, middle, ring, little = shape.bases
    # The palm's flesh is on the side to which the fingers bend; the joints are nearer to the back of the hand.
    wrist = big * np.array(
        [[0.013, -0.003, 0.004], [0.004, -0.003, 0.002], [-0.005, -0.003, 0.002], [-0.013, -0.003, 0.004]]
    )

    def between(a: Float64, b: Float64, f: float, y: float = 0.0) -> Float64:
        return np.asarray(a + f * (b - a) + big * np.array([0.0, y, 0.0]))

    low = big * np.array([0.0, -0.001, 0.0])
    rows = [
        (wrist[0], index + low, 0.0195, 0.0124),
        (wrist[1], middle + low, 0.0195, 0.0126),
        (wrist[2], ring + low, 0.0190, 0.0122),
        (wrist[3], little + low, 0.0180, 0.0114),
        (index + low, middle + low, 0.0120, 0.0120),
        (middle + low, ring + low, 0.0118, 0.0118),
        (ring + low, little + low, 0.0114, 0.0110),
        (between(thumb, index, 0.05, -0.004), between(wrist[0], index, 0.75), 0.0160, 0.0120),
        (between(thumb, middle, 0.1, -0.004), between(wrist[1], middle, 0.5, -0.002), 0.0170, 0.0130),
        (between(wrist[3], little, 0.25, -0.007), between(wrist[3], little, 0.7, -0.002), 0.0165, 0.0128),
    ]
    return np.array([[*a, *b, big * ra, big * rb] for a, b, ra, rb in rows])


@cache
def kernels() -> ModuleType:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import arm_fit_kernels

    return arm_fit_kernels
