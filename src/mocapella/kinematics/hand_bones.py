"""Estimate a person's finger bones from a short gesture: least squares over all frames, with a prior of proportions.

Three or more markers on the base, the back of the hand, measure the palm's pose in every frame. The person shows

- ``flat``: the flat hand, fingers straight and along the palm;
- ``knuckles``: straight fingers that bend at the knuckles, forth and back, as far as they go;
- ``hook``: knuckles straight, fingers that curl and open.

A fingertip then moves on an arc around its knuckle, whose radius is the finger's length, and on a curl that determines
the lengths of its bones. The thumb's first joint turns by some 50° only, too little to determine its length: the thumb
keeps its proportion to the fingers, with a larger uncertainty. No joint is held quite straight: its flexion is
estimated, too, and its uncertainty adds to that of the lengths.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.geometry.alignment import align, cross_matrix, moments
from mocapella.geometry.rigid import apply
from mocapella.model.hand import DIGITS, HandModel, HandShape
from mocapella.settings import check

Float64 = NDArray[np.float64]
GesturePhase = Literal["flat", "knuckles", "hook"]
PHASES: Final[tuple[str, ...]] = get_args(GesturePhase)

_SHARED: Final = 8  # three lengths, the base's place, flexions that were held: of the first and of the second joint
_FREE_DEG: Final = 1000.0
"""Standard deviation of an angle that the phase leaves free, practically infinite: with that of usual postures, the
many instants together would fix the mean angle, and so lengthen the bones."""


@dataclass(frozen=True)
class BonesSettings:
    """Priors of the fit, and requirements that the gesture must meet.

    Attributes:
        length_sd: standard deviation of a bone's length about the initial one, relative to it.
        base_sd_m: standard deviation of a coordinate of a digit's first joint about the initial one [m].
        held_sd_deg: standard deviation of the constant flexion of a joint that should be straight [°].
        unsteady_sd_deg: standard deviation of that flexion's variation over time [°].
        thumb_sd: relative standard deviation of the thumb's common proportion to the fingers.
        least_frames: least number of frames of each phase that show the whole base and the fingertip.
        least_knuckles_deg, least_hook_deg: least `Bones.knuckles_deg` and `Bones.hook_deg` of each finger [°].
        most_finger_sd_m: largest standard deviation of the length of a whole finger [m].
        most_iterations: largest number of iterations of the fit.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    length_sd: float = 0.15
    base_sd_m: float = 0.008
    held_sd_deg: float = 4.0
    unsteady_sd_deg: float = 1.0
    thumb_sd: float = 0.08
    least_frames: int = 20
    least_knuckles_deg: float = 40.0
    least_hook_deg: float = 50.0
    most_finger_sd_m: float = 0.005
    most_iterations: int = 40

    def __post_init__(self) -> None:
        for name in ("length_sd", "thumb_sd"):
            check(0 < getattr(self, name) < 1, name, getattr(self, name), "between 0 and 1")
        for name in ("base_sd_m", "most_finger_sd_m"):
            check(0 < getattr(self, name) < 0.1, name, getattr(self, name), "above 0, below 0.1 m")
        for name in ("held_sd_deg", "unsteady_sd_deg"):
            check(0 < getattr(self, name) < 90, name, getattr(self, name), "above 0, below 90")
        for name in ("least_knuckles_deg", "least_hook_deg"):
            check(0 <= getattr(self, name) < 90, name, getattr(self, name), "0 or more, below 90")
        check(self.least_frames >= 3, "least_frames", self.least_frames, "3 or more")
        check(1 <= self.most_iterations <= 1000, "most_iterations", self.most_iterations, "1 to 1000")


class Bones(msgspec.Struct, frozen=True, eq=False):
    """Measured bones of a hand, with their uncertainty.

    Attributes:
        shape: the hand, with the standard deviations of its lengths.
        base_markers: (k, 3) measured positions of the base's markers in the palm's frame of a right hand; of a left
            hand, mirrored, as `HandTracker` takes them [m].
        finger_sd_m: (5,) standard deviations of each digit's whole length [m].
        knuckles_deg: (4,) flexion range of the fingers' first joints in the phase ``knuckles``, from the 5 % to the
            95 % quantile [°].
        hook_deg: (4,) flexion range of the second joints in the phase ``hook``, likewise [°].
        frames: (4,) number of instants used for each finger.
        residual_m: root mean square distance of the measured tips from the fitted hand [m].
    """

    shape: HandShape
    base_markers: Float64
    finger_sd_m: Float64
    knuckles_deg: Float64
    hook_deg: Float64
    frames: NDArray[np.int64]
    residual_m: float


def measure_bones(
    model: HandModel,
    start: HandShape,
    base_markers: Any,
    points: Any,
    phases: Any,
    *,
    sd_m: float = 0.001,
    settings: BonesSettings | None = None,
) -> Bones:
    """Estimate the bones of a hand from a gesture of three phases, `PHASES`; the module describes them.

    Args:
        model: the hand's proportions and couplings.
        start: a hand of about that size; gives the person, the side, and the prior's lengths and positions.
        base_markers: (k, 3), k ≥ 3, approximate positions of the base's markers, as in `Bones` [m]. They define the
            palm's frame.
        points: (n, 5 + k, 3) fingertips and the base's markers, world [m]; NaN where one is not seen.
        phases: (n,) phase of the gesture at each instant, one of `PHASES`.
        sd_m: standard deviation of a coordinate of a marker [m].
        settings: priors and requirements; the defaults if None.

    Returns:
        The bones of the same person and side as ``start``, and the measured positions of the base's markers.

    Raises:
        InputError: arrays of another shape, too few base markers, or a gesture that does not determine a finger; the
            message names the finger and what to do.
        SettingsError: ``sd_m`` is not above 0 and below 0.1 m.
    """
    s = settings or BonesSettings()
    check(0 < sd_m < 0.1, "sd_m", sd_m, "above 0, below 0.1 m")
    points, layout, names = _checked(points, base_markers, phases)
    layout, tips = _in_palm(points, layout, start, s)
    fits = [
        _DigitFit(model, start, digit, tips[:, digit], _whitening(tips[:, digit], layout, sd_m), names, s)
        for digit in range(1, 5)
    ]
    for fit in fits:
        fit.run()
        fit.refuse_what_does_not_tell()
    scale = np.mean([fit.shared[:3].sum() for fit in fits]) / start.lengths[1:].sum(axis=1).mean()
    thumb = scale * start.lengths[0]
    covariances = [np.outer(s.thumb_sd * thumb, s.thumb_sd * thumb), *(fit.covariance[:3, :3] for fit in fits)]
    shape = HandShape(
        start.handedness,
        np.array([thumb, *(fit.shared[:3] for fit in fits)]),
        np.array([scale * start.bases[0], *(fit.frame @ fit.shared[3:6] for fit in fits)]),
        start.person,
        np.sqrt(np.array([np.diag(C) for C in covariances])),
    )
    residuals = np.concatenate([fit.residuals() for fit in fits])
    return Bones(
        shape=shape,
        base_markers=layout,
        finger_sd_m=np.sqrt([C.sum() for C in covariances]),
        knuckles_deg=np.array([fit.moved("knuckles", 0) for fit in fits]),
        hook_deg=np.array([fit.moved("hook", 2) for fit in fits]),
        frames=np.array([len(fit.angles) for fit in fits]),
        residual_m=float(np.sqrt((residuals**2).sum(axis=-1).mean())),
    )


def _checked(points: Any, base_markers: Any, phases: Any) -> tuple[Float64, Float64, NDArray[np.str_]]:
    points, layout = np.asarray(points, dtype=np.float64), np.asarray(base_markers, dtype=np.float64)
    names = np.asarray(phases, dtype=np.str_)
    if layout.ndim != 2 or layout.shape[1:] != (3,) or len(layout) < 3 or not np.isfinite(layout).all():
        fix = "put three or more markers on the back of the hand for the gesture; one is enough afterwards"
        raise InputError("do not tell how the palm lies", field="base_markers", value=layout.shape, fix=fix)
    wanted = (len(names), 5 + len(layout), 3)
    if names.ndim != 1 or points.shape != wanted:
        fix = f"give {wanted}: instants, five fingertips and {len(layout)} of the base"
        raise InputError("are no markers of this hand", field="points", value=points.shape, fix=fix)
    for name in np.unique(names):
        if name not in PHASES:
            fix = "take one of " + ", ".join(PHASES)
            raise InputError("is no part of the gesture", field="phases", value=str(name), fix=fix)
    return np.where(np.isfinite(points).all(axis=-1)[..., None], points, np.nan), layout, names


def _in_palm(points: Float64, layout: Float64, start: HandShape, s: BonesSettings) -> tuple[Float64, Float64]:
    """Return the base's mean layout (k, 3), and the tips (n, 5, 3), in the palm's frame of a right hand [m]."""
    base = points[:, 5:] * start.mirror
    whole = np.isfinite(base).all(axis=(1, 2))
    if whole.sum() < s.least_frames:
        fix = f"show all markers of the base in {s.least_frames} instants or more"
        raise InputError("is seen too rarely", field="base", value=int(whole.sum()), fix=fix)
    mean = layout
    for _ in range(5):
        T = align(moments(mean, base[whole]))
        mean = np.asarray(apply(T, base[whole]).mean(axis=0))
    mean = apply(align(moments(layout, mean)), mean)
    if np.linalg.svd(mean - mean.mean(axis=0), compute_uv=False)[1] < 0.005:
        fix = "put them apart in two directions, such as on the wrist and on two knuckles"
        raise InputError("lie in a line", field="base_markers", fix=fix)
    T = np.full((len(points), 4, 4), np.nan)
    T[whole] = align(moments(mean, base[whole]))
    return mean, apply(T, points[:, :5] * start.mirror)


def _whitening(tips: Float64, layout: Float64, sd_m: float) -> Float64:
    """Return the matrices (n, 3, 3) that whiten the tips' errors: their own noise, and the palm's.

    The palm's pose comes from the base's markers, with the same noise; its rotation error moves a tip by the lever.
    """
    H = np.zeros((6, 6))
    for x in layout:
        J = np.concatenate([np.eye(3), -cross_matrix(x)], axis=1)
        H += J.T @ J
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(tips), 3, 3)), -cross_matrix(np.nan_to_num(tips))], axis=-1)
    covariances = sd_m**2 * (np.eye(3) + J @ np.linalg.inv(H) @ np.swapaxes(J, 1, 2))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariances)))


class _DigitFit:
    """Fit of one digit: its lengths and base, shared by all instants, and its angles (f, a, m, b) at each instant."""

    def __init__(  # noqa: PLR0917 - of this module
        self,
        model: HandModel,
        start: HandShape,
        digit: int,
        tips: Float64,
        whitening: Float64,
        names: NDArray[np.str_],
        s: BonesSettings,
    ) -> None:
        seen = np.isfinite(tips).all(axis=-1)
        self.name, self.s = DIGITS[digit], s
        self.frame, self.ratio = model.frames[digit], float(model.coupling[digit])
        # All in the digit's frame, turned once.
        self.whitening = np.asarray(whitening[seen] @ self.frame)
        self.tips, self.names = np.asarray(tips[seen] @ self.frame), names[seen]
        self.prior = np.concatenate([start.lengths[digit], start.bases[digit] @ self.frame, [0.0, 0.0]])
        held = np.radians(s.held_sd_deg)
        self.prior_sd = np.concatenate([s.length_sd * start.lengths[digit], [s.base_sd_m] * 3, [held, held]])
        self.shared = self.prior.copy()
        is_hook, is_flat = self.names == "hook", self.names == "flat"
        unsteady, free = np.radians(s.unsteady_sd_deg), np.radians(_FREE_DEG)
        # Standard deviations of the angles about the held posture, and whether they are held.
        self.holds_first = is_hook | is_flat
        self.holds_second = ~is_hook
        self.first_sd = np.where(self.holds_first, unsteady, free)
        self.second_sd = np.where(self.holds_second, unsteady, free)
        self.last_sd = np.full(len(self.names), np.radians(0.1))  # the coupling is believed
        self.angles = np.zeros((len(self.names), 4))
        self.angles[:, 0] = np.where(self.names == "knuckles", 0.7, 0.0)
        self.angles[:, 2] = np.where(is_hook, 0.8, 0.0)
        self.angles[:, 3] = self.ratio * self.angles[:, 2]
        self.covariance = np.diag(self.prior_sd**2)

    def run(self) -> None:
        """Fit by the Levenberg–Marquardt method; the angles of each instant are eliminated (Schur complement)."""
        damping, cost = 1e-3, self._cost(self.shared, self.angles)
        for _ in range(self.s.most_iterations):
            A, B, C, gs, gf = self._equations()
            damped = C + damping * np.einsum("nij,ij->nij", C, np.eye(4))
            CB = np.linalg.solve(damped, np.swapaxes(B, 1, 2))
            Cg = np.linalg.solve(damped, gf[..., None])[..., 0]
            S = A + damping * np.diag(np.diag(A)) - np.einsum("nij,njk->ik", B, CB)
            step = np.linalg.solve(S, gs - np.einsum("nij,nj->i", B, Cg))
            turns = Cg - np.einsum("nij,j->ni", CB, step)
            shared, angles = self.shared + step, self.angles + np.clip(turns, -0.5, 0.5)
            there = self._cost(shared, angles)
            if there < cost and (shared[:3] > 0).all():
                gained, cost, self.shared, self.angles = cost - there, there, shared, angles
                damping = max(0.2 * damping, 1e-9)
                if gained < 1e-8 * (1.0 + cost):
                    break
            else:
                damping *= 5.0
                if damping > 1e8:
                    break
        A, B, C, _, _ = self._equations()
        self.covariance = np.linalg.inv(A - np.einsum("nij,njk->ik", B, np.linalg.solve(C, np.swapaxes(B, 1, 2))))

    def residuals(self) -> Float64:
        """Return the measured minus the fitted tips (n, 3) [m]."""
        return self.tips - self._tips(self.shared, self.angles)[0]

    def moved(self, phase: str, angle: int) -> float:
        """Return an angle's range in a phase, from the 5 % to the 95 % quantile [°]; 0 without instants."""
        values = self.angles[self.names == phase, angle]
        if len(values) == 0:
            return 0.0
        low, high = np.quantile(values, [0.05, 0.95])
        return float(np.degrees(high - low))

    def refuse_what_does_not_tell(self) -> None:
        """Raise an `InputError` that says what to do, unless the gesture determines this finger."""
        s = self.s
        for phase in PHASES:
            count = int((self.names == phase).sum())
            if count < s.least_frames:
                fix = f"show its tip and the base in {s.least_frames} instants or more of it"
                raise InputError(f"is seen too rarely in the part {phase!r}", field=self.name, value=count, fix=fix)
        for phase, angle, least, what in (
            ("knuckles", 0, s.least_knuckles_deg, "bend the straight finger at the knuckle"),
            ("hook", 2, s.least_hook_deg, "keep the knuckle straight and curl the finger"),
        ):
            moved = self.moved(phase, angle)
            if moved < least:
                fix = f"{what} by {least:g}° or more, forth and back"
                problem = f"moves by {moved:.0f}° only in the part {phase!r}"
                raise InputError(problem, field=self.name, fix=fix)
        sd = float(np.sqrt(self.covariance[:3, :3].sum()))
        if sd > s.most_finger_sd_m:
            fix = "repeat the gesture slowly, farther, and with markers that are steadier"
            raise InputError(f"is known to {1000 * sd:.1f} mm only", field=self.name, fix=fix)

    def _tips(self, shared: Float64, angles: Float64) -> tuple[Float64, Float64, Float64]:
        """Return tips (n, 3), and derivatives by lengths, base and held angles (n, 3, 8), and by angles (n, 3, 4)."""
        f, a = angles[:, 0], angles[:, 1]
        along = np.cumsum(np.stack([f, angles[:, 2], angles[:, 3]], axis=-1), axis=-1)
        u, w = np.cos(along) * shared[:3], np.sin(along) * shared[:3]
        sine, cosine = np.sin(a), np.cos(a)

        def along_plane(u: Float64, w: Float64) -> Float64:
            return np.stack([u * sine, -w, u * cosine], axis=-1)

        by_shared = np.zeros((len(angles), 3, _SHARED))
        by_angles = np.empty((len(angles), 3, 4))
        for k in range(3):
            by_shared[:, :, k] = along_plane(np.cos(along[:, k]), np.sin(along[:, k]))
        by_shared[:, :, 3:6] = np.eye(3)
        U, W = u.sum(axis=-1), w.sum(axis=-1)
        by_angles[:, :, 1] = np.stack([U * cosine, np.zeros_like(U), -U * sine], axis=-1)
        for angle, first in ((0, 0), (2, 1), (3, 2)):
            by_angles[:, :, angle] = along_plane(-w[:, first:].sum(axis=-1), u[:, first:].sum(axis=-1))
        return shared[3:6] + along_plane(U, W), by_shared, by_angles

    def _expected(self, shared: Float64, angles: Float64) -> tuple[Float64, Float64]:
        """Return the angles' whitened deviations (n, 4) from the phase's posture, and standard deviations (n, 4)."""
        first = angles[:, 0] - np.where(self.holds_first, shared[6], 0.0)
        second = angles[:, 2] - np.where(self.holds_second, shared[7], 0.0)
        last = angles[:, 3] - self.ratio * angles[:, 2]
        sd = np.stack(
            [self.first_sd, np.full(len(angles), np.radians(_FREE_DEG)), self.second_sd, self.last_sd], axis=-1
        )
        return np.stack([first, angles[:, 1], second, last], axis=-1) / sd, sd

    def _cost(self, shared: Float64, angles: Float64) -> float:
        r = np.einsum("nij,nj->ni", self.whitening, self.tips - self._tips(shared, angles)[0])
        e, _ = self._expected(shared, angles)
        d = (shared - self.prior) / self.prior_sd
        return float((r**2).sum() + (e**2).sum() + (d**2).sum())

    def _equations(self) -> tuple[Float64, Float64, Float64, Float64, Float64]:
        """Return the normal equations: A (8, 8) of shared unknowns, B (n, 8, 4), C (n, 4, 4) of angles, right sides."""
        tips, Js, Jf = self._tips(self.shared, self.angles)
        Js, Jf = self.whitening @ Js, self.whitening @ Jf
        r = np.einsum("nij,nj->ni", self.whitening, self.tips - tips)
        e, sd = self._expected(self.shared, self.angles)
        n = len(self.angles)
        Es, Ef = np.zeros((n, 4, _SHARED)), np.zeros((n, 4, 4))
        Ef[:, range(4), range(4)] = 1.0 / sd
        Ef[:, 3, 2] = -self.ratio / sd[:, 3]
        Es[:, 0, 6] = np.where(self.holds_first, -1.0, 0.0) / sd[:, 0]
        Es[:, 2, 7] = np.where(self.holds_second, -1.0, 0.0) / sd[:, 2]
        Js, Jf = np.concatenate([Js, Es], axis=1), np.concatenate([Jf, Ef], axis=1)
        r = np.concatenate([r, -e], axis=1)
        A = np.einsum("nki,nkj->ij", Js, Js) + np.diag(self.prior_sd**-2.0)
        B, C = np.einsum("nki,nkj->nij", Js, Jf), np.einsum("nki,nkj->nij", Jf, Jf)
        gs = np.einsum("nki,nk->i", Js, r) - (self.shared - self.prior) / self.prior_sd**2
        return A, B, C, gs, np.einsum("nki,nk->ni", Jf, r)
