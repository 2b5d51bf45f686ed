"""``mocapella node camera``: a camera whose images are sent themselves."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Literal, cast

import typer

from mocapella.cli.common import DEFAULT_ADDRESS, Connect, JsonOut, need_cameras, say, write_json
from mocapella.cli.markers import Exposure, Fourcc, Fps, Gain, Size, WhiteBalance, tell_state, wishes
from mocapella.cli.node import Epoch, EpochFromInput, read_epoch
from mocapella.errors import SettingsError, one_of

FORMATS = ("jpeg", "png")


def camera(
    source: Annotated[
        str,
        typer.Argument(metavar="SOURCE", help="camera:0, /dev/video0, http://… or rtsp://…, a film or a folder."),
    ],
    name: Annotated[str, typer.Option("--name", metavar="SENSOR", help="The camera's name, as in the rig.")],
    connect: Connect = DEFAULT_ADDRESS,
    size: Size = None,
    fps: Fps = None,
    fourcc: Fourcc = None,
    exposure: Exposure = None,
    gain: Gain = None,
    white_balance: WhiteBalance = None,
    format: Annotated[
        str, typer.Option("--format", metavar="jpeg|png", help="How images are sent; png loses nothing.")
    ] = "jpeg",
    quality: Annotated[int, typer.Option(metavar="PERCENT", min=1, max=100, help="Of a JPEG.")] = 90,
    delay_ms: Annotated[
        float,
        typer.Option(
            metavar="MS", min=0, max=10_000, help="Pictures show what was so long before they come (network cameras)."
        ),
    ] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="A film or folder begins again when it has ended.")] = False,
    linger: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", min=0, help="Stay so long after a film's end, so that a take gets what it missed."
        ),
    ] = 2.0,
    report: Annotated[
        float, typer.Option(metavar="SECONDS", min=0, help="So often it says how it goes; 0: only what is wrong.")
    ] = 10.0,
    epoch: Epoch = None,
    epoch_from_input: EpochFromInput = False,
    json: JsonOut = None,
) -> None:
    """Serve a camera's images, for methods that track the images themselves (silhouettes).

    docs/silhouettes.md says how cameras are set up, and how much a take of images takes.

    Example:  mocapella node camera camera:0 --name left
    """
    need_cameras("node camera")
    from mocapella.live.camera_node import CameraNodeSettings
    from mocapella.live.camera_service import CameraService
    from mocapella.live.image_node import run_image_node
    from mocapella.live.image_work import ImageSettings, ImageWork
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.frame_types import FRAME_TYPES
    from mocapella.model.observations import check_sensor_name
    from mocapella.sensing.colour_profile import CameraControls
    from mocapella.sources.acquisition import Acquisition
    from mocapella.sources.open_pictures import open_pictures
    from mocapella.wire.node import NodeLink

    if format not in FORMATS:
        raise SettingsError(f"--format is {format!r}; it must be one of {one_of(format, FORMATS)}")
    sent = ImageSettings(cast(Literal["jpeg", "png"], format), quality, delay_ms / 1e3)
    sensor = check_sensor_name(name)
    given = CameraControls(exposure, gain, white_balance)
    pictures = open_pictures(source, wishes(size, fps, fourcc, given, None), loop=loop)
    kept = FRAME_TYPES["images"].history_frames
    with Acquisition(pictures, say=say) as acquisition:
        tell_state(sensor, pictures, acquisition.state)
        work = ImageWork(sensor, acquisition, sent)
        zero = read_epoch() if epoch_from_input else epoch
        # From here on standard input is watched for the end of who started this process.
        with (
            stop_on_signals() as stop,
            CameraService(work, say=say) as service,
            NodeLink(connect, sensor, history_frames=kept) as link,
        ):
            summary = run_image_node(
                link, acquisition, work, service, CameraNodeSettings(report_s=report), epoch=zero, stop=stop, say=say,
                wait=not (pictures.live or zero is not None), linger_s=0.0 if pictures.live else linger,
            )  # fmt: skip
    say(f"{sensor}: {summary.published} frames published; {work.words()}")
    for problem in summary.report["problems"]:
        say(f"{sensor}: {problem}")
    write_json(json, asdict(summary))
