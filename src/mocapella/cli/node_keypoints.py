"""``mocapella node keypoints``: detect people's keypoints in a webcam's or a film's images."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from mocapella.cli.command_settings import SettingsFile, read_keys, read_settings, set_option
from mocapella.cli.common import DEFAULT_ADDRESS, Connect, JsonOut, Seed, say
from mocapella.cli.keypoint_options import KeypointDetectorName, ModelFile, detector_keys, opened_detector
from mocapella.cli.nodes import (
    DROP_AFTER_MS,
    LINGER,
    LOOP,
    REPORT,
    Epoch,
    EpochFromInput,
    NodeKeys,
    SensorName,
    read_epoch,
    serve_frames,
    tell_camera_end,
)
from mocapella.cli.pictures import FOURCC, Fps, Size, tell_state, wishes
from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.detectors.keypoint_detector import PeopleDetector
    from mocapella.live.camera_node import CameraNodeSettings, CameraNodeSummary
    from mocapella.live.keypoint_work import KeypointWork
    from mocapella.live.node_disk import NodeDisk

_NUMBER: Final = re.compile(r"[0-9]{1,3}")


@dataclass(frozen=True)
class KeypointNodeKeys(NodeKeys):
    """Settings of `node keypoints`."""

    fourcc: Annotated[str | None, FOURCC] = None
    loop: Annotated[bool, LOOP] = False
    drop_after_ms: Annotated[float, DROP_AFTER_MS] = 200.0
    linger: Annotated[float, LINGER] = 2.0
    report: Annotated[float, REPORT] = 10.0


def keypoints(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="0 or camera:0, /dev/video0, picamera:0, http://… or rtsp://…, a film or a folder, or "
            "simulated:SCENE/CAMERA.",
        ),
    ],
    name: SensorName = None,
    detector: KeypointDetectorName = None,
    model: ModelFile = None,
    connect: Connect = DEFAULT_ADDRESS,
    size: Size = None,
    fps: Fps = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(KeypointNodeKeys, detector_keys)] = None,
    seed: Seed = 0,
    epoch: Epoch = None,
    epoch_from_input: EpochFromInput = False,
    json: JsonOut = None,
) -> None:
    """Serve a webcam or a film: find the people in its images, and send their keypoints.

    The name is the camera's in the rig; without --name, camera 0 is cam0, and a film has its file's name.
    docs/webcams.md begins with two webcams, and ends with people in 3D.

    Example:  mocapella node keypoints 0 --name left
    """
    if source.startswith("simulated:"):
        _serve_simulated(
            source, name, connect, settings_file, settings, seed=seed, epoch=epoch, wait=not epoch_from_input,
            json=json, given={"--detector": detector, "--model": model, "--size": size, "--fps": fps},
        )  # fmt: skip
        return
    keys, own = read_settings(KeypointNodeKeys, settings_file, settings)
    finds = opened_detector("node keypoints", detector, model, own)
    serve_keypoints(
        source, name, finds, keys, connect=connect, size=size, fps=fps,
        epoch=epoch, epoch_from_input=epoch_from_input, json=json,
    )  # fmt: skip


def _serve_simulated(
    source: str,
    name: str | None,
    connect: str,
    settings_file: Path | None,
    settings: list[str] | None,
    *,
    seed: int,
    epoch: float | None,
    wait: bool,
    json: str | None,
    given: Mapping[str, object],
) -> None:
    """Serve the keypoints of a simulated camera; ``given`` has the options of real cameras, which are refused."""
    from mocapella.live.due_frame import DueFrame
    from mocapella.live.simulated_pictures import SimulatedPictures
    from mocapella.sources.simulate.keypoint_source import repeated, simulated_camera

    for option, value in given.items():
        if value is not None:
            raise SettingsError(f"{option} is of cameras and films; a simulated camera detects by itself: leave it out")
    disk = read_keys(NodeKeys, settings_file, settings).disk()
    camera, seconds = simulated_camera(source, seed)
    next(repeated(camera, seconds))  # make the motion before the clock matters
    # All processes that show the same scene begin at the same multiple of its duration.
    own = time.time() // seconds * seconds if epoch is None else epoch
    zero = own if wait else read_epoch()

    def frames() -> Iterator[DueFrame]:
        for due_s, frame in repeated(camera, seconds, time.time() - zero):
            pictures.time_ns = frame.time_ns
            yield DueFrame(due_s, frame)

    with SimulatedPictures(camera, round(seconds * NS_PER_S), say) as pictures:
        serve_frames(
            frames, name or camera.name, connect, zero, json, wait=wait, disk=disk, on_question=pictures.ask
        )  # fmt: skip


def camera_source(text: str) -> str:
    """Return the name of a source of images: a plain number is a camera's, unless there is such a file."""
    return f"camera:{int(text)}" if _NUMBER.fullmatch(text) and not Path(text).exists() else text


def camera_name(text: str) -> str:
    """Return a camera's name from its source: ``0`` and ``camera:0`` give ``cam0``, ``films/left.mp4`` gives ``left``.

    Raises:
        SettingsError: the result is no valid name of a sensor, such as of an address.
    """
    from mocapella.model.observations import check_sensor_name

    number = re.fullmatch(r"(?:(?:pi)?camera:|/dev/video)?([0-9]{1,3})", text)
    try:
        return check_sensor_name(f"cam{int(number[1])}" if number else Path(text).stem)
    except SettingsError:
        raise SettingsError(f"{text} gives the camera no name; give one with --name NAME, as in the rig") from None


def serve_keypoints(
    source: str,
    name: str | None,
    finds: PeopleDetector,
    keys: KeypointNodeKeys,
    *,
    connect: str,
    size: str | None,
    fps: float | None,
    epoch: float | None,
    epoch_from_input: bool,
    json: str | None,
) -> None:
    """Serve a camera or a film with a keypoint detector, until it ends or Ctrl-C; report the result at the end."""
    from mocapella.live.camera_node import CameraNodeSettings
    from mocapella.live.keypoint_work import KeypointWork
    from mocapella.model.observations import check_sensor_name
    from mocapella.sensing.colour_profile import CameraControls
    from mocapella.sources.acquisition import Acquisition
    from mocapella.sources.open_pictures import open_pictures

    sensor = camera_name(source) if name is None else check_sensor_name(name)
    wanted = wishes(size, fps, keys.fourcc, CameraControls(), None)
    pictures = open_pictures(camera_source(source), wanted, loop=keys.loop)
    with Acquisition(pictures, say=say) as acquisition:
        tell_state(sensor, pictures, acquisition.state)
        work = KeypointWork(sensor, acquisition, finds)
        zero = read_epoch() if epoch_from_input else epoch
        node_settings = CameraNodeSettings(keys.drop_after_ms / 1e3, keys.report)
        summary = run_keypoints(work, connect, keys.disk(), node_settings, epoch=zero, linger_s=keys.linger)
    tell_camera_end(summary, work.words(), json)


def run_keypoints(
    work: KeypointWork,
    connect: str,
    disk: NodeDisk | None,
    settings: CameraNodeSettings,
    *,
    epoch: float | None,
    linger_s: float = 0.0,
) -> CameraNodeSummary:
    """Serve a camera's or a film's keypoints until it ends or Ctrl-C; return the counts.

    From here on standard input is watched: it ends when the parent process does.

    Args:
        work: detects people; its source is not started yet.
        connect: address of the server, such as ``tls/127.0.0.1:7447``.
        disk: files that the node writes to its own disk; None for a spool only.
        settings: settings of the node.
        epoch: Unix time of the source's time 0 [s]; None for the beginning of the run.
        linger_s: time to keep running after a film's last frame, so that a take can fetch missed frames [s].
    """
    from mocapella.live.camera_service import CameraService
    from mocapella.live.keypoint_node import run_keypoint_node
    from mocapella.live.node_disk import open_link
    from mocapella.live.signals import stop_on_signals

    live = work.acquisition.source.live
    with (
        stop_on_signals() as stop,
        CameraService(work, say=say) as service,
        open_link(connect, work.camera, disk, say=say) as link,
    ):
        return run_keypoint_node(
            link, work.acquisition, work, service, settings, epoch=epoch, stop=stop, say=say,
            wait=not (live or epoch is not None), linger_s=0.0 if live else linger_s,
        )  # fmt: skip
