"""How well tracked people agree with the keypoints in each camera's images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.image_agreement import CONTRARY, image_agreement
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Scene
from mocapella.model.topology import Topology
from mocapella.model.trajectories import person_name

Float64 = NDArray[np.float64]

SAME_POINT: Final = 0.1
"""A keypoint of a person agrees with the joint if it is at most this part of the person's size away."""
CONFIDENT: Final = 0.3
"""Keypoints with a higher confidence are compared."""
ALARM: Final = 1.0 / 3.0
"""Share of rejected keypoints above which a camera is named."""
STRANGE: Final = 0.05
"""Share of detections that agree with a person below which a camera is named: such a share agrees by chance."""
LEAST_DETECTIONS: Final = 10
"""Least number of detections of a camera that is named."""

_ELSEWHERE: Final = (
    "it sees another room, is another camera of the rig, moved after the calibration, or began at another time; leave "
    "it out, or calibrate it again"
)


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
        contrary_share: of the people who are in its image by their places, and whom it sees or should, part in whose
            place it sees a stranger, 0 to 1; 0 without any. A camera that sees another room has many.
        outside_share: part of all confident keypoints that are outside the image, 0 to 1.
    """

    detections: int
    used: int
    keypoints: int
    rejected_share: float
    residual_px: float
    contrary_share: float
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
    compared = PeopleComparison(rig)
    for number, scene in last.items():
        compared.add(frames[number], scene)
    return compared.report(arrival.frame.sensor for arrival in arrivals)


class PeopleComparison:
    """Compares the people of one instant after the other with the keypoints of all cameras; keeps no frames.

    Args:
        rig: the cameras.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._cameras = {name: _Camera(placed) for name, placed in rig.cameras.items()}
        self._residuals: dict[str, list[Float64]] = {}
        self._people: dict[str, list[Any]] = {}
        self._instants = 0
        self._seen: set[str] = set()

    def add(self, frames: Iterable[KeypointFrame], scene: Scene) -> None:
        """Compare the frames of an instant with the people in its last scene."""
        self._instants += 1
        for person in scene.people:
            self._people.setdefault(person_name(person.name, person.id), []).append(person.states)
        for frame in frames:
            self._seen.add(frame.sensor)
            if frame.sensor in self._cameras:
                for name, far in self._cameras[frame.sensor].compare(frame, scene):
                    self._residuals.setdefault(name, []).append(far)

    def report(self, seen: Iterable[str] = ()) -> PeopleReport:
        """Return the report so far.

        Args:
            seen: names of further cameras, all of whose frames were useless.
        """
        there = self._seen.union(seen)
        residuals = self._residuals
        everything = [far for some in residuals.values() for far in some]
        people = {
            name: _person(states, self._instants, residuals.get(name, []))
            for name, states in sorted(self._people.items())
        }
        cameras = {name: camera.report() for name, camera in self._cameras.items() if name in there}
        return PeopleReport(self._instants, people, cameras, _median(everything))


def alarms(report: PeopleReport, *, films: bool = False) -> list[str]:
    """Return sentences about cameras that disagree, each with its likely causes and the remedy.

    Args:
        report: the comparison.
        films: whether the keypoints are of films, so their order is known.
    """
    bad = {name: why for name, one in report.cameras.items() if (why := _why(one))}
    if not report.people or len(bad) > 1:
        many = not report.people or len(bad) * 2 >= len(report.cameras)
    else:
        many = bool(bad) and len(report.cameras) == 2  # nothing tells which of two is wrong
    if not many:
        return [f"camera {name}: {why}" for name, why in bad.items()]
    start = "nobody was found that two cameras agree on"
    if report.people:
        start = f"the cameras disagree ({', '.join(report.cameras if len(report.cameras) == 2 else bad)})"
    order = "" if films else "the order of keypoints (--set order=…), "
    return [
        f"{start}: compare the rig with the recording (its cameras and their names), {order}whether the cameras "
        "began together, and whether they see the same room"
    ]


def _why(camera: CameraPeopleReport) -> str:
    if camera.rejected_share > ALARM:
        return (
            f"{camera.rejected_share:.0%} of its keypoints are rejected: it moved after the calibration, its frames "
            "are of other times, or its keypoints have another order; calibrate it again, or check when it began"
        )
    if camera.detections < LEAST_DETECTIONS:
        return ""
    if camera.used < STRANGE * camera.detections:
        few = f"only {camera.used}" if camera.used else "none"
        return f"{few} of its {camera.detections} detections agrees with the other cameras: {_ELSEWHERE}"
    if camera.contrary_share > CONTRARY:
        return f"in the place of {camera.contrary_share:.0%} of the people it sees somebody elsewhere: {_ELSEWHERE}"
    return ""


class _Camera:
    """Compares a camera's keypoints with the joints of people, and counts."""

    def __init__(self, placed: PlacedCamera) -> None:
        self._placed = placed
        self._detections = self._used = self._keypoints = self._rejected = self._all = self._outside = 0
        self._contrary = 0
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
        joints = np.array([person.positions[pairs[:, 1]] for person in people], np.float64)
        keypoints = np.where(confident[..., None], frame.positions_px, np.nan)[:, pairs[:, 0]]
        found = image_agreement(keypoints.astype(np.float64), joints, self._placed)
        self._contrary += found.contrary
        for i, k in found.pairs:
            distances = found.far[i, k][np.isfinite(found.far[i, k])]
            near = distances[distances <= SAME_POINT * found.size[k]]
            self._used += 1
            self._keypoints += len(distances)
            self._rejected += len(distances) - len(near)
            self._residuals.append(near)
            yield person_name(people[k].name, people[k].id), near

    def report(self) -> CameraPeopleReport:
        """Return the counts so far."""
        return CameraPeopleReport(
            self._detections, self._used, self._keypoints, self._rejected / max(1, self._keypoints),
            _median(self._residuals), self._contrary / max(1, self._used + self._contrary),
            self._outside / max(1, self._all),
        )  # fmt: skip


def _pairs(own: Topology, other: Topology) -> NDArray[np.int64]:
    """Return (pairs, 2) keypoints and the joints at the same places."""
    found = [(source, joint) for joint, source in own.single_joints(other.name).items()]
    return np.array(found, np.int64).reshape(-1, 2)


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
