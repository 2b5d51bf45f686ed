"""Convert fitted bodies into scene parts: pose, landmarks, and outlines over each camera's image."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.silhouette_fit import Eye, seen_at
from mocapella.model.observations import JointState
from mocapella.model.scene import TrackedBody, TrackedBodyView
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.outline_lines import border_lines, mask_lines
from mocapella.tracker.body_fitter import FittedBody
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouette_views import SeenBody

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]

_NO_LINES = np.empty((0, 2), np.float32)


class BodyScenes:
    """Creates the `TrackedBody` values of scenes.

    Args:
        bodies: the tracked bodies, by name; their order gives the ids.
        eyes: intrinsics and extrinsics of the rig's cameras, by name, in the rig's order.
    """

    def __init__(self, bodies: Mapping[str, InitialBody], eyes: Mapping[str, Eye]) -> None:
        self._bodies, self._eyes = bodies, eyes
        # The lines of a waiting body stay the same for long.
        self._waiting: dict[tuple[str, str], tuple[Silhouette, Float32]] = {}

    def tracked(self, seen: Mapping[str, SeenBody], *, looked_for: bool = True) -> tuple[TrackedBody, ...]:
        """Return the bodies of one frame as scene parts, in the order of ``bodies``.

        A landmark is tracked if it is inside the image of a camera that was used for the body and images support it
        (`limb_support.py`), else inferred; all of a lost body are inferred.

        Args:
            seen: all bodies in this frame, by name.
            looked_for: whether the tracker searches for them already; otherwise landmarks are *not tracked*.
        """
        return tuple(
            TrackedBody(
                id=number,
                name=name,
                build=body.build,
                T_world_model=one.fit.pose.T_world_model,
                angles=one.fit.pose.angles,
                joint_names=body.mesh.joint_names,
                landmark_names=tuple(body.mesh.landmarks),
                landmarks=one.fit.landmarks,
                states=self._states(one, looked_for=looked_for),
                lost=one.lost,
                views=tuple(self._view(name, camera, one) for camera in self._eyes),
            )
            for number, (name, body) in enumerate(self._bodies.items())
            for one in [seen[name]]
        )

    def _states(self, one: SeenBody, *, looked_for: bool) -> UInt8:
        landmarks = one.fit.landmarks
        states = np.full(len(landmarks), JointState.INFERRED if looked_for else JointState.NOT_TRACKED, np.uint8)
        for camera in () if one.lost else one.fit.seen:
            eye = self._eyes[camera]
            at = seen_at(landmarks, eye)
            inside = ((at >= -0.5) & (at < np.array(eye.size_px) - 0.5)).all(axis=1)
            states[inside] = JointState.TRACKED
        if looked_for and one.fit.supported is not None:
            states[~one.fit.supported] = JointState.INFERRED
        return states

    def _view(self, name: str, camera: str, one: SeenBody) -> TrackedBodyView:
        fit: FittedBody = one.fit
        left_out, seen = fit.left_out.get(camera, ""), fit.seen.get(camera)
        if one.lost:
            return TrackedBodyView(camera, np.nan, left_out, self._waits(name, camera, one), _NO_LINES)
        if seen is None:
            return TrackedBodyView(camera, np.nan, left_out, _NO_LINES, _NO_LINES)
        outline = mask_lines(seen.outline.mask, seen.outline.origin_px, seen.outline.step_px)
        contour = border_lines(seen.contour)
        return TrackedBodyView(camera, seen.overlap, left_out, outline, contour)

    def _waits(self, name: str, camera: str, one: SeenBody) -> Float32:
        silhouette = one.waits.get(camera)
        if silhouette is None:
            return _NO_LINES
        known = self._waiting.get((name, camera))
        if known is None or known[0] is not silhouette:
            known = self._waiting[name, camera] = silhouette, border_lines(silhouette)
        return known[1]
