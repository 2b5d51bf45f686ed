"""What a hand costs and how well it is met: tips reached, noisy and unreachable ones beside a general solver, all
solvers in one table, and finger angles on random motions with one and with three markers on the base.

The residuals "over the best of 20 starts" are beside scipy's `least_squares` in the same bounds. The settings of the
tracker were chosen with other seeds than those here.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from benchmarks.harness import Row, at_least, at_most, measured, median_seconds
from mocapella.geometry.rigid import apply, rigid
from mocapella.kinematics.hand_bones import measure_bones
from mocapella.kinematics.hand_chain import hand_chain, landmarks, palm_landmarks
from mocapella.kinematics.hand_solvers import (
    SOLVERS,
    ClosedForm,
    IterativeSettings,
    digit_rows,
    hand_solver,
    iterative_kernels,
    kernels,
)
from mocapella.kinematics.hand_tracker import HandTracker, base_layout
from mocapella.model.hand import (
    ANGLES,
    DIGIT_ANGLES,
    DIGITS,
    TIPS,
    ConstraintSet,
    HandModel,
    HandPose,
    HandShape,
    hand_model,
)
from mocapella.model.observations import JointState

Float64 = NDArray[np.float64]

RATE_HZ: Final = 60
MET_M: Final = 1e-4
STARTS: Final = 20
NOISES_MM: Final = (0.5, 1.0, 2.0, 4.0)


def run(quick: bool = False) -> list[Row]:
    return [*cost(quick), *reachable(quick), *beside_scipy(quick), *table(quick), *motions(quick), *gestures(quick)]


def cost(quick: bool) -> Iterator[Row]:
    """A hand, called from compiled code as a tracker does; the median over hands."""
    from numba import njit

    solve = kernels().hand_closed_form

    @njit
    def one(digits: Any, targets: Any, angles: Any, errors: Any, reached: Any, times: int) -> None:
        for _ in range(times):
            solve(digits, targets, angles, errors, reached)

    rng, times = np.random.default_rng(1), 5 if quick else 50
    constraints: tuple[ConstraintSet, ...] = ("thesis", "full")
    for chosen in constraints:
        model = hand_model(chosen)
        shape = model.shape("right")
        digits, tips = digit_rows(model, shape), reached_tips(model, shape, rng, 20 if quick else 100)
        noisy = tips + rng.normal(0, 0.005, tips.shape)
        for what, targets, goal in (("reachable", tips, at_most(5)), ("noise 5 mm", noisy, None)):
            angles, errors, reached = np.zeros((5, 4)), np.empty(5), np.empty(5, dtype=np.bool_)

            def taken(target: Float64, a: Any = digits, b: Any = angles, c: Any = errors, d: Any = reached) -> float:
                return median_seconds(lambda: one(a, target, b, c, d, times), repeat=3, number=1) / times

            value = 1e6 * statistics.median(taken(np.ascontiguousarray(target)) for target in targets)
            yield measured(f"hand: closed form, five digits, {chosen}, {what}", value, "µs", goal=goal)


def reachable(quick: bool) -> Iterator[Row]:
    """Random angles within the limits → fingertips by products of exponentials → angles, from the natural pose."""
    constraints: tuple[ConstraintSet, ...] = ("thesis", "full")
    for chosen in constraints:
        model, met, held = hand_model(chosen), [], []
        for seed, side in ((11, "right"), (12, "left")):
            shape = model.shape(side, hand_length_m=0.17 + 0.03 * (seed - 11))  # type: ignore[arg-type]
            tips = reached_tips(model, shape, np.random.default_rng(seed), 200 if quick else 20_000)
            found = ClosedForm(model, shape).solve(tips)
            # Checked with the independent forward kinematics, not with what the solver says of itself.
            there = palm_landmarks(hand_chain(model, shape), found.angles)[:, list(TIPS)]
            met.append((np.linalg.norm(there - tips, axis=-1) <= MET_M).mean())
            held.append(model.within(found.angles).mean())
        yield measured(f"hand: tips met to 0.1 mm, {chosen}", 100 * float(np.mean(met)), "%", goal=at_least(99.9))
        yield measured(f"hand: hands within limits, {chosen}", 100 * float(np.mean(held)), "%", goal=at_least(100))


def beside_scipy(quick: bool) -> Iterator[Row]:
    """Noisy and unreachable targets: what the closed form and its search leave, less the best of 20 starts of scipy."""
    rng, hands = np.random.default_rng(21), 1 if quick else 10
    constraints: tuple[ConstraintSet, ...] = ("thesis", "full")
    for chosen in constraints:
        model = hand_model(chosen)
        shape = model.shape("right")
        tips = reached_tips(model, shape, rng, hands)
        for what, targets in (
            ("noise 5 mm", tips + rng.normal(0, 0.005, tips.shape)),
            ("anywhere within 20 cm", shape.bases + rng.uniform(-0.2, 0.2, tips.shape)),
        ):
            found = ClosedForm(model, shape).solve(targets)
            excess = []
            for hand, target in enumerate(targets):
                for digit in range(5):
                    if found.errors_m[hand, digit] > 1e-6:
                        least = best_of_starts(model, shape, digit, target[digit], rng)
                        excess.append(1000 * (found.errors_m[hand, digit] - least))
            name = f"hand: residual over the best of {STARTS} starts, {chosen}, {what}"
            yield measured(f"{name}, the worst of {len(excess)}", float(max(excess)), "mm", goal=at_most(0.1))


def best_of_starts(model: HandModel, shape: HandShape, digit: int, target: Float64, rng: np.random.Generator) -> float:
    """The least distance [m] that scipy finds in the same limits, the cone's by direction and size."""
    f0, a0, F, A, least = model.cones[digit]
    l1, l2, l3 = shape.lengths[digit]
    R, ratio, coupled = model.frames[digit], model.coupling[digit], model.coupled[digit]
    local = R.T @ (target - shape.bases[digit])
    turn = (-math.pi, math.pi) if least < f0 else (0.0, math.pi)
    most = np.radians([model.digits[digit].middle_deg[1], model.digits[digit].last_deg[1]])
    low, high = np.array([0.0, turn[0], 0.0, 0.0]), np.array([1.0, turn[1], *most])
    if coupled:
        low, high = low[:3], high[:3]

    def missed(v: Float64) -> Float64:
        f, a = f0 + F * v[0] * math.sin(v[1]), a0 + A * v[0] * math.cos(v[1])
        fm = f + v[2]
        fmb = fm + (ratio * v[2] if coupled else v[3])
        u = l1 * math.cos(f) + l2 * math.cos(fm) + l3 * math.cos(fmb)
        w = l1 * math.sin(f) + l2 * math.sin(fm) + l3 * math.sin(fmb)
        return np.array([u * math.sin(a), -w, u * math.cos(a)]) * 1000 - 1000 * local

    fits = (least_squares(missed, rng.uniform(low, high), bounds=(low, high), x_scale="jac") for _ in range(STARTS))
    return min(float(np.linalg.norm(fit.fun)) for fit in fits) / 1000


def table(quick: bool) -> Iterator[Row]:
    """All solvers on the same reachable targets, from the natural pose: time, tips met, limits held."""
    hands = 20 if quick else 500
    constraints: tuple[ConstraintSet, ...] = ("thesis", "full")
    for chosen in constraints:
        model = hand_model(chosen)
        shape = model.shape("right")
        tips = reached_tips(model, shape, np.random.default_rng(31), hands)
        chain = hand_chain(model, shape)
        digits, natural = digit_rows(model, shape), np.ascontiguousarray(model.natural[DIGIT_ANGLES[:, :4]])
        for name in SOLVERS:
            found = hand_solver(name, model, shape).solve(tips)
            there = palm_landmarks(chain, found.angles)[:, list(TIPS)]
            met = (np.linalg.norm(there - tips, axis=-1) <= MET_M * 1.0001).mean()
            held = model.within(found.angles).mean()
            value = 1e6 * median_seconds(one_by_one(name, digits, natural, tips), repeat=3, number=1) / hands
            yield measured(f"hand: {name}, {chosen}, a hand, called from Python", value, "µs")
            yield measured(f"hand: {name}, {chosen}, tips met to 0.1 mm", 100 * float(met), "%")
            yield measured(f"hand: {name}, {chosen}, hands within limits", 100 * float(held), "%")


def one_by_one(name: str, digits: Float64, natural: Float64, tips: Float64) -> Callable[[], None]:
    """What solves hand after hand from the natural pose."""
    k, other, stop = iterative_kernels(), kernels(), IterativeSettings()
    angles, errors = natural.copy(), np.empty(5)
    reached, iterations = np.empty(5, dtype=np.bool_), np.empty(5, dtype=np.int64)
    kinds = {"fabrik": k.FABRIK, "transpose": k.TRANSPOSE, "pseudo-inverse": k.PSEUDO_INVERSE, "newton": k.NEWTON}
    kind = kinds.get(name, k.DAMPED)

    def solve() -> None:
        for target in tips:
            angles[:] = natural
            if name == ClosedForm.name:
                other.hand_closed_form(digits, target, angles, errors, reached)
            else:
                k.hand_iterative(
                    digits, target, angles, errors, iterations, kind, stop.tolerance_m, stop.most_iterations,
                    stop.damping_m, stop.starts,
                )  # fmt: skip

    return solve


def motions(quick: bool) -> Iterator[Row]:
    """Finger angles on random smooth motions of hand and palm, with markers that are noisy."""
    for markers in (3, 1):
        for noise_mm in NOISES_MM:
            found = [
                follow(markers, noise_mm / 1000, seed, 90 if quick else 600) for seed in range(1, 2 if quick else 7)
            ]
            angle, worst, landmark, palm, said = (float(np.mean(column)) for column in zip(*found, strict=True))
            name = f"hand: {markers} base marker{'s' * (markers > 1)}, noise {noise_mm:g} mm"
            yield measured(f"{name}, finger angle, median", angle, "°", goal=at_most(5))
            yield measured(f"{name}, finger angle, p95", worst, "°")
            yield measured(f"{name}, landmarks, median", landmark, "mm")
            yield measured(f"{name}, palm's direction, median", palm, "°")
            yield measured(f"{name}, landmarks said to be measured", said, "%")
    model = hand_model()
    shape = model.shape("right")
    layout = base_layout(shape, 3)
    tracker, points, frame = HandTracker(model, shape, layout), markers_of(model, shape, layout, 0, 100)[2], [0]

    def update() -> None:
        tracker.update(points[frame[0] % 100], frame[0] / RATE_HZ)
        frame[0] += 1

    value = 1e6 * median_seconds(update, repeat=3, number=20 if quick else 200)
    yield measured("hand: tracker, a frame of 8 markers, with covariance", value, "µs")


def follow(markers: int, noise_m: float, seed: int, frames: int) -> tuple[float, float, float, float, float]:
    """Median and p95 error of finger angles [°], landmarks [mm], the palm's direction [°], and the share tracked."""
    model = hand_model()
    shape = model.shape("right" if seed % 2 else "left")
    layout = base_layout(shape, markers)
    angles, T, points = markers_of(model, shape, layout, seed, frames)
    points = points + np.random.default_rng(1000 + seed).normal(0, noise_m, points.shape)
    tracker, sd = HandTracker(model, shape, layout), np.full(5 + markers, noise_m)
    hands = [tracker.update(x, k / RATE_HZ, sd) for k, x in enumerate(points)][20:]
    fingers = [i for i in range(5, len(ANGLES)) if model.limits[i, 0] < model.limits[i, 1]]
    errors = np.degrees(np.abs(np.array([hand.angles for hand in hands]) - angles[20:]))[:, fingers]
    truth = landmarks(hand_chain(model, shape), HandPose(angles, T))[20:]
    away = np.linalg.norm(np.array([hand.landmarks for hand in hands]) - truth, axis=-1)
    R = np.array([hand.T_world_palm[:3, :3] for hand in hands])
    palm = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ T[20:, :3, :3]).magnitude()
    tracked = np.mean([(hand.states == JointState.TRACKED).mean() for hand in hands])
    return (
        float(np.median(errors)), float(np.quantile(errors, 0.95)), 1000 * float(np.median(away)),
        float(np.degrees(np.median(palm))), 100 * float(tracked),
    )  # fmt: skip


def gestures(quick: bool) -> Iterator[Row]:
    """Bones of random hands (lengths ±15 % as a whole, ±5 % each) from a gesture of six seconds."""
    model = hand_model()
    start = model.shape("right")
    for noise_mm in (0.5, 1.0, 3.0):
        errors, said = [], []
        for seed in range(2 if quick else 8):
            rng = np.random.default_rng(500 + seed)
            lengths = start.lengths * rng.uniform(0.85, 1.15, (5, 1)) * rng.uniform(0.95, 1.05, (5, 3))
            truth = HandShape("right", lengths, start.bases + rng.normal(0, 0.003, (5, 3)))
            points, phases = gesture(model, truth, base_layout(truth, 3), rng, noise_mm / 1000)
            bones = measure_bones(model, start, base_layout(start, 3), points, phases, sd_m=noise_mm / 1000)
            errors.append(1000 * (bones.shape.lengths - lengths))
            said.append(1000 * bones.finger_sd_m)
        for what, digits in (("fingers", slice(1, 5)), ("thumb", slice(0, 1))):
            chosen = np.array(errors)[:, digits]
            name = f"hand: bones, noise {noise_mm:g} mm, {what}"
            yield measured(f"{name}, a bone, rms", float(np.sqrt(np.mean(chosen**2))), "mm")
            whole = float(np.sqrt(np.mean(chosen.sum(axis=-1) ** 2)))
            yield measured(f"{name}, the whole digit, rms", whole, "mm")
            yield measured(
                f"{name}, the whole digit, standard deviation said", float(np.mean(np.array(said)[:, digits])), "mm"
            )


def random_angles(model: HandModel, rng: np.random.Generator, hands: int) -> Float64:
    """(hands, 21) evenly within the limits, the two angles of a base within its cone."""
    low, high = model.limits.T
    angles = rng.uniform(low, high, (hands, len(ANGLES)))
    angles[:, DIGIT_ANGLES[0, 4]] = 0.0  # a tip does not tell it from the thumb's other angles
    for row, (f0, a0, F, A, least), coupled, ratio in zip(
        DIGIT_ANGLES, model.cones, model.coupled, model.coupling, strict=True
    ):
        size = np.sqrt(rng.uniform(0, 1, hands))
        turn = rng.uniform(-np.pi if least < f0 else 0.0, np.pi, hands)
        angles[:, row[0]], angles[:, row[1]] = f0 + F * size * np.sin(turn), a0 + A * size * np.cos(turn)
        if coupled:
            angles[:, row[3]] = ratio * angles[:, row[2]]
    return angles


def reached_tips(model: HandModel, shape: HandShape, rng: np.random.Generator, hands: int) -> Float64:
    """(hands, 5, 3) fingertips of random hands in the palm's frame [m]."""
    return palm_landmarks(hand_chain(model, shape), random_angles(model, rng, hands))[:, list(TIPS)]


def markers_of(
    model: HandModel, shape: HandShape, layout: Float64, seed: int, frames: int
) -> tuple[Float64, Float64, Float64]:
    """Angles (frames, 21), palms (frames, 4, 4) and markers (frames, 5 + k, 3) of a smooth random motion.

    Flexions are a third in common; the rest is each angle's own. Every angle is spread evenly over its limits.
    """
    rng = np.random.default_rng(seed)

    def smooth(columns: int, sd_s: float) -> Float64:
        path = gaussian_filter1d(rng.normal(size=(frames, columns)), sd_s * RATE_HZ, axis=0, mode="wrap")
        return np.asarray(path / path.std(axis=0))

    common = np.where(["flexion" in name for name in ANGLES], 1 / 3, 0.0)
    mixed = np.sqrt(1 - common) * smooth(len(ANGLES), 0.35) + np.sqrt(common) * smooth(1, 0.35)
    low, high = model.limits.T
    angles = model.limited(low + norm.cdf(mixed) * (high - low))
    T = rigid(Rotation.from_rotvec(np.radians(40) * smooth(3, 0.5)).as_matrix(), 0.15 * smooth(3, 0.5))
    return angles, T, markers_at(model, shape, layout, angles, T)


def markers_at(model: HandModel, shape: HandShape, layout: Float64, angles: Float64, T: Float64) -> Float64:
    tips = landmarks(hand_chain(model, shape), HandPose(angles, T))[:, list(TIPS)]
    base = apply(T, np.broadcast_to(layout * shape.mirror, (len(T), *layout.shape)))
    return np.concatenate([tips, base], axis=1)


def gesture(
    model: HandModel, shape: HandShape, layout: Float64, rng: np.random.Generator, noise_m: float
) -> tuple[Float64, NDArray[np.str_]]:
    """Markers and phases; joints that are to be straight are bent by 3° and shake by 1°."""
    frames = 120
    phases = np.repeat(["flat", "knuckles", "hook"], frames)
    swing = np.tile(0.5 - 0.5 * np.cos(np.linspace(0, 4 * np.pi, frames)), 3)
    angles, shake = np.zeros((len(phases), len(ANGLES))), np.radians(1.0)
    for digit, row in enumerate(DIGIT_ANGLES):
        first, second = np.abs(rng.normal(0, np.radians(3.0), 2))
        curl = np.where(phases == "hook", np.radians(95) * swing, second + rng.normal(0, shake, len(phases)))
        if DIGITS[digit] == "thumb":
            circle = np.tile(np.linspace(0, 4 * np.pi, frames), 3)
            angles[:, row[0]], angles[:, row[1]] = 0.35 * np.sin(circle), 0.25 * np.cos(circle)
            curl = np.minimum(curl, np.radians(55))
        else:
            angles[:, row[0]] = np.where(
                phases == "knuckles", np.radians(75) * swing, first + rng.normal(0, shake, len(phases))
            )
        angles[:, row[2]], angles[:, row[3]] = curl, model.coupling[digit] * curl
    angles = model.limited(angles)
    T = np.repeat(markers_of(model, shape, layout, int(rng.integers(1 << 30)), frames)[1], 3, axis=0)
    points = markers_at(model, shape, layout, angles, T)
    return points + rng.normal(0, noise_m, points.shape), phases
