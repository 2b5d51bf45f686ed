"""Track a recording again and compare the results: python examples/06_track_again.py walk-1.mcap stand-still [NEW]"""

import sys
from pathlib import Path

import numpy as np

import mocapella
from mocapella.errors import MocapellaError


def main(path: str, method: str, new: str | None) -> None:
    """Print how far the people of two methods are apart, and write the new results as a take."""
    before = mocapella.load(path)
    again = mocapella.track(before, method, record=new)
    for name, recording in (("recorded", before), (method, again)):
        print(f"{name}: {recording.people if recording.people is not None else 'no people'}")
    if again.take is not None:
        print(again.take.info.origin)
    if before.people is None or again.people is None:
        return
    one, other = before.people.at_rate(30.0), again.people.at_rate(30.0)
    head = one.keypoints.index("Head"), other.keypoints.index("Head")
    count = min(len(one), len(other))
    a, b = one.positions[:count, :, head[0]], other.positions[:count, :, head[1]]
    apart = np.linalg.norm(a[:, :, None] - b[:, None, :], axis=3)  # frames, people, people
    known = np.isfinite(apart).any(axis=2)
    if known.any():
        nearest = np.nanmin(np.where(known[:, :, None], apart, np.inf), axis=2)[known]
        print(f"heads are {1000 * np.median(nearest):.0f} mm apart in the median, where both know them")


if __name__ == "__main__":
    try:
        main(str(Path(sys.argv[1])), sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else None)
    except IndexError:
        sys.exit(__doc__)
    except MocapellaError as error:
        sys.exit(str(error))
