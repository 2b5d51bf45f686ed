"""Likelihood of the observations of a person as a function of the facing.

Three tables of log-probabilities over the angle α of the facing, from the direction towards the sensor (or from the
heading of the motion); each is symmetric in α with mirrored observations:

    yaw       (BINS, YAW_BINS)       of the folded yaw that a sensor reports: it is compressed, saturates and mirrors
    shape     (BINS, SHAPE_BINS)     of the score of the body's shape, if it was learnt
    motion    (SPEEDS, BINS)         of the facing from the heading, at each speed: walking backwards is not ruled out

The shipped tables are learnt (`mocapella.fusion.facing_training`); `untrained` needs no training.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import FAULTS, decode_json, read_whole
from mocapella.errors import InputError
from mocapella.fusion.facing_grid import BIN, BINS, YAWS, turned
from mocapella.fusion.facing_shape import FEATURES, ShapeClassifier
from mocapella.geometry.angles import wrap

Float64 = NDArray[np.float64]

YAW_BINS: Final = BINS // 2
"""Number of bins of the folded yaw, half a circle: bin j is the yaw (j − YAW_BINS / 2) · `BIN`."""
SHAPE_BINS: Final = 13
"""Number of bins of the shape classifier's scores, which are evenly spaced from −`MOST_SCORE` to `MOST_SCORE`."""
SPEEDS: Final = (0.4, 0.7, 1.0)
"""Lowest speed of each row of the motion table; below the first, motion is no evidence [m/s]."""

MOST_SCORE: Final = 6.0
"""Bound of a classifier score in the shape table; scores beyond it count as the bound."""
_HALF: Final = BINS // 2 + 1
_DECIMALS: Final = 3


class FacingModel(msgspec.Struct, frozen=True, eq=False):
    """Learnt likelihood tables for the direction a person faces.

    Attributes:
        yaw: (BINS, YAW_BINS) log-likelihoods of the folded yaw of a view's labels, for each angle of the facing from
            the direction towards the sensor.
        motion: (SPEEDS, BINS) log-likelihoods of the angle of the facing from the heading, at each speed of `SPEEDS`.
        shape: (BINS, SHAPE_BINS) log-likelihoods of the score of the body's shape, by the same angle as ``yaw``; None
            if shapes were not learnt.
        classifier: classifier of shapes; None if shapes were not learnt.
        topology: name of the topology that the shapes were learnt on; shapes of other topologies are ignored.
        trained_on: description of the training; empty for `untrained`.
    """

    yaw: Float64
    motion: Float64
    shape: Float64 | None = None
    classifier: ShapeClassifier | None = None
    topology: str = ""
    trained_on: Mapping[str, Any] = {}

    def yaw_evidence(self, seen: Float64) -> Float64:
        """Return the yaw's log-likelihoods (..., BINS) over α, the facing from the direction towards the sensor.

        ``seen`` (...,) is the yaw of a view's labels relative to that direction, folded into [−π/2, π/2) as in
        `mocapella.fusion.facing_shape.View` [rad]; where it is NaN, they are 0.
        """
        known = np.isfinite(seen)
        place = np.where(known, seen, 0.0) / BIN + YAW_BINS / 2
        return np.asarray(_column(self.yaw, place, wraps=True) * known[..., None])

    def shape_evidence(self, features: Float64) -> Float64 | None:
        """Return the shape's log-likelihoods (..., BINS) over α, the facing from the direction towards the sensor.

        ``features`` (..., `FEATURES`) are the body's shape in `mocapella.fusion.facing_shape.View`; with missing ones
        (NaN) the likelihoods are flatter. None if no shapes were learnt.
        """
        if self.classifier is None or self.shape is None:
            return None
        score, seen = self.classifier.score(features)
        return np.asarray(_column(self.shape, shape_place(score), wraps=False) * seen[..., None])

    def motion_evidence(self, velocity: Float64) -> Float64:
        """Return log-likelihoods (..., BINS) over the facing of persons with velocities (..., 3), y up [m/s].

        Bin i is the yaw i · `BIN` in the velocities' coordinates: 0 along +z, π/2 along +x. Speeds between two of
        `SPEEDS` count as the lower one. The log-likelihoods are 0 where x or z is NaN, or where the horizontal speed is
        below the first of `SPEEDS`.
        """
        speed = np.hypot(velocity[..., 0], velocity[..., 2])
        heading = np.arctan2(velocity[..., 0], velocity[..., 2])
        row = np.searchsorted(SPEEDS, np.nan_to_num(speed), side="right")
        evidence = turned(self.motion[np.maximum(row - 1, 0)], np.nan_to_num(heading))
        return np.asarray(evidence * (row > 0)[..., None])


def shape_place(score: Float64) -> Float64:
    """Return the position (...,) of classifier scores (...,) in the bins of the shape table, as a fractional index.

    Scores beyond ±`MOST_SCORE` are at the first or last bin.
    """
    return np.asarray((np.clip(score, -MOST_SCORE, MOST_SCORE) / MOST_SCORE + 1) * (SHAPE_BINS - 1) / 2)


def neighbours(place: Float64, count: int, wraps: bool) -> tuple[NDArray[np.intp], NDArray[np.intp], Float64]:
    """Return the two bins around a fractional index (...,), and the weight of the second in linear interpolation.

    Args:
        place: (...,) fractional index.
        count: number of bins.
        wraps: whether the first bin follows the last; otherwise bins beyond the ends are replaced by the end's.
    """
    first = np.floor(place).astype(np.intp)
    part = place - first
    if wraps:
        return first % count, (first + 1) % count, part
    return np.clip(first, 0, count - 1), np.clip(first + 1, 0, count - 1), part


def _column(table: Float64, place: Float64, wraps: bool) -> Float64:
    first, second, part = neighbours(place, table.shape[1], wraps)
    columns = table.T
    return np.asarray((1 - part[..., None]) * columns[first] + part[..., None] * columns[second])


@cache
def untrained() -> FacingModel:
    """Return a model of Kinect-class sensors without training; shapes are ignored.

    A sensor reports a facing of 34° from the direction towards it as 16°, 64° as 40° and 94° as 53°, and no more
    beyond. It mirrors turned backs: 37 % of the views at 124° and 87 % at 154° (measured on the KinectMultiTrack study
    of 2015). In motion, people mostly face ahead.
    """
    alpha, seen = wrap(YAWS), (np.arange(YAW_BINS) - YAW_BINS / 2) * BIN
    turn = np.degrees(np.abs(alpha))
    side = np.where(alpha < 0, -1.0, 1.0)

    def compressed(degrees: Float64) -> Float64:
        return np.radians(np.interp(degrees, (0, 34, 64, 94, 125, 180), (0, 16, 40, 53, 52, 52)))

    def likely_near(middle: Float64) -> Float64:
        away = (seen - middle[:, None] + np.pi / 2) % np.pi - np.pi / 2
        return np.asarray(np.exp(-0.5 * (away / np.radians(15)) ** 2))

    unmirrored = np.interp(turn, (0, 100, 124, 154, 180), (1, 1, 0.63, 0.13, 0))[:, None]
    yaw = unmirrored * likely_near(side * compressed(turn))
    yaw += (1 - unmirrored) * likely_near(-side * compressed(180 - turn))
    motion = np.exp(np.array([[1.0], [1.5], [2.0]]) * np.cos(alpha)) + 0.1
    return FacingModel(log_rows(yaw, 0.02), log_rows(motion, 0.02))


def log_rows(counts: Float64, floor: float) -> Float64:
    """Return log-probabilities (rows, bins) of counts (rows, bins), normalised by row.

    The share ``floor`` of each row's probability, 0 to 1, is distributed evenly over its bins.
    """
    p = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1e-12) + floor / counts.shape[1]
    return np.asarray(np.log(p / p.sum(axis=1, keepdims=True)))


class _File(msgspec.Struct, forbid_unknown_fields=True):
    """Layout of the file: a `FacingModel` with half of each table; the other half follows by symmetry."""

    trained_on: dict[str, Any]
    topology: str
    features: list[str]
    mean: list[float]
    spread: list[float]
    weights: list[float]
    yaw: list[list[float]]
    shape: list[list[float]]
    motion: list[list[float]]


def to_json(model: FacingModel) -> str:
    """Encode a trained model as the JSON text of a file for `read_model`, with tables of three decimals.

    Raises:
        ValueError: the model has no shapes, as that of `untrained`.
    """
    classifier, shape = model.classifier, model.shape
    if classifier is None or shape is None:
        raise ValueError("an untrained model is no file")

    def numbers(array: Float64) -> list[Any]:
        rounded: list[Any] = np.round(array, _DECIMALS).tolist()
        return rounded

    data = msgspec.structs.asdict(
        _File(
            trained_on=dict(model.trained_on),
            topology=model.topology,
            features=list(FEATURES),
            mean=np.round(classifier.mean, 6).tolist(),
            spread=np.round(classifier.spread, 6).tolist(),
            weights=np.round(classifier.weights, 6).tolist(),
            yaw=numbers(model.yaw[:_HALF]),
            shape=numbers(shape[:_HALF]),
            motion=numbers(model.motion[:, :_HALF]),
        )
    )
    lines = []
    for key, value in data.items():
        if isinstance(value, list) and value and isinstance(value[0], list):
            rows = ",\n".join(json.dumps(row, separators=(",", ":")) for row in value)
            lines.append(f"{json.dumps(key)}: [\n{rows}\n]")
        else:
            lines.append(f"{json.dumps(key)}: {json.dumps(value, indent=1 if key == 'trained_on' else None)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def from_json(text: bytes | str, file: object) -> FacingModel:
    """Decode a model from the JSON text of `to_json`; ``file`` is the file's name for the error.

    Raises:
        InputError: it is not such a file, or of another version; names ``file``.
    """
    fix = "make it with `mocapella lab train facing`"
    try:
        data = decode_json(text, _File)
        if data.features != list(FEATURES):
            raise ValueError("features are not those of this version")
        yaw, shape, motion = (np.array(table, dtype=np.float64) for table in (data.yaw, data.shape, data.motion))
        shapes = (yaw.shape, shape.shape, motion.shape)
        if shapes != ((_HALF, YAW_BINS), (_HALF, SHAPE_BINS), (len(SPEEDS), _HALF)):
            raise ValueError("a table has the wrong number of rows or columns")
        sizes = [len(values) for values in (data.mean, data.spread, data.weights)]
        if sizes != [len(FEATURES), len(FEATURES), 2 * len(FEATURES) + 1] or min(data.spread) <= 0:
            raise ValueError("the classifier has the wrong number of weights, or a spread that is none")
    except (*FAULTS, InputError) as error:
        raise InputError(f"is no model of facing: {error}", file=file, fix=fix) from error
    mirrored = yaw[-2:0:-1][:, (YAW_BINS - np.arange(YAW_BINS)) % YAW_BINS]
    return FacingModel(
        yaw=np.concatenate([yaw, mirrored]),
        shape=np.concatenate([shape, shape[-2:0:-1]]),
        motion=np.concatenate([motion, motion[:, -2:0:-1]], axis=1),
        classifier=ShapeClassifier(np.array(data.mean), np.array(data.spread), np.array(data.weights)),
        topology=data.topology,
        trained_on=data.trained_on,
    )


def read_model(path: Path) -> FacingModel:
    """Read a model that `mocapella lab train facing` wrote.

    Raises:
        InputError: the file cannot be read, or is no model.
    """
    return from_json(read_whole(path, fix="check the name and the folder"), path)


@cache
def shipped_model() -> FacingModel:
    """Return the model that comes with this version, or `untrained` without its file. It is read once, and shared."""
    source = files("mocapella.fusion").joinpath("data", "facing.json")
    return from_json(source.read_bytes(), source) if source.is_file() else untrained()
