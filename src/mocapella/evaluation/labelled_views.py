"""Views of one person in the study logs, with left/right labels corrected by the facing.

A Kinect swaps left and right of people who turn their back. The facing is estimated from past and future
(`mocapella.fusion.facing_training`), and views more than 90° off it are mirrored back.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.facing_sessions import AlignedViews, aligned_views, facing_session, reference_facings
from mocapella.evaluation.study_pairs import StudySession
from mocapella.fusion.facing_model import shipped_model
from mocapella.geometry.angles import wrap
from mocapella.model.session import SCENARIOS
from mocapella.sources.simulate.body import BODY, JOINT, body_template
from mocapella.sources.simulate.measured import (
    TURNED,
    turned_about_spine,
)
from mocapella.sources.simulate.occlusion import hidden, obstacles

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

WALK: Final = SCENARIOS["walk"]
STATIONARY: Final = SCENARIOS["stationary"]
MIRROR: Final = np.array(BODY.mirror)


class LabelledViews(msgspec.Struct, frozen=True, eq=False):
    """Both views of a session's person at the same instants, with labels and yaw corrected by the estimated facing.

    Attributes:
        placement: the sensors' placement.
        participant: the participant's number.
        raw: the aligned views before the corrections, in the reference sensor's camera space.
        alpha: (frames, 2) facing α, relative to the direction from the person to each sensor [rad].
        reported: (frames, 2) yaw of the shoulders by the sensor's labels, relative to the same direction [rad].
        mirrored: (frames, 2) whether left and right were swapped.
        positions: (frames, 2, joints, 3) in the reference sensor's camera space [m], with corrected labels; shoulders,
            elbows and hips are rotated about the spine, so that the shoulders' yaw is the facing.
        hidden: (frames, 2, joints) whether the person's own body hides the joint.
    """

    placement: str
    participant: int
    raw: AlignedViews
    alpha: Float64
    reported: Float64
    mirrored: Bools
    positions: Float64
    hidden: Bools

    @property
    def walk(self) -> Bools:
        """(frames,) whether the frame belongs to Walk."""
        return np.asarray(self.raw.task == WALK)


def signed_alpha(alpha: Float64, toward: Float64) -> Float64:
    """Return the facing α (frames,) relative to the first sensor, positive towards the side of the second one [rad].

    Args:
        alpha: (frames,) facing relative to the first sensor, positive about +y [rad].
        toward: (frames, 2) yaw from the person to each sensor [rad].
    """
    return np.asarray(alpha * np.sign(np.median(wrap(toward[:, 1] - toward[:, 0]))))


def mirrored_better(one: Float64, other: Float64) -> float:
    """Return the share of frames in which swapping left and right brings two views (frames, joints, 3) nearer.

    A frame with a joint that is NaN counts as not nearer.
    """
    straight, crossed = (np.linalg.norm(one - p, axis=-1).mean(axis=-1) for p in (other, other[:, MIRROR]))
    return float((crossed < straight).mean())


def labelled_views(session: StudySession) -> LabelledViews | None:
    """Correct labels and yaw of a session's views by the facing, which is estimated from all frames.

    A view more than 90° off the facing is mirrored. The second view is then interpolated at the first one's times.

    Returns:
        The corrected views; None if the session has no `aligned_views`.
    """
    raw, facing = aligned_views(session), facing_session(session)
    if raw is None or facing is None:
        return None
    yaw = reference_facings([facing], shipped_model())[0]
    alpha, reported = wrap(yaw[:, None] - raw.toward), wrap(shoulder_yaw(raw.positions) - raw.toward)
    mirrored = np.abs(wrap(alpha - reported)) > np.pi / 2
    labelled = np.where(mirrored[..., None, None], raw.positions[:, :, MIRROR], raw.positions)
    turned = labelled.copy()
    turn = wrap(alpha - np.where(mirrored, reported + np.pi, reported))
    turned[:, :, TURNED] = turned_about_spine(labelled, turn)[:, :, TURNED]
    return LabelledViews(
        session.placement,
        session.participant,
        raw,
        np.asarray(alpha),
        np.asarray(reported),
        mirrored,
        _at_one_time(turned, raw),
        _hidden(turned, raw),
    )


def shoulder_yaw(positions: Float64) -> Float64:
    """Return the yaw (…) of the shoulder line of skeletons (…, joints, 3) [rad]; 0 = facing +z, π/2 = +x."""
    across = positions[..., JOINT["ShoulderLeft"], :] - positions[..., JOINT["ShoulderRight"], :]
    return np.asarray(np.arctan2(-across[..., 2], across[..., 0]))


def _at_one_time(positions: Float64, raw: AlignedViews) -> Float64:
    """Interpolate the second view at the first one's times plus the constant offset that brings the views nearest."""
    moving = raw.task != STATIONARY
    flat = positions[:, 1].reshape(len(positions), -1)

    def second(offset_s: float) -> Float64:
        at_s = raw.at_s[:, 0] + offset_s
        order = np.argsort(raw.at_s[:, 1])
        columns = [np.interp(at_s, raw.at_s[order, 1], column[order]) for column in flat.T]
        return np.stack(columns, axis=1).reshape(positions[:, 1].shape)

    def apart(offset_s: float) -> float:
        return float(np.linalg.norm(positions[:, 0] - second(offset_s), axis=-1)[moving].mean())

    return np.stack([positions[:, 0], second(min(np.arange(-0.08, 0.081, 0.01), key=apart))], axis=1)


def _hidden(positions: Float64, raw: AlignedViews) -> Bools:
    """Return (frames, 2, joints) whether the body's own capsules hide the joint."""
    trunk = positions[..., JOINT["Head"], :] - positions[..., JOINT["SpineBase"], :]
    drawn = body_template().offsets[[JOINT[name] for name in ("SpineMid", "SpineShoulder", "Neck", "Head")]]
    stature = np.median(np.linalg.norm(trunk, axis=-1)) / np.linalg.norm(drawn.sum(axis=0))
    radii, nothing = (body_template().radii * stature)[None], obstacles((), ())
    mean = positions.mean(axis=1)
    return np.array([[hidden(eye, body[None], radii, nothing)[0] for eye in raw.places] for body in mean])
