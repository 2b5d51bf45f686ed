"""A camera's program, such as on a Raspberry Pi: it waits for the start command and sends a datagram for each picture.

``python 02_pi_camera.py MASTER PORT [PICTURES [START_PORT]]``; put your own detection into `find_markers`. It needs
Python alone; see docs/wire.md. `mocapella node datagrams --camera left=PORT --set start_to=HOST:5000`
hears it, where HOST is the network's broadcast address.
"""

import math
import socket
import sys
import time

START_PORT = 5000  # where the start command comes
MARKERS = ("red", "yellow", "green", "blue", "magenta", "cyan")
SIZE_PX = (640, 480)
FPS = 60.0


def find_markers(picture: int) -> dict[str, tuple[float, float]]:
    """Pixels of the markers that are seen, x to the right, y down; here of a hand that waves."""
    x = 0.5 * SIZE_PX[0] + 80 * math.sin(0.1 * picture)
    seen = {name: (x + 40 * k - 100, 200.0 + 10 * k) for k, name in enumerate(MARKERS)}
    if picture % 10 == 9:
        del seen["cyan"]
    return seen


def datagram(picture: int, time_us: int, seen: dict[str, tuple[float, float]]) -> bytes:
    """``#SEQUENCE,TIME_US;x,y;…``: a pair for each marker in the order agreed on, empty for one that is not seen."""
    pairs = ["{:.2f},{:.2f}".format(*seen[name]) if name in seen else "" for name in MARKERS]
    return (";".join([f"#{picture},{time_us}", *pairs]) + "\n").encode("ascii")


def wait_for_start(port: int) -> None:
    """Until somebody says ``start``."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # two cameras may run on one machine
        listener.bind(("", port))
        while listener.recv(64).strip() != b"start":
            pass


def main() -> None:
    """Wait, and send."""
    master, port = sys.argv[1], int(sys.argv[2])
    pictures = int(sys.argv[3]) if len(sys.argv) > 3 else 10**9
    start_port = int(sys.argv[4]) if len(sys.argv) > 4 else START_PORT
    wait_for_start(start_port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for picture in range(pictures):
            taken_us = time.monotonic_ns() // 1000  # of a real camera: the middle of the exposure
            out.sendto(datagram(picture, taken_us, find_markers(picture)), (master, port))
            time.sleep(1.0 / FPS)


if __name__ == "__main__":
    main()
