"""Print the position of each person's head: python examples/01_read_results.py [tls/HOST:PORT] [SECONDS]"""

import sys

import mocapella
from mocapella.errors import MocapellaError


def main(address: str, seconds: float) -> None:
    """Print about five times a second, for a number of seconds."""
    printed_ns = 0
    for scene in mocapella.connect(address, seconds=seconds):
        if scene.at_ns - printed_ns < 200_000_000:
            continue
        printed_ns = scene.at_ns
        head = scene.topology.parts["head"]
        for person in scene.people:
            seen_by = [view.sensor for view in person.views if view.states[head] == 2]
            x, y, z = person.positions[head]
            print(f"person {person.id}: head at {x:.2f} {y:.2f} {z:.2f} m, measured by {', '.join(seen_by)}")
        if not scene.people:
            print(f"{scene.state.phase}: {scene.state.frames_remaining} frames remain {scene.state.reason}")


if __name__ == "__main__":
    try:
        main(
            sys.argv[1] if len(sys.argv) > 1 else "tls/127.0.0.1:7447", float(sys.argv[2]) if len(sys.argv) > 2 else 1e9
        )
    except MocapellaError as error:  # without a server; start one (mocapella demo, or mocapella serve)
        sys.exit(str(error))
    except KeyboardInterrupt:
        pass
