"""Find cameras whose images show other moments than those of the others, by people who move.

Films that did not begin together show the same movement at other times. Each camera's keypoints are compared with the
tracked people at earlier and later instants: they agree best with the moment that the image shows.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.camera import PlacedCamera

Float64 = NDArray[np.float64]

LONGEST_S: Final = 1.0
"""Largest difference that is tried [s]."""
MOST_LAGS: Final = 120
"""Largest difference that is tried [instants]."""
PERIODS: Final = 1.5
"""Difference from the other cameras above which a camera is named [periods of the images]."""
LEAST_S: Final = 0.06
"""The difference is at least as large: a smaller one costs little accuracy [s]."""
BETTER: Final = 0.85
"""Largest distance at the best instant, as a part of that at the image's own instant."""
FAR: Final = 0.1
"""Distance of a keypoint from the joint, as a part of the person's size, at which larger ones are truncated."""
MOST_INSTANTS: Final = 1200
"""Number of instants that are kept: the first ones with people."""
FEWEST: Final = 20
"""Least number of a camera's sightings of people that tell something."""


class _Sighting(NamedTuple):
    person: str
    instant: int
    keypoints: Float64
    size_px: float


class MomentsOfCameras:
    """Collects people and their keypoints over the first instants, and compares them at other instants."""

    def __init__(self) -> None:
        self._at_s: list[float] = []
        self._paths: dict[str, dict[int, Float64]] = {}
        self._sightings: dict[str, list[_Sighting]] = {}

    @property
    def full(self) -> bool:
        """Whether enough instants are kept."""
        return len(self._at_s) >= MOST_INSTANTS

    def begin(self, at_s: float, people: Mapping[str, Float64]) -> None:
        """Begin an instant.

        Args:
            at_s: its time [s].
            people: joints (joints, 3) of the people, by name, world; NaN if unknown [m].
        """
        self._at_s.append(at_s)
        for name, joints in people.items():
            self._paths.setdefault(name, {})[len(self._at_s) - 1] = joints

    def see(self, camera: str, person: str, keypoints: Float64, size_px: float) -> None:
        """Take a camera's keypoints of a person at the instant that began last.

        Args:
            camera: the camera's name.
            person: the person's name.
            keypoints: (joints, 2) confident keypoints at the person's joints; NaN for others [px].
            size_px: size of the person in the image [px].
        """
        self._sightings.setdefault(camera, []).append(_Sighting(person, len(self._at_s) - 1, keypoints, size_px))

    def found(self, cameras: Mapping[str, PlacedCamera]) -> dict[str, tuple[float, int]]:
        """Return how much later the moments of a camera's images are than those of the other cameras' images.

        Args:
            cameras: the cameras, by name.

        Returns:
            For each camera that differs, the time, negative if its moments are earlier [s], and the number of images
            in it.
        """
        if len(self._at_s) < FEWEST:
            return {}
        period_s = statistics.median(np.diff(self._at_s).tolist())
        if not 0 < period_s < LONGEST_S:
            return {}
        most = min(MOST_LAGS, round(LONGEST_S / period_s))
        best = {
            name: self._best(self._sightings[name], cameras[name], most)
            for name in sorted(self._sightings)
            if name in cameras and len(self._sightings[name]) >= FEWEST
        }
        differ = {}
        for name, (lag, part) in best.items():
            others = [other for key, (other, _) in best.items() if key != name]
            ahead = lag - statistics.median(others) if others else 0.0
            if abs(ahead) >= max(PERIODS, LEAST_S / period_s) and lag != 0 and part <= BETTER:
                differ[name] = ahead * period_s, round(abs(ahead))
        return differ

    def _best(self, sightings: Sequence[_Sighting], placed: PlacedCamera, most: int) -> tuple[int, float]:
        """Return the difference, in instants, at which keypoints and people agree best, and the part of the distance.

        Sightings are compared where the person is known at both instants.
        """
        apart = np.concatenate([
            self._apart(self._paths[person], [one for one in sightings if one.person == person], placed, most)
            for person in sorted({one.person for one in sightings})
        ])  # fmt: skip
        now = np.where(np.isfinite(apart), apart[:, most, None], np.nan)
        both = np.isfinite(apart) & np.isfinite(now)
        sums = np.where(both, apart, 0.0).sum(axis=0), np.where(both, now, 0.0).sum(axis=0)
        parts = np.where((both.sum(axis=0) >= FEWEST) & (sums[1] > 0), sums[0] / np.maximum(sums[1], 1e-12), np.inf)
        best = int(np.argmin(parts))
        return (best - most, float(parts[best])) if parts[best] < 1.0 else (0, 1.0)

    def _apart(
        self, path: Mapping[int, Float64], sightings: Sequence[_Sighting], placed: PlacedCamera, most: int
    ) -> Float64:
        """Return the mean truncated distances of keypoints from the person (sightings, 2 · most + 1).

        Columns are of instants from ``most`` before the image's own to ``most`` after it; NaN if unknown.
        """
        joints = np.full((len(self._at_s) + 2 * most, *next(iter(path.values())).shape), np.nan)
        joints[[most + instant for instant in path]] = list(path.values())
        pixels = project(apply(placed.T_camera_world, joints), placed.camera.lens)
        keypoints = np.array([one.keypoints for one in sightings])
        rows, sizes = np.array([one.instant for one in sightings]), np.array([one.size_px for one in sightings])
        found = np.full((len(sightings), 2 * most + 1), np.nan)
        for k in range(2 * most + 1):
            far = np.minimum(np.linalg.norm(pixels[rows + k] - keypoints, axis=-1) / sizes[:, None], FAR)
            known = np.isfinite(far)
            count = known.sum(axis=1)
            found[:, k] = np.where(count > 0, np.where(known, far, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)
        return found
