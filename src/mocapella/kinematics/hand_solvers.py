"""Inverse kinematics of a hand: from five fingertips to the angles of five digits within their limits.

- `ClosedForm` solves a digit in its plane, and searches for the nearest posture if the target cannot be reached.
- `Fabrik`: A. Aristidou, J. Lasenby, "FABRIK: A fast, iterative solver for the Inverse Kinematics problem", Graphical
  Models 73 (2011) 243.
- `JacobianTranspose`, `PseudoInverse`, `DampedLeastSquares`: S. Buss, "Introduction to Inverse Kinematics with Jacobian
  Transpose, Pseudoinverse and Damped Least Squares methods" (2004), sections 3 to 6. Damped least squares are by
  C. Wampler, "Manipulator Inverse Kinematic Solutions Based on Vector Formulations and Damped Least-Squares Methods",
  IEEE Transactions on Systems, Man, and Cybernetics 16 (1986) 93. Joints at their limits are locked as by
  P. Baerlocher, R. Boulic, "An inverse kinematics architecture enforcing an arbitrary number of strict priority
  levels", The Visual Computer 20 (2004) 402.
- `Newton`: J. Nocedal, S. Wright, *Numerical Optimization* (2006), sections 3.4 and 16.7; second derivatives are exact.

`MAP` is the name of none of them: the tracker's own fit (`mocapella.kinematics.hand_tracker`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any, Final, Protocol

import msgspec
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.model.hand import ANGLES, DIGIT_ANGLES, HandModel, HandShape
from mocapella.settings import check

Float64 = NDArray[np.float64]


class Fingers(msgspec.Struct, frozen=True, eq=False):
    """Angles of a hand's digits from a solver.

    Attributes:
        angles: (..., 21) in the order of `ANGLES` [rad], always within the limits.
        errors_m: (..., 5) distances of the tips from their targets [m]; NaN without a target.
        measured: (..., 5) whether a digit had a target; the others keep their angles.
        iterations: (..., 5) number of iterations; of `ClosedForm`, 1 for a target that needed a search, else 0.
    """

    angles: Float64
    errors_m: Float64
    measured: NDArray[np.bool_]
    iterations: NDArray[np.int64]


class HandSolver(Protocol):
    """Interface of inverse-kinematics solvers: digit angles from fingertip positions.

    Attributes:
        name: key in `SOLVERS`.
    """

    name: str

    def solve(self, targets: Any, start: Any = None) -> Fingers:
        """Compute the angles that bring the fingertips to their targets.

        Args:
            targets: (..., 5, 3) fingertips, the thumb's first, in the palm's frame [m]; NaN where one is not seen.
            start: (..., 21) initial angles [rad], kept for digits without a target; None for the natural posture.
                Angles beyond the limits are clamped, and the opposition of a thumb with a target is set to 0.

        Returns:
            Angles within the limits, in new arrays; an unreachable target leaves a tip at a distance, ``errors_m``.
        """
        ...  # pragma: no cover


def digit_rows(model: HandModel, shape: HandShape) -> Float64:
    """Return the kernels' parameters (5, `DIGIT`) of a hand; a left hand is solved as its mirror image.

    A row has the digit's base and axes in the palm's frame, bone lengths [m] and joint limits [rad]; see
    `hand_kernels`.
    """
    k = kernels()
    rows = np.zeros((5, k.DIGIT))
    for i, (row, digit, cone) in enumerate(zip(rows, model.digits, model.cones, strict=True)):
        row[k.L1 : k.L3 + 1] = shape.lengths[i]
        row[k.BASE : k.BASE + 3] = shape.bases[i]
        row[k.FRAME : k.FRAME + 9] = model.frames[i].reshape(9)
        row[k.F0], row[k.A0], row[k.FX], row[k.AX], row[k.FMIN] = cone
        whole = cone[4] < cone[0]
        row[k.PHI_MIN], row[k.PHI_MAX] = (-10 * np.pi, 10 * np.pi) if whole else (0.0, np.pi)
        if cone[3] == 0.0:
            row[k.PHI_MIN] = row[k.PHI_MAX] = 0.5 * np.pi
        row[k.M_MAX], row[k.B_MAX] = np.radians([digit.middle_deg[1], digit.last_deg[1]])
        row[k.RATIO], row[k.COUPLED] = model.coupling[i], model.coupled[i]
        row[k.POLY : k.POLY + 8] = _squared_distance(shape.lengths[i], digit.coupling_thirds)
        row[k.NATURAL : k.NATURAL + 4] = model.natural[DIGIT_ANGLES[i, :4]]
    return rows


def _squared_distance(lengths: Float64, thirds: int) -> Float64:
    """Return the coefficients (8,) of the tip's squared distance from the digit's base, a polynomial of cos(m/3).

    The third joint flexes by thirds·m/3; cos(k t) is the Chebyshev polynomial T_k of cos t.
    """
    one, two, three = lengths
    coefficients = np.zeros(8)
    coefficients[0] = one**2 + two**2 + three**2
    for k, product in ((3, one * two), (thirds, two * three), (3 + thirds, one * three)):
        coefficients[k] += 2 * product
    powers = np.asarray(chebyshev.cheb2poly(coefficients))
    return np.concatenate([powers, np.zeros(8 - len(powers))])


class _Solver:
    """Base class of the solvers, which converts batches of hands and calls a kernel for each hand."""

    name: str

    def __init__(self, model: HandModel, shape: HandShape) -> None:
        self.model, self.shape = model, shape
        self.digits = digit_rows(model, shape)

    def solve(self, targets: Any, start: Any = None) -> Fingers:
        """Compute the angles; see `HandSolver.solve`."""
        targets = np.asarray(targets, dtype=np.float64) * self.shape.mirror
        batch = targets.shape[:-2]
        begin = self.model.natural if start is None else np.asarray(start, dtype=np.float64)
        angles = self.model.limited(np.broadcast_to(begin, (*batch, len(ANGLES)))).reshape(-1, len(ANGLES))
        flat = np.ascontiguousarray(targets).reshape(-1, 5, 3)
        rows = np.ascontiguousarray(angles[:, DIGIT_ANGLES[:, :4]])
        errors, iterations = np.empty((len(flat), 5)), np.zeros((len(flat), 5), dtype=np.int64)
        for k in range(len(flat)):
            self._solve(flat[k], rows[k], errors[k], iterations[k])
        # The kernels solve a thumb whose second joint does not abduct.
        angles[np.isfinite(errors[:, 0]), DIGIT_ANGLES[0, 4]] = 0.0
        angles[:, DIGIT_ANGLES[:, :4]] = rows
        errors = errors.reshape(*batch, 5)
        measured = np.isfinite(errors)
        return Fingers(angles.reshape(*batch, len(ANGLES)), errors, measured, iterations.reshape(*batch, 5))

    def _solve(self, targets: Float64, angles: Float64, errors: Float64, iterations: NDArray[np.int64]) -> None:
        raise NotImplementedError


class ClosedForm(_Solver):
    """Solver by a closed form in each digit's plane, with a limited search for unreachable targets.

    The initial angles matter only for a digit without a target.

    Args:
        model: the hand's joints and limits.
        shape: the hand's side and lengths.
    """

    name = "closed-form"

    def _solve(self, targets: Float64, angles: Float64, errors: Float64, iterations: NDArray[np.int64]) -> None:
        reached = np.empty(5, dtype=np.bool_)
        kernels().hand_closed_form(self.digits, targets, angles, errors, reached)
        iterations[:] = ~reached & np.isfinite(errors)


@dataclass(frozen=True)
class IterativeSettings:
    """Stopping criteria and damping of the iterative solvers.

    Attributes:
        tolerance_m: distance from the target at which a tip has reached it [m].
        most_iterations: largest number of iterations for a digit from one start.
        damping_m: λ of the damped least squares [m].
        starts: number of further initial postures to try if the first does not lead to the target.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    tolerance_m: float = 1e-4
    most_iterations: int = 100
    damping_m: float = 0.005
    starts: int = 4

    def __post_init__(self) -> None:
        check(0 < self.tolerance_m < 1, "tolerance_m", self.tolerance_m, "above 0 m")
        check(1 <= self.most_iterations <= 100_000, "most_iterations", self.most_iterations, "1 to 100000")
        check(0 < self.damping_m < 1, "damping_m", self.damping_m, "above 0 m")
        check(0 <= self.starts <= 4, "starts", self.starts, "0 to 4")


class _Iterative(_Solver):
    """Solver that iterates from the start until the tips are reached or ``most_iterations`` are used."""

    kind: str

    def __init__(self, model: HandModel, shape: HandShape, settings: IterativeSettings | None = None) -> None:
        super().__init__(model, shape)
        self.settings = settings or IterativeSettings()

    def _solve(self, targets: Float64, angles: Float64, errors: Float64, iterations: NDArray[np.int64]) -> None:
        s, k = self.settings, iterative_kernels()
        kind = getattr(k, self.kind)
        k.hand_iterative(
            self.digits, targets, angles, errors, iterations, kind, s.tolerance_m, s.most_iterations, s.damping_m,
            s.starts,
        )  # fmt: skip


class Fabrik(_Iterative):
    """Solver by forward and backward reaching, with a rotor and hinges that are held within their limits.

    Args:
        model: the hand's joints and limits.
        shape: the hand's lengths.
        settings: stopping criteria; its damping is not used. None for the defaults.
    """

    name, kind = "fabrik", "FABRIK"


class JacobianTranspose(_Iterative):
    """Solver by gradient descent, with the step length that is optimal for linear motion of the tip (Buss 2004, §3).

    Args:
        model: the hand's joints and limits.
        shape: the hand's lengths.
        settings: stopping criteria; its damping is not used. None for the defaults.
    """

    name, kind = "transpose", "TRANSPOSE"


class PseudoInverse(_Iterative):
    """Solver by Gauss–Newton steps with the Moore–Penrose inverse of the Jacobian (Buss 2004, §4).

    Args:
        model: the hand's joints and limits.
        shape: the hand's lengths.
        settings: stopping criteria; its damping is not used. None for the defaults.
    """

    name, kind = "pseudo-inverse", "PSEUDO_INVERSE"


class DampedLeastSquares(_Iterative):
    """Solver by Levenberg–Marquardt steps of constant damping, short near singular poses (Buss 2004, §5).

    Args:
        model: the hand's joints and limits.
        shape: the hand's lengths.
        settings: stopping criteria and damping; None for the defaults.
    """

    name, kind = "dls", "DAMPED"


class Newton(_Iterative):
    """Solver by Newton steps on the squared distance, with exact second derivatives and the limits as bounds.

    Args:
        model: the hand's joints and limits.
        shape: the hand's lengths.
        settings: stopping criteria; its damping is not used. None for the defaults.
    """

    name, kind = "newton", "NEWTON"


@cache
def kernels() -> ModuleType:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import hand_kernels

    return hand_kernels


@cache
def iterative_kernels() -> ModuleType:
    """Import the compiled iterative kernels, and with them numba, on first use."""
    from mocapella.kinematics import hand_iterative_kernels

    return hand_iterative_kernels


SOLVERS: Final[dict[str, Callable[[HandModel, HandShape], HandSolver]]] = {
    solver.name: solver for solver in (ClosedForm, Fabrik, JacobianTranspose, PseudoInverse, DampedLeastSquares, Newton)
}
"""The solvers' constructors by name."""
MAP: Final = "map"
"""Name of the tracker's own fit of palm and angles: maximum a posteriori, with priors and a prediction."""
SOLVER_NAMES: Final = (MAP, *SOLVERS)
"""Valid values of the setting ``solver``."""


def hand_solver(name: str, model: HandModel, shape: HandShape) -> HandSolver:
    """Make a solver by its name, a key of `SOLVERS`, with default settings.

    Raises:
        SettingsError: no such solver; lists those there are.
    """
    if name not in SOLVERS:
        raise SettingsError(f"unknown hand solver {name!r}; known: {one_of(name, SOLVERS)}")
    return SOLVERS[name](model, shape)
