"""Settings of the method ``webcams``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from mocapella.association.hand_keypoints import HandKeypointSettings
from mocapella.association.keypoint_rays import KeypointAssociationSettings
from mocapella.calibration.people_rig_live import LiveRigSettings
from mocapella.settings import check
from mocapella.tracker.webcams_memory import TIME_SD_S


def numbered_time_sd_s(rate_hz: float) -> float:
    """Return the standard deviation of the times of films whose frames of one number are called simultaneous [s].

    The true capture is anywhere within the period of the frame that is nearest: a uniform distribution.

    Args:
        rate_hz: frame rate of the films [Hz].
    """
    return 1.0 / (rate_hz * math.sqrt(12.0))


@dataclass(frozen=True)
class WebcamsSettings:
    """Settings of every stage of the method ``webcams``.

    Attributes:
        association: assignment of detections to people, and new people.
        hands: hands, and their people.
        confirm_instants: number of instants when two cameras must agree before a person is shown; larger: fewer
            phantoms, and people are shown later [count].
        sure_cameras: number of cameras whose agreement shows a person at once; larger: fewer phantoms, and people are
            shown later [count].
        unseen_s: a person whom no camera sees is lost after this time; larger: bridges longer occlusions, and people
            who leave stay longer [s].
        hidden_s: the same for a person whom other people or furniture hide from the cameras that look at the place;
            larger: bridges longer occlusions, with less certain places [s].
        one_camera_s: a person whom only one camera sees is lost after this time; larger: bridges longer occlusions,
            with a less certain distance [s].
        remember_s: a lost person who returns within this time gets the same number; larger: people return later, and
            may be confused more often [s].
        same_size: limit of the mean squared difference of the bones' lengths for a person who returns; larger: more
            are recognised, also wrongly [squared standard deviations].
        doubtful_instants: a person about whom two cameras disagree for more instants in succession is no person;
            larger: phantoms stay longer [count].
        same_within_m: two tracks nearer than this are one person; larger: close people may be merged [m].
        measured_sd_m: a joint with a larger standard deviation is inferred, not measured; larger: less certain joints
            are shown as measured [m].
        measured_s: where some cameras have no image, a joint that two cameras saw within this time, together or in
            turn, is measured; larger: slow cameras measure more joints, with larger standard deviations [s].
        slow_error_s: time over which the error of a keypoint changes; larger: larger standard deviations, and fewer
            measured joints [s].
        late_s: a frame that is older than the newest by more than this is not used; larger: slower cameras are used,
            with larger errors of moving people [s].
        time_sd_s: standard deviation of the errors of the cameras' times, which are estimated while people move;
            larger: errors are followed farther, also errors of a rig that look like them; 0: times are exact [s].
        rig_clocks: whether the clock offsets of a given rig are subtracted from the times of the frames; `mocapella
            replay --rig` sets it, because the rig may be calibrated from the recording's people.
        silent_after_s: a camera without a frame for this long is not waited for; larger: a camera that stops delays
            the others longer [s].
        missing_after_s: while people are tracked, a camera without a usable frame for this long counts as missing, and
            the state says so; larger: the state changes less often on a busy machine, and tells later of a camera that
            stops [s].
        calibration: calibration from the people, if there is no rig.
        height_m: mean stature of the people, which gives the scale if there is no rig; 0: a guess. Larger: all lengths
            are larger [m].
        start_position_m: people are tracked as soon as the cameras' positions have standard deviations below this, if
            there is no rig; larger: earlier, and less exact [m].
        start_rotation_deg: the same for the cameras' directions; larger: earlier, and less exact [°].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    association: KeypointAssociationSettings = field(default_factory=KeypointAssociationSettings)
    hands: HandKeypointSettings = field(default_factory=HandKeypointSettings)
    confirm_instants: int = 3
    sure_cameras: int = 3
    unseen_s: float = 0.7
    hidden_s: float = 2.0
    one_camera_s: float = 10.0
    remember_s: float = 300.0
    same_size: float = 1.5
    doubtful_instants: int = 15
    same_within_m: float = 0.12
    measured_sd_m: float = 0.04
    measured_s: float = 0.25
    slow_error_s: float = 0.08
    late_s: float = 0.2
    time_sd_s: float = TIME_SD_S
    rig_clocks: bool = False
    silent_after_s: float = 0.3
    missing_after_s: float = 2.0
    calibration: LiveRigSettings = field(default_factory=LiveRigSettings)
    height_m: float = 0.0
    start_position_m: float = 0.4
    start_rotation_deg: float = 2.0

    def __post_init__(self) -> None:
        check(1 <= self.confirm_instants <= 1000, "confirm_instants", self.confirm_instants, "from 1 to 1000")
        check(2 <= self.sure_cameras <= 1000, "sure_cameras", self.sure_cameras, "from 2 to 1000")
        check(0 < self.unseen_s <= 60, "unseen_s", self.unseen_s, "above 0 and at most 60 s")
        check(0 < self.hidden_s <= 60, "hidden_s", self.hidden_s, "above 0 and at most 60 s")
        check(0 < self.one_camera_s <= 600, "one_camera_s", self.one_camera_s, "above 0 and at most 600 s")
        check(0 <= self.remember_s <= 86400, "remember_s", self.remember_s, "from 0 to 86400 s")
        check(0 <= self.same_size <= 100, "same_size", self.same_size, "from 0 to 100")
        check(1 <= self.doubtful_instants <= 1000, "doubtful_instants", self.doubtful_instants, "from 1 to 1000")
        check(0 <= self.same_within_m <= 1, "same_within_m", self.same_within_m, "from 0 to 1 m")
        check(0 < self.measured_sd_m <= 1, "measured_sd_m", self.measured_sd_m, "above 0 and at most 1 m")
        check(0 <= self.measured_s <= 10, "measured_s", self.measured_s, "from 0 to 10 s")
        check(0 < self.slow_error_s <= 10, "slow_error_s", self.slow_error_s, "above 0 and at most 10 s")
        check(0 < self.late_s <= 10, "late_s", self.late_s, "above 0 and at most 10 s")
        check(0 <= self.time_sd_s <= 1, "time_sd_s", self.time_sd_s, "from 0 to 1 s")
        check(0 < self.silent_after_s <= 3600, "silent_after_s", self.silent_after_s, "above 0 and at most 3600 s")
        check(
            self.silent_after_s <= self.missing_after_s <= 3600, "missing_after_s", self.missing_after_s,
            "from silent_after_s to 3600 s",
        )  # fmt: skip
        stated = self.height_m == 0 or 0.5 <= self.height_m <= 2.5
        check(stated, "height_m", self.height_m, "from 0.5 to 2.5 m, or 0 for a guess")
        check(0 < self.start_position_m <= 10, "start_position_m", self.start_position_m, "above 0 and at most 10 m")
        check(
            0 < self.start_rotation_deg <= 45, "start_rotation_deg", self.start_rotation_deg, "above 0 and at most 45°"
        )
