"""Keypoints of one body as constraints of its fit to outlines, frame by frame.

    keypoints.begin(seen, stands)                          once a frame; None without keypoints
    given += keypoints.constraints(stands, moved)          for each pose fit, after `judge`

A keypoint that the image contradicts in every camera is left out: its pixel shows the background, in a colour that
nothing of the body has. A limb in the colour of its background is therefore never contradicted.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.keypoint_lines import (
    KeypointLineSettings,
    LandmarkLines,
    MeetingPoints,
    line_weights,
    meeting_points,
)
from mocapella.kinematics.twist_fit import InPlanes, OnLines
from mocapella.model.rigged_mesh import at_rest
from mocapella.tracker.silhouette_body import SilhouetteBody, Standing
from mocapella.tracker.silhouette_camera import SilhouetteCamera
from mocapella.tracker.silhouette_keypoints import BodyKeypoints

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

MISPLACED_SD = 2.0
"""A landmark farther than this from where its lines meet is misplaced [standard deviations]."""


class KeypointFit:
    """Keypoints of one body in the present frame: call `begin` once a frame.

    Args:
        body: the body.
        settings: the settings.
    """

    def __init__(self, body: SilhouetteBody, settings: KeypointLineSettings) -> None:
        self._body, self._settings = body, settings
        marks = list(body.mesh.landmarks.values())
        self._part = np.array([mark.part for mark in marks], np.int64)
        self._parents = body.mesh.tree.parents
        # Where a detector sees hips and shoulders differs most from a model's joints: the trunk is never misplaced.
        on_trunk = [name.endswith(("hip", "shoulder")) for name in body.mesh.landmarks]
        self._of_limbs = ~np.array(on_trunk, np.bool_)
        self._trunk = np.unique(np.concatenate([[0], self._part[on_trunk]])).astype(np.int64)
        self.begin(None, None)

    def begin(self, seen: BodyKeypoints | None, stands: Standing | None) -> None:
        """Take the keypoints of a frame; None for none.

        Args:
            seen: keypoints by landmark and camera.
            stands: the body in its expected pose.
        """
        self._seen, self._expected = seen, stands
        self._contradicted = np.zeros(len(self._part), np.bool_)
        self._lines: LandmarkLines | None = None
        self._met: MeetingPoints | None = None
        if seen is not None:
            self._use(seen.lines)

    def _use(self, lines: LandmarkLines) -> None:
        assert self._expected is not None
        self._lines, self._met = lines, meeting_points(lines, self._expected.landmarks, self._settings)

    @property
    def contradicted(self) -> int:
        """Number of landmarks whose keypoints are left out, because every image contradicts them."""
        return int(self._contradicted.sum())

    def judge(self, cameras: Mapping[str, SilhouetteCamera]) -> None:
        """Leave out the landmarks whose keypoints all images contradict; after each segmentation.

        Args:
            cameras: the cameras whose images were segmented, by name.
        """
        if self._seen is None or self._expected is None:
            return
        seen, there = self._seen, self._seen.lines.seen
        against = np.zeros_like(there)
        for c, name in enumerate(seen.cameras):
            if name in cameras:
                away = np.linalg.norm(self._expected.landmarks - seen.lines.origins[c], axis=-1)
                against[:, c] = cameras[name].contradicts(seen.pixels[:, c], self._settings.contradicts_m / away)
        contradicted = np.asarray(there.any(axis=1) & (against | ~there).all(axis=1))
        if (contradicted != self._contradicted).any():
            self._contradicted = contradicted
            self._use(seen.lines.without(contradicted))

    def misplaced_parts(self, stands: Standing) -> NDArray[np.int64]:
        """Return the parts (k,) of a body whose landmarks are not where lines meet, and the parts that carry them."""
        away = self.away_m(stands)
        return np.empty(0, np.int64) if away is None else np.flatnonzero(away > 0)

    def away_m(self, stands: Standing, limit_sd: float = MISPLACED_SD) -> Float64 | None:
        """Return how far parts (parts,) are from where their lines meet [m]; None without keypoints.

        It is the largest distance of the misplaced landmarks of a part, or of a part that it
        carries; else 0, as of the trunk.

        Args:
            stands: the body.
            limit_sd: a landmark farther away than this is misplaced [standard deviations].
        """
        if self._met is None:
            return None
        away = np.linalg.norm(stands.landmarks - self._met.points, axis=1)
        misplaced = self._met.known & self._of_limbs & (away > limit_sd * self._met.sds_m)
        out = np.zeros(len(self._parents))
        np.maximum.at(out, self._part[misplaced], away[misplaced])
        for part in np.unique(self._part[misplaced]).tolist():
            if part > 0:
                out[self._parents[part]] = max(out[self._parents[part]], out[part])
        out[self._trunk] = 0.0
        return out

    def contested(self, landmarks: Float64) -> Bool:
        """Return whether lines meet elsewhere than at each landmark (n, 3) of a limb in the world [m]; (n,) bool."""
        if self._met is None:
            return np.zeros(len(self._part), np.bool_)
        return np.asarray(self._met.known & self._of_limbs & ~self.supported(landmarks))

    def counting(self, planes: InPlanes, stands: Standing) -> InPlanes:
        """Return the planes of an outline without the planes of limbs that keypoints show elsewhere.

        Outlines are matched near the model; an edge near a misplaced limb is another thing's.

        Args:
            planes: of `SilhouetteCamera.planes`.
            stands: the body in its present pose.
        """
        away = self.away_m(stands, self._settings.agree_sd)
        if away is None or not away.any():
            return planes
        return InPlanes(planes.part, planes.points, planes.planes, np.where(away[planes.part] > 0, 0.0, planes.weights))

    def constraints(self, stands: Standing, motions: tuple[Float64, Float64]) -> list[OnLines]:
        """Return the lines of sight as constraints of the body's landmarks; empty without keypoints.

        Args:
            stands: the body in its present pose.
            motions: R (parts, 9) and t (parts, 3) of the kinematic tree in that pose.
        """
        if self._lines is None or self._met is None:
            return []
        weights = line_weights(self._lines, self._met, stands.landmarks, self._settings)
        marks, cameras = np.nonzero(weights > 0)
        part = self._part[marks]
        rest = at_rest(stands.landmarks[marks], part, motions)
        return [OnLines(part, rest, self._lines.lines[marks, cameras], weights[marks, cameras])]

    def supported(self, landmarks: Float64) -> Bool:
        """Return whether the lines of two cameras or more meet at each landmark (n, 3) in the world [m]; (n,) bool."""
        if self._met is None:
            return np.zeros(len(self._part), np.bool_)
        away = np.linalg.norm(landmarks - self._met.points, axis=1)
        return np.asarray(self._met.known & (away <= self._settings.agree_sd * self._met.sds_m))

    def supported_parts(self, landmarks: Float64) -> Bool:
        """Return the parts (parts,) that have a supported landmark, and parts without keypoints that these carry."""
        out = np.zeros(len(self._parents), np.bool_)
        if self._lines is None:
            return out
        out[self._part[self.supported(landmarks)]] = True
        judged = np.zeros(len(self._parents), np.bool_)
        judged[self._part[self._lines.seen.any(axis=1)]] = True
        for part, parent in enumerate(self._parents.tolist()):
            if parent > 0 and not judged[part]:
                out[part] = out[parent]
        return out
