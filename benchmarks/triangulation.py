"""Triangulation beside aniposelib, the filters beside theirs, and results on real and simulated recordings.

`uv run --group peers python -m benchmarks triangulation`. One thread: neither side starts more; `OMP_NUM_THREADS=1` and
`OPENBLAS_NUM_THREADS=1` keep numpy's own library from it.
"""

from __future__ import annotations

import importlib.metadata
import io
import warnings
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Row, against_peer, at_least, at_most, compared, measured, times_the_peer
from benchmarks.tracker import recordings
from mocapella.evaluation.point_references import holistic, single_person
from mocapella.fusion.marker_rays import MarkerRays, views_of
from mocapella.fusion.point_tracks import TracksSettings
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.geometry.triangulation import TriangulationSettings, Views, triangulate, views
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.smoothing.one_euro import OneEuro, OneEuroSettings

Float64 = NDArray[np.float64]

LENS: Final = np.array([600.0, 600.0, 320.0, 240.0, -0.2, 0.05, 1e-3, -1e-3, 0.0])
CAMERAS: Final = 4
TURNS: Final = np.array([0.35 + k * np.pi / 2 for k in range(CAMERAS)])
SD_PX: Final = 1.0
OUTLIERS: Final = 0.3
SEED: Final = 11


def run(quick: bool = False) -> list[Row]:
    rows = [*beside_aniposelib(quick), *filters(quick), *time_alignment(30 if quick else 200)]
    return [*rows, *references()]


def ring() -> Float64:
    """(cameras, 4, 4) of cameras around a room that look at its middle."""
    return np.stack([rigid(rotation_about_x(0.15) @ rotation_about_y(a), [0.0, 0.0, 3.0]) for a in TURNS])


def scene(points: int, outliers: float, seed: int = SEED) -> tuple[Float64, Float64, Views]:
    """Return true points (points, 3), pixels (points, cameras, 2) with up to all but two wrong, and the cameras."""
    rng, T = np.random.default_rng(seed), ring()
    truth = rng.uniform(-0.5, 0.5, (points, 3))
    pixels = np.stack([project(apply(t, truth), LENS) for t in T], axis=1)
    pixels += rng.normal(0, SD_PX, pixels.shape)
    wrong = rng.random((points, CAMERAS)) < outliers
    for row in wrong:
        row[np.flatnonzero(row)[CAMERAS - 2 :]] = False
    pixels[wrong] = rng.uniform([0, 0], [640, 480], (int(wrong.sum()), 2))
    return truth, pixels, views(np.tile(LENS, (CAMERAS, 1)), T)


def beside_aniposelib(quick: bool) -> Iterator[Row]:
    peer = aniposelib()
    name = "aniposelib" if peer is None else f"aniposelib {importlib.metadata.version('aniposelib')}"
    for points in (33, 198):
        for outliers in (0.0, OUTLIERS):
            truth, pixels, cameras = scene(points, outliers)
            what = f"{CAMERAS} cameras × {points} points" + (f", {OUTLIERS:.0%} outliers" if outliers else "")
            ours = partial(triangulate, pixels, cameras, SD_PX)
            if peer is None:
                yield measured(f"triangulation: error, {what}", mean_error_mm(ours().points, truth), "mm")
                continue
            kinds = {"triangulate": peer.triangulate, "triangulate(fast=True)": partial(peer.triangulate, fast=True)}
            if outliers:
                kinds = {"RANSAC": partial(without_outliers, peer)}
            for k, (how, call) in enumerate(kinds.items()):
                goal = times_the_peer(5000 if outliers else 100) if points == 33 and k == 0 else None
                yield against_peer(
                    f"triangulation: {what}", ours, partial(call, of_peer(pixels)), f"{name} {how}", goal=goal,
                    repeat=3 if quick else 9, number=50 if quick else 500, peer_number=1 if outliers else 10,
                )  # fmt: skip
                errors = []
                for seed in range(SEED, SEED + (3 if outliers else 40)):
                    truth, pixels, _ = scene(points, outliers, seed)
                    both = triangulate(pixels, cameras, SD_PX).points, call(of_peer(pixels))
                    errors.append([mean_error_mm(found, truth) for found in both])
                value, peer_value = np.mean(errors, axis=0)
                yield compared(
                    f"triangulation: error, {what}", float(value), "mm", peer=f"{name} {how}",
                    peer_value=float(peer_value), goal=times_the_peer(1),
                )  # fmt: skip


def of_peer(pixels: Float64) -> Float64:
    """Pixels as the peer takes them, (cameras, points, 2); it writes into them."""
    return np.ascontiguousarray(np.moveaxis(pixels, 1, 0))


def without_outliers(peer: Any, pixels: Float64) -> Any:
    """The points of its RANSAC, without its progress bars."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        return peer.triangulate_ransac(pixels)[0]


def mean_error_mm(points: Float64, truth: Float64) -> float:
    """Mean distance; a point that is missing counts as much as one that is 10 cm off."""
    return float(np.mean(np.nan_to_num(1000 * np.linalg.norm(points - truth, axis=-1), nan=100.0)))


def aniposelib() -> Any:
    """The peer's cameras, or None where it is not installed."""
    try:
        from aniposelib.cameras import Camera as TheirCamera
        from aniposelib.cameras import CameraGroup
    except ImportError:
        warnings.warn("aniposelib is not installed (group peers): no peer", stacklevel=2)
        return None
    import cv2

    cv2.setNumThreads(1)
    K = np.array([[LENS[0], 0, LENS[2]], [0, LENS[1], LENS[3]], [0, 0, 1]])
    return CameraGroup(
        [
            TheirCamera(
                matrix=K, dist=LENS[4:], size=(640, 480), rvec=cv2.Rodrigues(T[:3, :3])[0].ravel(), tvec=T[:3, 3]
            )
            for T in ring()
        ]
    )


def filters(quick: bool) -> Iterator[Row]:
    """The 1-euro filter of 450 numbers a frame."""
    try:
        from OneEuroFilter import OneEuroFilter
    except ImportError:
        warnings.warn("OneEuroFilter is not installed (group peers): no peer", stacklevel=2)
        return
    who = f"OneEuroFilter {importlib.metadata.version('OneEuroFilter')}"
    frames = np.random.default_rng(SEED).normal(size=(100, 150, 3)).cumsum(axis=0)
    one_euro = OneEuro(OneEuroSettings(1.0, 0.1, 1.0, per_component=True))
    theirs = [OneEuroFilter(60, 1.0, 0.1, 1.0) for _ in range(frames[0].size)]
    ours_out = np.stack([one_euro.update(frame, k / 60) for k, frame in enumerate(frames)])
    their_out = [
        [f(x, k / 60) for f, x in zip(theirs, frame.ravel().tolist(), strict=True)] for k, frame in enumerate(frames)
    ]
    off = float(np.abs(ours_out.reshape(100, -1) - np.array(their_out)).max())
    clocks, last = [100, 100], frames[-1].ravel().tolist()

    def ours() -> None:
        clocks[0] += 1
        one_euro.update(frames[-1], clocks[0] / 60)

    def peer() -> None:
        clocks[1] += 1
        for f, x in zip(theirs, last, strict=True):
            f(x, clocks[1] / 60)

    repeat = 3 if quick else 9
    yield against_peer(
        "triangulation: 1-euro per component, 450 numbers a frame", ours, peer, who, goal=times_the_peer(250),
        repeat=repeat, number=2000, peer_number=10,
    )  # fmt: skip
    yield measured("triangulation: 1-euro, largest difference from the peer", off, "", goal=at_most(1e-12))


def hand(at_s: float, points: int = 5) -> Float64:
    """(points, 3) of a fast hand half a metre before two cameras: up to 1.5 m/s [m]."""
    phase = 0.7 * np.arange(points)
    axes = ((0.12, 1.5, 0.0), (0.08, 1.1, 0.0), (0.06, 1.3, 1.0))
    x, y, z = (a * np.sin(2 * np.pi * f * at_s + phase + p) for a, f, p in axes)
    return np.stack([x, y, 0.5 + z], axis=-1)


def pair(baseline_m: float, readout_s: float) -> CameraRig:
    lens, cameras = np.array([530.0, 530.0, 319.5, 239.5, 0, 0, 0, 0, 0]), {}
    for name, x in (("left", -baseline_m / 2), ("right", baseline_m / 2)):
        T = rigid(np.eye(3), [-x, 0.0, 0.0])
        cameras[name] = PlacedCamera(Camera(name, (640, 480), lens, readout_s), T, np.full((6, 6), np.nan))
    return CameraRig(cameras)


def shot(placed: PlacedCamera, at_s: float) -> Float64:
    """(points, 2) as a rolling shutter shows the hand [px]."""
    rows, pixels = np.full(5, 240.0), np.zeros((5, 2))
    for _ in range(6):
        points = np.stack([hand(at_s + rows[k] * placed.camera.readout_s / 479)[k] for k in range(5)])
        pixels = project(apply(placed.T_camera_world, points), placed.camera.lens)
        rows = pixels[:, 1]
    return pixels


def time_alignment(frames: int) -> Iterator[Row]:
    """A fast hand before two cameras that are half a frame apart, time heeded and ignored."""
    every = TriangulationSettings(gate_sd=np.inf)
    for hz, readout_s, baseline_m in ((30, 0.03, 0.4), (60, 0.02, 0.4), (30, 0.03, 0.075), (60, 0.02, 0.075)):
        rig, rng = pair(baseline_m, readout_s), np.random.default_rng(SEED)
        rays, cameras, latest = MarkerRays(rig, 5), views_of(rig), {}
        ours, ignored = [], []
        for i in range(frames):
            for k, (name, placed) in enumerate(rig.cameras.items()):
                at_s = (i + 0.5 * k) / hz
                latest[name] = shot(placed, at_s) + rng.normal(0, 0.3, (5, 2))
                result = rays.update(name, latest[name], 0.3, at_s)
                if i >= 10:
                    truth = hand(result.at_s)
                    ours.append(np.linalg.norm(result.points - truth, axis=-1))
                    both = triangulate(np.stack([latest[n] for n in rig.cameras], axis=1), cameras, 0.3, every)
                    ignored.append(np.linalg.norm(both.points - truth, axis=-1))
        what = f"{hz} fps, readout {1000 * readout_s:.0f} ms, {100 * baseline_m:g} cm apart"
        for figure, q in (("median", 50), ("p95", 95)):
            value, without = (1000 * float(np.nanpercentile(e, q)) for e in (ours, ignored))
            yield compared(
                f"triangulation: fast hand, {figure} error, {what}", value, "mm", peer="time ignored",
                peer_value=without, goal=times_the_peer(2),
            )  # fmt: skip


def references() -> Iterator[Row]:
    """Real recordings beside other tools' results."""
    data = recordings()
    folders = data / "mediapipe_holistic_4cam", data / "pose2sim_single_person"
    if not all(folder.is_dir() for folder in folders):
        warnings.warn(f"no references: {data} lacks them (MOCAPELLA_DATA names another place)", stacklevel=2)
        return
    for name, settings in (("linear, at most 40 px", None), ("robust, sd 20 px", TracksSettings(sd_px=20.0))):
        near, steady = holistic(folders[0]) if settings is None else holistic(folders[0], settings)
        goals = (at_most(8), at_most(35)) if settings is None else (None, None)
        of = f"holistic, {name}"
        yield measured(f"triangulation: {of}: median from the reference", near.median_mm, "mm", goal=goals[0])
        yield measured(f"triangulation: {of}: p95 from the reference", near.p95_mm, "mm", goal=goals[1])
        yield measured(f"triangulation: {of}: of its points", 100 * near.compared / near.reference, "%")
        for who, value in (("all its points", steady.reference), ("the same points", steady.reference_where_ours)):
            goal = times_the_peer(1) if settings is None else None
            peer = f"the reference, {who}"
            yield compared(
                f"triangulation: {of}: variation of hand bones", 100 * steady.ours, "%", peer=peer,
                peer_value=100 * value, goal=goal,
            )  # fmt: skip
    linear, robust = single_person(folders[1]), single_person(folders[1], TracksSettings(sd_px=5.0))
    for name, near, wanted in (
        ("weighted-linear", linear, at_least(99)),
        ("robust, sd 5 px", robust, None),
    ):
        of = f"single person, {name}"
        yield measured(f"triangulation: {of}: within 1 mm", 100 * near.within_1_mm, "%", goal=wanted)
        yield measured(f"triangulation: {of}: median from the reference", near.median_mm, "mm")
        yield measured(f"triangulation: {of}: p95 from the reference", near.p95_mm, "mm")
