"""How well tracked people agree with the keypoints in each camera's images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.exchanged_cameras import exchange_text, exchanged_cameras
from mocapella.association.image_agreement import CONTRARY, image_agreement
from mocapella.association.ray_agreement import INSTANTS
from mocapella.conventions import NS_PER_S
from mocapella.library.flipped_images import flipped_images
from mocapella.library.late_cameras import MomentsOfCameras
from mocapella.library.rig_units import unlikely_scale
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

_BLIND: Final = "look at the images (dark, covered, of another room), and detect again"


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
        exchanged: which cameras' images seem exchanged, as a clause; empty if none do.
        flipped: sentence that names the cameras whose images are mirrored or upside down; empty without any, and if
            some are exchanged.
        scale: sentence about people of an impossible size, with the rig's likely scale; empty if it is possible, and
            if images are exchanged or flipped.
        late: by camera, how much later the moments are that its images show than those of the others, negative if they
            are earlier [s], and the number of images in that time.
    """

    instants: int
    people: Mapping[str, PersonReport]
    cameras: Mapping[str, CameraPeopleReport]
    residual_px: float
    exchanged: str = ""
    flipped: str = ""
    scale: str = ""
    late: Mapping[str, tuple[float, int]] = {}


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
    """Compares the people of one instant after the other with the keypoints of all cameras; keeps few frames.

    Args:
        rig: the cameras.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._cameras = {name: _Camera(placed) for name, placed in rig.cameras.items()}
        self._residuals: dict[str, list[Float64]] = {}
        self._people: dict[str, list[Any]] = {}
        self._instants = 0
        self._seen: set[str] = set()
        self._rig, self._kept, self._stride = rig, list[dict[str, KeypointFrame]](), 1
        self._moments = MomentsOfCameras()

    def add(self, frames: Iterable[KeypointFrame], scene: Scene) -> None:
        """Compare the frames of an instant with the people in its last scene."""
        frames = list(frames)
        self._keep(frames)
        self._instants += 1
        moments = None if self._moments.full or not scene.people else self._moments
        if moments:
            names = {person_name(one.name, one.id): one.positions for one in scene.people}
            moments.begin(scene.at_ns / NS_PER_S, names)
        for person in scene.people:
            self._people.setdefault(person_name(person.name, person.id), []).append(person.states)
        for frame in frames:
            self._seen.add(frame.sensor)
            if frame.sensor in self._cameras:
                for seen in self._cameras[frame.sensor].compare(frame, scene):
                    self._residuals.setdefault(seen.person, []).append(seen.near_px)
                    if moments:
                        moments.see(frame.sensor, seen.person, seen.keypoints, seen.size_px)

    def _keep(self, frames: Sequence[KeypointFrame]) -> None:
        """Keep some instants that two cameras see people in, spread over all: at most twice `INSTANTS`."""
        seen = {one.sensor: one for one in frames if len(one.ids) and one.sensor in self._cameras}
        if self._instants % self._stride == 0 and len(seen) > 1:
            self._kept.append(seen)
        if len(self._kept) > 2 * INSTANTS:
            self._kept, self._stride = self._kept[::2], 2 * self._stride

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
        exchanged = exchange_text(exchanged_cameras(self._kept, self._rig.cameras))
        kept: dict[str, list[KeypointFrame]] = {}
        for name, frame in (item for instant in self._kept for item in instant.items()):
            kept.setdefault(name, []).append(frame)
        flipped = "" if exchanged else flipped_images(kept, self._rig)
        scale = "" if exchanged or flipped else unlikely_scale(kept, self._rig)
        late = {} if exchanged or flipped else self._moments.found(self._rig.cameras)
        return PeopleReport(self._instants, people, cameras, _median(everything), exchanged, flipped, scale, late)


def alarms(report: PeopleReport, *, films: bool = False) -> list[str]:
    """Return sentences about cameras that disagree, each with its likely causes and the remedy.

    Args:
        report: the comparison.
        films: whether the keypoints are of films, so their order is known.
    """
    if report.exchanged:
        return [f"{report.exchanged}: exchange the names of their files, or their names in the rig"]
    if report.flipped:
        return [report.flipped]  # which explains the rest
    blind = [name for name, one in report.cameras.items() if not one.detections]
    if blind and len(blind) == len(report.cameras):
        return [f"no camera's keypoints have a person: {_BLIND}"]
    most = max((one.detections for one in report.cameras.values()), default=0)
    unseen = [f"camera {name}: its keypoints have no person: {_BLIND}" for name in blind if most >= LEAST_DETECTIONS]
    return [*unseen, *_disagreements(report, films=films)]


def _disagreements(report: PeopleReport, *, films: bool) -> list[str]:
    """Return the sentences about people and cameras that disagree."""
    bad = {name: why for name, one in report.cameras.items() if (why := _why(one))}
    if not report.people or len(bad) > 1:
        many = not report.people or len(bad) * 2 >= len(report.cameras)
    else:
        many = bool(bad) and len(report.cameras) == 2  # nothing tells which of two is wrong
    scale = [report.scale] if report.scale else []
    late = [f"camera {name}: {_late(*one, films=films)}" for name, one in report.late.items()]
    if late or not many:
        return [*scale, *late, *(f"camera {name}: {why}" for name, why in bad.items() if name not in report.late)]
    start = "nobody was found that two cameras agree on"
    if report.people:
        start = f"the cameras disagree ({', '.join(report.cameras if len(report.cameras) == 2 else bad)})"
    order = "" if films else "the order of keypoints (--set order=…), "
    return [
        *scale,
        f"{start}: compare the rig with the recording (its cameras and their names), {order}whether the cameras "
        "began together, and whether they see the same room",
    ]


def _late(seconds: float, images: int, *, films: bool) -> str:
    """Return what to do about a camera whose images show other moments."""
    kind, when = "films" if films else "files", "later" if seconds > 0 else "earlier"
    which = f"the others' {kind}" if seconds > 0 else f"its {kind[:-1]}"
    return (
        f"its images show moments about {abs(seconds):.2g} s {when} than the others': leave out the first {images} "
        f"images of {which}"
    )


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


class _Seen(NamedTuple):
    """A person in a camera's image.

    Attributes:
        person: the name.
        near_px: distances of the keypoints that agree from the joints [px].
        keypoints: (joints, 2) confident keypoints at the person's joints; NaN for others [px].
        size_px: size of the person in the image [px].
    """

    person: str
    near_px: Float64
    keypoints: Float64
    size_px: float


class _Camera:
    """Compares a camera's keypoints with the joints of people, and counts."""

    def __init__(self, placed: PlacedCamera) -> None:
        self._placed = placed
        self._detections = self._used = self._keypoints = self._rejected = self._all = self._outside = 0
        self._contrary = 0
        self._residuals: list[Float64] = []

    def compare(self, frame: KeypointFrame, scene: Scene) -> Iterable[_Seen]:
        """Compare a frame with the people of its instant; yield each person who is seen."""
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
            at_joints = np.full((len(scene.topology), 2), np.nan)
            at_joints[pairs[:, 1]] = keypoints[i]
            yield _Seen(person_name(people[k].name, people[k].id), near, at_joints, float(found.size[k]))

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
