"""``mocapella node rgbd``: people's joints from a depth camera with colour."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocapella.cli.arm import Intrinsics, Unit
from mocapella.cli.command_settings import KeySpec, SettingsFile, read_settings, set_option
from mocapella.cli.common import DEFAULT_ADDRESS, Connect, JsonOut, need_cameras, parse_size, say
from mocapella.cli.keypoint_options import KeypointDetectorName, ModelFile, detector_keys, opened_detector
from mocapella.cli.node_keypoints import run_keypoints
from mocapella.cli.nodes import DROP_AFTER_MS, LOOP, NAME_HELP, REPORT, Epoch, NodeKeys, tell_camera_end
from mocapella.cli.pictures import Fps, Size
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.detectors.keypoint_detector import PeopleDetector
    from mocapella.sources.picture_source import PictureSource, SourceState


@dataclass(frozen=True)
class RgbdNodeKeys(NodeKeys):
    """Settings of `node rgbd`."""

    sure: Annotated[
        float, KeySpec("Least confidence of the detector of a tracked joint; below, it is inferred.", "ratio", least=0)
    ] = 0.4
    loop: Annotated[bool, LOOP] = False
    drop_after_ms: Annotated[float, DROP_AFTER_MS] = 200.0
    report: Annotated[float, REPORT] = 10.0


def rgbd(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="realsense:SERIAL, orbbec:0, oak:0, k4a:0, openni:0, freenect:0, freenect2:0, a folder of depth and "
            "colour images, or rendered:room-SCENE/SEED/SENSOR/VIEW.",
        ),
    ],
    name: Annotated[str, typer.Option("--name", metavar="SENSOR", help=NAME_HELP)] = "rgbd",
    intrinsics: Intrinsics = None,
    unit: Unit = None,
    size: Size = None,
    fps: Fps = None,
    detector: KeypointDetectorName = None,
    model: ModelFile = None,
    connect: Connect = DEFAULT_ADDRESS,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(RgbdNodeKeys, detector_keys)] = None,
    epoch: Epoch = None,
    json: JsonOut = None,
) -> None:
    """Serve a depth camera with colour as a body sensor: find people in its colour images, and their joints in space.

    docs/sensors.md lists the cameras and their packages. A rendered room has a simulated detector unless --detector
    names another.

    Example:  mocapella node rgbd realsense: --name front

    Example:  mocapella node rgbd rendered:room-walk/0/kinect/right --name right
    """
    need_cameras("node rgbd")
    from mocapella.cli.depth_recordings import depth_of_take, depth_options
    from mocapella.live.camera_node import CameraNodeSettings
    from mocapella.live.rgbd_work import RgbdWork
    from mocapella.model.observations import check_sensor_name
    from mocapella.sensing.keypoint_depth import LiftSettings
    from mocapella.settings import check
    from mocapella.sources.acquisition import Acquisition
    from mocapella.sources.open_depth import open_depth

    keys, own = read_settings(RgbdNodeKeys, settings_file, settings)
    check(fps is None or 0 < fps <= 1000, "--fps", fps, "above 0, at most 1000")
    sensor, lift = check_sensor_name(name), LiftSettings(keys.sure)
    options = depth_options(intrinsics, unit, None, fps, None if size is None else parse_size(size))
    options = replace(options, colour=True)
    images = open_depth(source, options, loop=keys.loop, recorded=lambda text: depth_of_take(text, options))
    finds = _detector(images, detector, model, own)
    with Acquisition(images, say=say) as acquisition:
        work = RgbdWork(sensor, acquisition, finds, lift)
        _tell_state(sensor, acquisition.source.name, acquisition.state)
        node_settings = CameraNodeSettings(keys.drop_after_ms / 1e3, keys.report)
        summary = run_keypoints(work, connect, keys.disk(), node_settings, epoch=epoch)
    tell_camera_end(summary, work.words(), json)


def _detector(images: PictureSource, name: str | None, model: Path | None, settings: dict[str, Any]) -> PeopleDetector:
    """Make the detector of the options; of a rendered room, the simulated one if none is named."""
    scene = getattr(images, "scene", None)
    if scene is None or name is not None:
        return opened_detector("node rgbd", name, model, settings)
    from mocapella.live.rgbd_work import RoomDetector
    from mocapella.model.topology import topology
    from mocapella.sources.simulate.room_keypoints import RoomKeypoints

    if settings or model is not None:
        named = ", ".join(settings) or "--model"
        raise SettingsError(f"{named}: the simulated detector of a rendered room has none; name another by --detector")
    return RoomDetector(RoomKeypoints(scene, topology("coco_17")))


def _tell_state(sensor: str, source: str, state: SourceState) -> None:
    """Print the sizes, the rate and the problems of the source."""
    depth, colour = state.size_px or (0, 0), state.colour
    beside = "" if colour is None else f", colour of {colour.size_px[0]} × {colour.size_px[1]} px"
    rate = "" if state.fps is None else f", {state.fps:g} a second"
    say(f"{sensor}: depth of {source}, {depth[0]} × {depth[1]} px{beside}{rate}")
    for problem in state.problems:
        say(f"{sensor}: {problem}")
