"""Colour markers: what an image costs and how good the centres are, beside OpenCV's own chain in the same run.

The peers are what the RHOT thesis did with OpenCV. *Full chain*: Gaussian blur and conversion to HSV once, then for
each colour thresholds, opening, closing, contours, and the moments of the largest. *Reduced chain*: thresholds of
blue, green and red, contours and moments. Their thresholds come from the same clicks and the same pixels as our
profile, as wide, for moving light, as leaves the wall out. One thread each. `uv run --extra cameras python -m
benchmarks markers`.

*Live* rows are of processes with one thread for numpy's library: the whole chain on one core, and two cameras' nodes
with a server, over real sockets (`benchmarks/_marker_camera.py`).

Images are rendered (`mocapella.sources.simulate.marker_scene`), with seeds that nothing was tuned on.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Goal, Row, against_peer, at_least, at_most, compared, measured, times_the_peer
from mocapella.errors import EvaluationError
from mocapella.evaluation.marker_films import RATE_HZ, MarkerFilm, MarkerScore, learnt_film
from mocapella.live.launch import free_port
from mocapella.sensing.colour_learning import ColourSample, grow, inside
from mocapella.sensing.colour_table import separability
from mocapella.sensing.markers import MarkerDetector, MarkerSettings
from mocapella.sources.simulate.marker_scene import load_marker_scene, marker_scene_names

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

SEEDS: Final = (101, 102)
FRAMES: Final = 240
ROI_PX: Final = 40
ROOM: Final = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)
"""How wide the peers' thresholds may be, the first that leaves the wall out being taken."""


def run(quick: bool = False) -> list[Row]:
    """The rows of docs/markers.md."""
    return [*cost(quick), *accuracy(quick), *live(quick)]


def film(name: str, seed: int) -> MarkerFilm:
    """A scene by name, its colours learnt from clicks at its beginning."""
    return learnt_film(load_marker_scene(name, seed=seed))


def cost(quick: bool) -> Iterator[Row]:
    """An image of six colours, in the whole image and around each marker."""
    made = film("desk", SEEDS[0])
    shots = list(made.shots(16))
    shots += shots[::-1]  # to and fro, so that nothing jumps
    cv2 = opencv()
    repeat, number = (3, 32) if quick else (9, 320)
    for where, whole_s, roi in (("whole image 640 × 480", 0.0, False), (f"{ROI_PX}-px regions", 1e6, True)):
        detector = MarkerDetector(made.profile, MarkerSettings(whole_image_s=whole_s, light_s=1e6))
        state = [0]

        def ours(detector: MarkerDetector = detector, state: list[int] = state) -> None:
            detector.update(shots[state[0] % len(shots)].image, state[0] / RATE_HZ)
            state[0] += 1

        for chain, goal in (
            ("full", times_the_peer(5 if roi else 8)),
            ("reduced", times_the_peer(1)),
        ):
            name = f"markers: six colours, {where}, beside the {chain} chain"
            if cv2 is None:
                from benchmarks.harness import median_seconds

                yield measured(name, 1e6 * median_seconds(ours, repeat, number), "µs", goal=goal)
                continue
            peer = Peer(cv2, made.sample, made.profile.names, reduced=chain == "reduced")
            turn = [0]

            def theirs(peer: Peer = peer, roi: bool = roi, turn: list[int] = turn) -> None:
                shot = shots[turn[0] % len(shots)]
                peer.centres(shot.image, shot.centres_px if roi else None)
                turn[0] += 1

            yield against_peer(
                name, ours, theirs, f"OpenCV {cv2.__version__}", goal=goal, repeat=repeat, number=number,
                peer_number=max(number // 4, 1),
            )  # fmt: skip


def accuracy(quick: bool) -> Iterator[Row]:
    """How far off centres are, and how often a marker is missed or seen where none is."""
    cv2 = opencv()
    ours, theirs, good, refused = MarkerScore(), MarkerScore(), MarkerScore(), 0
    for name in marker_scene_names():
        here, beside = MarkerScore(), MarkerScore()
        for seed in SEEDS[:1] if quick else SEEDS:
            made = film(name, seed)
            problems = separability(made.profile).problems  # the user gets a warning; the scene is scored all the same
            refused += bool(problems)
            detector = MarkerDetector(made.profile)
            peer = Peer(cv2, made.sample, made.profile.names, reduced=False) if cv2 else None
            for shot in made.shots(10 if quick else FRAMES):
                frame = detector.update(shot.image, shot.at_s)
                told = frame.positions_px.astype(np.float64), frame.sd_px.astype(np.float64)
                here.add(shot, *told)
                if not problems:
                    good.add(shot, *told)
                if peer:
                    beside.add(shot, peer.centres(shot.image, None))
        yield from error_rows(here, f"markers: scene {name}", beside if cv2 else None, error=None)
        yield measured(f"markers: scene {name}, markers found", 100 * here.found_share, "%")
        yield measured(f"markers: scene {name}, false markers", 100 * here.false_share, "%")
        ours.join(here)
        theirs.join(beside)
    what = "markers: all scenes"
    yield from error_rows(ours, what, theirs if cv2 else None, error=at_most(0.35))
    yield measured(f"{what}, markers found", 100 * ours.found_share, "%", goal=at_least(99.5))
    yield measured(f"{what}, false markers", 100 * ours.false_share, "%", goal=at_most(0.1))
    if cv2:
        yield measured(f"{what}, markers found by the full chain", 100 * theirs.found_share, "%")
        yield measured(f"{what}, false markers of the full chain", 100 * theirs.false_share, "%")
    yield measured(f"{what}, errors over stated standard deviation (RMS, 1 is right)", ours.normalised, "")
    yield measured("markers: films whose colours are warned of when they are learnt", refused, "")
    yield measured("markers: the others alone, markers found", 100 * good.found_share, "%")
    yield jitter("still", SEEDS[0], 10 if quick else 200)


def error_rows(score: MarkerScore, what: str, peer: MarkerScore | None, *, error: Goal | None) -> Iterator[Row]:
    """The median and the 95th percentile of the errors."""
    for name, share, goal in (("median", 50, error), ("95 %", 95, None)):
        value, title = float(np.percentile(score.errors, share)), f"{what}, centre error, {name}"
        if peer is None or not peer.errors:
            yield measured(title, value, "px", goal=goal)
        else:
            theirs = float(np.percentile(peer.errors, share))
            yield compared(title, value, "px", peer="OpenCV full chain", peer_value=theirs, goal=goal)


def jitter(name: str, seed: int, frames: int) -> Row:
    """Standard deviation of a coordinate of markers that rest."""
    made = film(name, seed)
    detector = MarkerDetector(made.profile)
    found = np.array([detector.update(shot.image, shot.at_s).positions_px for shot in made.shots(frames)])
    return measured("markers: scene still, jitter of a coordinate", float(np.nanstd(found, axis=0).mean()), "px")


def live(quick: bool) -> Iterator[Row]:
    """From a picture in memory to the hand published, and 90 pictures a second of two cameras through processes."""
    from benchmarks._marker_camera import RATE_HZ, SCENE, prepare

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder, 30 if quick else 180)
        done = subprocess.run(
            _program("chain", folder, 200 if quick else 4000), check=True, capture_output=True, env=ONE_THREAD
        )
        took = json.loads(done.stdout)
        what = f"markers: two cameras of 640 × 480, scene {SCENE}, from pictures in memory to hands published, one core"
        yield measured(f"{what}, median", float(np.median(took["ms"])), "ms")
        yield measured(f"{what}, p99", float(np.percentile(took["ms"], 99)), "ms", goal=at_most(11))
        worked = float(np.percentile(took["processor_ms"], 99))
        yield measured(f"{what}, p99 of the processor's time, without what others used", worked, "ms")
        count = 450 if quick else 5400
        server, nodes = _through_processes(folder, count)
    what = f"markers: two nodes and a server, {RATE_HZ:g} pictures a second for {count / RATE_HZ:g} s"
    yield measured(
        f"{what}, of {2 * count} pictures without a result", 2 * count - server["frames_out"], "", goal=at_most(0)
    )
    yield measured(f"{what}, overwritten before anybody looked", sum(n["report"]["dropped"] for n in nodes), "")
    yield measured(f"{what}, dropped by the server", server["drops"], "")
    worst = max(node["stages"]["all"]["p99_ms"] for node in nodes)
    yield measured(f"{what}, node: from a picture to its markers sent, p99", worst, "ms")
    yield measured(f"{what}, server: from sent to hands published, p99", server["latency_ms"]["p99"], "ms")


ONE_THREAD: Final = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}


def _program(what: str, folder: Path, count: int, *more: str) -> list[str]:
    return [sys.executable, "-m", "benchmarks._marker_camera", what, str(folder), "--count", str(count), *more]


def _through_processes(folder: Path, count: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The server's and the nodes' summaries."""
    from benchmarks._marker_camera import BEGIN_IN_S, RATE_HZ

    port, out = free_port(), folder / "summary.json"
    places = (folder / "base.json").read_text()
    server = subprocess.Popen(
        [sys.executable, "-m", "mocapella", "serve", "--no-view", "--port", str(port), "--sensors", "2",
         "--method", "hands", "--rig", str(folder / "rig.toml"), "--file", f"hand={folder / 'hand.json'}",
         "--set", f"base_places_m={places}", "--json", str(out)],
        stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, env=ONE_THREAD,
    )  # fmt: skip
    nodes = [
        subprocess.Popen(
            _program("node", folder, count, "--camera", name, "--connect", f"tls/127.0.0.1:{port}"),
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=ONE_THREAD,
        )
        for name in ("left", "right")
    ]  # fmt: skip
    try:
        for node in nodes:
            assert node.stdout is not None
            node.stdout.readline()  # it is ready
        epoch = time.time() + BEGIN_IN_S
        for k, node in enumerate(nodes):
            assert node.stdin is not None
            node.stdin.write(f"{epoch + 0.5 * k / RATE_HZ}\n")  # in turn
            node.stdin.flush()
        said = [json.loads(node.communicate(timeout=count / RATE_HZ + 60.0)[0]) for node in nodes]
    finally:
        for node in nodes:
            node.kill()
            node.wait()
        server.send_signal(signal.SIGINT)
        _, errors = server.communicate(timeout=60.0)
    if not out.exists():
        raise EvaluationError(f"the server ended without a summary: {errors.decode()}")
    return json.loads(out.read_text()), said


def opencv() -> Any:
    """OpenCV with one thread, or None."""
    try:
        import cv2
    except ImportError:
        warnings.warn("no peer: uv run --extra cameras python -m benchmarks markers", stacklevel=2)
        return None
    cv2.setNumThreads(1)
    return cv2


class Peer:
    """The thesis' chain for every colour."""

    def __init__(self, cv2: Any, sample: ColourSample, names: tuple[str, ...], *, reduced: bool) -> None:
        self.cv2, self.reduced = cv2, reduced
        self.small, self.large = np.ones((3, 3), np.uint8), np.ones((5, 5), np.uint8)
        self.ranges: list[list[tuple[UInt8, UInt8]]] = []
        picture = sample.image if reduced else self.prepared(sample.image)
        for name in names:
            region = grow(sample.image, sample.clicks[name], name)
            pixels = picture[inside(region)].astype(np.float64)
            for room in ROOM:  # like a user who tunes sliders on a live mask: as wide as possible without the wall
                ranges = _bgr_range(pixels, room) if reduced else _hsv_ranges(pixels, room)
                if (self.mask(picture, ranges) > 0).sum() <= 1.2 * region.sum():
                    break
            self.ranges.append(ranges)

    def prepared(self, image: UInt8) -> UInt8:
        cv2 = self.cv2
        return np.asarray(cv2.cvtColor(cv2.GaussianBlur(image, (5, 5), 0), cv2.COLOR_BGR2HSV))

    def centres(self, image: UInt8, around: Float64 | None) -> Float64:
        """(colours, 2) in the whole image, or in regions around points (colours, 2)."""
        out = np.full((len(self.ranges), 2), np.nan)
        if around is None:
            picture = image if self.reduced else self.prepared(image)
            for k, ranges in enumerate(self.ranges):
                out[k] = self.largest(picture, ranges)
            return out
        height, width = image.shape[:2]
        for k, ranges in enumerate(self.ranges):
            x0 = min(max(int(around[k, 0]) - ROI_PX // 2, 0), width - ROI_PX)
            y0 = min(max(int(around[k, 1]) - ROI_PX // 2, 0), height - ROI_PX)
            part = image[y0 : y0 + ROI_PX, x0 : x0 + ROI_PX]
            x, y = self.largest(part if self.reduced else self.prepared(part), ranges)
            out[k] = x + x0, y + y0
        return out

    def mask(self, picture: UInt8, ranges: list[tuple[UInt8, UInt8]]) -> UInt8:
        mask = self.cv2.inRange(picture, *ranges[0])
        for low, high in ranges[1:]:
            mask = self.cv2.bitwise_or(mask, self.cv2.inRange(picture, low, high))
        return np.asarray(mask)

    def largest(self, picture: UInt8, ranges: list[tuple[UInt8, UInt8]]) -> tuple[float, float]:
        cv2 = self.cv2
        mask = self.mask(picture, ranges)
        if not self.reduced:
            mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, self.small)
            mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, self.large)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if not contours:
            return math.nan, math.nan
        m = cv2.moments(max(contours, key=cv2.contourArea))
        return (m["m10"] / m["m00"], m["m01"] / m["m00"]) if m["m00"] > 12 else (math.nan, math.nan)


def _hsv_ranges(pixels: Float64, room: float) -> list[tuple[UInt8, UInt8]]:
    """Hue around the pixels' (a circle of 180, in two parts where it closes), any brighter, any stronger colour.

    Room 1 is ± 8 of hue, 0.7 of the least saturation and 0.6 of the least value; 0 is none.
    """
    turns = np.exp(2j * np.pi * pixels[:, 0] / 180)
    middle = float(np.angle(turns.mean())) * 90 / np.pi % 180
    off = (pixels[:, 0] - middle + 90) % 180 - 90
    low, high = middle + np.percentile(off, 1) - 8 * room, middle + np.percentile(off, 99) + 8 * room
    s, v = (max(np.percentile(pixels[:, k], 2) * (1 - part * room), 20) for k, part in ((1, 0.3), (2, 0.4)))

    def part(a: float, b: float) -> tuple[UInt8, UInt8]:
        return np.array([a, s, v], np.uint8), np.array([b, 255, 255], np.uint8)

    if low < 0:
        return [part(0, high), part(180 + low, 179)]
    if high > 179:
        return [part(low, 179), part(0, high - 180)]
    return [part(low, high)]


def _bgr_range(pixels: Float64, room: float) -> list[tuple[UInt8, UInt8]]:
    """All three channels within 1 … 99 % of the pixels'; room 1 is ± 25."""
    low, high = np.percentile(pixels, 1, axis=0) - 25 * room, np.percentile(pixels, 99, axis=0) + 25 * room
    return [(np.clip(low, 0, 255).astype(np.uint8), np.clip(high, 0, 255).astype(np.uint8))]
