"""Describe problems of sensors in the calibration from people (frozen, wrong clock, moved), and their remedies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np

from mocapella.calibration.pair_calibration import PairEstimate
from mocapella.calibration.sensor_graph import PlacedSensor
from mocapella.calibration.sensor_pair import BY_LAYOUT, Pair, PairOfSensors
from mocapella.model import condition_texts as texts

REPORTED_FOR_S: Final = 5.0
"""A clock jump is reported for this long [s]."""
ONE_PLACE_M: Final = 0.1
"""Largest distance of two sensors that count as at one place, if their orientations agree, too [m]."""
ONE_PLACE_TURN: Final = np.radians(5.0)
"""Largest rotation between two such sensors, which then have one field of view [rad]."""
ONE_PLACE_SD: Final = 0.4
"""Largest standard deviation of their distance and rotation, as a fraction of these limits: others may be apart."""
_LEAST_COSINE: Final = float(np.cos(ONE_PLACE_TURN))


class StreamFaults(msgspec.Struct, frozen=True):
    """Faults of one sensor's frames.

    Attributes:
        frozen: whether its bodies do not change at all.
        behind_s: delay of its times behind another sensor's, if it is too large; otherwise 0 [s].
        jumped_s: time since its clock jumped back; infinite if it did not [s].
        moved: whether the sensor, or the other one of a pair, was moved and is not calibrated again yet.
        mistilted: whether people walk on another floor than that of its stated tilt.
    """

    frozen: bool
    behind_s: float
    jumped_s: float
    moved: bool
    mistilted: bool

    @property
    def condition(self) -> str:
        """The fault and its remedy; empty without a fault."""
        if self.frozen:
            return texts.FROZEN
        if self.behind_s > 0:
            return texts.CLOCK_BEHIND.format(seconds=self.behind_s)
        if 0 <= self.jumped_s < REPORTED_FOR_S:
            return texts.CLOCK_JUMPED
        if self.moved:
            return texts.MOVED
        if self.mistilted:
            return texts.MISTILTED
        return ""


def pose_condition(
    name: str,
    pairs: Mapping[Pair, PairOfSensors],
    contradicted: Mapping[Pair, PairOfSensors],
    placed: Mapping[str, PlacedSensor],
    *,
    seeing: bool,
) -> str:
    """Describe a problem of a sensor's pose, such as a contradiction, and its remedy; empty without one.

    A single sensor has none.

    Args:
        name: name of the sensor.
        pairs: all pairs of sensors, or the pairs of this sensor.
        contradicted: the pairs of them for which `contradicts` is true.
        placed: all sensors' poses.
        seeing: whether it sees a person now.
    """
    if not any(name in key for key in pairs):
        return ""
    place = placed[name]
    tied = place.trusted and any(
        other.root == place.root and other.trusted for key, other in placed.items() if key != name
    )
    if tied:
        return _contradiction(name, contradicted)
    seen = [(key, pair.estimate) for key, pair in pairs.items() if name in key and pair.estimate is not None]
    if not seen:
        return texts.NOBODY_SHARED if seeing else texts.SEES_NOBODY
    key, estimate = min(seen, key=lambda item: item[1].position_sd)
    return f"with {_other(key, name)}: {estimate.problem}" if estimate.problem else ""


def contradicts(pair: PairOfSensors) -> bool:
    """Return whether a pair must be reported: its relative pose is contradicted, or both sensors are at one place.

    `PairOfSensors.contradicted` does not count while the pair is `unproven`, because the sensors' poses then come from
    other pairs. At one place means position and direction of view, by a trusted estimate from people who walked.
    """
    return _same_place(pair) or (pair.contradicted and not pair.unproven)


def _same_place(pair: PairOfSensors) -> bool:
    return pair.estimate is not None and _in_one_place(pair.estimate) and pair.trusted and pair.walked


def _contradiction(name: str, contradicted: Mapping[Pair, PairOfSensors]) -> str:
    """Return what speaks against the pose of a sensor that others are tied to; empty where nothing does."""
    for key, pair in contradicted.items():
        if name not in key:
            continue
        if _same_place(pair):
            return texts.ONE_PLACE.format(other=_other(key, name))
        return texts.UNSEEN_BY_LAYOUT if pair.told == BY_LAYOUT else texts.UNSEEN.format(other=_other(key, name))
    return ""


def _other(key: Pair, name: str) -> str:
    return key[0] if key[1] == name else key[1]


def _in_one_place(estimate: PairEstimate) -> bool:
    """Return whether both sensors are at one place and look into one direction, and this is known well enough."""
    T_a_b = estimate.T_a_b
    if abs(T_a_b.item(0, 3)) >= ONE_PLACE_M:  # most pairs, at less cost
        return False
    x, y, z = T_a_b[:3, 3].tolist()
    if not x * x + y * y + z * z < ONE_PLACE_M**2:
        return False
    if not (T_a_b[0, 0] + T_a_b[1, 1] + T_a_b[2, 2] - 1) / 2 > _LEAST_COSINE:
        return False
    sd_m, sd = (np.sqrt(np.trace(estimate.covariance[part, part])) for part in (slice(3), slice(3, 6)))
    return bool(sd_m < ONE_PLACE_SD * ONE_PLACE_M and sd < ONE_PLACE_SD * ONE_PLACE_TURN)
