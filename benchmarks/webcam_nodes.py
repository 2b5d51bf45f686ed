"""Two webcams of 640 × 480 px with MediaPipe and a server, live: skipped images, and the time from image to scene.

Films of two cameras of the recording ``pose2sim_single_person`` are made smaller, and played in real time by two nodes,
each a process of its own, as is the server. The time from image to scene is the sum of two 99th percentiles, and so
not below the true one: from the decoded image to the sent keypoints (node), and from there to the scene (server).
A loaded machine skips images: run it alone. `uv run --extra webcam python -m benchmarks webcam_nodes`;
`MOCAPELLA_DATA` names the folder of the recordings.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from benchmarks.harness import Row, at_most, measured
from mocapella.detectors.keypoint_detector import make_keypoint_detector
from mocapella.detectors.mediapipe_pose import missing
from mocapella.errors import EvaluationError
from mocapella.live.launch import free_port
from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import load_camera_rig, save_camera_rig
from mocapella.tracker import warm_up

CAMERAS: Final = {"cam_01": "cam01.mp4", "cam_03": "cam03.mp4"}
SIZE_PX: Final = (640, 480)
HZ: Final = 30
READY_S: Final = 12.0
"""Time for the nodes to load their models before the films begin [s]."""


def run(quick: bool = False) -> list[Row]:
    import cv2

    folder = Path(os.environ.get("MOCAPELLA_DATA", Path(__file__).parents[2] / "shared" / "data"))
    clip = folder / "pose2sim_single_person"
    if missing() or not clip.is_dir():
        raise EvaluationError(f"webcam_nodes needs MediaPipe and {clip}: {missing() or 'set MOCAPELLA_DATA'}")
    warm_up("webcams")
    with tempfile.TemporaryDirectory() as text:
        work = Path(text)
        rig = load_camera_rig(clip / "calibration" / "Calib_qualisys.toml")
        smaller = {name: small_film(cv2, clip / "videos" / film, work, rig, name) for name, film in CAMERAS.items()}
        save_camera_rig(work / "rig.toml", CameraRig(smaller))
        nodes, status = live(work, 12.0 if quick else 40.0)
        cost_ms = processor_ms(cv2, work / "cam_01.mp4", 20 if quick else 50)
    skipped = max(node["report"]["skipped_share"] for node in nodes)
    node_ms = max(node["report"]["p99_ms"] for node in nodes)
    server_ms = float(status["health"]["latency_ms"].get("p99", np.nan))
    what = f"two films of {SIZE_PX[0]} × {SIZE_PX[1]} px, {HZ} Hz, MediaPipe"
    return [
        measured(f"webcam_nodes: skipped images, {what}", 100 * skipped, "%", goal=at_most(10)),
        measured(f"webcam_nodes: image to sent keypoints, p99, {what}", node_ms, "ms"),
        measured(f"webcam_nodes: image to scene, p99, {what}", node_ms + server_ms, "ms", goal=at_most(120)),
        measured("webcam_nodes: processor time of an image with one person", cost_ms, "ms"),
        measured(
            "webcam_nodes: mean detection of an image", max(node["report"]["mean_ms"] for node in nodes), "ms",
        ),
    ]  # fmt: skip


def small_film(cv2: Any, film: Path, folder: Path, rig: CameraRig, name: str) -> Any:
    """Write a film in the middle of black images of `SIZE_PX`, every second frame, and return its camera."""
    placed, capture = rig.cameras[name], cv2.VideoCapture(str(film))
    scale = SIZE_PX[1] / capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
    wide = round(scale * capture.get(cv2.CAP_PROP_FRAME_WIDTH))
    left = (SIZE_PX[0] - wide) // 2
    out = cv2.VideoWriter(str(folder / f"{name}.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), HZ, SIZE_PX)
    number = 0
    while capture.grab():
        if number % 2 == 0:
            image = np.zeros((SIZE_PX[1], SIZE_PX[0], 3), np.uint8)
            image[:, left : left + wide] = cv2.resize(capture.retrieve()[1], (wide, SIZE_PX[1]))
            out.write(image)
        number += 1
    out.release()
    lens = placed.camera.lens.copy()
    lens[:4] *= scale
    lens[2] += left
    return msgspec.structs.replace(placed, camera=msgspec.structs.replace(placed.camera, size_px=SIZE_PX, lens=lens))


def processor_ms(cv2: Any, film: Path, count: int) -> float:
    """Return the processor time of an image's detection, in all threads, which other programs change little [ms]."""
    capture, finds = cv2.VideoCapture(str(film)), make_keypoint_detector("mediapipe", {"most_people": 1})
    images = [capture.read()[1] for _ in range(count)]
    for image in images[:5]:
        finds.update(image, 0.0)
    begin_s = time.process_time()
    for k, image in enumerate(images):
        finds.update(image, 1.0 + k / HZ)
    return 1e3 * (time.process_time() - begin_s) / count


def live(folder: Path, seconds: float) -> tuple[list[Any], Any]:
    """Run server and nodes for some seconds; return the nodes' results, and the server's status near the end."""
    address = f"tls/127.0.0.1:{free_port()}"
    port = address.rpartition(":")[2]
    server = start(
        folder, "serve", "--method", "webcams", "--rig", "rig.toml", "--sensors", "2", "--port", port, "--no-view"
    )  # fmt: skip
    epoch = time.time() + READY_S
    nodes = [
        start(
            folder, "node", "keypoints", f"{name}.mp4", "--connect", address, "--epoch", str(epoch),
            "--set", "loop=true", "--set", "most_people=1", "--json", f"{name}.json",
        )
        for name in CAMERAS
    ]  # fmt: skip
    try:
        time.sleep(max(0.0, epoch - time.time()) + seconds)
        command = [sys.executable, "-m", "mocapella", "status", "--connect", address, "--json", "-"]
        status = json.loads(subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=60).stdout)
    finally:
        for process in (*nodes, server):
            process.send_signal(signal.SIGINT)
            process.wait(60)
    return [json.loads((folder / f"{name}.json").read_text()) for name in CAMERAS], status


def start(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    quiet = subprocess.DEVNULL
    return subprocess.Popen([sys.executable, "-m", "mocapella", *words], cwd=folder, stdout=quiet, stderr=quiet)
