"""``mocapella node arm``: detect arms in a depth camera's images."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from mocapella.cli.arm import DEFAULT_DETECTOR, Detector, Intrinsics, RenamedMethod, Rig, Unit, detector_keys
from mocapella.cli.command_settings import KeySpec, SettingsFile, read_settings, set_option
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
from mocapella.cli.nodes import DROP_AFTER_MS, LOOP, NAME_HELP, REPORT, Epoch, EpochFromInput, NodeKeys, read_epoch
from mocapella.cli.pictures import Fps, Size

if TYPE_CHECKING:
    from mocapella.sources.acquisition import Acquisition


@dataclass(frozen=True)
class ArmNodeKeys(NodeKeys):
    """Settings of `node arm`."""

    publish_depth: Annotated[
        bool, KeySpec("Publish the depth images, too, as the sensor SENSOR.depth, so that a take holds them.")
    ] = False
    loop: Annotated[bool, LOOP] = False
    drop_after_ms: Annotated[float, DROP_AFTER_MS] = 100.0
    report: Annotated[float, REPORT] = 10.0


def node_arm(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="openni:0, freenect:0, freenect2:0, realsense:SERIAL, orbbec:0, oak:0, k4a:0, rendered:SCENE/SEED, "
            "PNGs, a folder, or a take.",
        ),
    ],
    name: Annotated[str, typer.Option("--name", metavar="SENSOR", help=NAME_HELP)] = "arm",
    intrinsics: Intrinsics = None,
    unit: Unit = None,
    rig: Rig = None,
    size: Size = None,
    fps: Fps = None,
    detector: Detector = DEFAULT_DETECTOR,
    method: RenamedMethod = None,
    connect: Connect = DEFAULT_ADDRESS,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(ArmNodeKeys, detector_keys)] = None,
    epoch: Epoch = None,
    epoch_from_input: EpochFromInput = False,
    json: JsonOut = None,
) -> None:
    """Serve a depth camera: detect the arms in its images, and send them.

    docs/arms/recordings.md lists the cameras and the packages they need.

    Example:  mocapella node arm openni:0 --name arm
    """
    need_cameras("node arm")
    from mocapella.cli.depth_recordings import depth_of_take, depth_options
    from mocapella.detectors import make_detector
    from mocapella.live.arm_node import run_arm_node
    from mocapella.live.arm_work import ArmWork, independent_after_s
    from mocapella.live.camera_node import CameraNodeSettings
    from mocapella.live.node_disk import NodeDisk, open_link
    from mocapella.live.signals import stop_on_signals
    from mocapella.model.depth import IMAGES_SUFFIX
    from mocapella.model.frame_types import FRAME_TYPES
    from mocapella.model.observations import check_sensor_name
    from mocapella.settings import check
    from mocapella.sources.acquisition import Acquisition
    from mocapella.sources.depth_options import complete
    from mocapella.sources.open_depth import open_depth

    keys, detector_settings = read_settings(ArmNodeKeys, settings_file, settings)
    check(fps is None or 0 < fps <= 1000, "--fps", fps, "above 0, at most 1000")
    depth_name = check_sensor_name(check_sensor_name(name) + IMAGES_SUFFIX)
    options = depth_options(intrinsics, unit, rig, fps, None if size is None else parse_size(size))
    node_settings = CameraNodeSettings(keys.drop_after_ms / 1e3, keys.report)
    images = open_depth(source, options, loop=keys.loop, recorded=lambda text: depth_of_take(text, options))
    with Acquisition(images, say=say) as acquisition:
        camera = complete(acquisition.state, source)
        _tell_state(name, acquisition)
        apart_s = independent_after_s(acquisition.state.fps)
        finds = make_detector(detector, camera, detector_settings, independent_s=apart_s)
        with telling_of_compiling(f"the detector {detector}"):
            work = ArmWork(name, acquisition, camera, finds)
        zero = read_epoch() if epoch_from_input else epoch
        wait = not (images.live or zero is not None)
        # From here on standard input is watched: it ends when the parent process does.
        with stop_on_signals() as stop, ExitStack() as links:
            link = links.enter_context(open_link(connect, name, keys.disk(), say=say))
            depth_link, kept = None, FRAME_TYPES["depth"].history_frames
            if keys.publish_depth:
                own = NodeDisk(keys.spool)  # a take of the node has its arms
                depth_link = links.enter_context(open_link(connect, depth_name, own, history_frames=kept, say=say))
            summary = run_arm_node(
                link, acquisition, work, node_settings, depth_link=depth_link, epoch=zero, stop=stop, wait=wait, say=say
            )  # fmt: skip
    say(f"{name}: {summary.published} frames published; {work.words()}")
    for problem in summary.report["problems"]:
        say(f"{name}: {problem}")
    write_json(json, asdict(summary))


def _tell_state(sensor: str, acquisition: Acquisition) -> None:
    """Print the settings of the source."""
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
