"""Print the position of each person's head: python examples/01_read_results.py [tls/HOST:PORT] [SECONDS]"""

import sys
import time

from mocapella.errors import MocapellaError
from mocapella.wire.reader import Newest
from mocapella.wire.session import DEFAULT_ADDRESS, open_reader


def main(address: str, seconds: float) -> None:
    """Print five times a second, for a number of seconds."""
    session = open_reader(address)
    newest = Newest(session)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        scene = newest.scene()
        if scene is not None:
            head = scene.topology.parts["head"]
            for person in scene.people:
                seen_by = [view.sensor for view in person.views if view.states[head] == 2]
                x, y, z = person.positions[head]
                print(f"person {person.id}: head at {x:.2f} {y:.2f} {z:.2f} m, measured by {', '.join(seen_by)}")
            if not scene.people:
                print(f"{scene.state.phase}: {scene.state.frames_remaining} frames remain {scene.state.reason}")
        time.sleep(0.2)
    session.close()


if __name__ == "__main__":
    try:
        main(sys.argv[1] if len(sys.argv) > 1 else DEFAULT_ADDRESS, float(sys.argv[2]) if len(sys.argv) > 2 else 1e9)
    except MocapellaError as error:  # without a server; start one (mocapella demo, or mocapella serve)
        sys.exit(str(error))
    except KeyboardInterrupt:
        pass
