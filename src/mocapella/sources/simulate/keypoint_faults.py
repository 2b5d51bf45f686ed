"""Faults of detectors that the recordings here do not show: their rates are assumed.

The measured errors are in `keypoint_errors`. The clips that they were measured on show one person, without swaps and
almost without occlusion by others, so what happens in crowds is set here. The defaults are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

from mocapella.settings import check


@dataclass(frozen=True)
class KeypointFaults:
    """Rates and sizes of faults of a simulated detector and its camera.

    Attributes:
        noise: factor of the measured errors; larger: less accurate [ratio].
        hidden_noise: factor of the errors of hidden keypoints, besides; larger: less accurate [ratio].
        hidden_missing: probability that a hidden keypoint is not reported; larger: fewer [ratio].
        taken: probability that a keypoint that another person hides is reported at that person's same keypoint;
            larger: more [ratio].
        mirrored: probabilities that left and right of a person seen from the front, side and back are swapped;
            larger: more [ratio].
        legs_mirrored: probability that left and right of the legs are swapped; larger: more [ratio].
        mirrored_s: time constant of swaps; larger: longer, rarer swaps [s].
        missed: probabilities that a person is not detected, by the visible share of the keypoints, 0 to 25 %, to 50 %,
            to 75 %, to 100 %; larger: more [ratio].
        missed_s: time constant of missed people and missing keypoints; larger: longer, rarer gaps [s].
        merged: probability that two people whose keypoints are close in the image are one detection with keypoints of
            both; larger: more [ratio].
        duplicates: probability that a detected person is detected twice; larger: more [ratio].
        false_per_image: mean number of detections that are no person; larger: more [1/image].
        noise_px: standard deviation of a further error that does not depend on the size, as of small people in a coarse
            image; larger: less accurate [px].
        exchanged_limbs: probability that two people whose keypoints are close in the image exchange an arm or a leg;
            larger: more [ratio].
        taken_limbs: probability that a person gets an arm or a leg of a person nearby, who then lacks it; larger: more
            [ratio].
        split: probability that a person is detected in two parts, above and below the hips; larger: more [ratio].
        snapped: probability that a keypoint that furniture or a person hides is reported on the way to the next visible
            keypoint of the limb, as at the edge of a table; larger: more [ratio].
        furniture: mean number of places of an image where a person seems to be at times, such as a coat on a chair;
            larger: more [1/image].
        unrelated_confidences: probability that a keypoint's confidence has nothing to do with its error; larger: more
            [ratio].
        step_px: coordinates are rounded to multiples of it, 0 for none; larger: coarser [px].
        least_px: least stature in the image at which a person is detected; larger: fewer people [px].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    noise: float = 1.0
    hidden_noise: float = 1.5
    hidden_missing: float = 0.3
    taken: float = 0.3
    mirrored: tuple[float, float, float] = (0.001, 0.01, 0.02)
    legs_mirrored: float = 0.01
    mirrored_s: float = 0.15
    missed: tuple[float, float, float, float] = (0.9, 0.35, 0.06, 0.005)
    missed_s: float = 0.1
    merged: float = 0.1
    duplicates: float = 0.005
    false_per_image: float = 0.05
    noise_px: float = 0.0
    exchanged_limbs: float = 0.0
    taken_limbs: float = 0.0
    split: float = 0.0
    snapped: float = 0.0
    furniture: float = 0.0
    unrelated_confidences: float = 0.0
    step_px: float = 0.0
    least_px: float = 25.0

    def __post_init__(self) -> None:
        for name in ("noise", "hidden_noise"):
            check(0 <= getattr(self, name) <= 20, name, getattr(self, name), "from 0 to 20")
        shares = ("hidden_missing", "taken", "legs_mirrored", "merged", "duplicates")
        for name in (*shares, "exchanged_limbs", "taken_limbs", "split", "snapped", "unrelated_confidences"):
            check(0 <= getattr(self, name) <= 1, name, getattr(self, name), "from 0 to 1")
        for name in ("mirrored", "missed"):
            check(all(0 <= one <= 1 for one in getattr(self, name)), name, getattr(self, name), "each from 0 to 1")
        for name in ("mirrored_s", "missed_s"):
            check(0 < getattr(self, name) <= 60, name, getattr(self, name), "above 0 and at most 60 s")
        check(0 <= self.false_per_image <= 20, "false_per_image", self.false_per_image, "from 0 to 20")
        check(0 <= self.furniture <= 20, "furniture", self.furniture, "from 0 to 20")
        check(0 <= self.noise_px <= 64, "noise_px", self.noise_px, "from 0 to 64 px")
        check(0 <= self.step_px <= 64, "step_px", self.step_px, "from 0 to 64 px")
        check(0 <= self.least_px <= 1000, "least_px", self.least_px, "from 0 to 1000 px")


NO_FAULTS = KeypointFaults(
    noise=0.0, hidden_noise=1.0, hidden_missing=0.0, taken=0.0, mirrored=(0.0, 0.0, 0.0), legs_mirrored=0.0,
    missed=(0.0, 0.0, 0.0, 0.0), merged=0.0, duplicates=0.0, false_per_image=0.0, least_px=0.0,
)  # fmt: skip
"""A detector that reports every keypoint in the image exactly, also hidden ones."""
