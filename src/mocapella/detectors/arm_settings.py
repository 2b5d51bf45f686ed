"""Settings of the detector ``kinematic-arm``.

They control detection (search, rejection, non-maximum suppression), tracking (loss, re-detection), segmentation and
fit.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from mocapella.kinematics.arm_fit import ArmFitSettings
from mocapella.sensing.arm_region import ArmRegionSettings
from mocapella.settings import check


@dataclass(frozen=True)
class KinematicArmSettings:
    """Parameters of detection and tracking. A cost is that of a fit, `Fitted.cost`.

    Attributes:
        arms: largest number of arms that are tracked [arms].
        hand_length_m: length of the average hand, from the wrist to the tip of the middle finger; fitted sizes are near
            it [m].
        believe: cost above which a new fit is rejected; larger: more arms are found, also false ones [cost].
        keep: cost above which the fit of a tracked arm is doubtful; larger: arms are lost more rarely, also false ones
            [cost].
        digits: number of digits tested in each image for a better posture; all are tested while an arm is in doubt;
            larger: wrong postures are corrected sooner, at more work [digits].
        gain: least expected reduction of the cost for fitting another posture; larger: less work, and more wrong
            postures [cost].
        doubt: cost above which an arm is in doubt; a rise by a quarter counts, too; larger: less work, and more wrong
            postures [cost].
        better: share of the present pose's cost below which another pose replaces it; larger: postures are replaced
            more often [0 to 1].
        look_again_after: number of images in doubt before a hand is searched anew at its position; doubled each time
            nothing better is found; an arm without a good fit yet begins with 3; larger: less work, later corrections
            [images].
        firm: cost below which a new arm is reported; after several images below it, no replacement is searched; larger:
            arms are reported sooner, also false ones [cost].
        firm_in_blocks: cost below which a new arm is reported where the camera makes things wider; larger: arms are
            reported sooner, also false ones [cost].
        fattening_px: by how much the camera makes near things wider, on each side, as stereo cameras do; -1: found out
            from the first arms [px].
        independent_s: images further apart do not continue each other: arms are detected anew; 0: in every image [s].
        refuse_for: number of images for which a place without an arm is not searched again; eight times as many while
            an arm is tracked, and doubled each time; larger: less work, later arms [images].
        lost_after: number of successive doubtful images (see ``keep``) after which an arm is lost; larger: arms are
            lost more rarely, and false ones last longer [images].
        look_every: number of images between two searches for further arms where the foreground changed, while one is
            tracked; larger: less work, later arms [images].
        look_anyway_every: number of images between two searches of the whole image, while an arm is tracked; larger:
            less work, later arms [images].
        region, fit: settings of the segmentation and of the fit.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    arms: int = 2
    hand_length_m: float = 0.189
    believe: float = 0.30
    keep: float = 0.38
    digits: int = 2
    gain: float = 0.006
    doubt: float = 0.14
    better: float = 0.93
    look_again_after: int = 12
    firm: float = 0.19
    firm_in_blocks: float = 0.30
    fattening_px: int = -1
    independent_s: float = 0.3
    refuse_for: int = 8
    lost_after: int = 3
    look_every: int = 20
    look_anyway_every: int = 150
    region: ArmRegionSettings = field(default_factory=ArmRegionSettings)
    fit: ArmFitSettings = field(default_factory=ArmFitSettings)

    def __post_init__(self) -> None:
        check(1 <= self.arms <= 8, "arms", self.arms, "1 to 8")
        check(0.1 <= self.hand_length_m <= 0.3, "hand_length_m", self.hand_length_m, "0.1 to 0.3 m")
        check(0 < self.believe <= self.keep < 2, "believe", self.believe, "above 0, at most keep, which is below 2")
        check(1 <= self.digits <= 5, "digits", self.digits, "1 to 5")
        check(0 < self.gain < 2, "gain", self.gain, "above 0, below 2")
        check(0 < self.doubt < 2, "doubt", self.doubt, "above 0, below 2")
        check(0 < self.better <= 1, "better", self.better, "above 0, at most 1")
        check(0 < self.firm < 2, "firm", self.firm, "above 0, below 2")
        check(0 < self.firm_in_blocks < 2, "firm_in_blocks", self.firm_in_blocks, "above 0, below 2")
        check(-1 <= self.fattening_px <= 15, "fattening_px", self.fattening_px, "-1 to 15")
        check(1 <= self.look_again_after <= 1000, "look_again_after", self.look_again_after, "1 to 1000")
        check(0 <= self.independent_s <= 3600, "independent_s", self.independent_s, "0 to 3600")
        check(1 <= self.refuse_for <= 100_000, "refuse_for", self.refuse_for, "1 to 100000")
        check(1 <= self.lost_after <= 1000, "lost_after", self.lost_after, "1 to 1000")
        check(1 <= self.look_every <= 1000, "look_every", self.look_every, "1 to 1000")
        check(1 <= self.look_anyway_every <= 100_000, "look_anyway_every", self.look_anyway_every, "1 to 100000")
