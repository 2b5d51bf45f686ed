"""Encode and decode fitted body models of a scene; invalid messages are refused."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError
from mocapella.model.scene import TrackedBody, TrackedBodyView
from mocapella.schema import mocapella_pb2 as pb
from mocapella.schema.checks import F4, F8, MAX_NAME, STATES, array, choices, names, points, sensor_name, transform

MAX_VIEWS: Final = 64
"""Largest number of camera views of a body."""
MAX_LINE: Final = 8192
"""Largest number of points of a model's outline, and of an image's contour, in one camera."""
MAX_BUILD: Final = 8192
MAX_REASON: Final = 1000
"""Longest reason why a view is not used, in characters."""
_FARTHEST_RAD: Final = 100.0


def encode_body(body: TrackedBody) -> Any:
    """Encode a fitted body as a protobuf message; a view's reason longer than `MAX_REASON` is cut."""
    return pb.Body(
        id=body.id,
        name=body.name,
        build=body.build,
        T_world_model=body.T_world_model[:3].astype(F8, copy=False).tobytes(),
        angles_rad=body.angles.astype(F8, copy=False).tobytes(),
        joint_names=body.joint_names,
        landmark_names=body.landmark_names,
        landmarks_m=body.landmarks.astype(F8, copy=False).tobytes(),
        landmark_states=body.states.tobytes(),
        lost=body.lost,
        views=[_encode_view(view) for view in body.views],
        person=None if body.person < 0 else body.person,
    )


def decode_body(m: Any) -> TrackedBody:
    """Decode a fitted body from a parsed protobuf message, and check its values.

    Raises:
        WireError: a field is too long, of the wrong length or out of range; names the field and its valid values.
    """
    if len(m.name) > MAX_NAME:
        raise WireError(f"Body.name has {len(m.name)} characters; at most {MAX_NAME} are read")
    if len(m.build) > MAX_BUILD:
        raise WireError(f"Body.build has {len(m.build)} characters; at most {MAX_BUILD} are read")
    if len(m.views) > MAX_VIEWS:
        raise WireError(f"Body.views has {len(m.views)} cameras; at most {MAX_VIEWS} are read")
    joints, landmarks = names(m.joint_names, "Body.joint_names"), names(m.landmark_names, "Body.landmark_names")
    angles = array(m.angles_rad, F8, (len(joints),), "Body.angles_rad")
    if not (np.abs(angles) <= _FARTHEST_RAD).all():  # NaN compares false
        raise WireError(f"Body.angles_rad has a value that is not within ±{_FARTHEST_RAD:g}; radians are wanted")
    return TrackedBody(
        m.id,
        m.name,
        m.build,
        transform(m.T_world_model, "Body.T_world_model"),
        angles,
        joints,
        landmarks,
        points(m.landmarks_m, (len(landmarks), 3), "Body.landmarks_m"),
        choices(m.landmark_states, STATES, len(landmarks), "Body.landmark_states"),
        m.lost,
        tuple(map(_decode_view, m.views)),
        m.person if m.HasField("person") else -1,
    )


def _encode_view(view: TrackedBodyView) -> Any:
    return pb.BodyView(
        camera=view.camera,
        overlap=view.overlap,
        left_out=view.left_out[:MAX_REASON],
        outline_px=view.outline_px.astype(F4, copy=False).tobytes(),
        contour_px=view.contour_px.astype(F4, copy=False).tobytes(),
    )


def _decode_view(m: Any) -> TrackedBodyView:
    if not (math.isnan(m.overlap) or 0.0 <= m.overlap <= 1.0):
        raise WireError(f"BodyView.overlap is {m.overlap:g}; 0 to 1 is wanted, or NaN")
    if len(m.left_out) > MAX_REASON:
        raise WireError(f"BodyView.left_out has {len(m.left_out)} characters; at most {MAX_REASON} are read")
    outline, contour = _line(m.outline_px, "BodyView.outline_px"), _line(m.contour_px, "BodyView.contour_px")
    return TrackedBodyView(sensor_name(m.camera), m.overlap, m.left_out, outline, contour)


def _line(data: bytes, field: str) -> NDArray[np.float32]:
    count = len(data) // 8
    if count > MAX_LINE:
        raise WireError(f"{field} has {count} points; at most {MAX_LINE} are read")
    line = array(data, F4, (count, 2), field)
    if np.isinf(line).any():
        raise WireError(f"{field} has an infinite value; write NaN between two lines")
    return line
