"""Two processes of the marker benchmark, as programs: `python -m benchmarks._marker_camera chain|node FOLDER …`.

*chain*: from two pictures in memory to the hand published, all in one process on one core; prints the milliseconds of
each instant as JSON. *node*: a camera's node whose pictures are in memory, at a fixed rate; prints its summary.
`prepare` renders the pictures beforehand, so that rendering does not count.
"""

from __future__ import annotations

import argparse
import json
import os
import threading
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from mocapella.model.camera_rig_file import load_camera_rig, save_camera_rig
from mocapella.model.hand_file import encode_hand_shape, load_hand_shape
from mocapella.sensing.colour_profile import load_profile, save_profile
from mocapella.sources.picture_source import Picture, SourceState
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import HandScene, base_places, hand_scene_settings

RATE_HZ: Final = 90.0
SCENE: Final = "wide"
SEED: Final = 101
BEGIN_S: Final = 10.0
BEGIN_IN_S: Final = 2.0
"""So long after the slowest node is ready the pictures begin."""


def prepare(folder: Path, pictures: int) -> None:
    """Render so many pictures of both cameras, learn their colours, and write what the processes need."""
    made = hand_scene_settings(SCENE)
    cameras = tuple(replace(camera, fps=RATE_HZ) for camera in made.cameras)
    scene = HandScene(replace(made, cameras=cameras), SEED)
    for name in scene.cameras:
        shots = [scene.at(name, BEGIN_S + k / RATE_HZ).image for k in range(pictures)]
        np.save(folder / f"{name}.npy", np.stack(shots))
        save_profile(folder / f"{name}.json", pointed_at(scene, name))
    save_camera_rig(folder / "rig.toml", scene.rig)
    (folder / "hand.json").write_bytes(encode_hand_shape(scene.shape))
    (folder / "base.json").write_text(json.dumps(base_places(scene).tolist()))


class InMemory:
    """A source that shows pictures to and fro at a fixed rate, so that nothing ever jumps."""

    live, times = False, "a counter"

    def __init__(self, name: str, images: Any, count: int) -> None:
        self.name, self._images, self._count = name, images, count
        self._turn = 0

    def open(self) -> SourceState:
        height, width = self._images.shape[1:3]
        return SourceState((width, height), RATE_HZ)

    def begin(self, zero_s: float) -> None:
        self._zero_s = zero_s

    def read(self, stop: threading.Event) -> Picture | None:
        if self._turn == self._count:
            return None
        at_s = self._turn / RATE_HZ
        if stop.wait(max(0.0, self._zero_s + at_s - time.monotonic())):
            return None
        image = to_and_fro(self._images, self._turn)
        self._turn += 1
        return Picture(image, round(1e9 * at_s) + 1, self._turn - 1, time.monotonic(), 0.0)

    def close(self) -> None:
        pass


def to_and_fro(images: Any, turn: int) -> Any:
    last = len(images) - 1
    place = turn % (2 * last)
    return images[place if place <= last else 2 * last - place]


def chain(folder: Path, count: int) -> dict[str, Any]:
    """From two pictures in memory to the hand published; milliseconds of each instant after the first second."""
    from mocapella.model.observations import Arrival
    from mocapella.schema import decode_frame, encode_frame, encode_scene
    from mocapella.sensing.markers import MarkerDetector
    from mocapella.settings import parse
    from mocapella.tracker.hands import HandsSettings, HandsTracker

    rig = load_camera_rig(folder / "rig.toml")
    settings = parse(
        HandsSettings, {"base_places_m": json.loads((folder / "base.json").read_text())}, where="benchmark"
    )
    tracker = HandsTracker(rig, settings, shape=load_hand_shape(folder / "hand.json"))
    names = list(rig.cameras)
    detectors = [MarkerDetector(load_profile(folder / f"{name}.json")) for name in names]
    films = [np.load(folder / f"{name}.npy") for name in names]
    took, worked, hands = [], [], 0
    for k in range(count):
        at_s = (k + 1) / RATE_HZ
        begin, begin_work = time.perf_counter(), time.thread_time()
        for detector, film in zip(detectors, films, strict=True):
            frame = decode_frame(encode_frame(detector.update(to_and_fro(film, k), at_s)))
            scene = tracker.update(Arrival(frame, frame.time_ns))
            encode_scene(scene)
        took.append(1e3 * (time.perf_counter() - begin))
        worked.append(1e3 * (time.thread_time() - begin_work))
        hands += len(scene.hands)
    settled = round(RATE_HZ)
    return {"ms": took[settled:], "processor_ms": worked[settled:], "hands": hands / count}


def node(folder: Path, name: str, connect: str, count: int) -> dict[str, Any]:
    """A camera's node, as `mocapella node markers` is one."""
    from mocapella.cli.nodes import read_epoch
    from mocapella.live.camera_node import CameraNodeSettings
    from mocapella.live.camera_service import CameraService
    from mocapella.live.marker_node import run_marker_node
    from mocapella.live.marker_work import MarkerWork
    from mocapella.live.stage_times import StageTimes
    from mocapella.sources.acquisition import Acquisition
    from mocapella.wire.node import NodeLink

    stop, profile = threading.Event(), load_profile(folder / f"{name}.json")
    with Acquisition(InMemory(name, np.load(folder / f"{name}.npy"), count)) as acquisition:
        work = MarkerWork(name, acquisition, profile)
        times = StageTimes(count, len(work.names))
        with CameraService(work) as service, NodeLink(connect, name) as link:
            while not link.join():
                time.sleep(0.1)
            epoch = read_epoch()
            summary = run_marker_node(
                link, acquisition, work, service, CameraNodeSettings(report_s=0.0),
                epoch=epoch, stop=stop, wait=False, times=times,
            )  # fmt: skip
            time.sleep(1.0)  # the last frames are on their way
    return asdict(summary)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=["chain", "node"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--camera", default="")
    parser.add_argument("--connect", default="")
    options = parser.parse_args()
    if options.what == "chain":
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        result = chain(options.folder, options.count)
    else:
        result = node(options.folder, options.camera, options.connect, options.count)
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
