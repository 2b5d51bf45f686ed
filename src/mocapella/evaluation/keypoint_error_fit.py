"""Measures the errors of detectors of keypoints on recordings of several cameras, for the simulation of crowds.

There is no ground truth. The detection of one camera is compared with the point that the *other* cameras triangulate
robustly (`mocapella.geometry.triangulation`), and the residual is divided by the square root of 1 + v, where v is the
variance that this point has in the image for unit errors of the other cameras. Occlusion follows from capsules
around the reference skeletons. Errors that all cameras share cannot be measured so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocapella.evaluation.keypoint_clips import KeypointClip, mediapipe_clip, pose2sim_clip
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.triangulation import TriangulationSettings, Views, triangulate, views
from mocapella.sources.simulate.body import JOINT, body_template
from mocapella.sources.simulate.keypoint_body import GROUPS, HALPE, group_of, hiding_joint
from mocapella.sources.simulate.keypoint_camera import LEGS
from mocapella.sources.simulate.keypoint_errors import CONFIDENCE_BINS, QUANTILES, STATES, DetectorErrors, bin_of
from mocapella.sources.simulate.occlusion import hidden, obstacles

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

SAME_PERSON: Final = 0.12
"""Largest median distance of a detection from a reference skeleton, relative to the size, to be of that person."""
TAIL_FROM: Final = 3.5
"""Errors above this number of standard deviations of the core count as tail."""
LEAST: Final = 30
"""Least number of errors for an entry of a table; with fewer, the entry of all confidences or groups is used."""
_LEAST_CONFIDENCE: Final = 0.3
"""Least confidence of a keypoint that triangulates, and least mean confidence of a detection that is not weak."""
_SD_OF_SIZE: Final = 0.01
"""Assumed standard deviation of a detection in the triangulation, relative to the size."""
_LAG_S: Final = 0.25
"""Longer lag of the autocorrelation [s]."""
_NOT_FAR: Final = 0.05
"""Errors above it have no part in the autocorrelation."""


class MatchedClip(msgspec.Struct, frozen=True, eq=False):
    """A clip's detections by person, and the expected ones; axes (frames, cameras, people, 26, …).

    Attributes:
        pixels: (…, 2) detections [px]; NaN where missing.
        confidences: (…) 0 to 1.
        expected: (…, 2) the reference in the image [px].
        residuals: (…, 2) errors against the other cameras, corrected, relative to the size; NaN where unknown.
        states: (…) index in `STATES`.
        sizes: (frames, cameras, people) statures in the image [px].
        matched: (frames, cameras, people) whether the person is detected.
        swapped: (frames, cameras, people) whether left and right of the whole person are swapped.
        legs: (frames, cameras, people) whether left and right of the legs alone are swapped.
        towards: (frames, cameras, people) cosine between the facing and the direction to the camera.
        extra: (3,) numbers of unmatched detections: duplicates, weak ones, and bystanders.
        images: number of images.
        hz: frame rate [Hz].
    """

    pixels: Float64
    confidences: Float64
    expected: Float64
    residuals: Float64
    states: Int64
    sizes: Float64
    matched: Bools
    swapped: Bools
    legs: Bools
    towards: Float64
    extra: tuple[int, int, int]
    images: int
    hz: float


def match_clip(clip: KeypointClip, reference: Float64 | None = None) -> MatchedClip:
    """Match the detections of a clip with its people, and compute all errors.

    Args:
        clip: the detections and the reference.
        reference: (people, frames, 26, 3) another reference, world [m]; None for the clip's.
    """
    people = clip.reference if reference is None else reference
    placed = list(clip.rig.cameras.values())
    frames, cameras, count = len(clip.frames), len(placed), len(people)
    shape = (frames, cameras, count)
    pixels, sure = np.full((*shape, len(HALPE), 2), np.nan), np.zeros((*shape, len(HALPE)))
    expected, states = np.full((*shape, len(HALPE), 2), np.nan), np.zeros((*shape, len(HALPE)), dtype=np.int64)
    sizes, towards = np.full(shape, np.nan), np.full(shape, np.nan)
    matched, swapped, legs = (np.zeros(shape, dtype=np.bool_) for _ in range(3))
    extra = np.zeros(3, dtype=np.int64)
    statures = [_stature(person) for person in people]
    bodies = np.stack([_kinect(person) for person in people], axis=1)
    radii = np.array([body_template().radii * stature for stature in statures])
    nothing = obstacles((), ())
    for t, instant in enumerate(clip.frames):
        for c, frame in enumerate(instant):
            T, lens = placed[c].T_camera_world, placed[c].camera.lens
            eye = inverse(T)[:3, 3]
            inside = apply(T, people[:, t])
            expected[t, c] = project(inside, lens)
            sizes[t, c] = [lens[0] * s / np.nanmedian(z) for s, z in zip(statures, inside[..., 2], strict=True)]
            towards[t, c] = _towards(bodies[t], eye)
            states[t, c] = _states(eye, bodies[t], radii, nothing)
            rows = _Rows(pixels[t, c], sure[t, c], matched[t, c], swapped[t, c], legs[t, c])
            extra += _assign(
                frame.positions_px.astype(np.float64), frame.confidences, expected[t, c], sizes[t, c], rows
            )
    residuals = _left_out(
        pixels, sure, sizes, views([p.camera.lens for p in placed], [p.T_camera_world for p in placed])
    )
    return MatchedClip(
        pixels, sure, expected, residuals, states, sizes, matched, swapped, legs, towards,
        (int(extra[0]), int(extra[1]), int(extra[2])), frames * cameras, clip.hz,
    )  # fmt: skip


class _Rows(msgspec.Struct, frozen=True, eq=False):
    """Views into the arrays of one image, which `_assign` writes."""

    pixels: Float64
    confidences: Float64
    matched: Bools
    swapped: Bools
    legs: Bools


def _assign(found: Float64, sure: Any, expected: Float64, sizes: Float64, rows: _Rows) -> Int64:
    """Assign detections to people one to one; return the numbers of duplicates, weak ones and bystanders."""
    mirror = np.array(HALPE.mirror)
    direct = np.stack([_cost(found, one) / size for one, size in zip(expected, sizes, strict=True)])
    turned = np.stack([_cost(found[:, mirror], one) / size for one, size in zip(expected, sizes, strict=True)])
    cost = np.nan_to_num(np.minimum(direct, turned), nan=9.0)
    people, detections = linear_sum_assignment(cost) if cost.size else (np.zeros(0, int), np.zeros(0, int))
    used = set()
    for p, d in zip(people, detections, strict=True):
        if cost[p, d] > SAME_PERSON:
            continue
        used.add(int(d))
        order = np.arange(len(HALPE))
        rows.matched[p] = True
        rows.swapped[p] = turned[p, d] < 0.5 * direct[p, d] and direct[p, d] > 0.02
        if rows.swapped[p]:
            order = mirror
        one = _cost(found[d][None][:, order][:, LEGS], expected[p][LEGS])
        other = _cost(found[d][None][:, mirror[order]][:, LEGS], expected[p][LEGS])
        rows.legs[p] = bool(other[0] < 0.5 * one[0] and one[0] > 0.03 * sizes[p])
        if rows.legs[p]:
            order = order.copy()
            order[LEGS] = mirror[order][LEGS]
        rows.pixels[p], rows.confidences[p] = found[d][order], sure[d][order]
    extra = np.zeros(3, dtype=np.int64)
    for d in range(len(found)):
        if d not in used:
            seen = np.isfinite(found[d, :, 0])
            again = cost.size and cost[:, d].min() <= SAME_PERSON
            weak = seen.sum() < len(HALPE) / 3 or float(np.mean(sure[d][seen])) < _LEAST_CONFIDENCE
            extra[0 if again else 1 if weak else 2] += 1
    return extra


def _cost(found: Float64, expected: Float64) -> Float64:
    """Median distance (detections,) of the keypoints that both have [px]; NaN without any."""
    apart = np.linalg.norm(found - expected, axis=-1)
    few = np.isfinite(apart).sum(axis=-1) < 3
    return np.where(few, np.nan, np.nanmedian(np.where(few[:, None], 0.0, apart), axis=-1))


def _left_out(pixels: Float64, sure: Float64, sizes: Float64, cameras: Views) -> Float64:
    """Errors (frames, cameras, people, 26, 2) of each camera against the point of all others, see the module."""
    out, usable = np.full(pixels.shape, np.nan), np.where((sure >= _LEAST_CONFIDENCE)[..., None], pixels, np.nan)
    settings = TriangulationSettings(gate_sd=4.0)
    sd = _SD_OF_SIZE * np.moveaxis(np.nan_to_num(sizes, nan=1.0), 1, -1)[:, :, None, :]  # (frames, people, 1, cameras)
    for c in range(pixels.shape[1]):
        others = np.moveaxis(usable, 1, 3).copy()  # (frames, people, 26, cameras, 2)
        others[..., c, :] = np.nan
        found = triangulate(others, cameras, sd, settings)
        numbers = cameras.numbers[c]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = numbers[10:19].reshape(3, 3), numbers[19:22]
        point = project(apply(T, found.points), numbers[:9])
        step = 1e-4
        slopes = np.stack(
            [(project(apply(T, found.points + step * axis), numbers[:9]) - point) / step for axis in np.eye(3)], axis=-1
        )
        spread = np.einsum("...ij,...jk,...ik->...", slopes, found.covariances, slopes) / 2
        size = sizes[:, c][..., None]
        excess = np.sqrt(1 + spread / (_SD_OF_SIZE * size) ** 2)
        out[:, c] = (pixels[:, c] - point) / (size * excess)[..., None]
    return out


def fit_errors(clips: Mapping[str, MatchedClip], detector: str) -> DetectorErrors:
    """Fit the tables of a detector to matched clips.

    Args:
        clips: the clips by name; at least one.
        detector: name of the detector, for the statement.
    """
    joined = list(clips.values())
    group, size = group_of(), len(GROUPS)
    groups = np.concatenate([np.broadcast_to(group, one.states.shape).ravel() for one in joined])
    states, sure = (_joined(joined, name) for name in ("states", "confidences"))
    error = np.concatenate([np.linalg.norm(one.residuals, axis=-1).ravel() for one in joined])
    there = np.concatenate([np.broadcast_to(one.matched[..., None], one.states.shape).ravel() for one in joined])
    known, bins = np.isfinite(error) & (sure > 0), bin_of(np.maximum(sure, 1e-6))
    core = np.array([[_core(error[known & (groups == g)], bins[known & (groups == g)], b)
                      for b in range(len(CONFIDENCE_BINS))] for g in range(size)])  # fmt: skip
    core = np.where(core > 0, core, np.median(core[core > 0]))
    far = error / core[groups, bins]
    ratio = _tail_ratio(far[known])
    beyond = np.exp(-(TAIL_FROM**2) / (2 * ratio**2))
    tail = [[_tail_share(far[known & (states == s) & (bins == b)], far[known & (bins == b)], beyond)
             for b in range(len(CONFIDENCE_BINS))] for s in range(len(STATES))]  # fmt: skip
    reported = there & (sure > 0)
    lacking = {g for g in range(size) if not reported[groups == g].any()}
    quantiles = [[_quantiles(sure[reported & (states == s) & (groups == g)], sure[reported & (groups == g)],
                             sure[reported]) for g in range(size)] for s in range(len(STATES))]  # fmt: skip
    has = np.concatenate([np.broadcast_to(_reported_joints(one), one.states.shape).ravel() for one in joined])
    missing = [[_share(~reported, there & has & (states == s) & (groups == g), there & has & (groups == g))
                if g not in lacking else 0.0 for g in range(size)] for s in range(len(STATES))]  # fmt: skip
    slow, slow_s = _slow(joined)
    statement = {
        "detector": detector,
        "recordings": {name: counts(one) for name, one in clips.items()},
        "errors": int(known.sum()),
        "hidden": int((known & (states > 0)).sum()),
        "command": "mocapella lab train keypoint-errors DIR",
    }
    return DetectorErrors(
        statement, _rounded(core, 5), _rounded(tail, 4), round(ratio, 2), _rounded(quantiles, 3), _rounded(missing, 4),
        round(slow, 3), round(slow_s, 3),
    )  # fmt: skip


def counts(clip: MatchedClip) -> dict[str, int]:
    """Count the faults of whole detections in a clip; no table has them, because the clips show too few."""
    duplicates, weak, bystanders = clip.extra
    return {
        "images": clip.images, "people": int(clip.sizes.size), "missed": int((~clip.matched).sum()),
        "left_right_swapped": int(clip.swapped.sum()), "legs_swapped": int(clip.legs.sum()), "duplicates": duplicates,
        "weak": weak, "bystanders": bystanders,
    }  # fmt: skip


def fit_recordings(folder: Path, on_run: Callable[[str], None] = lambda text: None) -> dict[str, DetectorErrors]:
    """Measure the detectors of the recordings in a folder: OpenPose's BODY_25B, and MediaPipe Holistic.

    The clip of two people has the same images as that of one, and a virtual second person; it is not used.

    Raises:
        InputError: a file is missing or has another format.
    """
    on_run("pose2sim_single_person")
    single = match_clip(pose2sim_clip(folder, "pose2sim_single_person"))
    on_run("mediapipe_holistic_4cam")
    clip = mediapipe_clip(folder)
    session = match_clip(clip, reference_of(clip))
    return {
        "openpose": fit_errors({"pose2sim_single_person": single}, "OpenPose BODY_25B"),
        "mediapipe": fit_errors({clip.name: session}, "MediaPipe Holistic"),
    }


def _joined(clips: list[MatchedClip], name: str) -> NDArray[Any]:
    return np.concatenate([getattr(one, name).ravel() for one in clips])


def _core(error: Float64, bins: Int64, wanted: int) -> float:
    """Return the standard deviation of a coordinate from the errors' median length (Rayleigh); of all bins if few."""
    chosen = error[bins == wanted]
    use = chosen if len(chosen) >= LEAST else error
    return float(np.median(use) / np.sqrt(2 * np.log(2))) if len(use) else 0.0


def _tail_ratio(far: Float64) -> float:
    """Standard deviation of the tail over the core's, from the mean square of the errors beyond `TAIL_FROM`."""
    tail = np.minimum(far[far > TAIL_FROM], 30.0)
    return float(np.sqrt(max((np.mean(tail**2) - TAIL_FROM**2) / 2, 4.0))) if len(tail) else 3.0


def _tail_share(far: Float64, instead: Float64, beyond: float) -> float:
    use = far if len(far) >= LEAST else instead
    expected = np.exp(-(TAIL_FROM**2) / 2)
    return float(np.clip((np.mean(use > TAIL_FROM) - expected) / (beyond - expected), 0.0, 1.0)) if len(use) else 0.0


def _quantiles(*choices: Float64) -> Float64:
    use = next((one for one in choices if len(one) >= LEAST), choices[-1])
    return np.quantile(use, QUANTILES) if len(use) else np.full(len(QUANTILES), 0.5)


def _share(what: Bools, among: Bools, instead: Bools) -> float:
    use = among if among.sum() >= LEAST else instead
    return float(what[use].mean()) if use.any() else 0.0


def _reported_joints(clip: MatchedClip) -> Bools:
    """(26,) keypoints that the detector has at all."""
    return np.asarray((clip.confidences > 0).any(axis=(0, 1, 2)))


def _slow(clips: list[MatchedClip]) -> tuple[float, float]:
    """Share and time constant of the slow part, from the autocorrelation over one frame and over `_LAG_S`."""
    found = []
    for clip in clips:
        error = np.where(np.linalg.norm(clip.residuals, axis=-1)[..., None] < _NOT_FAR, clip.residuals, np.nan)
        known = np.isfinite(error)
        error = error - np.where(known, error, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        power = np.nanmean(error**2)
        lags = [1, max(2, round(_LAG_S * clip.hz))]
        row = [float(np.nanmean(error[lag:] * error[:-lag]) / power) for lag in lags]
        found.append((row[0], max(row[1], 0.02), lags[0] / clip.hz, lags[1] / clip.hz))
    near, late, near_s, late_s = np.mean(np.array(found), axis=0)
    time_s = float((late_s - near_s) / np.log(max(near / late, 1.05)))
    return float(np.clip(near * np.exp(near_s / time_s), 0.0, 0.98)), time_s


def _stature(person: Float64) -> float:
    """Height of a person (frames, 26, 3) from the median lengths of legs and trunk [m]."""

    def length(a: str, b: str) -> float:
        found = np.linalg.norm(person[:, HALPE.index(a)] - person[:, HALPE.index(b)], axis=-1)
        known = found[np.isfinite(found)]
        return float(np.median(known)) if len(known) else np.nan

    trunk = np.mean([length("LShoulder", "LHip"), length("RShoulder", "RHip")]) / 0.288
    legs = [length(f"{s}Hip", f"{s}Knee") + length(f"{s}Knee", f"{s}Ankle") for s in "LR"]
    whole = [value for value in (float(trunk), float(np.mean(legs)) / 0.491) if np.isfinite(value)]
    return float(np.clip(np.mean(whole), 0.5, 2.5))


def _kinect(person: Float64) -> Float64:
    """(frames, 25, 3) joints of `simulate.body.BODY` for the capsules; NaN where unknown, which hides nothing."""
    out = np.full((len(person), len(JOINT), 3), np.nan)
    at = HALPE.index
    for side, name in (("L", "Left"), ("R", "Right")):
        for part in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle"):
            out[:, JOINT[part + name]] = person[:, at(side + part)]
        out[:, JOINT[f"Foot{name}"]] = person[:, at(f"{side}BigToe")]
    hips, shoulders = (person[:, [at(f"L{p}"), at(f"R{p}")]].mean(axis=1) for p in ("Hip", "Shoulder"))
    out[:, JOINT["SpineBase"]], out[:, JOINT["SpineShoulder"]] = hips, shoulders
    out[:, JOINT["SpineMid"]] = (hips + shoulders) / 2
    top = person[:, at("Head")]
    top = np.where(np.isfinite(top), top, shoulders + 0.6 * (shoulders - hips))
    out[:, JOINT["Neck"]], out[:, JOINT["Head"]] = (2 * shoulders + top) / 3, (shoulders + 2 * top) / 3
    return out


def _states(eye: Float64, bodies: Float64, radii: Float64, nothing: Any) -> Int64:
    """Index in `STATES` of each keypoint (people, 26)."""
    joints = hiding_joint()
    whole = hidden(eye, bodies, radii, nothing)[:, joints]
    own = np.stack([hidden(eye, bodies[p : p + 1], radii[p : p + 1], nothing)[0, joints] for p in range(len(bodies))])
    return np.where(own, 1, np.where(whole, 2, 0))


def _towards(bodies: Float64, eye: Float64) -> Float64:
    """Cosine (people,) between the horizontal facing and the direction to a camera; the world's up is the trunk's."""
    left = bodies[:, JOINT["ShoulderLeft"]] - bodies[:, JOINT["ShoulderRight"]]
    up = bodies[:, JOINT["SpineShoulder"]] - bodies[:, JOINT["SpineBase"]]
    ahead, view = np.cross(left, up), eye - bodies[:, JOINT["SpineShoulder"]]
    lengths = np.linalg.norm(ahead, axis=1) * np.linalg.norm(view, axis=1)
    return np.asarray(np.einsum("ij,ij->i", ahead, view) / lengths)


def _rounded(values: Any, digits: int) -> Any:
    return np.round(np.array(values), digits).tolist()


def reference_of(clip: KeypointClip) -> Float64:
    """Triangulate the most confident detection of each camera robustly: (1, frames, 26, 3), world [m].

    It is the reference of a clip of one person without another program's result.
    """
    placed = list(clip.rig.cameras.values())
    pixels = np.full((len(clip.frames), len(HALPE), len(placed), 2), np.nan)
    for t, instant in enumerate(clip.frames):
        for c, frame in enumerate(instant):
            if len(frame.ids):
                pixels[t, :, c] = frame.positions_px[int(np.argmax(frame.confidences.sum(axis=1)))]
    cameras = views([p.camera.lens for p in placed], [p.T_camera_world for p in placed])
    return triangulate(pixels, cameras, 8.0).points[None]
