"""Outlines of a person by the region model, beside scikit-image's Chan–Vese in the same run.

Pictures are drawn (`benchmarks/_outlined_people.py`), with other seeds than those on which settings were compared;
the person covers about a tenth of 640 × 480 px, and where both begin is off by some pixels. The peers (`chan_vese`,
`morphological_chan_vese`) get the same prior to begin with and the same part of the picture, in gray as they need it.
Their smoothness is swept, and so is their number of iterations; of all that, the best mean intersection over union
(IoU) is taken, and the time of the setting that is the first to reach ours, or else of the best. Ours has every
second pixel (`step_px` 2) unless a row says otherwise. `uv run --group peers python -m benchmarks segmentation`.
"""

from __future__ import annotations

import statistics
import warnings
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks._outlined_people import KINDS, Shot, at_every_pixel, shot, window_of
from benchmarks.harness import Row, at_least, at_most, compared, measured, median_seconds, times_the_peer
from mocapella.geometry.signed_distance import signed_distance
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.region_contour import DEFAULT, GRAY, region_contour

UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

SEEDS: Final = (101, 102, 103)
ITERATIONS: Final = (1, 2, 3, 5, 8, 12, 20, 35, 60, 100)
"""At which the peers are looked at."""
SMOOTH: Final = (0.05, 0.15, 0.4)
"""`mu` of chan_vese."""
SMOOTHINGS: Final = (1, 2, 3)
"""Of morphological_chan_vese."""
MAY_BE_WORSE: Final = 0.005
TIMES: Final = 25.0
AROUND_PX: Final = 16


@dataclass(frozen=True)
class Run:
    """What a peer reaches with a setting.

    Attributes:
        name: of the function.
        setting: its smoothness.
        iterations: how many.
        iou: mean over the pictures.
    """

    name: str
    setting: float
    iterations: int
    iou: float


def run(quick: bool = False) -> list[Row]:
    """The rows of docs/methods/silhouettes.md."""
    rows, there = [distance(quick)], find_spec("skimage") is not None
    if not there:
        warnings.warn("no peers: uv run --group peers python -m benchmarks segmentation", stacklevel=2)
    for kind in KINDS:
        shots = [shot(kind, seed) for seed in SEEDS[: 1 if quick else None]]
        if there:
            peers = [peer_runs(s, quick) for s in shots]
            runs = [
                Run(r[0].name, r[0].setting, r[0].iterations, statistics.mean(p.iou for p in r))
                for r in zip(*peers, strict=True)
            ]
            for gray in (False, True):
                rows += beside_peer(kind, shots, runs, gray=gray, quick=quick)
        rows.append(every_pixel(kind, shots))
    return rows


def distance(quick: bool) -> Row:
    """What the signed distance of a mask costs."""
    y, x = np.mgrid[:150, :150]
    mask = np.hypot(x - 75, y - 75) < 50
    took = median_seconds(partial(signed_distance, mask, 16, 2), repeat=3 if quick else 9, number=50)
    return measured("segmentation: signed distance, 150 × 150 samples, 16 px", 1e3 * took, "ms", goal=at_most(0.15))


def beside_peer(kind: str, shots: list[Shot], runs: list[Run], *, gray: bool, quick: bool) -> list[Row]:
    """How good and how fast ours is, beside the best of the peers."""
    images = [_gray(s) if gray else s.image for s in shots]
    priors = [s.prior(2, AROUND_PX) for s in shots]
    ask = partial(region_contour, settings=GRAY if gray else DEFAULT)
    found = [ask(i, p) for i, p in zip(images, priors, strict=True)]
    ours = statistics.mean(_iou(at_every_pixel(f.silhouette), s.mask) for f, s in zip(found, shots, strict=True))
    best = max(runs, key=lambda r: r.iou)
    reaching = [r for r in runs if r.iou >= ours]
    timed = min(reaching, key=lambda r: (r.iterations, r.name)) if reaching else best
    turns = []
    for _ in range(2 if quick else 5):
        mine = median_seconds(lambda: [ask(i, p) for i, p in zip(images, priors, strict=True)], 1, 10)
        theirs = median_seconds(lambda: [_peer(timed, s) for s in shots], 1, 1)
        turns.append((1e3 * mine / len(shots), 1e3 * theirs / len(shots)))
    mine, theirs = (statistics.median(column) for column in zip(*turns, strict=True))
    name = f"segmentation: {kind}{', gray' if gray else ''}"
    peer = f"{timed.name} ({timed.setting:g}), {timed.iterations} iterations, IoU {timed.iou:.3f}"
    return [
        measured(f"{name}: IoU (Chan–Vese at best {best.iou:.3f})", ours, "", goal=at_least(best.iou - MAY_BE_WORSE)),
        compared(f"{name}: an outline", mine, "ms", peer=peer, peer_value=theirs, goal=times_the_peer(TIMES)),
    ]


def every_pixel(kind: str, shots: list[Shot]) -> Row:
    """How good ours is with every pixel."""
    found = [at_every_pixel(region_contour(s.image, s.prior(1, AROUND_PX)).silhouette) for s in shots]
    ours = statistics.mean(_iou(f, s.mask) for f, s in zip(found, shots, strict=True))
    return measured(f"segmentation: {kind}: IoU, every pixel", ours, "")


def peer_runs(s: Shot, quick: bool) -> list[Run]:
    """What the peers reach in one picture, by setting and iterations."""
    from skimage.segmentation import chan_vese, morphological_chan_vese

    image, begin, truth = _crop(s)
    counts = ITERATIONS[:4] if quick else ITERATIONS
    runs = []
    for mu in SMOOTH:
        level: Any = begin
        done = 0
        for count in counts:
            _, level, _ = chan_vese(
                image, mu=mu, tol=0, max_num_iter=count - done, init_level_set=level, extended_output=True
            )
            done = count
            runs.append(Run("chan_vese", mu, count, _either(level > 0, truth)))
    for smoothing in SMOOTHINGS:
        seen: list[float] = []
        morphological_chan_vese(
            image,
            counts[-1],
            init_level_set=(begin > 0).astype(np.int8),
            smoothing=smoothing,
            iter_callback=lambda u, seen=seen: seen.append(_either(u > 0, truth)),
        )
        runs += [Run("morphological_chan_vese", smoothing, count, seen[count]) for count in counts]
    return runs


def _peer(run: Run, s: Shot) -> None:
    from skimage.segmentation import chan_vese, morphological_chan_vese

    image, begin, _ = _crop(s)
    if run.name == "chan_vese":
        chan_vese(image, mu=run.setting, tol=0, max_num_iter=run.iterations, init_level_set=begin)
    else:
        begun = (begin > 0).astype(np.int8)
        morphological_chan_vese(image, run.iterations, init_level_set=begun, smoothing=int(run.setting))


def _gray(s: Shot) -> UInt8:
    return np.ascontiguousarray(cv2.cvtColor(s.image, cv2.COLOR_BGR2GRAY))


def _crop(s: Shot) -> tuple[NDArray[np.float64], NDArray[np.float64], Bool]:
    """Return our region of interest: gray from 0 to 1, the prior's distances, and the true mask."""
    window: Silhouette = window_of(s.prior_phi, 1, AROUND_PX)
    x, y = window.origin_px
    rows, columns = window.phi.shape
    part = slice(y, y + rows), slice(x, x + columns)
    return _gray(s)[part] / 255.0, window.phi.astype(float), s.mask[part]


def _either(found: Bool, truth: Bool) -> float:
    """Chan–Vese does not know which side is inside."""
    return max(_iou(found, truth), _iou(~found, truth))


def _iou(a: Bool, b: Bool) -> float:
    return float((a & b).sum() / (a | b).sum())
