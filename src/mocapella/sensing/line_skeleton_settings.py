"""The settings of `mocapella.sensing.line_skeleton`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mocapella.settings import check


@dataclass(frozen=True)
class LineSkeletonSettings:
    """Thresholds and sizes of the stages; values that the source document gives are kept.

    Attributes:
        near_m: least depth of the cube region, along the optical axis [m].
        far_m: greatest depth of the cube region; to the sides of the axis it reaches as far as half the difference of
            ``far_m`` and ``near_m`` [m].
        reach_m: distance of the threshold behind the nearest part of the image; larger: more of a bent arm is seen. A
            torso nearer than that to the arm counts as part of it [m].
        median_px: size of the median blur, odd; 1 for none; larger: less noise, and thin fingers vanish [px].
        gaussian_px: size of the Gaussian blur, odd; larger: less noise, and thin fingers vanish [px].
        canny_low: lower threshold of the Canny edge detector's hysteresis, for the Sobel gradient: weaker gradients are
            no edges [grey levels].
        canny_high: upper threshold of the Sobel gradient: stronger gradients begin an edge, which weaker ones above
            ``canny_low`` continue; larger: fewer edges [grey levels].
        least_area_px: least area of an outline; larger: small or distant arms are ignored [px²].
        mirror: whether the image is mirrored. It decides which end of a level arm is the elbow, and which end of the
            fingers is the thumb.
        noise: replacement for unmeasured pixels in the region: ``far`` uses noise_m, ``median`` the median of the
            measured ones among the eight neighbours.
        noise_m: depth that replaces unmeasured pixels if ``noise`` is ``far`` [m].
        ridge_least: least ridge strength, 0 to 255, of a thin line, see
            `mocapella.sensing.line_skeleton_thinning.skeleton`; larger: fewer side branches [grey levels].
        hough_votes: least number of votes of a line in the probabilistic Hough transform; larger: fewer lines [votes].
        hough_length_px: least length of a line in the Hough transform; larger: fewer lines [px].
        hough_gap_px: largest gap between pixels of one line in the Hough transform; larger: fewer, longer lines [px].
        corner_part: least strength of a Harris corner, as a share of the strongest; larger: fewer corners that may be
            fingertips [0 to 1].
        least_hull_px2: least area of a convex hull; smaller ones are ignored [px²].
        finger_degrees: greatest angle between a finger and the direction elbow–palm or elbow–wrist [°].
        angle_at: vertex of that angle: palm or wrist.
        tip_radius_m: radius of a disc around a corner, see ``tip_fill_most`` [m].
        tip_fill_most: a corner is a fingertip if the arm covers at most this share of the disc of ``tip_radius_m``
            around it; larger: blunter corners are fingertips [0 to 1].
        palm_forward_m: distance by which the reported palm is nearer to the camera than its pixel's surface [m].
        blob_nearer_m: a part of the hand nearer than the palm by this may be a finger in front of it, a blob; larger:
            fewer blobs [m].
        blob_least_m2: least area of a blob, at its distance; larger: fewer blobs [m²].
        grid_px: stride of the point grid; larger: less work, and small blobs are missed [px].
        longest_m: largest distance of a fingertip from the palm; one farther away is placed at the palm [m].
        fills_most: greatest share of the image that an arm covers; more is no arm [0 to 1].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    near_m: float = 0.2
    far_m: float = 1.4
    reach_m: float = 0.15
    median_px: Literal[1, 3, 5] = 5
    gaussian_px: int = 5
    canny_low: float = 50.0
    canny_high: float = 150.0
    least_area_px: float = 2000.0
    mirror: bool = True
    noise: Literal["far", "median"] = "far"
    noise_m: float = 3.0
    ridge_least: int = 128
    hough_votes: int = 20
    hough_length_px: float = 20.0
    hough_gap_px: float = 8.0
    corner_part: float = 0.05
    least_hull_px2: float = 1000.0
    finger_degrees: float = 110.0
    angle_at: Literal["palm", "wrist"] = "palm"
    tip_radius_m: float = 0.018
    tip_fill_most: float = 0.5
    palm_forward_m: float = 0.02
    blob_nearer_m: float = 0.02
    blob_least_m2: float = 1e-4
    grid_px: int = 4
    longest_m: float = 1.5
    fills_most: float = 0.6

    def __post_init__(self) -> None:
        check(0 < self.near_m < self.far_m <= 20, "near_m", self.near_m, f"above 0 and below far_m, {self.far_m}")
        for name in ("reach_m", "noise_m", "longest_m", "tip_radius_m", "blob_nearer_m"):
            check(0 < getattr(self, name) <= 20, name, getattr(self, name), "above 0 and at most 20 m")
        check(self.median_px in (1, 3, 5), "median_px", self.median_px, "1, 3 or 5")
        check(
            self.gaussian_px % 2 == 1 and 1 <= self.gaussian_px <= 31, "gaussian_px", self.gaussian_px, "odd, 1 to 31"
        )
        check(0 < self.canny_low <= self.canny_high, "canny_low", self.canny_low, "above 0, at most canny_high")
        for name in ("least_area_px", "least_hull_px2", "hough_length_px", "hough_gap_px", "blob_least_m2"):
            check(getattr(self, name) >= 0, name, getattr(self, name), "0 or more")
        check(self.noise in ("far", "median"), "noise", self.noise, "far or median")
        check(self.angle_at in ("palm", "wrist"), "angle_at", self.angle_at, "palm or wrist")
        check(0 <= self.ridge_least <= 255, "ridge_least", self.ridge_least, "0 to 255")
        check(self.hough_votes >= 1, "hough_votes", self.hough_votes, "1 or more")
        for name in ("corner_part", "tip_fill_most", "fills_most"):
            check(0 < getattr(self, name) <= 1, name, getattr(self, name), "above 0 and at most 1")
        check(0 < self.finger_degrees <= 180, "finger_degrees", self.finger_degrees, "above 0, at most 180")
        check(abs(self.palm_forward_m) <= 0.1, "palm_forward_m", self.palm_forward_m, "at most 0.1 m")
        check(1 <= self.grid_px <= 50, "grid_px", self.grid_px, "1 to 50")
