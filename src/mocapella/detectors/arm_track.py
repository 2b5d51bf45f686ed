"""A tracked arm: its state, and its prediction for the next image.

The prediction is that of an alpha-beta filter with constant velocity; its uncertainty is the prior of the next fit. An
arm at rest is predicted where it is, and its prior has a narrow part as well (`Expected.steady`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.detectors.arm_finding import SUREST
from mocapella.detectors.arm_settings import KinematicArmSettings
from mocapella.kinematics.arm_fit import ArmFitSettings, ArmModel, ArmPose, Expected, Fitted
from mocapella.kinematics.arm_fit import kernels as fit_kernels
from mocapella.model.hand import TIPS, Handedness
from mocapella.sensing.arm_region import Region

Float64 = NDArray[np.float64]


class CameraArmTrack:
    """An arm that is tracked in one camera's images; `KinematicArmDetector` updates its attributes.

    The constructor takes side, model, fitted, at_s and wait.

    Attributes:
        side, model: side of the hand, and the arm's model.
        fitted: the newest fit.
        begun: the fit that the next image is fitted from instead, see `arm_finding.Found`; None after it.
        at_s: capture time of the fitted image [s]; `move` does not change it.
        drift: (6 + n,) exponential mean of the motions between images, of palm and angles as in ``velocity``, in
            standard deviations of an arm at rest; noise has a mean of 0. A new arm counts as moving.
        velocity: (6 + n,) velocity of the palm, in its frame [m/s, rad/s], and of n free angles [rad/s]; at first 0.
        id: number of the arm; -1 for a candidate that is not tracked yet.
        doubtful: number of successive images with a cost above the setting ``keep``.
        proven: whether any fit so far was good; only then is its first pose trusted.
        in_doubt: number of images with a doubtful posture, see the setting ``doubt``; successive ones once ``proven``.
        firm: counter, 0 to 5: up by 1 for an image with a cost below the setting ``firm``, else down by 1.
        next_digit: index of the digit that is tested next for a better posture.
        wait: value of ``in_doubt`` at which the hand is searched anew.
        sure: certainty of its side, 0.5 to `SUREST`.
        believed: whether its cost was once below the setting ``firm``; only such arms are reported.
        unclear: (23,) landmarks that another fit, which was nearly as good, had elsewhere when the arm was found.
        clear: (5,) whether each fingertip is clear: every posture of its digit with the tip elsewhere fits worse.
        shown: (23,) visible shares of the landmarks in the last two reported images, the last one first.
        calm: lowest cost of late: it rises by 1 % with each image unless a lower one comes.
        region: the part of the image that ``fitted`` is a fit to; None at first.
    """

    def __init__(self, side: Handedness, model: ArmModel, fitted: Fitted, at_s: float, wait: int) -> None:
        self.side, self.model, self.fitted, self.at_s = side, model, fitted, at_s
        self.id = -1
        self.begun: Fitted | None = None
        self.velocity = np.zeros(6 + len(fitted.pose.z))
        self.drift = np.full(6 + len(fitted.pose.z), _NEW_DRIFT)
        self.doubtful = self.in_doubt = self.firm = self.next_digit = 0
        self.wait, self.sure, self.believed, self.proven = min(wait, _SOON), SUREST, False, False
        self.calm = fitted.cost
        self.region: Region | None = None
        self.unclear = np.zeros(23, np.bool_)
        self.clear = np.zeros(5, np.bool_)
        self.shown: tuple[Float64, ...] = ()

    def move(self, fitted: Fitted, dt: float) -> None:
        """Set the fit of the next image, ``dt`` [s] after the last one, above 0; update the smoothed velocity."""
        motion = _motion(self.fitted.pose, fitted.pose)
        self.velocity = 0.6 * motion / dt + 0.4 * self.velocity
        self.drift += _DRIFT_GAIN * (motion / _rest_sd(len(motion)) - self.drift)
        self.fitted, self.calm = fitted, min(_CALM_RISES * self.calm, fitted.cost)

    def check(self, digit: int, clearness: float) -> None:
        """Note how clear a digit's fingertip is, `HeldOtherwise.clearness`; noise alone does not change the result."""
        self.clear[digit] = clearness > (_STILL_CLEAR if self.clear[digit] else _CLEAR)

    def confirmed(self, shown: Float64) -> Float64:
        """Return visible shares (23,), of fingertips at most the larger one of the last two images; keep this image's.

        In a fist a hidden fingertip may be next to another surface in a single image.
        """
        before = self.shown or (shown,)
        self.shown = (shown, before[0])
        shares = shown.copy()
        shares[[*TIPS]] = np.minimum(shown, np.max(before, axis=0))[[*TIPS]]
        return shares

    def prove(self, s: KinematicArmSettings) -> None:
        """Note the arm's first good fit, below a share of the setting ``doubt``; from then on it waits for longer."""
        if not self.proven and self.fitted.cost < _PROVEN * s.doubt:
            self.proven, self.wait = True, s.look_again_after

    def count_doubt(self, doubt: bool, s: KinematicArmSettings) -> None:
        """Count a further image in doubt, or end the doubt; until the arm is proven, only a good fit ends it."""
        self.prove(s)
        if doubt:
            self.in_doubt += 1
        elif self.proven:
            self.in_doubt = 0

    def is_due(self, s: KinematicArmSettings) -> bool:
        """Return whether the hand is to be searched anew; not so soon with a cost of at least the setting ``firm``.

        Such an arm is perhaps none, and about to be lost.
        """
        poor = self.fitted.cost >= s.firm
        return self.in_doubt >= (max(self.wait, s.look_again_after) if poor else self.wait)

    def predicted(self, dt: float) -> ArmPose:
        """Extrapolate the pose by ``dt`` [s] at constant velocity, within the joint limits; joint angles by half of it.

        An arm at rest (`rests`) has no velocity but noise's, so its share is left out.
        At most 0.1 s is extrapolated. Half of the angular velocity is used because fingers often stop or reverse.
        """
        model, pose = self.model, self.fitted.pose.copied()
        step = self.velocity * min(dt, 0.1)
        step[6:] *= 0.5
        step *= 1.0 - self.rests
        turned = np.empty(9)
        fit_kernels().turned(pose.R, 0, step[3], step[4], step[5], turned)
        t = pose.t + pose.R.reshape(3, 3) @ step[:3]
        z = pose.z + step[6:]
        fit_kernels().within(model.digits, model.columns, model.gains, z, model.c_max)
        return ArmPose(turned, t, z, pose.v)

    @property
    def rests(self) -> float:
        """Whether the arm is at rest, from 0 (it moves) to 1: by the part with the greatest ``drift``."""
        return float(1.0 / (1.0 + (np.abs(self.drift).max() / _DRIFTS) ** 2) ** 2)

    def expected(self, predicted: ArmPose, dt: float, s: ArmFitSettings) -> Expected:
        """Return the Gaussian prior of the next fit: its mean is the prediction, its width grows with time and speed.

        Args:
            predicted: mean pose, a result of `predicted`.
            dt: time since the last fitted image, above 0 [s].
            s: standard deviations and their growth.
        """
        model = self.model
        rates = np.full(6 + len(predicted.z), np.radians(s.angle_rate_deg_s))
        rates[:3], rates[3:6] = s.palm_rate_m_s, np.radians(s.palm_rate_deg_s)
        rates = np.clip(_MAY_CHANGE * np.abs(self.velocity), _STILL * rates, rates)
        base, before = model.unexpected(predicted), self.fitted.pose.v.copy()
        # Sizes do not change while an arm is tracked. A forearm's length is inferred from the hand's.
        known = np.full(len(before), 1.0 / _SIZE_SD**2)
        before[2] /= before[0]
        known[2] /= model.forearm_m**2
        known[4:10] = 1.0 / np.radians(_FOREARM_RATE_DEG_S * dt) ** 2
        information = base.information + known
        v = (base.information * base.v + known * before) / information
        steady = self.rests / _rest_sd(len(rates)) ** 2
        return replace(base, certainty=1.0 / (rates * dt) ** 2, steady=steady, v=v, information=information)


def _rest_sd(dofs: int) -> Float64:
    """Return (dofs,) standard deviations of the motion of an arm at rest between two images [m, rad]."""
    sd = np.full(dofs, _REST_ANGLE_SD)
    sd[:3], sd[3:6] = _REST_SD_M, _REST_TURN_SD
    return sd


def _motion(before: ArmPose, after: ArmPose) -> Float64:
    """Return the twist of the palm, in its frame, and the change of the joint angles."""
    turn = fit_kernels().turn_between(before.R, 0, after.R)
    moved = before.R.reshape(3, 3).T @ (after.t - before.t)
    return np.concatenate([moved, turn, after.z - before.z])


_CALM_RISES: Final = 1.01
_SIZE_SD: Final = 0.002
"""Standard deviation of relative sizes from image to image."""
_FOREARM_RATE_DEG_S: Final = 300.0
_CLEAR: Final = 0.005
_STILL_CLEAR: Final = -0.006
"""Least clearness of a fingertip, if it was not clear before, and if it was [cost]: then until another posture would be
tried (the setting ``gain``)."""
_PROVEN: Final = 0.8
"""Share of the setting ``doubt`` below which a cost proves a new arm's side and posture."""
_SOON: Final = 3
"""Images in doubt after which an arm that is not proven is searched anew for the first time."""
_MAY_CHANGE: Final = 4.0
"""A prediction's standard deviation grows by this factor times the speed, at most by the rate of the settings …"""
_STILL: Final = 0.1
"""… and at least by this share of that rate."""
_REST_SD_M: Final = 0.0015
_REST_TURN_SD: Final = np.radians(0.9)
_REST_ANGLE_SD: Final = np.radians(2.25)
"""Standard deviations of the palm's motion [m, rad] and of joint angles [rad] between two images of an arm at rest:
about the errors of single fits before a camera with structured light, on scenes with seeds below 100."""
_DRIFT_GAIN: Final = 0.2
_NEW_DRIFT: Final = 10.0
_DRIFTS: Final = 1.33
"""Drift at which an arm counts as a quarter at rest: 2 mm, 1.2° of the palm, or 3° of a joint, an image."""
