"""How wrong a Kinect v2 really is: errors of a view as they were measured on recordings of people.

    turned   = shoulders, elbows and hips turned about the spine, from the true facing to the reported one
    seen     = turned + bias[joint, α] + sd[joint, hidden, |α|] · noise          left and right swapped where mirrored
    noise    = √share · splines + white[joint]                                   the share is smaller of who stands

α is the true facing from the direction towards the sensor. The tables are in ``data/kinect_v2_measured.json``, which
`mocapella lab train sensor-errors` makes (docs/simulation.md). Noise in time is white noise and cubic B-splines (de
Boor, *A Practical Guide to Splines*, 1978, chapter IX) over independent knots at several spacings, so that any instant
can be asked for without those before it.
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
from scipy.special import ndtr

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.geometry.angles import wrap
from mocapella.sources.simulate.body import BODY, JOINT, facing

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

KIND: Final = "kinect-v2-measured"
"""`SensorSettings.errors` of a sensor that has them."""
SIDES_DEG: Final = (60.0, 120.0)
"""|α| up to the first is a front, beyond the second a back, between them a side."""
BIAS_BINS: Final = 12
"""Of the bias: bin i is α = i · 30°; between them it is interpolated."""
SPEEDS: Final = (0.1, 0.4)
"""Who is slower than the first stands, who is faster than the second moves [m/s]."""
TURNED: Final = [JOINT[part + side] for part in ("Shoulder", "Elbow", "Hip") for side in ("Left", "Right")]
"""What a sensor turns about the spine when it is wrong about the facing. The rest stays: turning it fits no better."""
LOSS_WITHIN: Final = 10.0
"""[s]."""
TILT_SD: Final = np.radians(1.0)
HEIGHT_SD: Final = 0.02
"""How wrong a sensor says that it stands [rad], [m]. Not measured: the recordings do not tell."""
_TRUNK: Final = [JOINT[name] for name in ("SpineBase", "SpineMid", "SpineShoulder")]


class SensorErrors(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file.

    Attributes:
        measured_on: on what and how, for people to read.
        alpha_deg: (bins,) |α| of the five rows that follow.
        mirrored: (bins,) how often left and right are swapped.
        yaw_deg, yaw_sd_deg: (bins,) yaw that the labels say, from the direction to the sensor, where they are true.
        mirrored_yaw_deg, mirrored_yaw_sd_deg: likewise where they are swapped.
        bias_m: (25, `BIAS_BINS`, 3) to the side, up, towards the sensor; see `view_axes`.
        sd_m: (25, 2, 3) of each coordinate: visible or hidden; front, side, back.
        correlation: (25, 25) of the joints' noise, but for what is white.
        white_m: (25,) beside it, of a visible joint from the front; elsewhere it is greater by as much as ``sd_m``.
        knots_s: (parts,) spacing of the splines' knots.
        share: (parts,) of the splines' variance, of who moves.
        still_share: (parts,) the same of who stands; their sum is less than 1.
        mirror_knots_s: spacing of the knots of what decides whether labels are swapped.
        losses_per_min: how often a sensor loses somebody who is in view.
        loss_s: how long such losses lasted, each as likely as the others.
        joint_lost: share of the joints that are not tracked though visible.
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
    """`SensorErrors` as arrays, ready to be put on views."""

    def __init__(self, data: SensorErrors) -> None:
        """Check the shapes.

        Raises:
            ValueError: a table has the wrong shape.
        """
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
        self.mix /= np.linalg.norm(self.mix, axis=1, keepdims=True)  # rounding leaves a diagonal that is not quite 1
        if len(data.white_m) != joints or (self.sd_m <= 0).any():
            raise ValueError("white_m has the wrong length, or sd_m is 0 somewhere")
        self.white = np.array(data.white_m) / self.sd_m[:, 0, 0]
        shares = (data.share, data.still_share)
        if {*map(len, rows)} != {len(data.alpha_deg)} or {*map(len, shares)} != {len(data.knots_s)}:
            raise ValueError("rows are not equally long")
        self.spacings = (*data.knots_s, data.mirror_knots_s)
        """Of all splines [s]; the last decides about mirrored labels."""

    def noise(self, splines: Float64, white: Float64, speed: Float64) -> tuple[Float64, Float64, Float64]:
        """What `put_on` wants, of independent values of variance 1.

        Args:
            splines: (spacings, n, 77): of the coordinates, the yaw, and what decides about labels.
            white: (n, 25, 3).
            speed: (n,) [m/s].
        """
        d, moves = self.data, np.interp(speed, SPEEDS, (0.0, 1.0))[:, None]
        share = moves * np.array(d.share) + (1 - moves) * np.array(d.still_share)
        mixed = np.einsum("nk,kni->ni", np.sqrt(share), splines[:-1])
        joints = self.mix @ mixed[:, :-2].reshape(white.shape) + self.white[:, None] * white
        return joints, mixed[:, -2], np.asarray(ndtr(splines[-1, :, -1]))

    def put_on(
        self, world: Float64, eye: Float64, visible: Bools, noise: tuple[Float64, Float64, Float64]
    ) -> tuple[Float64, Bools]:
        """Bodies as the sensor has them, with true labels, and whether it swaps them.

        Args:
            world: (n, 25, 3) true joints [m].
            eye: (3,) the lens.
            visible: (n, 25).
            noise: as `noise` gives it: (n, 25, 3) of variance 1, besides what is white; (n,) likewise, of the yaw; and
                (n,) from 0 to 1: labels are swapped where it is below their probability.

        Returns:
            (n, 25, 3) world [m], and (n,).
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
    """How a sensor's errors go on in time. Any instant can be asked for; the same key gives the same, to the bit."""

    def __init__(self, errors: Errors, key: NDArray[np.uint64], people: int) -> None:
        """Of one sensor.

        Args:
            errors: what they are.
            key: (2,) seed and sensor.
            people: in the room.
        """
        self.errors = errors
        self._key = key
        self._people = people
        self._knots: dict[tuple[int, int], Float64] = {}
        tilt, height = self._rng(len(errors.spacings) + 1, 0).standard_normal(2)
        self.tilt_error, self.height_error = TILT_SD * float(tilt), HEIGHT_SD * float(height)

    def splines(self, room_ns: int) -> Float64:
        """(spacings, people, 3 · 25 + 2) of variance 1."""
        out = []
        for i, spacing in enumerate(self.errors.spacings):
            knot, rest = divmod(room_ns, round(spacing * NS_PER_S))
            weights = spline_weights(rest / (spacing * NS_PER_S))
            out.append(np.tensordot(weights, np.stack([self._knot(i, knot + k) for k in range(4)]), axes=1))
        return np.stack(out)

    def lost(self, room_ns: int) -> Bools:
        """(people,) whom the sensor does not see, though they are there. At most one loss in `LOSS_WITHIN` seconds."""
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
        # The second word is 0 for the frames' own numbers.
        counter = np.array([0, 0, 1 + kind, index], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=self._key, counter=counter))


def bias_place(alpha: Float64) -> tuple[NDArray[np.intp], NDArray[np.intp], Float64]:
    """The two bins about α (...,) [rad], and how much of the second there is in it."""
    place = (np.asarray(alpha) / (2 * np.pi) * BIAS_BINS) % BIAS_BINS
    first = np.floor(place).astype(np.intp) % BIAS_BINS
    return first, (first + 1) % BIAS_BINS, place - np.floor(place)


def toward_sensor(bodies: Float64, eye: Float64) -> Float64:
    """(...,) yaw from the trunks of bodies (..., 25, 3) to a lens (..., 3) [rad]."""
    sight = eye - np.nanmean(bodies[..., _TRUNK, :], axis=-2)
    return np.asarray(np.arctan2(sight[..., 0], sight[..., 2]))


def view_axes(toward: Float64) -> Float64:
    """(..., 3, 3) whose columns are to the side (up × towards), up, and horizontally towards the sensor; of a yaw."""
    sin, cos, zero = np.sin(toward), np.cos(toward), np.zeros_like(toward)
    columns = ((cos, zero, -sin), (zero, zero + 1.0, zero), (sin, zero, cos))
    return np.stack([np.stack(column, axis=-1) for column in columns], axis=-1)


def turned_about_spine(bodies: Float64, turn: Float64) -> Float64:
    """Bodies (..., 25, 3) turned (...,) about the vertical through SpineMid [rad]."""
    middle = bodies[..., JOINT["SpineMid"], None, :]
    x, y, z = np.moveaxis(bodies - middle, -1, 0)
    cos, sin = np.cos(turn)[..., None], np.sin(turn)[..., None]
    return np.asarray(np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1) + middle)


def spline_weights(part: float) -> Float64:
    """(4,) of the knots −1, 0, 1 and 2 at a part of the way from 0 to 1; their squares sum to 1."""
    x = np.abs(np.array([1.0, 0.0, -1.0, -2.0]) + part)
    inner, outer = 2 / 3 - x**2 + x**3 / 2, np.maximum(2 - x, 0.0) ** 3 / 6
    weights = np.where(x < 1, inner, outer)
    return np.asarray(weights / np.sqrt((weights**2).sum()))


def errors_from_json(text: bytes | str, file: object) -> Errors:
    """The errors of a file's text.

    Raises:
        InputError: it is not such a file; names ``file``.
    """
    try:
        return Errors(msgspec.json.decode(text, type=SensorErrors))
    except (msgspec.DecodeError, ValueError) as error:
        fix = "make it with `mocapella lab train sensor-errors`"
        raise InputError(f"is no table of a sensor's errors: {error}", file=file, fix=fix) from error


def errors_to_json(data: SensorErrors) -> str:
    """The text of a file for `errors_from_json`."""
    lines = []
    for key, value in msgspec.structs.asdict(data).items():
        rows = isinstance(value, list) and isinstance(value[0], list)
        text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), indent=None if key != "measured_on" else 1)
        lines.append(f'"{key}": {text}'.replace("]],[[", "]],\n[[") if rows else f'"{key}": {text}')
    return "{\n" + ",\n".join(lines) + "\n}\n"


@cache
def measured_errors() -> Errors:
    """Those that come with this version."""
    source = files("mocapella.sources.simulate").joinpath("data", "kinect_v2_measured.json")
    return errors_from_json(source.read_bytes(), source)


def statement() -> Mapping[str, Any]:
    """On what they were measured."""
    return measured_errors().data.measured_on
