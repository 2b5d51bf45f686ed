"""Errors of a Kinect v2's skeletons, as measured on recordings of people.

    turned   = shoulders, elbows and hips turned about the spine, from the true facing to the reported one
    view     = turned + bias[joint, α] + sd[joint, hidden, |α|] · noise          left and right swapped if mirrored
    noise    = √share · splines + white[joint]                                   the share is smaller for a still person

α is the true facing relative to the direction towards the sensor. The tables are in ``data/kinect_v2_measured.json``,
which `mocapella lab train sensor-errors` writes (docs/simulation.md). Noise over time is white noise plus cubic
B-splines (de Boor, *A Practical Guide to Splines*, 1978, chapter IX) over independent knots at several spacings, so
that any instant can be computed without the previous ones.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.decoding import FAULTS, decode_json
from mocapella.errors import InputError
from mocapella.geometry.angles import wrap
from mocapella.sources.simulate.body import BODY, JOINT, facing

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

KIND: Final = "kinect-v2-measured"
"""`SensorSettings.errors` of a sensor with these errors."""
SIDES_DEG: Final = (60.0, 120.0)
"""|α| up to the first is a front view, beyond the second a back view, between them a side view."""
BIAS_BINS: Final = 12
"""Number of bins of the bias: bin i is α = i · 30°; between them it is interpolated."""
SPEEDS: Final = (0.1, 0.4)
"""A person slower than the first is still, a person faster than the second moves; between, shares are mixed [m/s]."""
TURNED: Final = [JOINT[part + side] for part in ("Shoulder", "Elbow", "Hip") for side in ("Left", "Right")]
"""Joints that rotate about the spine with an error of the facing; rotating the others does not fit better."""
LOSS_WITHIN: Final = 10.0
"""Interval with at most one loss of a person [s]."""
TILT_SD: Final = np.radians(1.0)
HEIGHT_SD: Final = 0.02
"""Standard deviation of a sensor's reported height [m]; like `TILT_SD` [rad] assumed: recordings do not show them."""
_TRUNK: Final = [JOINT[name] for name in ("SpineBase", "SpineMid", "SpineShoulder")]


class SensorErrors(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Tables of a Kinect v2's errors: the content of ``data/kinect_v2_measured.json``.

    α is a person's true facing relative to the direction towards the sensor.

    Attributes:
        measured_on: description of the recordings and the method.
        alpha_deg: (bins,) |α| at which the next five tables are given [deg].
        mirrored: (bins,) probability that left and right are swapped.
        yaw_deg, yaw_sd_deg: (bins,) mean and standard deviation of the reported yaw relative to the direction to the
            sensor, with correct labels, for α ≥ 0; for α < 0, its sign is reversed [deg].
        mirrored_yaw_deg, mirrored_yaw_sd_deg: (bins,) mean and standard deviation of that yaw with swapped labels
            [deg].
        bias_m: (25, `BIAS_BINS`, 3) bias of each joint to the side, up, and towards the sensor [m]; see `view_axes`.
        sd_m: (25, 2, 3) standard deviation of a coordinate of each joint: visible or hidden; front, side, back [m].
        correlation: (25, 25) correlation of the joints' noise, without the white part.
        white_m: (25,) standard deviation of the white part for a visible joint in a front view [m]; otherwise scaled
            like ``sd_m``.
        knots_s: (parts,) spacing of each spline's knots [s].
        share: (parts,) fraction of the variance that each spline has, for a moving person.
        still_share: (parts,) that fraction for a still person; their sum is less than 1.
        mirror_knots_s: spacing of the knots of the spline that decides about swapped labels [s].
        losses_per_min: rate at which a sensor loses a person in view [1/min].
        loss_s: durations of these losses, equally likely [s].
        joint_lost: probability that a visible joint is not tracked.
    """

    measured_on: dict[str, Any]
    alpha_deg: list[float]
    mirrored: list[float]
    yaw_deg: list[float]
    yaw_sd_deg: list[float]
    mirrored_yaw_deg: list[float]
    mirrored_yaw_sd_deg: list[float]
    bias_m: list[list[list[float]]]
    sd_m: list[list[list[float]]]
    correlation: list[list[float]]
    white_m: list[float]
    knots_s: list[float]
    share: list[float]
    still_share: list[float]
    mirror_knots_s: float
    losses_per_min: float
    loss_s: list[float]
    joint_lost: float


class Errors:
    """`SensorErrors` as arrays, ready to be applied to views.

    Args:
        data: the tables.

    Attributes:
        data: as given.
        bias_m: (25, `BIAS_BINS`, 3) bias of each joint to the side, up, and towards the sensor [m].
        sd_m: (25, 2, 3) standard deviation of a coordinate of each joint: visible or hidden; front, side, back [m].
        mix: (25, 25) matrix that gives independent values the joints' correlation.
        white: (25,) standard deviation of the white part, relative to that of a visible joint in a front view.

    Raises:
        ValueError: a table has the wrong shape.
    """

    def __init__(self, data: SensorErrors) -> None:
        self.data = data
        self.bias_m, self.sd_m = np.array(data.bias_m), np.array(data.sd_m)
        rows = (data.mirrored, data.yaw_deg, data.yaw_sd_deg, data.mirrored_yaw_deg, data.mirrored_yaw_sd_deg)
        joints = len(BODY)
        if self.bias_m.shape != (joints, BIAS_BINS, 3) or self.sd_m.shape != (joints, 2, 3):
            raise ValueError("bias_m or sd_m has the wrong shape")
        correlation = np.array(data.correlation)
        if correlation.shape != (joints, joints) or np.abs(correlation - correlation.T).max() > 1e-6:
            raise ValueError("correlation has the wrong shape")
        values, vectors = np.linalg.eigh(correlation)
        self.mix = vectors * np.sqrt(np.maximum(values, 0.0))
        self.mix /= np.linalg.norm(self.mix, axis=1, keepdims=True)  # rounding leaves a diagonal slightly off 1
        if len(data.white_m) != joints or (self.sd_m <= 0).any():
            raise ValueError("white_m has the wrong length, or sd_m is 0 somewhere")
        self.white = np.array(data.white_m) / self.sd_m[:, 0, 0]
        shares = (data.share, data.still_share)
        if {*map(len, rows)} != {len(data.alpha_deg)} or {*map(len, shares)} != {len(data.knots_s)}:
            raise ValueError("rows are not equally long")
        self.spacings = (*data.knots_s, data.mirror_knots_s)
        """Knot spacings of all splines [s]; the last decides about mirrored labels."""

    def noise(self, splines: Float64, white: Float64, speed: Float64) -> tuple[Float64, Float64, Float64]:
        """Mix independent values of variance 1 to the correlated noise that `put_on` takes.

        Args:
            splines: (spacings, n, 77) values for the 75 coordinates, the yaw, and the decision about labels.
            white: (n, 25, 3) values for the joints' coordinates.
            speed: (n,) speed of each person [m/s].

        Returns:
            The argument ``noise`` of `put_on`.
        """
        from scipy.special import ndtr

        d, moves = self.data, np.interp(speed, SPEEDS, (0.0, 1.0))[:, None]
        share = moves * np.array(d.share) + (1 - moves) * np.array(d.still_share)
        mixed = np.einsum("nk,kni->ni", np.sqrt(share), splines[:-1])
        joints = self.mix @ mixed[:, :-2].reshape(white.shape) + self.white[:, None] * white
        return joints, mixed[:, -2], np.asarray(ndtr(splines[-1, :, -1]))

    def put_on(
        self, world: Float64, eye: Float64, visible: Bools, noise: tuple[Float64, Float64, Float64]
    ) -> tuple[Float64, Bools]:
        """Apply the errors to bodies; return their joints with correct labels, and whether the labels are swapped.

        Args:
            world: (n, 25, 3) true joints [m].
            eye: (3,) position of the lens in the world [m].
            visible: (n, 25) whether each joint is visible to the sensor.
            noise: result of the method `noise`: (n, 25, 3) of variance 1 plus the white part; (n,) of variance 1 for
                the yaw; and (n,) from 0 to 1, where values below the probability of swapped labels swap them.

        Returns:
            Joints (n, 25, 3), world [m], as a new array, and whether the labels are swapped (n,); the caller swaps
            them.
        """
        joint_noise, yaw_noise, chance = noise
        forward = facing(world)
        toward = toward_sensor(world, eye)
        alpha = wrap(np.arctan2(forward[:, 0], forward[:, 2]) - toward)
        turn, mirrored = self._turn(alpha, yaw_noise, chance)
        seen = world.copy()
        seen[:, TURNED] = turned_about_spine(world, turn)[:, TURNED]
        side = np.digitize(np.degrees(np.abs(alpha)), SIDES_DEG)
        sd = self.sd_m[np.arange(world.shape[1]), (~visible).astype(np.intp), side[:, None]]
        axes = view_axes(toward)
        seen += np.einsum("nik,njk->nji", axes, self._bias(alpha)) + sd[..., None] * joint_noise
        return seen, mirrored

    def _turn(self, alpha: Float64, noise: Float64, chance: Float64) -> tuple[Float64, Bools]:
        d, degrees, sign = self.data, np.degrees(np.abs(alpha)), np.where(alpha < 0, -1.0, 1.0)

        def at(row: list[float]) -> Float64:
            return np.asarray(np.interp(degrees, d.alpha_deg, row))

        mirrored = chance < at(d.mirrored)
        true_yaw = at(d.yaw_deg) + at(d.yaw_sd_deg) * noise
        swapped_yaw = at(d.mirrored_yaw_deg) + at(d.mirrored_yaw_sd_deg) * noise
        yaw = np.where(mirrored, swapped_yaw + 180.0, true_yaw)
        return np.asarray(wrap(sign * np.radians(yaw) - alpha)), mirrored

    def _bias(self, alpha: Float64) -> Float64:
        first, second, part = bias_place(alpha)
        weight = part[:, None, None]
        bias = (1 - weight) * self.bias_m[:, first].swapaxes(0, 1) + weight * self.bias_m[:, second].swapaxes(0, 1)
        return np.asarray(bias)


class Course:
    """A sensor's errors over time, at any instant; the same key gives the same values, to the bit.

    Args:
        errors: the tables.
        key: (2,) seed and index of the sensor.
        people: number of people in the room.

    Attributes:
        errors: as given.
        tilt_error, height_error: constant errors of the sensor's reported tilt [rad] and height [m].
    """

    def __init__(self, errors: Errors, key: NDArray[np.uint64], people: int) -> None:
        self.errors = errors
        self._key = key
        self._people = people
        self._knots: dict[tuple[int, int], Float64] = {}
        tilt, height = self._rng(len(errors.spacings) + 1, 0).standard_normal(2)
        self.tilt_error, self.height_error = TILT_SD * float(tilt), HEIGHT_SD * float(height)

    def splines(self, room_ns: int) -> Float64:
        """Return the values of all splines (spacings, people, 3 · 25 + 2), of variance 1, at a room time [ns]."""
        out = []
        for i, spacing in enumerate(self.errors.spacings):
            knot, rest = divmod(room_ns, round(spacing * NS_PER_S))
            weights = spline_weights(rest / (spacing * NS_PER_S))
            out.append(np.tensordot(weights, np.stack([self._knot(i, knot + k) for k in range(4)]), axes=1))
        return np.stack(out)

    def lost(self, room_ns: int) -> Bools:
        """Return whether the sensor has lost each person (people,), in view or not, at a room time [ns].

        There is at most one loss in `LOSS_WITHIN` seconds.
        """
        data = self.errors.data
        block, rest = divmod(room_ns, round(LOSS_WITHIN * NS_PER_S))
        lengths = np.array(data.loss_s or [0.0])
        out = np.zeros(self._people, dtype=np.bool_)
        for ago in range(2):
            if block < ago:
                continue
            chance, when, length = self._rng(len(self.errors.spacings), block - ago).random((3, self._people))
            since_s = rest / NS_PER_S + (ago - when) * LOSS_WITHIN
            lasts_s = lengths[(length * len(lengths)).astype(np.intp)]
            happens = chance < data.losses_per_min * LOSS_WITHIN / 60
            out |= happens & (since_s >= 0) & (since_s < lasts_s)
        return out

    def _knot(self, spacing: int, knot: int) -> Float64:
        found = self._knots.get((spacing, knot))
        if found is None:
            found = self._rng(spacing, knot).standard_normal((self._people, 3 * len(BODY) + 2))
            if len(self._knots) > 100:
                self._knots.clear()
            self._knots[spacing, knot] = found
        return found

    def _rng(self, kind: int, index: int) -> np.random.Generator:
        # The third word is 0 for the frames' own random numbers.
        counter = np.array([0, 0, 1 + kind, index], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=self._key, counter=counter))


def bias_place(alpha: Float64) -> tuple[NDArray[np.intp], NDArray[np.intp], Float64]:
    """Return the two bins of the bias around angles ``alpha`` (...,) [rad], and the weight of the second.

    Interpolation is linear and periodic; see `BIAS_BINS`.
    """
    place = (np.asarray(alpha) / (2 * np.pi) * BIAS_BINS) % BIAS_BINS
    first = np.floor(place).astype(np.intp) % BIAS_BINS
    return first, (first + 1) % BIAS_BINS, place - np.floor(place)


def toward_sensor(bodies: Float64, eye: Float64) -> Float64:
    """Return the yaw (...,) of the direction from the trunks of bodies (..., 25, 3) to a lens (..., 3) [rad]."""
    sight = eye - np.nanmean(bodies[..., _TRUNK, :], axis=-2)
    return np.asarray(np.arctan2(sight[..., 0], sight[..., 2]))


def view_axes(toward: Float64) -> Float64:
    """Return the axes of a view (..., 3, 3) for the yaw (...,) towards the sensor [rad].

    The columns are unit vectors to the side (up × towards), up, and horizontally towards the sensor.
    """
    sin, cos, zero = np.sin(toward), np.cos(toward), np.zeros_like(toward)
    columns = ((cos, zero, -sin), (zero, zero + 1.0, zero), (sin, zero, cos))
    return np.stack([np.stack(column, axis=-1) for column in columns], axis=-1)


def turned_about_spine(bodies: Float64, turn: Float64) -> Float64:
    """Return bodies (..., 25, 3), y up, rotated about the vertical through SpineMid.

    ``turn`` (...,) are the angles [rad].
    """
    middle = bodies[..., JOINT["SpineMid"], None, :]
    x, y, z = np.moveaxis(bodies - middle, -1, 0)
    cos, sin = np.cos(turn)[..., None], np.sin(turn)[..., None]
    return np.asarray(np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1) + middle)


def spline_weights(part: float) -> Float64:
    """Return the weights (4,) of a cubic B-spline's knots −1, 0, 1 and 2 at a position from 0 to 1.

    Their squares sum to 1, so that independent knots of variance 1 give a value of variance 1.
    """
    x = np.abs(np.array([1.0, 0.0, -1.0, -2.0]) + part)
    inner, outer = 2 / 3 - x**2 + x**3 / 2, np.maximum(2 - x, 0.0) ** 3 / 6
    weights = np.where(x < 1, inner, outer)
    return np.asarray(weights / np.sqrt((weights**2).sum()))


def errors_from_json(text: bytes | str, file: object) -> Errors:
    """Parse the text of a JSON file of measured errors, see `SensorErrors`.

    Raises:
        InputError: it is no such file; names ``file``.
    """
    what, fix = "table of a sensor's errors", "make it with `mocapella lab train sensor-errors`"
    data = decode_json(text, SensorErrors, what=what, file=file, fix=fix)
    try:
        return Errors(data)
    except FAULTS as error:
        raise InputError(f"is no {what}: {error}", file=file, fix=fix) from error


def errors_to_json(data: SensorErrors) -> str:
    """Encode the tables as the text of a JSON file, which `errors_from_json` reads."""
    lines = []
    for key, value in msgspec.structs.asdict(data).items():
        rows = isinstance(value, list) and isinstance(value[0], list)
        text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), indent=None if key != "measured_on" else 1)
        lines.append(f'"{key}": {text}'.replace("]],[[", "]],\n[[") if rows else f'"{key}": {text}')
    return "{\n" + ",\n".join(lines) + "\n}\n"


@cache
def measured_errors() -> Errors:
    """Return the errors that ship with this version, cached."""
    source = files("mocapella.sources.simulate").joinpath("data", "kinect_v2_measured.json")
    return errors_from_json(source.read_bytes(), source)


def statement() -> Mapping[str, Any]:
    """Return the description of the recordings that the shipped errors were measured on."""
    return measured_errors().data.measured_on
