"""Speed of each person's hands in a recording: python examples/05_load_recording.py walk-1.mcap [speed.png]"""

import sys

import numpy as np

import mocapella
from mocapella.errors import MocapellaError


def main(path: str, picture: str | None) -> None:
    """Print the median and the largest speed of the right hand, while it is measured, and plot its path."""
    recording = mocapella.load(path)
    print(recording)
    people = recording.people
    if people is None:
        sys.exit(f"{path} has no people")
    people = people.at_rate(30.0)
    hand = people.keypoints.index("HandRight")
    measured = (people.states[:, :, hand] == 2).astype(float)
    path_m = np.where(measured[..., None] > 0, people.positions[:, :, hand], np.nan)
    speed = np.linalg.norm(np.diff(path_m, axis=0), axis=2) * people.rate_hz
    for name, own in zip(people.individuals, speed.T, strict=True):
        if np.isfinite(own).any():
            print(f"{name}: right hand {np.nanmedian(own):.2f} m/s in the median, {np.nanmax(own):.2f} at most")
    if picture is not None:
        people.plot("HandRight").savefig(picture)


if __name__ == "__main__":
    try:
        main(sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else None)
    except IndexError:
        sys.exit(__doc__)
    except MocapellaError as error:
        sys.exit(str(error))
