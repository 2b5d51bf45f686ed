"""``mocapella node arm``: a depth camera whose images are looked at for arms."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from mocapella.cli.arm import DEFAULT_DETECTOR, Detector, DetectorSettings, Intrinsics, RenamedMethod, Rig, Unit
from mocapella.cli.common import (
    DEFAULT_ADDRESS,
    Connect,
    JsonOut,
    need_cameras,
    parse_size,
    say,
    telling_of_compiling,
    write_json,
)
from mocapella.cli.nodes import Epoch, EpochFromInput, read_epoch

if TYPE_CHECKING:
    from mocapella.sources.acquisition import Acquisition


def node_arm(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="openni:0, freenect:0, realsense:SERIAL, orbbec:0, rendered:SCENE/SEED, PNGs, a folder, or a take.",
        ),
    ],
    name: Annotated[str, typer.Option(metavar="SENSOR", help="The camera's name.")] = "arm",
    intrinsics: Intrinsics = None,
    unit: Unit = None,
    rig: Rig = None,
    size: Annotated[str | None, typer.Option("--size", metavar="WxH", help="To ask a camera for.")] = None,
    fps: Annotated[float | None, typer.Option(metavar="HZ", help="Images a second: to ask for; of files.")] = None,
    detector: Detector = DEFAULT_DETECTOR,
    detector_settings: DetectorSettings = None,
    method: RenamedMethod = None,
    publish_depth: Annotated[
        bool,
        typer.Option(
            "--publish-depth", help="Send the images, too, as the sensor SENSOR.depth, so that a take has them."
        ),
    ] = False,
    loop: Annotated[bool, typer.Option("--loop", help="A recording begins again when it has ended.")] = False,
    drop_after_ms: Annotated[
        float, typer.Option(metavar="MS", min=1, help="Arms found so long after the image was there are not sent.")
    ] = 100.0,
    report: Annotated[
        float, typer.Option(metavar="SECONDS", min=0, help="So often it says how it goes; 0: only what is wrong.")
    ] = 10.0,
    connect: Connect = DEFAULT_ADDRESS,
    epoch: Epoch = None,
    epoch_from_input: EpochFromInput = False,
    json: JsonOut = None,
) -> None:
    """Serve a depth camera: find the arms in its images, and send them.

    docs/arms/recordings.md has the cameras, and what they need installed.

    Example:  mocapella node arm openni:0 --name arm
    """
    need_cameras("node arm")
    from mocapella.cli.depth_recordings import depth_of_take, depth_options
    from mocapella.detectors import make_detector
    from mocapella.live.arm_node import run_arm_node
    from mocapella.live.arm_work import ArmWork
    from mocapella.live.camera_node import CameraNodeSettings
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.depth import IMAGES_SUFFIX
    from mocapella.model.frame_types import FRAME_TYPES
    from mocapella.model.observations import check_sensor_name
    from mocapella.settings import check, settings_of_pairs
    from mocapella.sources.acquisition import Acquisition
    from mocapella.sources.depth_options import complete
    from mocapella.sources.open_depth import open_depth
    from mocapella.wire.node import NodeLink

    check(fps is None or 0 < fps <= 1000, "--fps", fps, "above 0, at most 1000")
    depth_name = check_sensor_name(check_sensor_name(name) + IMAGES_SUFFIX)
    options = depth_options(intrinsics, unit, rig, fps, None if size is None else parse_size(size))
    settings = CameraNodeSettings(drop_after_ms / 1e3, report)
    images = open_depth(source, options, loop=loop, recorded=lambda text: depth_of_take(text, options))
    with Acquisition(images, say=say) as acquisition:
        camera = complete(acquisition.state, source)
        _tell_state(name, acquisition)
        finds = make_detector(detector, camera, settings_of_pairs(detector_settings))
        with telling_of_compiling(f"the detector {detector}"):
            work = ArmWork(name, acquisition, camera, finds)
        zero = read_epoch() if epoch_from_input else epoch
        wait = not (images.live or zero is not None)
        # From here on standard input is watched for the end of who started this process.
        with stop_on_signals() as stop, NodeLink(connect, name) as link, ExitStack() as depth:
            depth_link, kept = None, FRAME_TYPES["depth"].history_frames
            if publish_depth:
                depth_link = depth.enter_context(NodeLink(connect, depth_name, history_frames=kept))
            summary = run_arm_node(
                link, acquisition, work, settings, depth_link=depth_link, epoch=zero, stop=stop, wait=wait, say=say
            )  # fmt: skip
    say(f"{name}: {summary.published} frames published; {work.words()}")
    for problem in summary.report["problems"]:
        say(f"{name}: {problem}")
    write_json(json, asdict(summary))


def _tell_state(sensor: str, acquisition: Acquisition) -> None:
    """How the source is set, in words."""
    state = acquisition.state
    assert state.size_px is not None
    assert state.lens is not None
    rate = "" if state.fps is None else f", {state.fps:g} a second"
    say(
        f"{sensor}: depth images of {acquisition.source.name}, {state.size_px[0]} × {state.size_px[1]} px{rate}, "
        f"{state.unit_m:g} m a unit, f {state.lens[0]:.1f} px; their time is {acquisition.source.times}"
    )
    for problem in state.problems:
        say(f"{sensor}: {problem}")
