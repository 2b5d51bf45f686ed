"""Bundle adjustment of cameras and people's joints: poses, focal lengths, clocks, joints and bones' lengths together.

Source: B. Triggs et al., *Bundle Adjustment – A Modern Synthesis* (2000): Levenberg–Marquardt steps (section 4), joints
eliminated first (6.1, Schur complement), outer robust loss (3.3: Cauchy), gauge (9.1). The constraint of constant,
symmetric bones is that of J. Puwein et al., "Joint camera pose estimation and 3D human pose estimation in a
multi-camera setup", ACCV (2014), section 4. The covariance is that of an M-estimator (Huber 1981, 7.6) times a
dispersion by clusters of observations, because a detector's errors last for longer than a frame (Liang, Zeger:
Biometrika 73 (1986) 13).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.keypoint_contact import (
    CONTACTS,
    FLOOR,
    contact_derivatives,
    contact_residuals,
    moved_floor,
    no_floor,
)
from mocapella.calibration.keypoint_tracks import HALPE
from mocapella.calibration.stepwise import Steps, result_of
from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.lens_jacobian import project_with_jacobian
from mocapella.geometry.twists import exp_twist

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]

CAMERA: Final = 11
"""Number of parameters of a camera: a small motion in its own frame (6), the log of its focal length, its clock, its
principal point in focal lengths (2), and the first coefficient k1 of its radial distortion."""
POSE: Final = slice(0, 6)
FOCAL: Final = 6
CLOCK: Final = 7
CENTRE: Final = slice(8, 10)
BEND: Final = 10
"""Places of a camera's motion, logarithm of the focal length, clock, principal point and k1 among its parameters."""
LENS: Final = (FOCAL, 8, 9, BEND)
"""Places of the parameters of the lens."""
CAUCHY: Final = 2.5
"""Scale of the Cauchy loss, in standard deviations."""
BONE_SD: Final = 0.05
"""Standard deviation of a bone's length between two instants, by errors of detectors, as a fraction."""
SHAPE_SD: Final = 0.10
"""Standard deviation of a bone's proportion between people, as a fraction."""
PINNED: Final = 1e-4
"""Standard deviation of the mean proportion, which fixes the scale."""
ALIKE_SD: Final = 0.01
"""Standard deviation of the logarithm of the focal length, and of k1, about their means over cameras of one model."""
STEPS: Final = 15
"""Most steps of a minimisation."""
ROUNDS: Final = 4
SETTLED: Final = 3e-5
"""Relative decrease of the cost at which a minimisation ends."""

_LENGTHS: Final = {  # in statures: Drillis, Contini, *Body segment parameters* (1966), in Winter (2009), fig. 4.1
    ("Hip", "Knee"): 0.245, ("Knee", "Ankle"): 0.246, ("Shoulder", "Elbow"): 0.186, ("Elbow", "Wrist"): 0.146,
    ("Shoulder", "Hip"): 0.288,
}  # fmt: skip
JOINTS: Final = len(HALPE)
"""Number of joints of a body, as in `HALPE`."""
BONES: Final = tuple(
    (HALPE.index(side + a), HALPE.index(side + b), k) for k, (a, b) in enumerate(_LENGTHS) for side in "LR"
)
"""Joints at the ends of each bone, in `HALPE`, and the number of its length, which left and right share."""
STATURES: Final = np.array(list(_LENGTHS.values()))
"""Typical lengths of the bones, in statures."""


@dataclass(frozen=True)
class KeypointViews:
    """Keypoints of people at common instants. A body is a person at one instant.

    Attributes:
        camera: (n,) index of the camera.
        body: (n,) index of the body.
        joint: (n,) index of the joint in `HALPE`.
        pixel: (n, 2) keypoint, interpolated to the instant by the camera's present clock [px].
        velocity: (n, 2) its velocity [px/s].
        sd: (n,) relative standard deviation of the keypoint's coordinates.
        person: (bodies,) person of each body.
        cluster: (bodies,) number of the stretch of time and person, within which errors are dependent.
        resting: (bodies, 26) whether a keypoint of a foot rests on the floor; None if that is not known.
    """

    camera: Int64
    body: Int64
    joint: Int64
    pixel: Float64
    velocity: Float64
    sd: Float64
    person: Int64
    cluster: Int64
    resting: Bool | None = None


@dataclass(frozen=True)
class PeopleBundle:
    """The estimated values.

    Attributes:
        T_camera_world: (cameras, 4, 4).
        lenses: (cameras, 9), see `geometry.lens`.
        clocks_s: (cameras,) the camera's time minus the rig's, relative to the clocks of the interpolation [s].
        joints: (bodies, 26, 3) in the world [m]; any value where fewer than two cameras see a joint.
        log_lengths: (people, bones) logarithms of the bones' lengths [m].
        floor: (7,) normal and heights of the floor, see `keypoint_contact.contact_residuals`.
    """

    T_camera_world: Float64
    lenses: Float64
    clocks_s: Float64
    joints: Float64
    log_lengths: Float64
    floor: Float64 = field(default_factory=no_floor)


@dataclass(frozen=True)
class BundlePrior:
    """What is known before.

    Attributes:
        free: (cameras, 11) whether each parameter is estimated.
        lens: (cameras, 9) lenses whose focal length [px], principal point [px] and k1 are the means.
        clock_s: (cameras,) mean of the clock, relative to the clocks of the interpolation [s].
        sd: (cameras, 11) standard deviations, in the units of the parameters; infinite for the pose.
        mean_stature: stature that the mean of all bones has, which fixes the scale [m].
        alike: (cameras, cameras) symmetric projection to the differences of lenses that are equal but for `ALIKE_SD`;
            None if there are none.
    """

    free: Bool
    lens: Float64
    clock_s: Float64
    sd: Float64
    mean_stature: float
    alike: Float64 | None = None


@dataclass(frozen=True)
class AdjustedPeople:
    """Result of `adjust_people`.

    Attributes:
        bundle: the adjusted values.
        residual_px: (n, 2) measured minus projected keypoints [px].
        sigma: robust standard deviation of a keypoint's coordinate, of relative standard deviation 1 [px].
        covariance: (cameras, 11, cameras, 11); 0 for fixed values.
        bound: (cameras, 11, cameras, 11) covariance if the errors of all keypoints were independent, Gaussian and of
            the assumed relative sizes: no estimate from these keypoints and this prior is more certain (Cramér–Rao).
    """

    bundle: PeopleBundle
    residual_px: Float64
    sigma: float
    covariance: Float64
    bound: Float64


@dataclass(frozen=True)
class _System:
    """The equations JᵀWJ x = −JᵀWr of one step.

    Attributes:
        general: (g, g) of the cameras, bones and floor.
        joints: (bodies, 78, 78).
        mixed: (bodies, g, 78).
        of_general: (g,) right-hand side.
        of_joints: (bodies, 78).
        of_bodies: (bodies, g) part of each body in the right-hand side.
    """

    general: Float64
    joints: Float64
    mixed: Float64
    of_general: Float64
    of_joints: Float64
    of_bodies: Float64


def adjust_people(
    views: KeypointViews, start: PeopleBundle, prior: BundlePrior, rounds: int = ROUNDS
) -> AdjustedPeople:
    """Minimise the reprojection errors, the differences of bones and the deviations from the prior.

    Args:
        views: the keypoints; each joint of a body has two or more.
        start: initial values, near the minimum.
        prior: fixed values and prior knowledge.
        rounds: number of estimates of the noise level.

    Returns:
        The minimum that was found; its residuals show whether it is good.
    """
    return result_of(stating_covariance(views, result_of(adjusting_people(views, start, prior, rounds)), prior))


def adjusting_people(
    views: KeypointViews, start: PeopleBundle, prior: BundlePrior, rounds: int = ROUNDS
) -> Steps[AdjustedPeople]:
    """Return the steps of `adjust_people` without the covariance, which is 0."""
    seen = _seen(views)
    unknown = 3 * int(seen.sum()) + int(prior.free.sum()) + start.log_lengths.size
    known = views.pixel.size + len(seen) * len(BONES) + int(_resting(views, seen).sum())
    spare = min(0.9, unknown / known)
    bundle, sigma = start, _sigma(views, _residual(views, start), spare)
    for _ in range(rounds):
        bundle = yield from _descend(views, bundle, prior, sigma, seen)
        before, sigma = sigma, _sigma(views, _residual(views, bundle), spare)
        if abs(sigma - before) <= 0.01 * sigma:
            break
    nothing = np.zeros((len(bundle.lenses), CAMERA) * 2)
    return AdjustedPeople(bundle, _residual(views, bundle), sigma, nothing, nothing)


def _seen(views: KeypointViews) -> Bool:
    seen = np.zeros((len(views.person), JOINTS), dtype=bool)
    seen[views.body, views.joint] = True
    return seen


def _resting(views: KeypointViews, seen: Bool) -> Bool:
    return np.zeros_like(seen) if views.resting is None else views.resting & seen


def _sigma(views: KeypointViews, residual: Float64, spare: float) -> float:
    """Return the noise of relative standard deviation 1 from the median distance (χ² of two degrees of freedom)."""
    r2 = (residual**2).sum(axis=1) / views.sd**2
    return max(1e-6, float(np.sqrt(np.median(r2) / (2 * np.log(2)) / (1 - spare))))


def _expected(views: KeypointViews, bundle: PeopleBundle) -> tuple[Float64, Float64, Float64, Float64, Float64]:
    """Return joints in the cameras' frames, pixels, their derivatives by joint and lens, and ``R_camera_world``."""
    T = bundle.T_camera_world[views.camera]
    R = T[:, :3, :3]
    p = np.einsum("nij,nj->ni", R, bundle.joints[views.body, views.joint]) + T[:, :3, 3]
    pixel, by_point, by_lens = project_with_jacobian(p, bundle.lenses[views.camera])
    return p, pixel, by_point, by_lens, R


def _residual(views: KeypointViews, bundle: PeopleBundle) -> Float64:
    return _difference(views, bundle, _expected(views, bundle)[1])


def _difference(views: KeypointViews, bundle: PeopleBundle, pixel: Float64) -> Float64:
    """Return measured minus projected pixels; a joint behind a camera gets a huge residual."""
    measured = views.pixel + views.velocity * bundle.clocks_s[views.camera, None]
    return np.nan_to_num(measured - pixel, nan=1e5)


def _loss(squares: Float64) -> float:
    return float(CAUCHY**2 * np.log1p(squares / CAUCHY**2).sum())


def _bones(bundle: PeopleBundle, person: Int64, seen: Bool) -> tuple[Float64, Float64, Float64]:
    """Return residuals (bodies, bones), 0 where not seen; unit directions (bodies, bones, 3); lengths / expected."""
    first, second, which = (np.array(of) for of in zip(*BONES, strict=True))
    along = bundle.joints[:, first] - bundle.joints[:, second]
    length = np.maximum(np.linalg.norm(along, axis=-1), 1e-9)
    ratio = length / np.exp(bundle.log_lengths[person][:, which])
    both = seen[:, first] & seen[:, second]
    return np.where(both, (ratio - 1.0) / BONE_SD, 0.0), along / length[..., None], np.where(both, ratio, 0.0)


def _unlike(bundle: PeopleBundle, prior: BundlePrior) -> Float64:
    """Return the differences (2, cameras) of the logarithms of focal lengths and of k1 that should be equal."""
    if prior.alike is None:
        return np.zeros((2, len(bundle.lenses)))
    return np.stack([np.log(bundle.lenses[:, :2]).mean(axis=1), bundle.lenses[:, 4]]) @ prior.alike / ALIKE_SD


def _prior_residuals(bundle: PeopleBundle, prior: BundlePrior) -> tuple[Float64, Float64, float]:
    """Return the deviations of the cameras' parameters (cameras, 11), of the bones, and of their mean, in their sds."""
    lens, mean = bundle.lenses, prior.lens
    own = np.zeros((len(lens), CAMERA))
    own[:, FOCAL] = np.log(lens[:, :2] / mean[:, :2]).mean(axis=1)
    own[:, CLOCK] = bundle.clocks_s - prior.clock_s
    own[:, CENTRE] = (lens[:, 2:4] - mean[:, 2:4]) / mean[:, :2]
    own[:, BEND] = lens[:, 4] - mean[:, 4]
    off = bundle.log_lengths - np.log(STATURES * prior.mean_stature)
    pinned = float(off.mean()) / PINNED
    return np.where(prior.free, own / prior.sd, 0.0), (off - off.mean()) / SHAPE_SD, pinned


def _cost(views: KeypointViews, bundle: PeopleBundle, prior: BundlePrior, sigma: float, seen: Bool) -> float:
    squares = (_residual(views, bundle) ** 2).sum(axis=1) / (views.sd * sigma) ** 2
    bones, priors = _bones(bundle, views.person, seen)[0], (*_prior_residuals(bundle, prior), _unlike(bundle, prior))
    contacts = contact_residuals(bundle.joints, _resting(views, seen), bundle.floor)
    return _loss(squares) + _loss(bones**2) + _loss(contacts**2) + sum(float(np.sum(np.square(r))) for r in priors)


def _descend(
    views: KeypointViews, bundle: PeopleBundle, prior: BundlePrior, sigma: float, seen: Bool
) -> Steps[PeopleBundle]:
    """Run Levenberg–Marquardt at one noise level."""
    damping, cost = 1e-4, _cost(views, bundle, prior, sigma, seen)
    for _ in range(STEPS):
        yield
        system = _equations(views, bundle, prior, sigma, seen)
        while damping < 1e8:
            yield
            tried = _step(bundle, system, prior, damping)
            tried_cost = _cost(views, tried, prior, sigma, seen)
            if tried_cost <= cost:
                break
            damping *= 10
        else:
            return bundle
        bundle, gain, cost = tried, cost - tried_cost, tried_cost
        damping = max(damping / 10, 1e-10)
        if gain <= SETTLED * cost:
            return bundle
    return bundle


def _equations(views: KeypointViews, bundle: PeopleBundle, prior: BundlePrior, sigma: float, seen: Bool) -> _System:
    cameras, bodies = len(bundle.lenses), len(views.person)
    size = cameras * CAMERA + bundle.log_lengths.size + FLOOR
    residual, J, by_joint = _linearised(views, bundle, prior)
    scale = views.sd * sigma
    weight = 1.0 / (1.0 + (residual**2).sum(axis=1) / (CAUCHY * scale) ** 2) / scale**2
    weighted, joint_weighted = J * weight[:, None, None], by_joint * weight[:, None, None]
    general, mixed = np.zeros((size, size)), np.zeros((bodies, size, JOINTS * 3))
    joints, of_joints = np.zeros((bodies, JOINTS, 3, JOINTS, 3)), np.zeros((bodies, JOINTS, 3))
    of_bodies = np.zeros((bodies, size))
    both = np.einsum("nki,nkj->nij", weighted, by_joint)
    squares = np.einsum("nki,nkj->nij", joint_weighted, by_joint)
    pulls, joint_pulls = (np.einsum("nki,nk->ni", j, residual) for j in (weighted, joint_weighted))
    by_camera = mixed[:, : cameras * CAMERA].reshape(bodies, cameras, CAMERA, JOINTS, 3)
    by_camera[views.body, views.camera, :, views.joint] = both
    for c in range(cameras):
        mine = views.camera == c
        own, b, j = slice(c * CAMERA, (c + 1) * CAMERA), views.body[mine], views.joint[mine]
        general[own, own] += np.einsum("nki,nkj->ij", weighted[mine], J[mine])
        joints[b, j, :, j] += squares[mine]
        of_joints[b, j] += joint_pulls[mine]
        np.add.at(of_bodies[:, own], b, pulls[mine])
    blocks = _Blocks(general, mixed, joints, of_joints, of_bodies)
    _add_bones(blocks, bundle, views.person, seen)
    _add_contacts(blocks, bundle, _resting(views, seen))
    of_general = of_bodies.sum(axis=0)
    _add_prior(general, of_general, bundle, prior)
    nothing = np.repeat(~seen, 3, axis=1)
    square = joints.reshape(bodies, JOINTS * 3, JOINTS * 3)
    square[:, np.arange(JOINTS * 3), np.arange(JOINTS * 3)] += nothing
    return _System(general, square, mixed, of_general, of_joints.reshape(bodies, -1), of_bodies)


def _linearised(views: KeypointViews, bundle: PeopleBundle, prior: BundlePrior) -> tuple[Float64, Float64, Float64]:
    """Return the residuals, and their derivatives by the camera's parameters (n, 2, 11) and by the joint (n, 2, 3).

    Derivatives by fixed parameters are 0.
    """
    p, pixel, by_point, by_lens, R = _expected(views, bundle)
    focal = bundle.lenses[views.camera, :2]
    by_focal = by_lens[..., 0] * focal[:, :1] + by_lens[..., 1] * focal[:, 1:]
    parts = [
        -by_point, by_point @ cross_matrix(p), -by_focal[..., None], views.velocity[..., None],
        -by_lens[..., 2:4] * focal[:, None, :], -by_lens[..., 4:5],
    ]  # fmt: skip
    J = np.where(prior.free[views.camera][:, None, :], np.nan_to_num(np.concatenate(parts, axis=-1)), 0.0)
    return _difference(views, bundle, pixel), J, np.nan_to_num(-by_point @ R)


@dataclass(frozen=True)
class _Blocks:
    """Arrays of `_System` while they are added up."""

    general: Float64
    mixed: Float64
    joints: Float64
    of_joints: Float64
    of_bodies: Float64


def _add_bones(to: _Blocks, bundle: PeopleBundle, person: Int64, seen: Bool) -> None:
    residual, along, ratio = _bones(bundle, person, seen)
    weight = 1.0 / (1.0 + residual**2 / CAUCHY**2)
    first = len(bundle.lenses) * CAMERA
    bodies = np.arange(len(person))
    for k, (i, j, which) in enumerate(BONES):
        length = np.exp(bundle.log_lengths[person, which])
        by_i = along[:, k] / (length * BONE_SD)[:, None] * (ratio[:, k] > 0)[:, None]
        by_l = -ratio[:, k] / BONE_SD
        w, r = weight[:, k], residual[:, k]
        column = first + person * len(STATURES) + which
        square = by_i[:, :, None] * by_i[:, None, :] * w[:, None, None]
        to.joints[:, i, :, i] += square
        to.joints[:, j, :, j] += square
        to.joints[:, i, :, j] -= square
        to.joints[:, j, :, i] -= square
        to.of_joints[:, i] += by_i * (w * r)[:, None]
        to.of_joints[:, j] -= by_i * (w * r)[:, None]
        np.add.at(to.general, (column, column), w * by_l**2)
        to.of_bodies[bodies, column] += w * by_l * r
        cross = by_i * (w * by_l)[:, None]
        to.mixed[bodies, column, 3 * i : 3 * i + 3] += cross
        to.mixed[bodies, column, 3 * j : 3 * j + 3] -= cross


def _add_contacts(to: _Blocks, bundle: PeopleBundle, resting: Bool) -> None:
    residual = contact_residuals(bundle.joints, resting, bundle.floor)
    by_joint, by_floor = contact_derivatives(bundle.joints, bundle.floor)
    weight = np.where(resting[:, CONTACTS], 1.0 / (1.0 + residual**2 / CAUCHY**2), 0.0)
    floor = slice(len(to.general) - FLOOR, len(to.general))
    weighted = by_floor * weight[..., None]
    to.general[floor, floor] += np.einsum("bki,bkj->ij", weighted, by_floor) + _UNKNOWN * np.eye(FLOOR)
    to.of_bodies[:, floor] += np.einsum("bki,bk->bi", weighted, residual)
    for k, joint in enumerate(CONTACTS):
        to.joints[:, joint, :, joint] += weight[:, k, None, None] * np.outer(by_joint, by_joint)
        to.of_joints[:, joint] += (weight[:, k] * residual[:, k])[:, None] * by_joint
        to.mixed[:, floor, 3 * joint : 3 * joint + 3] += weighted[:, k, :, None] * by_joint


_UNKNOWN: Final = 1e-6
"""Weight of the present floor, so that its equations are never singular."""


def _add_prior(general: Float64, of_general: Float64, bundle: PeopleBundle, prior: BundlePrior) -> None:
    cameras = len(bundle.lenses)
    own, shape, pinned = _prior_residuals(bundle, prior)
    at = np.arange(cameras * CAMERA)
    general[at, at] += np.where(prior.free, prior.sd**-2.0, 0.0).ravel()
    of_general[at] += (own / prior.sd).ravel()
    if prior.alike is not None:
        for place, off in zip((FOCAL, BEND), _unlike(bundle, prior), strict=True):
            mine = np.flatnonzero(prior.free[:, place])
            of = mine * CAMERA + place
            general[np.ix_(of, of)] += prior.alike[np.ix_(mine, mine)] / ALIKE_SD**2
            of_general[of] += off[mine] / ALIKE_SD
    count = bundle.log_lengths.size
    bones = slice(cameras * CAMERA, cameras * CAMERA + count)
    general[bones, bones] += (np.eye(count) - 1.0 / count) / SHAPE_SD**2
    of_general[bones] += shape.ravel() / SHAPE_SD
    general[bones, bones] += 1.0 / (count * PINNED) ** 2
    of_general[bones] += pinned / (count * PINNED)
    fixed = np.flatnonzero(~prior.free.ravel())
    general[fixed, fixed] += 1.0


@dataclass(frozen=True)
class _JointInverse:
    """Inverse of the joints' equations of each body: one block of the ends of bones, and one of each other joint.

    Attributes:
        ends: (bodies, 36, 36).
        others: (bodies, 14, 3, 3).
    """

    ends: Float64
    others: Float64

    def times(self, values: Float64) -> Float64:
        """Return the product with values (bodies, 78, k)."""
        bodies, _, columns = values.shape
        out = np.empty_like(values)
        out[:, _END_ROWS] = self.ends @ values[:, _END_ROWS]
        others = self.others @ values[:, _OTHER_ROWS].reshape(bodies, -1, 3, columns)
        out[:, _OTHER_ROWS] = others.reshape(bodies, -1, columns)
        return out


_ENDS: Final = np.unique([joint for one, other, _ in BONES for joint in (one, other)])
_OTHERS: Final = np.setdiff1d(np.arange(JOINTS), _ENDS)
_END_ROWS: Final = (3 * _ENDS[:, None] + np.arange(3)).ravel()
_OTHER_ROWS: Final = (3 * _OTHERS[:, None] + np.arange(3)).ravel()


def _joint_inverse(joints: Float64, damping: float) -> _JointInverse:
    """Invert equations (bodies, 78, 78) that couple no joints but the ends of bones."""
    bodies = len(joints)
    diagonal = np.einsum("bii->bi", joints) * damping + 1e-9
    ends = joints[:, _END_ROWS[:, None], _END_ROWS]
    ends[:, np.arange(len(_END_ROWS)), np.arange(len(_END_ROWS))] += diagonal[:, _END_ROWS]
    blocks = joints.reshape(bodies, JOINTS, 3, JOINTS, 3)
    others = blocks[:, _OTHERS, :, _OTHERS].swapaxes(0, 1)
    others[..., np.arange(3), np.arange(3)] += diagonal[:, _OTHER_ROWS].reshape(bodies, -1, 3)
    return _JointInverse(np.asarray(np.linalg.inv(ends)), np.asarray(np.linalg.inv(others)))


def _reduced(system: _System, damping: float) -> tuple[Float64, Float64, _JointInverse]:
    """Eliminate the joints; return the equations of the others, (bodies, 78, g), and the inverse blocks."""
    inverse = _joint_inverse(system.joints, damping)
    solved = inverse.times(np.swapaxes(system.mixed, 1, 2))
    general = system.general + damping * np.diag(np.diag(system.general))
    flat = system.mixed.transpose(1, 0, 2).reshape(len(general), -1)
    return general - flat @ solved.reshape(-1, len(general)), solved, inverse


def _step(bundle: PeopleBundle, system: _System, prior: BundlePrior, damping: float) -> PeopleBundle:
    S, solved, inverse = _reduced(system, damping)
    own = inverse.times(system.of_joints[..., None])[..., 0]
    right = system.of_general - np.einsum("bgi,bi->g", system.mixed, own)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(S), 1e-30))
    x = -scale * np.linalg.lstsq(S * np.outer(scale, scale), scale * right, rcond=1e-13)[0]
    y = -own - solved @ x
    cameras = len(bundle.lenses)
    of_cameras = np.where(prior.free, x[: cameras * CAMERA].reshape(cameras, CAMERA), 0.0)
    of_cameras = np.clip(of_cameras, -1.0, 1.0)
    lenses = bundle.lenses.copy()
    lenses[:, 2:4] += lenses[:, :2] * np.clip(of_cameras[:, CENTRE], -0.05, 0.05)
    lenses[:, :2] *= np.exp(np.clip(of_cameras[:, FOCAL], -0.3, 0.3))[:, None]
    lenses[:, 4] += np.clip(of_cameras[:, BEND], -0.1, 0.1)
    return PeopleBundle(
        exp_twist(of_cameras[:, POSE]) @ bundle.T_camera_world,
        lenses,
        bundle.clocks_s + of_cameras[:, CLOCK],
        bundle.joints + y.reshape(bundle.joints.shape),
        bundle.log_lengths + np.clip(x[cameras * CAMERA : -FLOOR], -0.5, 0.5).reshape(bundle.log_lengths.shape),
        moved_floor(bundle.floor, x[-FLOOR:]),
    )


def stating_covariance(views: KeypointViews, adjusted: AdjustedPeople, prior: BundlePrior) -> Steps[AdjustedPeople]:
    """Return the steps that add the covariance of the cameras' parameters to an adjustment.

    Dispersions are estimated for each kind of parameter (`_KINDS`): the mean square of the pulls of the clusters,
    relative to what independent errors would do. Errors that last for the whole recording are in no residual:
    `LASTING_PX` of them is assumed and propagated (`_lasting_pulls`).
    """
    bundle, sigma = adjusted.bundle, adjusted.sigma
    cameras = len(bundle.lenses)
    yield
    system = _equations(views, bundle, prior, sigma, _seen(views))
    yield
    S, solved, _ = _reduced(system, 0.0)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(S), 1e-30))
    inverse = np.linalg.pinv(S * np.outer(scale, scale), rcond=1e-13, hermitian=True) * np.outer(scale, scale)
    yield
    scores = np.zeros((int(views.cluster.max(initial=0)) + 1, len(S)))
    np.add.at(scores, views.cluster, system.of_bodies)
    scores -= scores.mean(axis=0)
    count = len(np.unique(views.cluster))
    pulls = (scores @ inverse)[:, : cameras * CAMERA] * math.sqrt(count / max(count - 1, 1))
    r2 = (_residual(views, bundle) ** 2).sum(axis=1) / (views.sd * sigma) ** 2
    weight = 1.0 / (1.0 + r2 / CAUCHY**2)
    slope = weight - r2 / CAUCHY**2 * weight**2
    factor = float((weight.mean() / slope.mean()) ** 2)
    free, inner = prior.free, inverse[: cameras * CAMERA, : cameras * CAMERA]
    spread = np.ones((cameras, CAMERA))
    for kind in _KINDS:
        at = np.flatnonzero((free & (np.isin(np.arange(CAMERA), kind))).ravel())
        if len(at):
            block = np.linalg.pinv(inner[np.ix_(at, at)], rcond=1e-10, hermitian=True)
            squares = float(np.einsum("ki,ij,kj->", pulls[:, at], block, pulls[:, at]))
            spread.ravel()[at] = math.sqrt(max(1.0, squares / len(at)))
    mask, own = free.ravel(), slice(0, cameras * CAMERA)
    yield
    lasting = _lasting_pulls(views, bundle, prior, sigma, solved) @ inverse[:, own]
    total = factor * inner * np.outer(spread, spread) + lasting.T @ lasting
    covariance, bound = (
        np.where(mask[:, None] & mask, of, 0.0).reshape(cameras, CAMERA, cameras, CAMERA) for of in (total, inner)
    )
    return replace(adjusted, covariance=covariance, bound=bound)


def _lasting_pulls(
    views: KeypointViews, bundle: PeopleBundle, prior: BundlePrior, sigma: float, solved: Float64
) -> Float64:
    """Return the pulls (errors, g) on the parameters of errors that last, each of one standard deviation.

    A detector shifts a joint by the same vector while it sees a person at one place from the same side: one error in x
    and one in y for each camera, joint, person, place and eighth of a turn. People who walk about average them out, and
    people who stay in one place do not.

    Args:
        solved: (bodies, 78, g) influence of the cameras and bones on the joints, see `_reduced`.
    """
    residual, J, by_joint = _linearised(views, bundle, prior)
    r2 = (residual**2).sum(axis=1) / (views.sd * sigma) ** 2
    pull = LASTING_PX * views.sd / (1.0 + r2 / CAUCHY**2) / (views.sd * sigma) ** 2
    size = solved.shape[-1]
    joint_columns = 3 * views.joint[:, None] + np.arange(3)
    reduced = -np.einsum("nki,nig->nkg", by_joint, solved[views.body[:, None], joint_columns])
    columns = CAMERA * views.camera[:, None] + np.arange(CAMERA)
    reduced[np.arange(len(J))[:, None, None], np.arange(2)[:, None], columns[:, None, :]] += J
    keys = np.column_stack([views.camera, views.joint, views.person[views.body], _circumstances(views, bundle)])
    _, of_error = np.unique(keys, axis=0, return_inverse=True)
    pulls = np.zeros((int(of_error.max(initial=-1)) + 1, 2, size))
    np.add.at(pulls, of_error.ravel(), reduced * pull[:, None, None])
    return pulls.reshape(-1, size)


def _circumstances(views: KeypointViews, bundle: PeopleBundle) -> Int64:
    """Return (n, 4): the camera's direction from the person, in eighths of a turn, and the person's place."""
    at = {name: HALPE.index(name) for name in ("LShoulder", "RShoulder", "LHip", "RHip")}
    shoulders, hips = (bundle.joints[:, [at["L" + name], at["R" + name]]] for name in ("Shoulder", "Hip"))
    left, right = (0.5 * (shoulders[:, k] + hips[:, k]) for k in range(2))
    across, upward = left - right, (shoulders - hips).sum(axis=1)
    middle = 0.5 * (left + right)
    centres = -np.einsum("cji,cj->ci", bundle.T_camera_world[:, :3, :3], bundle.T_camera_world[:, :3, 3])
    towards = centres[views.camera] - middle[views.body]
    sideways, ahead = (
        axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
        for axis in (across, np.cross(across, upward))
    )
    x, z = (np.einsum("ni,ni->n", towards, axis[views.body]) for axis in (sideways, ahead))
    side = np.floor(np.arctan2(x, z) / (2 * np.pi) * SIDES) % SIDES
    cells = np.floor(middle / PLACE_M)[views.body]
    return np.column_stack([side, cells]).astype(np.int64)


SIDES: Final = 8
"""Number of directions around a person; within each, a detector's lasting error is the same."""
PLACE_M: Final = 0.5
"""Size of a place within which it is the same [m]."""
LASTING_PX: Final = 4.0
"""Standard deviation of a lasting error of a keypoint of relative standard deviation 1 [px]: 1 % of the size of a
person of 400 px, about what annotators of joints differ by (Lin et al., *COCO*, keypoint similarity)."""
_KINDS: Final = ((0, 1, 2), (3, 4, 5), (FOCAL,), (CLOCK,), (8, 9), (BEND,))
"""Parameters of a camera whose dispersions are estimated together."""
