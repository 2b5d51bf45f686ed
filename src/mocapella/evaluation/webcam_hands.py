"""Scores the hands of the method ``webcams`` on simulated hands with ground truth (docs/evaluation.md)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.evaluation.simulation import Tracked
from mocapella.model.camera import CameraRig
from mocapella.model.hand import LANDMARKS, TIPS
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import TrackedHand
from mocapella.settings import parse
from mocapella.sources.simulate.hand_keypoints import (
    SimulatedHands,
    hand_frames,
    hand_keypoint_scene,
    hand_keypoint_scenes,
)
from mocapella.tracker.webcams import WebcamsTracker
from mocapella.tracker.webcams_settings import WebcamsSettings

Float64 = NDArray[np.float64]

SETTLE_S: Final = 0.5
"""Time after the first frame that is not scored [s]."""
NEAR_M: Final = 0.15
"""Mean distance of the landmarks above which a found hand is none of the true ones [m]."""
WRONG_M: Final = 0.025
"""Distance of a measured landmark from the true one above which it is wrongly measured [m]."""
_TIPS: Final = list(TIPS)


class HandFigures(msgspec.Struct, frozen=True):
    """Figures of the hands in a scene; NaN where there is nothing to score.

    Attributes:
        found_percent: instants and hands that two cameras see, and that are found [%].
        phantoms_percent: found hands that are none, relative to the true ones [%].
        side_percent: found hands of the right side [%].
        ids: number of different ids beyond the number of hands.
        median_mm, p95_mm: distance of the landmarks from the true ones, of hands that two cameras see [mm].
        tips_mm: median of the same for the fingertips [mm].
        alone_mm: median distance of hands that one camera sees [mm].
        jitter_mm: root mean square of the change of a landmark's error from one frame to the next, over √2 [mm].
        measured_percent: landmarks given as measured [%].
        false_percent: measured landmarks that are more than 25 mm off [%].
        normalised: root mean square of measured landmarks' errors over their standard deviations; 1 is consistent.
    """

    found_percent: float
    phantoms_percent: float
    side_percent: float
    ids: int
    median_mm: float
    p95_mm: float
    tips_mm: float
    alone_mm: float
    jitter_mm: float
    measured_percent: float
    false_percent: float
    normalised: float


class HandsScore:
    """Collects what a tracker finds, instant by instant."""

    def __init__(self) -> None:
        self._true = self._well_seen = self._found = self._others = self._sides = 0
        self._ids: set[int] = set()
        self._most = 0
        self._rows: list[tuple[Float64, Float64, NDArray[np.bool_], bool]] = []
        self._changes: list[Float64] = []
        self._before: dict[tuple[str, int], Float64] = {}

    def update(self, truth: SimulatedHands, hands: Sequence[TrackedHand]) -> None:
        """Add an instant.

        Args:
            truth: the frame with its true hands.
            hands: what is found at its time.
        """
        true = list(truth.hands.items())
        known = [hand for hand in hands if np.isfinite(hand.landmarks).all()]
        away = np.array([[np.linalg.norm(hand.landmarks - x, axis=1).mean() for hand in known] for _, x in true])
        pairs = _nearest(away.reshape(len(true), len(known)))
        self._others += len(known) - len(pairs)
        self._most = max(self._most, len(true))
        before, self._before = self._before, {}
        for i, (side, points) in enumerate(true):
            well_seen = truth.cameras[side] >= 2
            self._true += 1
            self._well_seen += well_seen
            if i not in pairs:
                continue
            hand = known[pairs[i]]
            self._found += well_seen
            self._sides += hand.left == (side == "left")
            self._ids.add(hand.id)
            error = hand.landmarks - points
            measured = np.asarray(hand.states == JointState.TRACKED)
            self._rows.append((np.linalg.norm(error, axis=1), hand.sd.astype(np.float64), measured, well_seen))
            last = before.get((side, hand.id))
            if last is not None and well_seen:
                self._changes.append(((error - last) ** 2).sum(axis=1))
            self._before[side, hand.id] = error

    def figures(self) -> HandFigures:
        """Return the figures of all instants so far."""
        count = len(self._rows)
        off = np.array([row[0] for row in self._rows]).reshape(count, len(LANDMARKS))
        sds = np.array([row[1] for row in self._rows]).reshape(off.shape)
        measured = np.array([row[2] for row in self._rows], dtype=np.bool_).reshape(off.shape)
        well = np.array([row[3] for row in self._rows], dtype=np.bool_)
        changes = np.array(self._changes)
        return HandFigures(
            _share(self._found, self._well_seen), _share(self._others, self._true), _share(self._sides, count),
            max(len(self._ids) - self._most, 0), _percentile(off[well], 50), _percentile(off[well], 95),
            _percentile(off[well][:, _TIPS], 50), _percentile(off[~well], 50),
            1e3 * float(np.sqrt(changes.mean() / 2.0)) if len(changes) else np.nan,
            100.0 * float(measured.mean()) if count else np.nan,
            100.0 * float((off[measured] > WRONG_M).mean()) if measured.any() else np.nan,
            float(np.sqrt(np.mean(off[measured] ** 2 / 3.0 / sds[measured] ** 2))) if measured.any() else np.nan,
        )  # fmt: skip


def evaluate(
    scenes: Sequence[str] | None = None,
    seeds: Sequence[int] = (0,),
    settings: Mapping[str, Any] | None = None,
    on_run: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Score the hands of the method in simulated scenes.

    Args:
        scenes: names of the scenes; None for all.
        seeds: random seeds of the errors.
        settings: settings of the method; None for the defaults.
        on_run: called with the next step, in words.

    Returns:
        ``seeds``, and ``scenes``: for each the means over the seeds, ``mean``, and each seed's figures, ``runs``.

    Raises:
        SettingsError: an unknown scene or setting, or no seed.
    """
    names = list(hand_keypoint_scenes()) if scenes is None else list(scenes)
    if not seeds or min(seeds) < 0:
        raise SettingsError(f"seeds {list(seeds)} cannot be used; give one or more of 0, 1, 2, …")
    own = parse(WebcamsSettings, settings or {}, where="settings of webcams")
    chosen = [hand_keypoint_scene(name) for name in names]
    result: dict[str, Any] = {"seeds": list(seeds), "scenes": {}}
    for scene in chosen:
        runs = []
        for seed in seeds:
            on_run(f"{scene.name}, seed {seed}")
            runs.append(score_frames(hand_frames(scene, seed), scene.rig, own).figures())
        values = [msgspec.to_builtins(run) for run in runs]
        result["scenes"][scene.name] = {"mean": _mean(values), "runs": values}
    return result


def score_frames(
    frames: Iterable[SimulatedHands],
    rig: CameraRig,
    settings: WebcamsSettings | None = None,
    tracker: Tracked | None = None,
) -> HandsScore:
    """Track frames in the order of their capture, and score after the last camera of each instant.

    Args:
        frames: the frames.
        rig: their cameras.
        settings: settings of the method; None for the defaults.
        tracker: another tracker, in the world of the rig; None for the method's.
    """
    used = tracker or WebcamsTracker(rig, settings, sensors_expected=len(rig.cameras))
    score, seen, began_ns = HandsScore(), set[str](), None
    for item in frames:
        began_ns = item.at_ns if began_ns is None else began_ns
        scene = used.update(Arrival(item.frame, item.at_ns))
        seen.add(item.frame.sensor)
        if len(seen) == len(rig.cameras):
            seen.clear()
            if item.at_ns - began_ns >= SETTLE_S * NS_PER_S:
                score.update(item, scene.hands)
    return score


def _nearest(away: Float64) -> dict[int, int]:
    """Return pairs of true and found hands (true, found), the nearest first, within `NEAR_M`."""
    pairs: dict[int, int] = {}
    order = np.dstack(np.unravel_index(np.argsort(away, axis=None, kind="stable"), away.shape))[0] if away.size else []
    for i, j in np.asarray(order).reshape(-1, 2).tolist():
        if away[i, j] <= NEAR_M and i not in pairs and j not in pairs.values():
            pairs[i] = j
    return pairs


def _share(part: int, whole: int) -> float:
    return 100.0 * part / whole if whole else np.nan


def _percentile(values: Float64, percent: float) -> float:
    return 1e3 * float(np.percentile(values, percent)) if values.size else np.nan


def _mean(runs: Sequence[Mapping[str, float]]) -> dict[str, float | None]:
    """Mean of each figure over the runs that have it; None if none has. Ids are summed."""
    out: dict[str, float | None] = {}
    for name in runs[0]:
        values = np.array([run[name] for run in runs], dtype=np.float64)
        known = values[np.isfinite(values)]
        out[name] = None if not len(known) else float(known.sum() if name == "ids" else known.mean())
    return out
