"""Calibrate the cameras of films from the people in them, and track these people; `mocapella people` uses it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from mocapella.calibration.people_rig import RigFromPeople, RigScale
from mocapella.errors import CalibrationError
from mocapella.library.keypoint_tracking import METHOD, arrivals_of, track_arrivals
from mocapella.library.people_calibration import calibrate_frames
from mocapella.library.people_report import PeopleReport, people_report
from mocapella.live.file_take import FileTake
from mocapella.live.film_people import FilmCounts
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.model.session import Setup
from mocapella.settings import parse
from mocapella.tracker.webcams_calibration import why_not
from mocapella.tracker.webcams_settings import WebcamsSettings

Progress = Callable[[str], None]
Frames = dict[str, list[KeypointFrame]]


def calibrate_films(
    frames: Frames, settings: Mapping[str, Any], progress: Progress = lambda text: None
) -> RigFromPeople:
    """Calibrate the cameras of films from the people in them.

    Args:
        frames: as of `mocapella.live.film_people.detect_in_films`.
        settings: settings of the method ``webcams``; ``height_m`` gives the scale.
        progress: called with a line about each stage.

    Raises:
        CalibrationError: the people do not determine the cameras, or not well enough to track; says what to do.
        SettingsError: a setting is invalid.
    """
    s = parse(WebcamsSettings, dict(settings), where="settings of webcams")
    scale = RigScale(stature_m=s.height_m) if s.height_m else None
    try:
        found = calibrate_frames([frame for of in frames.values() for frame in of], scale, progress=progress)
    except CalibrationError as error:
        raise CalibrationError(f"{error}; {_OR_A_RIG}") from None
    if problem := why_not(found, s):
        raise CalibrationError(
            f"{problem}: film people who walk about, nearer and farther, for half a minute; {_OR_A_RIG}"
        )
    return found


_OR_A_RIG: Final = "or give a rig with --rig (mocapella calibrate cameras makes one with a printed board)"


def track_films(
    frames: Frames, found: RigFromPeople, record: Path, settings: Mapping[str, Any],
    progress: Progress = lambda text: None,
) -> tuple[FilmCounts, PeopleReport]:  # fmt: skip
    """Track the people in films with the cameras that they calibrated, and write a take.

    Args:
        frames: as of `mocapella.live.film_people.detect_in_films`.
        found: the rig; the films' clocks are corrected by its.
        record: the take.
        settings: settings of the method ``webcams``.
        progress: called with a line about the progress.

    Returns:
        The counts, and how well the cameras agree about the people.

    Raises:
        InputError, SettingsError, TakeExistsError, DiskFullError, RecordingError: as `track_arrivals`.
    """
    arrivals = arrivals_of(frames, found.rig)
    _, scenes = track_arrivals(arrivals, found.rig, source=record, record=record, settings=settings, progress=progress)
    return _counts(frames, scenes), people_report(arrivals, scenes, found.rig)


def keep_frames(frames: Frames, record: Path, settings: Mapping[str, Any]) -> None:
    """Write the keypoint frames of films to a take without people, to be tracked later by a replay.

    Args:
        frames: as of `mocapella.live.film_people.detect_in_films`; all cameras have one clock.
        record: the take.
        settings: settings of the method ``webcams`` for the replay.

    Raises:
        TakeExistsError, DiskFullError, RecordingError: the take cannot be written.
    """
    arrivals = [Arrival(frame, frame.time_ns) for of in frames.values() for frame in of]
    arrivals.sort(key=lambda arrival: (arrival.at_ns, arrival.frame.sensor))
    with FileTake(record, Setup(METHOD, len(frames)), settings) as take:
        for arrival in arrivals:
            take.write_frame(arrival.frame, arrival)


def _counts(frames: Frames, scenes: Sequence[Any]) -> FilmCounts:
    """Return the counts of a run; an instant is tracked if a person is in the scene of a frame of its last camera."""
    last = sorted(frames)[-1]
    ends = [scene for scene in scenes if scene.sensor == last]
    return FilmCounts(
        len(ends),
        {name: len(of) for name, of in frames.items()},
        {name: sum(bool(frame.bodies) for frame in of) for name, of in frames.items()},
        sum(bool(scene.people) for scene in ends),
        max((len(scene.people) for scene in scenes), default=0),
        len({person.id for scene in scenes for person in scene.people}),
    )
