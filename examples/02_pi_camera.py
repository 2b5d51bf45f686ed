"""A camera's program, such as on a Raspberry Pi: it finds colour markers and sends a datagram for each picture.

``python 02_pi_camera.py SOURCE PROFILE MASTER PORT [PICTURES [START_PORT]]``, such as ``picamera:0 left.json 192.0.2.7
5001``. SOURCE is one of `mocapella node markers`; PROFILE has its colours, and is ``-`` for a rendered scene. At the
end it prints how long each stage took. `mocapella node datagrams` hears it; docs/markers-rig.md builds a rig of two.
"""

import contextlib
import socket
import sys
import time

import numpy as np
from rich.console import Console

from mocapella.cli.markers import show_times
from mocapella.conventions import NS_PER_S
from mocapella.errors import MocapellaError
from mocapella.live.stage_times import StageTimes
from mocapella.model.markers import MarkerFrame
from mocapella.sensing.colour_profile import load_profile
from mocapella.sensing.markers import MarkerDetector
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.camera_controls import CameraWishes
from mocapella.sources.open_pictures import open_pictures


def datagram(picture: int, time_us: int, frame: MarkerFrame) -> bytes:
    """``#SEQUENCE,TIME_US;x,y;…``: a pair for each marker in the profile's order, empty for one that is not seen."""
    seen = zip(frame.positions_px, frame.found, strict=True)
    pairs = [f"{x:.2f},{y:.2f}" if found else "" for (x, y), found in seen]
    return (";".join([f"#{picture},{time_us}", *pairs]) + "\n").encode("ascii")


def wait_for_start(port: int) -> None:
    """Wait for the datagram ``start``."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # two cameras may run on one machine
        listener.bind(("", port))
        while listener.recv(64).strip() != b"start":
            pass


def main() -> None:
    """Wait, look, and send."""
    name, file, master, port = sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4])
    pictures = int(sys.argv[5]) if len(sys.argv) > 5 else 10**9
    if file == "-" and not name.startswith("rendered:"):
        sys.exit(f"{name} needs a profile of its colours; make it with `mocapella node markers {name} --profile FILE`")
    profile = None if file == "-" else load_profile(file)
    source = open_pictures(name, profile and CameraWishes(profile.size_px, controls=profile.controls))
    detector = MarkerDetector(known := profile or source.profile())
    detector.update(np.zeros((*known.size_px[::-1], 3), np.uint8), 0.0)  # compiles before the first picture
    detector.reset()
    times, number = StageTimes(min(pictures, 10_000), len(known.names)), 0
    with Acquisition(source, say=print) as camera, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        print(f"--markers {','.join(known.names)} --size {'x'.join(map(str, known.size_px))}", flush=True)
        wait_for_start(int(sys.argv[6]) if len(sys.argv) > 6 else 5000)
        camera.start()
        with contextlib.suppress(KeyboardInterrupt):
            while number < pictures and not camera.ended:
                if (taken := camera.take(0.1)) is None:
                    continue
                begin_s = time.monotonic()
                frame = detector.update(taken.image, taken.time_ns / NS_PER_S)
                found_s = time.monotonic()
                out.sendto(datagram(number, taken.time_ns // 1000, frame), (master, port))
                sent_s = time.monotonic()
                spent = {"retrieval": taken.retrieval_s, "detection": found_s - begin_s, "sending": sent_s - found_s}
                times.add({**spent, "all": sum(spent.values())}, frame.positions_px)
                number += 1
    show_times(times.table(), times.jitter(known.names), None, Console())


if __name__ == "__main__":
    try:
        main()
    except (MocapellaError, OSError, KeyboardInterrupt) as error:  # no camera, no network, or Ctrl-C before a picture
        sys.exit(str(error) or "interrupted before the first picture")
