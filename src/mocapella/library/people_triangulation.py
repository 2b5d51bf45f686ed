"""Track all people in other programs' keypoint files; `mocapella triangulate` uses it too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, SettingsError
from mocapella.library.exchanged_images import check_not_exchanged
from mocapella.library.keypoint_tracking import arrivals_of, rig_with_y_up, track_arrivals, without_gaps
from mocapella.library.motion_tracks import MotionTracks
from mocapella.library.people_files import save_people, up_problem
from mocapella.library.people_report import PeopleReport, alarms, people_report
from mocapella.library.recording import Recording
from mocapella.library.rig_image_sizes import check_image_sizes
from mocapella.library.rig_units import rig_in_metres
from mocapella.model.camera import CameraRig
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.point_tracks import match_cameras
from mocapella.model.topology import Topology
from mocapella.recording.detection_files import read_detections
from mocapella.recording.detections import AUTO, CameraDetections, keypoint_frames
from mocapella.recording.disk import take_path

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False, repr=False)
class TriangulatedPeople:
    """People tracked from keypoint files, in a world with y up.

    Attributes:
        recording: the results, as of `mocapella.load`.
        report: people, cameras and errors.
        topology: topology of the detector's keypoints; None if the cameras' differ.
        fps: frame rate that the times follow; None for the times of the files [Hz].
        notes: sentences about omissions and likely faults.
        most: largest number of people in `people` and in files; None for all.
    """

    recording: Recording
    report: PeopleReport
    topology: Topology | None = None
    fps: float | None = None
    notes: tuple[str, ...] = field(default_factory=tuple)
    most: int | None = None

    @property
    def people(self) -> MotionTracks | None:
        """The people with joints of `halpe_26`; of more than ``most``, those in most frames. None without people."""
        found = self.recording.people
        if found is None or self.most is None or len(found.individuals) <= self.most:
            return found
        order = sorted(self.report.people, key=lambda name: -self.report.people[name].frames)[: self.most]
        return found.of([name for name in found.individuals if name in order])

    def save(self, path: Path | str) -> list[Path]:
        """Write the people to a file, whose ending is that of an export; one file a person if the format wants that.

        Files of points have the names and the order of the detector's keypoints.

        Returns:
            The files; existing ones are replaced.

        Raises:
            SettingsError: the ending is unknown, the file cannot be written, or there are no people.
        """
        people = self.people
        if people is None:
            raise SettingsError("nobody was tracked, so there is nothing to write; the notes say why")
        return save_people(people, Path(path), own=self.topology, rate_hz=self.fps)

    def __repr__(self) -> str:
        names = ", ".join(self.report.people) or "nobody"
        return f"<{names} in {self.report.instants} instants of {len(self.report.cameras)} cameras>"


def triangulate_people(
    files: Sequence[Path | str] | Path | str,
    rig: CameraRig | Path | str,
    *,
    fps: float | None = None,
    up: str = "y",
    order: str = AUTO,
    most: int | None = None,
    record: Path | str | None = None,
    progress: Progress = lambda text: None,
    **settings: Any,
) -> TriangulatedPeople:
    """Track all people in keypoint files of several calibrated cameras, with the method ``webcams``.

    found = mocapella.triangulate_people("session/pose", "rig.toml", fps=60, up="z")
    found.save("walk.trc")

    Args:
        files: a folder with a folder or file for each camera, or several folders or files: JSON of OpenPose, MMPose or
            AlphaPose, CSV or H5 of DeepLabCut or SLEAP, or our CSV.
        rig: the cameras, or their file.
        fps: frame rate that the numbers of the frames follow; None for the times of the files [Hz].
        up: the upward axis of the rig's world: y, z or -y; in the results, y is up.
        order: order of keypoints without names, such as BODY_25; auto: by their number and places.
        most: largest number of people in `TriangulatedPeople.people`: those in most frames; None for all.
        record: new take to write, with the keypoints and all people; None for none.
        progress: called with a line about each stage.
        settings: settings of the method.

    Raises:
        InputError: a file cannot be used, the rig has not the cameras, or the points are no people's.
        SettingsError: an argument is invalid; names the valid ones.
        TakeExistsError, DiskFullError, RecordingError: the take cannot be written.
    """
    if fps is not None and not 0 < fps < 1e6:
        raise SettingsError(f"fps is {fps!r}; it must be above 0")
    if most is not None and most < 1:
        raise SettingsError(f"most is {most!r}; it must be 1 or more")
    paths = [Path(path) for path in ([files] if isinstance(files, Path | str) else files)]
    turned = rig_with_y_up(rig if isinstance(rig, CameraRig) else load_camera_rig(Path(rig)), up)
    found = read_detections(paths, order=order, progress=lambda text: progress(f"reading {text}"))
    return track_detections(
        found, turned, source=paths[0], fps=fps, most=most, settings=settings, progress=progress,
        record=None if record is None else take_path(Path(record).parent, Path(record).name),
    )  # fmt: skip


def track_detections(
    found: Sequence[CameraDetections],
    rig: CameraRig,
    *,
    source: Path,
    fps: float | None = None,
    most: int | None = None,
    record: Path | None = None,
    settings: dict[str, Any] | None = None,
    progress: Progress = lambda text: None,
) -> TriangulatedPeople:
    """Track the people of detections that are read; arguments and errors as of `triangulate_people`, with y up."""
    if len(found) < 2:
        raise InputError(
            "has the keypoints of one camera", file=source, fix="give those of two cameras or more that see the people"
        )
    names = match_cameras([one.camera for one in found], rig.cameras, file=source)
    frames = {
        name: keypoint_frames(one, name, rig.cameras[name].camera.size_px, fps)
        for name, one in zip(names, found, strict=True)
        if len(one.numbers)
    }
    frames = _with_all_instants(frames, found, names, fps)
    check_image_sizes(frames, rig, file=source)
    check_not_exchanged(frames, rig, file=source)
    rig, unit = rig_in_metres(frames, rig)
    arrivals = arrivals_of(frames, rig)
    recording, scenes = track_arrivals(
        arrivals, rig, source=source, record=record, settings=settings, progress=progress
    )
    progress("comparing people with the keypoints")
    report = people_report(arrivals, scenes, rig)
    people = recording.people
    up = "" if people is None or report.flipped else up_problem(people)
    kinds = {one.topology.name: one.topology for one in found if one.topology is not None}
    notes = [*dict.fromkeys(note for one in found for note in one.notes), *recording.problems, *alarms(report)]
    return TriangulatedPeople(
        recording, report, next(iter(kinds.values())) if len(kinds) == 1 else None, fps,
        tuple(note for note in (unit, *notes, up) if note), most,
    )  # fmt: skip


def _with_all_instants(
    frames: dict[str, list[KeypointFrame]], found: Sequence[CameraDetections], names: Sequence[str], fps: float | None
) -> dict[str, list[KeypointFrame]]:
    """Return the frames of each camera at all instants, numbered alike; unchanged if the files have times."""
    numbers = np.unique(np.concatenate([one.numbers for one in found])).tolist()
    if fps is None:
        of = dict(zip(names, found, strict=True))
        return {
            name: without_gaps(some, dict(zip(of[name].numbers.tolist(), (f.time_ns for f in some), strict=True)))
            for name, some in frames.items()
        }
    times = {number: NS_PER_S + round(number / fps * NS_PER_S) for number in numbers}
    return {name: without_gaps(some, times) for name, some in frames.items()}
