"""Constrain a body's landmarks to the lines of sight of keypoints, as Plücker lines with robust weights.

The cost of a landmark x and a line (n, m) is |x × n − m|² over the variance of their distance: B. Rosenhahn, T. Brox,
D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion Capture", DAGM 2007, equations 11 to 14. The variance
has two parts: that of the keypoint, by its angular standard deviation and its distance, and that of the difference
between a detector's keypoint and the model's landmark, which is the same for all cameras.

Lines of a landmark that meet in one point count in full (`meeting_points`). Other lines have the weight of Geman and
McClure (Bull. ISI 52, 1987) by their distance from the landmark's present position, so that a wrong line's cost is
bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.plucker import nearest_point, residual
from mocapella.settings import check

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class KeypointLineSettings:
    """Weights of keypoints beside outlines.

    Attributes:
        joint_sd: standard deviation of a keypoint, relative to the person's size in the image; larger: keypoints count
            less [ratio].
        least_sd_px: least standard deviation of a keypoint; larger: keypoints of small people count less [px].
        misfit_m: standard deviation of the difference between keypoints and the model's landmarks; larger: outlines
            count more where there are both [m].
        least_confidence: keypoints below this confidence are not used; larger: fewer wrong and fewer true ones
            [0 to 1].
        agree_sd: largest distance of lines that meet from their point; larger: noisier keypoints still agree, and wrong
            ones sooner [standard deviations].
        least_angle_rad: least angle between two lines that meet; larger: better distances from fewer cameras [rad].
        contradicts_m: a keypoint contradicts an image's contour if it is farther outside of it, in the landmark's
            distance; larger: fewer keypoints are left out [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    joint_sd: float = 0.02
    least_sd_px: float = 1.0
    misfit_m: float = 0.03
    least_confidence: float = 0.1
    agree_sd: float = 3.0
    least_angle_rad: float = 0.087
    contradicts_m: float = 0.1

    def __post_init__(self) -> None:
        check(0.001 <= self.joint_sd <= 1, "joint_sd", self.joint_sd, "from 0.001 to 1")
        check(0.1 <= self.least_sd_px <= 100, "least_sd_px", self.least_sd_px, "from 0.1 to 100 px")
        check(0.001 <= self.misfit_m <= 1, "misfit_m", self.misfit_m, "from 0.001 to 1 m")
        check(0 <= self.least_confidence < 1, "least_confidence", self.least_confidence, "from 0 to below 1")
        check(0 < self.agree_sd <= 10, "agree_sd", self.agree_sd, "above 0 and at most 10")
        check(0 < self.least_angle_rad < 1.57, "least_angle_rad", self.least_angle_rad, "above 0 and below 1.57 rad")
        check(0 < self.contradicts_m <= 10, "contradicts_m", self.contradicts_m, "above 0 and at most 10 m")


DEFAULT = KeypointLineSettings()


class LandmarkLines(msgspec.Struct, frozen=True, eq=False):
    """Lines of sight of one body's keypoints, by landmark and camera.

    Attributes:
        lines: (landmarks, cameras, 6) Plücker lines in the world, from the camera outwards; NaN where not seen.
        origins: (cameras, 3) the cameras' centres, world [m].
        sds_rad: (landmarks, cameras) angular standard deviations [rad]; NaN where not seen.
    """

    lines: Float64
    origins: Float64
    sds_rad: Float64

    @property
    def seen(self) -> Bool:
        """(landmarks, cameras) whether there is a line."""
        return np.asarray(np.isfinite(self.lines).all(axis=-1) & (self.sds_rad > 0))

    def without(self, landmarks: Bool) -> LandmarkLines:
        """Return the lines without the given landmarks' lines, (landmarks,) bool."""
        return LandmarkLines(np.where(landmarks[:, None, None], np.nan, self.lines), self.origins, self.sds_rad)

    def sds_m(self, points: Float64) -> Float64:
        """Return the standard deviations (landmarks, cameras) of the lines at points (landmarks, 3) [m]."""
        return np.asarray(self.sds_rad * np.linalg.norm(points[:, None] - self.origins, axis=-1))


class MeetingPoints(msgspec.Struct, frozen=True, eq=False):
    """Points where lines of several cameras meet.

    Attributes:
        points: (landmarks, 3) world [m]; NaN where fewer than two lines meet.
        agree: (landmarks, cameras) whether each line meets the others in the point; False where there is none.
        sds_m: (landmarks,) standard deviation of the landmark's distance from the point, of both parts [m].
    """

    points: Float64
    agree: Bool
    sds_m: Float64

    @property
    def known(self) -> Bool:
        """(landmarks,) whether there is a point."""
        return np.asarray(np.isfinite(self.points).all(axis=-1))


def meeting_points(given: LandmarkLines, expected: Float64, settings: KeypointLineSettings = DEFAULT) -> MeetingPoints:
    """Find for each landmark the point where most lines meet; of several, the one nearest to the expected position.

    Every pair of lines gives a candidate (M. Fischler, R. Bolles, "Random sample consensus", CACM 24, 1981, with all
    samples); the point is then the one nearest to all lines that agree.

    Args:
        given: the lines.
        expected: (landmarks, 3) positions, world [m].
        settings: the settings.
    """
    s, (count, cameras), seen = settings, given.sds_rad.shape, given.seen
    agree, found = np.zeros((count, cameras), np.bool_), np.full((count, 3), np.nan)
    lines = np.where(seen[..., None], given.lines, 0.0)
    most, nearest = np.ones(count, np.int64), np.full(count, np.inf)
    for a, b in combinations(range(cameras), 2):
        sine = np.linalg.norm(np.cross(lines[:, a, :3], lines[:, b, :3]), axis=-1)
        both = seen[:, a] & seen[:, b] & (sine >= np.sin(s.least_angle_rad))
        if not both.any():
            continue
        at = nearest_point(np.where(both[:, None, None], lines[:, (a, b)], np.nan))
        fits = _near(given, lines, seen, at, s)
        enough = both & fits[:, a] & fits[:, b]
        votes, away = fits.sum(axis=1), np.linalg.norm(at - expected, axis=-1)
        better = enough & ((votes > most) | ((votes == most) & (away < nearest)))
        most, nearest = np.where(better, votes, most), np.where(better, away, nearest)
        agree[better], found[better] = fits[better], at[better]
    refined = nearest_point(np.where(agree[..., None], lines, 0.0))
    found = np.where(np.isfinite(refined), refined, found)
    number = np.maximum(agree.sum(axis=1), 1)
    own = np.where(agree, given.sds_m(found) ** 2, 0.0).sum(axis=1) / number**2
    return MeetingPoints(found, agree, np.sqrt(own + s.misfit_m**2))


def _near(given: LandmarkLines, lines: Float64, seen: Bool, at: Float64, s: KeypointLineSettings) -> Bool:
    """Return which lines (landmarks, cameras) pass points (landmarks, 3) within their standard deviations."""
    away = np.linalg.norm(residual(at[:, None], lines), axis=-1)
    return np.asarray(seen & (away <= s.agree_sd * np.hypot(given.sds_m(at), s.misfit_m)))


def line_weights(
    given: LandmarkLines, met: MeetingPoints, places: Float64, settings: KeypointLineSettings = DEFAULT
) -> Float64:
    """Return the robust weights (landmarks, cameras) of lines; 0 where not seen [1/m²].

    Args:
        given: the lines.
        met: where they meet.
        places: (landmarks, 3) the landmarks' present positions, world [m].
        settings: the settings.
    """
    s, seen = settings, given.seen
    # The misfit is common to all cameras: of c lines that meet, it counts as that of one.
    own = np.where(seen, given.sds_m(np.where(met.known[:, None], met.points, places)), 1.0)
    together = 1.0 / (own**2 + np.maximum(met.agree.sum(axis=1), 1)[:, None] * s.misfit_m**2)
    away = np.linalg.norm(residual(places[:, None], np.where(seen[..., None], given.lines, 0.0)), axis=-1)
    alone = 1.0 / (own**2 + s.misfit_m**2)
    alone = alone / (1.0 + away**2 * alone / s.agree_sd**2) ** 2
    return np.where(seen, np.where(met.agree, together, alone), 0.0)
