"""Print the heads that `mocapella stream osc` sends: python examples/09_receive_osc.py [PORT]"""

import contextlib
import socket
import sys

from mocapella.sources.osc import messages

with contextlib.suppress(KeyboardInterrupt), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
    receiver.bind(("127.0.0.1", int(sys.argv[1]) if len(sys.argv) > 1 else 9000))
    while True:
        for address, arguments in messages(receiver.recv(65_507)):
            if address.endswith("/Head"):
                x, y, z, state, sd = arguments
                print(address, f"{x:.2f} {y:.2f} {z:.2f} m", "measured" if state == 2 else "inferred", flush=True)
