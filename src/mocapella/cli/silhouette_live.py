"""Live cameras of `mocapella track silhouettes`: open them, learn the empty room, and track people until Ctrl-C."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Final

import typer
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

from mocapella.cli import INTERRUPTED
from mocapella.cli.common import console, say, telling_of_compiling
from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError, SettingsError
from mocapella.settings import check

if TYPE_CHECKING:
    from mocapella.live.silhouette_run import SilhouetteRun, Step
    from mocapella.model.camera import CameraRig
    from mocapella.sources.frame_set import FrameSource
    from mocapella.sources.live_set import LiveSet
    from mocapella.tracker.initial_body import InitialBody

LONGEST_EMPTY_S: Final = 600.0
LONGER_S: Final = 5.0
"""Time beyond that of learning the empty room for which its images are waited for [s]."""
NO_CAMERA: Final = "no camera gives a picture any more"
PLUGGED_IN: Final = "look whether they are plugged in, and films long enough"
RATE_OF: Final = 30
"""Number of latest frames over which the frame rate is measured."""


@dataclass(frozen=True)
class LiveWishes:
    """Options of the command that differ between live cameras and videos.

    Attributes:
        sources: camera, URL or video by the camera's name.
        as_live: whether videos are treated as live cameras.
        hz: frame rate to request of cameras, or to assume for videos [Hz]; None for the sources' own.
        other_size: ``crop`` or ``scale``, for images of another size than the calibration's; None refuses these.
        fourcc: image format to request of live cameras; None for the camera's choice.
        empty_room_s: live: time to learn the background [s]; None learns none.
        seconds: live: duration of the run [s]; None for no limit.
        frames: of videos: the frames to use; None for all.
        background: ``[NAME=]PATH`` of images of the empty room.
        late: live: ``NAME=MILLISECONDS`` of each camera with a latency.
    """

    sources: Mapping[str, str]
    as_live: bool = False
    hz: float | None = None
    other_size: str | None = None
    fourcc: str | None = None
    empty_room_s: float | None = None
    seconds: float | None = None
    frames: str | None = None
    background: Sequence[str] = ()
    late: Sequence[str] = ()

    @property
    def live(self) -> bool:
        """Whether the sources are live cameras, or videos treated as such."""
        from mocapella.sources.open_pictures import is_live

        return self.as_live or any(is_live(text) for text in self.sources.values())

    def verify(self) -> None:
        """Check that no option for live cameras is given with videos or the reverse, and check ``empty_room_s``.

        Raises:
            SettingsError: such an option is given, ``empty_room_s`` is out of range or given beside ``background``.
        """
        if self.live and self.frames is not None:
            raise SettingsError("--frames is of videos; live cameras go on until Ctrl-C, or for --seconds")
        if not self.live and self.empty_room_s is not None:
            raise SettingsError("empty_room is of live cameras; of videos give --background, or --set live=true")
        if not self.live and self.seconds is not None:
            raise SettingsError(
                "--seconds is of live cameras; of videos --frames says which are used, or give --set live=true"
            )
        if not self.live and self.fourcc is not None:
            raise SettingsError("fourcc is of live cameras; leave it out")
        if not self.live and self.late:
            raise SettingsError(
                "late is of live cameras; of videos cut off what one begins earlier, or give --set live=true"
            )
        if self.empty_room_s is not None:
            within = 0 < self.empty_room_s <= LONGEST_EMPTY_S
            check(within, "empty_room", self.empty_room_s, f"above 0, at most {LONGEST_EMPTY_S:g} s")
            if self.background:
                raise SettingsError("empty_room and --background are both given; choose one of them")


def open_live(wishes: LiveWishes, rig: CameraRig) -> LiveSet:
    """Open the live cameras of the options, and return them as one source of simultaneous images.

    Args:
        wishes: sources, frame rate, format and latencies; with ``other_size``, cameras choose their own image size,
            otherwise that of the calibration is requested.
        rig: the calibrated cameras.

    Raises:
        SettingsError, InputError: a camera cannot be opened, alone or together with the others.
    """
    from mocapella.model.point_tracks import match_cameras
    from mocapella.sources.camera_controls import CameraWishes
    from mocapella.sources.live_set import LiveSet
    from mocapella.sources.open_pictures import open_pictures

    late_s = late_cameras(wishes.late, wishes.sources, rig)
    sources = {}
    for name, text in wishes.sources.items():
        (called,) = match_cameras([name], rig.cameras, file=text)
        size = rig.cameras[called].camera.size_px if wishes.other_size is None else None
        sources[name] = open_pictures(text, CameraWishes(size, wishes.hz, wishes.fourcc), rate_option="--fps")
    return LiveSet(sources, rig, other_size=wishes.other_size, late_s=late_s)


def late_cameras(texts: Sequence[str], sources: Mapping[str, str], rig: CameraRig) -> dict[str, float]:
    """Parse the setting ``late``, the latency of cameras' images.

    Args:
        texts: ``NAME=MILLISECONDS`` each.
        sources: camera, URL or video by the name of the camera.
        rig: the calibrated cameras; names are matched by `mocapella.model.point_tracks.match_cameras`.

    Returns:
        The latency [s] by the camera's name in ``sources``; cameras without a text are left out.

    Raises:
        SettingsError: an unknown or repeated camera, or a latency that is not from 0 to `LATEST_S`.
        InputError: the rig has no such camera.
    """
    from mocapella.model.point_tracks import match_cameras
    from mocapella.sources.newest_instant import LATEST_S

    called = {match_cameras([name], rig.cameras, file=text)[0]: name for name, text in sources.items()}
    found: dict[str, float] = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            late_ms = float(number)
        except ValueError:
            raise SettingsError(f"late {text!r} cannot be used; write NAME=MILLISECONDS, such as back=120") from None
        (camera,) = match_cameras([name], rig.cameras, file=f"late {text}")
        if camera not in called:
            raise SettingsError(f"late {text}: no source is of {camera}; there are {', '.join(called)}")
        if called[camera] in found:
            raise SettingsError(f"late is given twice of {camera}; give it once")
        check(0 <= late_ms <= 1e3 * LATEST_S, f"late {name}", late_ms, f"0 to {1e3 * LATEST_S:g} ms")
        found[called[camera]] = late_ms / 1e3
    return found


def wait_for_people(run: SilhouetteRun, shown: FrameSource, empty_room_s: float | None, *, view: bool) -> None:
    """Let the tracker learn the empty room if requested, then print where each person is expected: the hips' position.

    Args:
        run: the run, before its first frame.
        shown: the live cameras.
        empty_room_s: time to learn the room [s]; None learns nothing.
        view: whether there is a live view; the printed line then refers to the outlines in it.

    Raises:
        InputError: the cameras send no images.
    """
    from mocapella.sources.live_set import LiveSet

    assert isinstance(shown, LiveSet)  # in videos, people are present from the first frame
    if empty_room_s is not None:
        learn_room(run, shown, empty_room_s)
    where = "where the outlines are in the view's pictures" if view else "at the start (--view shows the outlines)"
    for name, body in run.tracker.bodies.items():
        run.note(f"{name or 'the person'} may come now, in the start's pose and best {where}: {_place(body)}")


def learn_room(run: SilhouetteRun, shown: LiveSet, seconds: float) -> None:
    """Pass images of the empty room to the tracker until it has learnt the background.

    Args:
        run: the run, before its first frame.
        shown: the live cameras.
        seconds: time to learn [s], for which the tracker is set up; it does not include compilation.

    Raises:
        typer.Exit: Ctrl-C was pressed.
        InputError: the cameras sent too few images in this time and a tolerance.
    """
    from mocapella.live.signals import stop_on_signals

    say(f"learning the empty room for {seconds:g} s: keep the images empty of people")
    columns = (TextColumn("keep the images empty of people"), BarColumn(), TimeRemainingColumn())
    with (
        telling_of_compiling("the method silhouettes"),
        stop_on_signals() as stop,
        Progress(*columns, console=console, transient=True) as progress,
    ):
        task = progress.add_task("learning", total=seconds)
        # The first frame may compile kernels, which must not count as time to learn.
        for frame in islice(shown.until(stop, say=run.note), 1):
            run.feed(frame)
            run.tracker.reset()
        for frame in shown.until(stop, seconds + LONGER_S, run.note):
            progress.update(task, completed=frame.time_ns / NS_PER_S)
            run.feed(frame)
            if not run.tracker.learning:
                break
    if stop.is_set():
        say("stopped before the end")
        raise typer.Exit(INTERRUPTED)
    if run.tracker.learning:
        raise InputError(NO_CAMERA, fix=PLUGGED_IN)


def follow_live(
    run: SilhouetteRun,
    shown: LiveSet,
    stop: threading.Event,
    seconds: float | None,
    tell: Sequence[Callable[[Step], None]],
) -> None:
    """Track frame by frame until ``stop`` is set, the time is over, or all sources have ended.

    Args:
        run: tracks and counts.
        shown: the live cameras.
        stop: ends the tracking.
        seconds: duration [s]; None for no limit.
        tell: functions that are called with each step.

    Raises:
        InputError: no camera sent an image, and the run was not stopped.
    """
    whom = ", ".join(filter(None, run.meshes))
    say(f"following {whom}".strip() + (" until Ctrl-C" if seconds is None else f" for {seconds:g} s"))
    columns = (
        SpinnerColumn(), TextColumn(f"following {whom}".strip(), markup=False),
        TextColumn("{task.completed} frames, {task.fields[rate]} a second, {task.fields[dropped]} pictures dropped"),
    )  # fmt: skip
    done_s: deque[float] = deque(maxlen=RATE_OF)
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("following", total=None, rate="–", dropped=0)
        for step in run.steps(shown.until(stop, seconds, run.note)):
            for each in tell:
                each(step)
            done_s.append(time.monotonic())
            rate = f"{(len(done_s) - 1) / (done_s[-1] - done_s[0]):.0f}" if len(done_s) > 1 else "–"
            progress.update(task, advance=1, rate=rate, dropped=sum(shown.dropped.values()))
    if not (run.frames or stop.is_set()):
        raise InputError(NO_CAMERA, fix=PLUGGED_IN)


def _place(body: InitialBody) -> str:
    """Return the position of a body's hips as text, so that a person can stand there."""
    from mocapella.model.rigged_mesh import landmarks_at

    places = dict(zip(body.mesh.landmarks, landmarks_at(body.mesh, body.pose), strict=True))
    hips = {joint: at for joint, at in places.items() if joint.endswith("hip")}
    said = hips or dict(list(places.items())[:2])
    return ", ".join(f"{joint} at ({x:.2f}, {y:.2f}, {z:.2f}) m" for joint, (x, y, z) in said.items())
