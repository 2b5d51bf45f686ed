"""The settings of the method ``silhouettes``.

They are the settings of segmentation, background model, correspondences, smoothness prior, limb recovery and image
rejection.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Final

import numpy as np

from mocapella.errors import SettingsError, one_of
from mocapella.kinematics.keypoint_lines import KeypointLineSettings
from mocapella.kinematics.limb_search import LimbSearchSettings
from mocapella.kinematics.silhouette_fit import CorrespondenceSettings
from mocapella.kinematics.twist_prediction import JitterPenalty
from mocapella.sensing.background_memory import MemorySettings
from mocapella.sensing.region_contour import RegionSettings
from mocapella.settings import check

REJECTIONS: Final = ("adaptive", "none")
"""Ways to reject images: by adaptive thresholds of each camera, or not at all."""


@dataclass(frozen=True)
class Steadiness:
    """Smoothness prior (penalty on jitter): standard deviations of people's accelerations.

    Most of it acts on points of the surface. Parameters that images hardly determine, such as the rotation of the
    pelvis within the body, hardly move the surface either, so they are constrained as much as well-determined ones.
    Fast or recently accelerated points may accelerate more.

    Attributes:
        point_m_per_s2: standard deviation of the acceleration of a point of the surface at rest; larger: less lag, more
            jitter [m/s²].
        point_per_s: this times a point's speed is added to its standard deviation, in squares; larger: less lag in
            motion, more jitter [1/s].
        point_per_past: this times a point's recent acceleration is added to its standard deviation, in squares; larger:
            less lag after sudden motion, more jitter [ratio].
        root_m_per_s2: standard deviation of the acceleration of the body's position; larger: less lag, more jitter
            [m/s²].
        root_rad_per_s2: standard deviation of the angular acceleration of the body's orientation; larger: less lag,
            more jitter [rad/s²].
        angle_rad_per_s2: standard deviation of the angular acceleration of a joint; larger: less lag, more jitter
            [rad/s²].
        beside_skin: factor of ``root_m_per_s2``, ``root_rad_per_s2`` and ``angle_rad_per_s2`` while the surface is
            constrained, too. With only one camera the surface is not constrained, because the distance is hardly
            visible and moves all of it [ratio].
        turn_rad_per_s: standard deviation of the speed, not acceleration, of a limb's rotation about itself, which is
            hardly visible if the limb is straight; larger: less lag, more jitter [rad/s].
        still_m: standard deviation of a point of a part about which no image changes, from where it came to rest;
            larger: contours of other things move it more, and a wrong pose is corrected sooner [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    point_m_per_s2: float = 24.0
    point_per_s: float = 40.0
    point_per_past: float = 4.0
    root_m_per_s2: float = 20.0
    root_rad_per_s2: float = 150.0
    angle_rad_per_s2: float = 150.0
    beside_skin: float = 1.5
    turn_rad_per_s: float = 3.0
    still_m: float = 0.005

    def __post_init__(self) -> None:
        may_be_0 = ("point_per_s", "point_per_past")
        for name in may_be_0:
            check(0 <= getattr(self, name) < np.inf, name, getattr(self, name), "0 or more")
        for name in (one.name for one in fields(self) if one.name not in may_be_0):
            check(0 < getattr(self, name) < np.inf, name, getattr(self, name), "above 0")

    def penalty(self, per_s2: float) -> JitterPenalty:
        """Return the weights of the smoothness prior on deviations of root and angles from the predicted pose.

        Args:
            per_s2: 1 / T², T the time between two frames: an acceleration a displaces the body from the
                prediction at constant velocity by a · T² [1/s²].
        """
        return JitterPenalty(per_s2 / self.root_m_per_s2, per_s2 / self.root_rad_per_s2, per_s2 / self.angle_rad_per_s2)

    def times(self, weight: float) -> Steadiness:
        """Return settings whose penalty is multiplied by ``weight``, above 0; larger: less jitter, more lag."""
        s = 1.0 / np.sqrt(weight)  # accelerations are standard deviations: a cost has their inverse squares
        times = {one.name: float(s * getattr(self, one.name)) for one in fields(self)}
        return Steadiness(**{**times, "beside_skin": self.beside_skin, "still_m": self.still_m})


@dataclass(frozen=True)
class SilhouetteSettings:
    """The settings of every stage.

    Attributes:
        steadiness: smoothness prior, the penalty on jitter; None for none.
        region: segmentation of an image, for samples of two pixels.
        closer: segmentation near the final pose, for the last segmentation of a frame.
        background: learning of the background; None for moving cameras.
        limbs: recovery of misplaced limbs; None for none.
        correspondences: matching of outlines.
        keypoints: weights of people's keypoints, where there are any.
        step_px: stride of the sampled pixels; 0 chooses it so that a body is about 200 samples high; larger: less work,
            less accurate. Lengths and areas of ``region`` and ``closer`` are of a stride of 2 px, and scale with it
            [px].
        margin_steps: distance from the predicted body within which its outline is searched; larger: faster motion is
            found, at more work [samples].
        rounds: pose fits per frame; one less if the first did not move the body; larger: more accurate, at more work
            [rounds].
        segmented: number of rounds, from the first, in which the images are segmented; only the first if it did not
            move the body; larger: more accurate, at more work [rounds].
        expected_steps: if the last frame's body was within this distance of its prediction, the settings ``closer`` are
            used at once; larger: less work, and sudden motion may be missed [samples].
        settled_steps: the first round counts as having moved the body if it moved it farther than this; larger: less
            work, less accurate [samples].
        usual_per_rad: weight of the resting pose, as the inverse of an angle's standard deviation about it; larger:
            hidden limbs stay nearer to it [1/rad].
        rejection: which images do not count: ``adaptive`` leaves out dead images, and images of something else by
            thresholds of each camera; ``none`` uses every image, to measure the penalty on jitter alone.
        unlike: an image is rejected if more than this fraction of the usually unchanged background has changed; larger:
            fewer images are rejected [0 to 1].
        something_else_s: after being rejected for so long, an image becomes the new background, because the light has
            changed or the camera has moved [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    steadiness: Steadiness | None = field(default_factory=Steadiness)
    region: RegionSettings = field(default_factory=lambda: RegionSettings(band_px=16.0, length_weight=3.0))
    closer: RegionSettings = field(
        default_factory=lambda: RegionSettings(prior_weight=0.2, band_px=8.0, window_px=16.0, length_weight=3.0)
    )
    background: MemorySettings | None = field(default_factory=MemorySettings)
    limbs: LimbSearchSettings | None = field(default_factory=LimbSearchSettings)
    correspondences: CorrespondenceSettings = field(default_factory=CorrespondenceSettings)
    keypoints: KeypointLineSettings = field(default_factory=KeypointLineSettings)
    step_px: int = 0
    margin_steps: int = 12
    rounds: int = 3
    segmented: int = 2
    expected_steps: float = 1.0
    settled_steps: float = 2.0
    usual_per_rad: float = 3.0
    rejection: str = "adaptive"
    unlike: float = 0.2
    something_else_s: float = 0.5

    def __post_init__(self) -> None:
        check(self.step_px >= 0, "step_px", self.step_px, "0 or more")
        check(2 <= self.margin_steps <= 100, "margin_steps", self.margin_steps, "2 to 100")
        check(self.rounds >= 1, "rounds", self.rounds, "1 or more")
        check(1 <= self.segmented <= self.rounds, "segmented", self.segmented, f"1 to {self.rounds}")
        check(self.expected_steps >= 0, "expected_steps", self.expected_steps, "0 or more")
        check(self.settled_steps >= 0, "settled_steps", self.settled_steps, "0 or more")
        check(self.usual_per_rad >= 0, "usual_per_rad", self.usual_per_rad, "0 or more")
        if self.rejection not in REJECTIONS:
            raise SettingsError(f"rejection is {self.rejection!r}; it must be {one_of(self.rejection, REJECTIONS)}")
        check(0 < self.unlike <= 1, "unlike", self.unlike, "above 0 and at most 1")
        check(self.something_else_s > 0, "something_else_s", self.something_else_s, "above 0 s")
