"""How well tracked people agree with the keypoints in each camera's images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Scene
from mocapella.model.topology import Topology
from mocapella.model.trajectories import person_name

Float64 = NDArray[np.float64]

AGREES: Final = 0.1
"""A detection is of a person whose joints are, in the median, at most this part of the person's size away."""
SAME_POINT: Final = 0.1
"""A keypoint of a person agrees with the joint if it is at most this part of the person's size away."""
LEAST_PX: Final = 8.0
"""These limits are at least as large [px]."""
LEAST_POINTS: Final = 3
"""Least number of common keypoints of a detection and a person that are compared."""
CONFIDENT: Final = 0.3
"""Keypoints with a higher confidence are compared."""
ALARM: Final = 1.0 / 3.0
"""Share of rejected keypoints or unused detections above which a camera is named."""


class PersonReport(msgspec.Struct, frozen=True):
    """A person over all instants.

    Attributes:
        frames: number of instants where the person is tracked.
        share: the same, as part of all instants, 0 to 1.
        measured, inferred: part of the joints that are measured, and that the body model estimates, while the person
            is tracked, 0 to 1.
        residual_px: median distance of the used keypoints from the projected joints [px]; NaN without any.
    """

    frames: int
    share: float
    measured: float
    inferred: float
    residual_px: float


class CameraPeopleReport(msgspec.Struct, frozen=True):
    """A camera over all instants.

    Attributes:
        detections: number of detections of people in its images.
        used: number of these that agree with a tracked person.
        keypoints: number of confident keypoints in the used detections that a tracked joint has.
        rejected_share: part of these that are far from the joint, 0 to 1; 0 without any.
        residual_px: median distance of the others from the projected joints [px]; NaN without any.
        outside_share: part of all confident keypoints that are outside the image, 0 to 1.
    """

    detections: int
    used: int
    keypoints: int
    rejected_share: float
    residual_px: float
    outside_share: float


class PeopleReport(msgspec.Struct, frozen=True):
    """People and cameras over all instants.

    Attributes:
        instants: number of instants.
        people: report of each person, by name.
        cameras: report of each camera, by its name in the rig.
        residual_px: median over all used keypoints [px]; NaN without any.
    """

    instants: int
    people: Mapping[str, PersonReport]
    cameras: Mapping[str, CameraPeopleReport]
    residual_px: float


def people_report(arrivals: Sequence[Arrival], scenes: Sequence[Scene], rig: CameraRig) -> PeopleReport:
    """Compare the people of each instant with the keypoints of all cameras.

    Args:
        arrivals: the keypoint frames; frames of one instant have the same ``sequence``.
        scenes: the scenes of these frames; a frame that the tracker could not use has none.
        rig: the cameras.
    """
    last: dict[int, Scene] = {}
    frames: dict[int, list[KeypointFrame]] = {}
    scene_of = {(scene.sensor, scene.node_id, scene.sequence): scene for scene in scenes}
    for arrival in arrivals:
        frame: Any = arrival.frame
        if frame.key in scene_of:
            last[frame.sequence] = scene_of[frame.key]
            frames.setdefault(frame.sequence, []).append(frame)
    cameras = {name: _Camera(placed) for name, placed in rig.cameras.items()}
    residuals: dict[str, list[Float64]] = {}
    people: dict[str, list[Any]] = {}
    for number, scene in last.items():
        for person in scene.people:
            people.setdefault(person_name(person.name, person.id), []).append(person.states)
        for frame in frames[number]:
            if frame.sensor in cameras:
                for name, far in cameras[frame.sensor].compare(frame, scene):
                    residuals.setdefault(name, []).append(far)
    seen = {arrival.frame.sensor for arrival in arrivals}
    everything = [far for some in residuals.values() for far in some]
    return PeopleReport(
        len(last),
        {name: _person(states, len(last), residuals.get(name, [])) for name, states in sorted(people.items())},
        {name: camera.report() for name, camera in cameras.items() if name in seen}, _median(everything),
    )  # fmt: skip


def alarms(report: PeopleReport) -> list[str]:
    """Return sentences about cameras that disagree, each with its likely causes and the remedy."""
    found = []
    bad = {name: why for name, one in report.cameras.items() if (why := _why(one))}
    many = len(bad) > 1 and len(bad) * 2 >= len(report.cameras)
    if not report.people or many:
        outside = [name for name, one in report.cameras.items() if one.outside_share > ALARM]
        start = "nobody was found that two cameras agree on" if not report.people else "the cameras disagree"
        found.append(
            f"{start}: " + (
                f"keypoints are outside the images of {', '.join(outside)}: give a rig for this image size" if outside
                else "compare the rig with the recording (its cameras, their names and image size), the order of "
                "keypoints (--set order=…), and whether the cameras began together"
            )
        )  # fmt: skip
    if not many and report.people:
        found += [f"camera {name}: {why}" for name, why in bad.items()]
    return found


def _why(camera: CameraPeopleReport) -> str:
    if camera.outside_share > ALARM:
        return (
            f"{camera.outside_share:.0%} of its keypoints are outside the image: give a rig for this image size, or "
            "the camera's own name"
        )
    if camera.rejected_share > ALARM:
        return (
            f"{camera.rejected_share:.0%} of its keypoints are rejected: it moved after the calibration, its frames "
            "are of other times, or its keypoints have another order; calibrate it again, or check when it began"
        )
    if camera.detections >= 10 and camera.used == 0:
        return (
            f"none of its {camera.detections} detections agrees with the other cameras: it is another camera of the "
            "rig, moved after the calibration, or began at another time"
        )
    return ""


class _Camera:
    """Compares a camera's keypoints with the joints of people, and counts."""

    def __init__(self, placed: PlacedCamera) -> None:
        self._placed = placed
        self._detections = self._used = self._keypoints = self._rejected = self._all = self._outside = 0
        self._residuals: list[Float64] = []

    def compare(self, frame: KeypointFrame, scene: Scene) -> Iterable[tuple[str, Float64]]:
        """Compare a frame with the people of its instant; yield a person's name and the distances that agree [px]."""
        width, height = frame.size_px
        confident = frame.confidences > CONFIDENT
        own = frame.positions_px[confident]
        self._detections += len(frame.ids)
        self._all += len(own)
        self._outside += int(((own < -0.05 * width) | (own > 1.05 * np.array([width, height]))).any(axis=-1).sum())
        people = scene.people
        pairs = _pairs(frame.topology, scene.topology)
        if not len(frame.ids) or not people or not len(pairs):
            return
        joints = np.array([person.positions[pairs[:, 1]] for person in people])
        in_camera = apply(self._placed.T_camera_world, joints)
        in_camera[in_camera[..., 2] < 0.1] = np.nan
        projected = project(in_camera, self._placed.camera.lens)
        size = np.array([max(LEAST_PX / AGREES, _size(one)) for one in projected])
        keypoints = np.where(confident[..., None], frame.positions_px, np.nan)[:, pairs[:, 0]]
        far = np.linalg.norm(keypoints[:, None] - projected[None], axis=-1)  # (detections, people, joints)
        known = np.isfinite(far).sum(axis=-1)
        enough = np.where((known >= LEAST_POINTS)[..., None], far, 0.0)
        middle = np.where(known >= LEAST_POINTS, np.nanmedian(enough, axis=-1) / size, np.inf)
        while np.isfinite(middle).any() and middle.min() <= AGREES:
            i, k = np.unravel_index(middle.argmin(), middle.shape)
            middle[i], middle[:, k] = np.inf, np.inf
            distances = far[i, k][np.isfinite(far[i, k])]
            near = distances[distances <= SAME_POINT * size[k]]
            self._used += 1
            self._keypoints += len(distances)
            self._rejected += len(distances) - len(near)
            self._residuals.append(near)
            yield person_name(people[k].name, people[k].id), near

    def report(self) -> CameraPeopleReport:
        """Return the counts so far."""
        return CameraPeopleReport(
            self._detections, self._used, self._keypoints, self._rejected / max(1, self._keypoints),
            _median(self._residuals), self._outside / max(1, self._all),
        )  # fmt: skip


def _pairs(own: Topology, other: Topology) -> NDArray[np.int64]:
    """Return (pairs, 2) keypoints and the joints at the same places."""
    found = [(source, joint) for joint, source in own.single_joints(other.name).items()]
    return np.array(found, np.int64).reshape(-1, 2)


def _size(projected: Float64) -> float:
    """Return the diagonal of the box around points (points, 2) [px]; 0 if none is known."""
    known = projected[np.isfinite(projected).all(axis=-1)]
    return float(np.linalg.norm(np.ptp(known, axis=0))) if len(known) else 0.0


def _median(values: Sequence[Float64]) -> float:
    known = np.concatenate([np.empty(0), *values])
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")


def _person(states: Sequence[Any], instants: int, residuals: Sequence[Float64]) -> PersonReport:
    stacked = np.array(states)
    return PersonReport(
        len(states), len(states) / instants, float((stacked == JointState.TRACKED).mean()),
        float((stacked == JointState.INFERRED).mean()), _median(residuals),
    )  # fmt: skip
