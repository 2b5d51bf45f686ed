"""The settings of the method ``silhouettes``."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from mocapella.kinematics.limb_search import LimbSearchSettings
from mocapella.kinematics.silhouette_fit import CorrespondenceSettings
from mocapella.kinematics.twist_prediction import JitterPenalty
from mocapella.sensing.background_memory import MemorySettings
from mocapella.sensing.region_contour import RegionSettings
from mocapella.settings import check


@dataclass(frozen=True)
class Steadiness:
    """The penalty on jitter, as the accelerations that people have: what is more costs.

    Most of it is on points of the skin: what images hardly say of a body, such as how its pelvis is turned in it,
    hardly moves its skin either, so that it is held neither more nor less than what they say clearly. Who moves fast,
    or was just accelerated, may be accelerated more.

    Attributes:
        point_m_per_s2: of a point of the skin that has not moved [m/s²] …
        point_per_s: … and so much for its speed [1/s] …
        point_per_past: … and so many times as much as it was accelerated lately.
        root_m_per_s2: of the body's place [m/s²].
        root_rad_per_s2: of its orientation [rad/s²].
        angle_rad_per_s2: of a joint [rad/s²].
        beside_skin: so many times as much may these three be where the skin is held, too. Where one camera alone sees
            the body it is not: how far away somebody is hardly shows there, and all of the skin moves with that.
        turn_rad_per_s: of a limb about itself, which hardly shows where it is straight: not the acceleration, the speed
            [rad/s].
    """

    point_m_per_s2: float = 24.0
    point_per_s: float = 40.0
    point_per_past: float = 4.0
    root_m_per_s2: float = 20.0
    root_rad_per_s2: float = 150.0
    angle_rad_per_s2: float = 150.0
    beside_skin: float = 1.5
    turn_rad_per_s: float = 3.0

    def __post_init__(self) -> None:
        may_be_0 = ("point_per_s", "point_per_past")
        for name in may_be_0:
            check(0 <= getattr(self, name) < np.inf, name, getattr(self, name), "0 or more")
        for name in (one.name for one in fields(self) if one.name not in may_be_0):
            check(0 < getattr(self, name) < np.inf, name, getattr(self, name), "above 0")

    def penalty(self, per_s2: float) -> JitterPenalty:
        """Where an acceleration of 1 brings the body away by 1 / ``per_s2``."""
        return JitterPenalty(per_s2 / self.root_m_per_s2, per_s2 / self.root_rad_per_s2, per_s2 / self.angle_rad_per_s2)

    def times(self, weight: float) -> Steadiness:
        """The same penalty, so many times as strong; not 0."""
        s = 1.0 / np.sqrt(weight)  # accelerations are standard deviations: a cost has their inverse squares
        times = {one.name: float(s * getattr(self, one.name)) for one in fields(self)}
        return Steadiness(**{**times, "beside_skin": self.beside_skin})


@dataclass(frozen=True)
class SilhouetteSettings:
    """The settings of every stage.

    Attributes:
        steadiness: the penalty on jitter; None: there is none.
        region: how an image is segmented, for samples of two pixels.
        closer: the same where the body is nearly where it should be: the last time that a frame is segmented.
        background: how what is behind people is learnt; None: it is not, as where cameras move.
        limbs: how a limb that went astray is looked for; None: it is not.
        correspondences: how outlines are brought together.
        step_px: images are looked at in squares of so many pixels; 0: so that a body is about 200 of them high.
        margin_steps: how far from where the body is expected its outline is looked for.
        rounds: how often a pose is fitted to a frame; once less where the first time did not move the body.
        segmented: in how many of these rounds, the first ones, the images are segmented; once where that did not move
            the body.
        expected_steps: a body that is so near to where it was expected, in samples, is looked for as `closer` says.
        settled_steps: the first round has moved it where it has moved it farther.
        usual_per_rad: how little angles that nothing shows stray from the resting pose [1/rad].
        unlike: a camera of whose background more than this share of what usually is as it was is not, shows something
            else.
        something_else_s: after so long it is taken for a new background: the light changed, or the camera moved [s].
    """

    steadiness: Steadiness | None = field(default_factory=Steadiness)
    region: RegionSettings = field(default_factory=lambda: RegionSettings(band_px=16.0, length_weight=3.0))
    closer: RegionSettings = field(
        default_factory=lambda: RegionSettings(prior_weight=0.2, band_px=8.0, window_px=16.0, length_weight=3.0)
    )
    background: MemorySettings | None = field(default_factory=MemorySettings)
    limbs: LimbSearchSettings | None = field(default_factory=LimbSearchSettings)
    correspondences: CorrespondenceSettings = field(default_factory=CorrespondenceSettings)
    step_px: int = 0
    margin_steps: int = 12
    rounds: int = 3
    segmented: int = 2
    expected_steps: float = 1.0
    settled_steps: float = 2.0
    usual_per_rad: float = 3.0
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
        check(0 < self.unlike <= 1, "unlike", self.unlike, "above 0 and at most 1")
        check(self.something_else_s > 0, "something_else_s", self.something_else_s, "above 0 s")
