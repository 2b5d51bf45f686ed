"""``mocapella node camera``: a camera whose images are published."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, cast

import typer

from mocapella.cli.command_settings import KeySpec, SettingsFile, read_keys, read_settings, set_option
from mocapella.cli.common import DEFAULT_ADDRESS, Connect, JsonOut, need_cameras, say
from mocapella.cli.keypoint_options import KeypointDetectorName, ModelFile, opened_detector
from mocapella.cli.node_keypoints import KeypointNodeKeys, camera_source, serve_keypoints
from mocapella.cli.nodes import (
    DELAY_MS,
    LINGER,
    LOOP,
    REPORT,
    Epoch,
    EpochFromInput,
    NodeKeys,
    SensorName,
    read_epoch,
    tell_camera_end,
)
from mocapella.cli.pictures import BLUE, EXPOSURE, FOURCC, GAIN, RED, WHITE_BALANCE, Fps, Size, tell_state, wishes
from mocapella.errors import SettingsError

FORMATS = ("jpeg", "png")
NO_DETECTOR = "none"


@dataclass(frozen=True)
class CameraNodeKeys(NodeKeys):
    """Settings of `node camera`."""

    fourcc: Annotated[str | None, FOURCC] = None
    exposure: Annotated[float | None, EXPOSURE] = None
    gain: Annotated[float | None, GAIN] = None
    white_balance: Annotated[float | None, WHITE_BALANCE] = None
    white_balance_red: Annotated[float | None, RED] = None
    white_balance_blue: Annotated[float | None, BLUE] = None
    format: Annotated[str, KeySpec("Encoding of the published images; png is lossless.", choices=FORMATS)] = "jpeg"
    quality: Annotated[int, KeySpec("Quality of JPEG images.", "%", 1, 100)] = 90
    delay_ms: Annotated[float, replace(DELAY_MS, most=10_000)] = 0.0
    loop: Annotated[bool, LOOP] = False
    linger: Annotated[float, LINGER] = 2.0
    report: Annotated[float, REPORT] = 10.0


def camera(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE", help="0 or camera:0, /dev/video0, picamera:0, http://… or rtsp://…, a film or a folder."
        ),
    ],
    name: SensorName = None,
    detector: KeypointDetectorName = None,
    model: ModelFile = None,
    connect: Connect = DEFAULT_ADDRESS,
    size: Size = None,
    fps: Fps = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(CameraNodeKeys)] = None,
    epoch: Epoch = None,
    epoch_from_input: EpochFromInput = False,
    json: JsonOut = None,
) -> None:
    """Serve a camera: its images, for methods that track the images themselves (silhouettes), or people's keypoints.

    A camera given as a plain number, such as 0, is a webcam that sends keypoints, like `mocapella node keypoints 0`; so
    is any with --detector. Everything else, and --detector none, sends the images. docs/silhouettes.md says how its
    cameras are set up, and how much a take of images takes; docs/webcams.md is about webcams.

    Example:  mocapella node camera camera:0 --name left
    """
    need_cameras("node camera")
    if (detector is None and source.isdecimal() and camera_source(source) != source) or detector not in (
        None,
        NO_DETECTOR,
    ):
        found, own = read_settings(KeypointNodeKeys, settings_file, settings)
        serve_keypoints(
            source, name, opened_detector("node camera", detector, model, own), found, connect=connect, size=size,
            fps=fps, epoch=epoch, epoch_from_input=epoch_from_input, json=json,
        )  # fmt: skip
        return
    if name is None or model is not None:
        problem = "--model is of --detector" if name is not None else "no name; images need one, as in the rig"
        raise SettingsError(f"{problem}: give {'--detector NAME' if name is not None else '--name NAME'}")
    from mocapella.live.camera_node import CameraNodeSettings
    from mocapella.live.camera_service import CameraService
    from mocapella.live.image_node import run_image_node
    from mocapella.live.image_work import ImageSettings, ImageWork
    from mocapella.live.node_disk import open_link
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.frame_types import FRAME_TYPES
    from mocapella.model.observations import check_sensor_name
    from mocapella.sensing.colour_profile import CameraControls
    from mocapella.sources.acquisition import Acquisition
    from mocapella.sources.open_pictures import open_pictures

    keys = read_keys(CameraNodeKeys, settings_file, settings)
    sent = ImageSettings(cast(Literal["jpeg", "png"], keys.format), keys.quality, keys.delay_ms / 1e3)
    sensor = check_sensor_name(name)
    given = CameraControls(
        keys.exposure, keys.gain, keys.white_balance,
        white_balance_red=keys.white_balance_red, white_balance_blue=keys.white_balance_blue,
    )  # fmt: skip
    pictures = open_pictures(camera_source(source), wishes(size, fps, keys.fourcc, given, None), loop=keys.loop)
    kept = FRAME_TYPES["images"].history_frames
    with Acquisition(pictures, say=say) as acquisition:
        tell_state(sensor, pictures, acquisition.state)
        work = ImageWork(sensor, acquisition, sent)
        zero = read_epoch() if epoch_from_input else epoch
        # From here on standard input is watched: it ends when the parent process does.
        with (
            stop_on_signals() as stop,
            CameraService(work, say=say) as service,
            open_link(connect, sensor, keys.disk(), history_frames=kept, say=say) as link,
        ):
            summary = run_image_node(
                link, acquisition, work, service, CameraNodeSettings(report_s=keys.report),
                epoch=zero, stop=stop, say=say,
                wait=not (pictures.live or zero is not None), linger_s=0.0 if pictures.live else keys.linger,
            )  # fmt: skip
    tell_camera_end(summary, work.words(), json)
