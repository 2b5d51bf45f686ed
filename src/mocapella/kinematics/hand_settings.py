"""Settings and counts of the tracker of a hand (`mocapella.kinematics.hand_tracker`)."""

from __future__ import annotations

from dataclasses import dataclass, field

from mocapella.settings import check


@dataclass(frozen=True)
class HandSettings:
    """Priors of a hand's posture and motion, and thresholds for outliers and tracking states.

    Attributes:
        marker_sd_m: standard deviation of a marker's coordinate if the markers' source gives none [m].
        flexion_sd_deg: standard deviation of the flexion of the fingers' first and second joints about the posture at
            rest; larger: the posture at rest counts less [°].
        abduction_sd_deg: standard deviation of the abduction of the fingers, and of the thumb's second joint, about the
            posture at rest; larger: the posture at rest counts less [°].
        thumb_sd_deg: standard deviation of the thumb's flexions, and of its first joint's abduction, about the posture
            at rest; larger: the posture at rest counts less [°].
        coupling_sd_deg: standard deviation of a third joint's flexion about the value coupled to the second joint's, if
            it is free; larger: it follows the second joint less [°].
        posture_every_s: period after which the posture at rest counts once more while a hand is followed; larger: it
            counts less [s].
        angle_rate_deg_s: standard deviation of an angle's unpredicted speed, which changes every sixtieth of a second;
            larger: less lag, more jitter [°/s].
        palm_rate_m_s: the same of each direction of the palm's motion [m/s].
        palm_rate_deg_s: the same of the palm's rotation about each axis [°/s].
        velocity_memory_s: time constant of the decay of velocities while no marker is seen; measured velocities are
            smoothed with half of it; larger: the motion is extrapolated farther, and changes later [s].
        outlier_sd: distance from the fitted hand above which a marker is rejected, the farthest first, at most two in a
            frame; larger: fewer are rejected [standard deviations].
        tracked_sd_m: a landmark is tracked if its standard deviation from the present markers alone is at most this;
            larger: fewer landmarks are inferred [m].
        forget_after_s: time without markers after which the hand is forgotten [s].
        most_iterations: largest number of iterations of a fit; larger: more accurate after sudden motion, at more work
            [iterations].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    marker_sd_m: float = 0.001
    flexion_sd_deg: float = 60.0
    abduction_sd_deg: float = 8.0
    thumb_sd_deg: float = 20.0
    coupling_sd_deg: float = 12.0
    posture_every_s: float = 0.1
    angle_rate_deg_s: float = 100.0
    palm_rate_m_s: float = 0.4
    palm_rate_deg_s: float = 90.0
    velocity_memory_s: float = 0.3
    outlier_sd: float = 8.0
    tracked_sd_m: float = 0.015
    forget_after_s: float = 0.5
    most_iterations: int = 20

    def __post_init__(self) -> None:
        for name in ("marker_sd_m", "palm_rate_m_s", "tracked_sd_m", "velocity_memory_s", "forget_after_s",
                     "posture_every_s"):  # fmt: skip
            check(0 < getattr(self, name) < 1e3, name, getattr(self, name), "above 0, below 1000")
        for name in ("flexion_sd_deg", "abduction_sd_deg", "thumb_sd_deg", "coupling_sd_deg"):
            check(0 < getattr(self, name) <= 360, name, getattr(self, name), "above 0, at most 360")
        for name in ("angle_rate_deg_s", "palm_rate_deg_s"):
            check(0 < getattr(self, name) < 1e5, name, getattr(self, name), "above 0")
        check(self.outlier_sd >= 1, "outlier_sd", self.outlier_sd, "1 or more")
        check(1 <= self.most_iterations <= 1000, "most_iterations", self.most_iterations, "1 to 1000")


@dataclass
class HandReport:
    """Counts of frames and markers.

    Attributes:
        frames: number of frames.
        fitted: number of frames with a hand fitted to markers.
        predicted: number of frames with a hand that is only predicted.
        lost: number of frames without a hand.
        found: number of times the hand was acquired or re-acquired.
        markers: sum over all frames of the number of markers seen.
        rejected: number of rejections of each marker as an outlier: fingertips, then the base's.
        missing: number of frames without each marker, in the same order.
    """

    frames: int = 0
    fitted: int = 0
    predicted: int = 0
    lost: int = 0
    found: int = 0
    markers: int = 0
    rejected: list[int] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)
