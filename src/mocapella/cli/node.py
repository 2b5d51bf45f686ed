"""Commands of ``mocapella node`` without a camera: simulations, recordings, other programs and trackers."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocapella.cli.command_settings import KeySpec, SettingsFile, read_keys, set_option
from mocapella.cli.common import (
    DEFAULT_ADDRESS,
    DEFAULT_SCENE,
    SPACE_HELP,
    Connect,
    Host,
    JsonOut,
    Placement,
    SceneName,
    Seconds,
    Seed,
    check_scene,
    parse_size,
    say,
    warn_if_open,
    write_json,
)
from mocapella.cli.nodes import (
    DELAY_MS,
    LINGER,
    NAME_HELP,
    SENSOR_HELP,
    Epoch,
    EpochFromInput,
    Listen,
    NodeKeys,
    SensorName,
    read_epoch,
    serve_frames,
)
from mocapella.cli.pictures import Fps, Size
from mocapella.errors import SettingsError
from mocapella.settings import check

if TYPE_CHECKING:
    from mocapella.live.due_frame import DueFrame


@dataclass(frozen=True)
class ReplayKeys(NodeKeys):
    """Settings of `node replay`."""

    linger: Annotated[float, LINGER] = 2.0


@dataclass(frozen=True)
class DatagramKeys:
    """Settings of `node datagrams`."""

    start_to: Annotated[
        str | None,
        KeySpec("Send the start command there, also to a broadcast address, while a camera is silent.", "ADDRESS:PORT"),
    ] = None
    start_text: Annotated[str, KeySpec("Text of the start command.")] = "start"
    delay_ms: Annotated[float, replace(DELAY_MS, most=1000)] = 0.0
    sd_px: Annotated[float, KeySpec("Standard deviation of a coordinate; 0: unknown.", "px", 0, 100)] = 0.0
    zero_is_lost: Annotated[bool, KeySpec("The programs send 0,0 for a marker that they do not detect.")] = False
    by_host: Annotated[
        bool, KeySpec("The programs send from another port each time: a sender is a machine, not a port.")
    ] = False


def simulate(
    scene: SceneName = None,
    sensor: Annotated[str, typer.Option("--sensor", metavar="SENSOR", help=SENSOR_HELP)] = "1",
    connect: Connect = DEFAULT_ADDRESS,
    seed: Seed = 0,
    bvh: Annotated[
        Path | None, typer.Option(metavar="FILE", help="BVH file with the motion of the first person.")
    ] = None,
    topology: Annotated[
        str, typer.Option(metavar="NAME", help="Kind of sensor: kinect_v2, kinect_v1 or azure_kinect.")
    ] = "kinect_v2",
    seconds: Seconds = None,
    epoch: Epoch = None,
    epoch_from_input: EpochFromInput = False,
    name: SensorName = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(NodeKeys)] = None,
    json: JsonOut = None,
) -> None:
    """Serve a sensor of a simulated room. Waits for the server, which may be started before or after.

    Every process that simulates the same scene with the same epoch (by default 0) shows the same room.

    Example:  mocapella node simulate --scene obstacle --sensor right
    """
    from mocapella.live.due_frame import DueFrame
    from mocapella.sources.simulate import SimulatedSensor, load_scene

    disk = read_keys(NodeKeys, settings_file, settings).disk()
    room = load_scene(check_scene(scene or DEFAULT_SCENE), seed=seed, topology=topology, bvh=bvh)
    source = SimulatedSensor(room, sensor)
    next(source.frames())  # compile and load before the clock matters
    zero = read_epoch() if epoch_from_input else epoch or 0.0

    def frames() -> Iterator[DueFrame]:
        start_s = max(0.0, time.time() - zero)
        stop_s = None if seconds is None else start_s + seconds
        return (DueFrame(f.due_s, f.frame, f.truth) for f in source.frames(start_s=start_s, stop_s=stop_s))

    serve_frames(frames, name or source.name, connect, zero, json, wait=not epoch_from_input, disk=disk)


def replay(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="A take (.mcap), a study log, or one sensor's bodies as CSV (.csv, .csv.gz)."
        ),
    ],
    sensor: Annotated[str, typer.Option("--sensor", metavar="SENSOR", help=SENSOR_HELP)],
    connect: Connect = DEFAULT_ADDRESS,
    placement: Placement = None,
    epoch: Epoch = None,
    epoch_from_input: EpochFromInput = False,
    name: SensorName = None,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(ReplayKeys)] = None,
    json: JsonOut = None,
) -> None:
    """Serve a sensor out of a recording, in real time. Without --epoch it begins when a server is there.

    The kind of a CSV file is recognised by its first row: a study log; the positions of Azure Kinect Body Tracking
    (`timestamp;body_idx;PELVIS (c);…`); or joints of a Kinect v2, without a header. docs/sensors.md describes them.

    Example:  mocapella node replay walk-1 --sensor front

    Example:  mocapella node replay azure_positions.csv.gz --sensor left
    """
    from mocapella.live.recordings import is_take, open_recording
    from mocapella.live.track_again import Changes
    from mocapella.model.frame_types import HISTORY_FRAMES, frame_type_of

    keys = read_keys(ReplayKeys, settings_file, settings)
    if placement and is_take(file):
        raise SettingsError(f"{file} is a take; leave --placement out, which is for study logs")
    recording = open_recording(file, Changes(placement=placement))
    frames = recording.due_frames(sensor)
    first = next(frames, None)
    whole = frames if first is None else chain((first,), frames)
    kind = None if first is None else frame_type_of(first.frame)
    kept = HISTORY_FRAMES if kind is None else kind.history_frames
    zero = read_epoch() if epoch_from_input else epoch
    serve_frames(
        lambda: whole,
        name or sensor,
        connect,
        zero,
        json,
        wait=zero is None,
        linger_s=keys.linger,
        history_frames=kept,
        disk=keys.disk(),
    )


def bridge(
    listen: Listen = "127.0.0.1:7450",
    connect: Connect = DEFAULT_ADDRESS,
    json: JsonOut = None,
) -> None:
    """Serve the sensors of programs that cannot speak zenoh (C, C#, …): length-delimited BodyFrames over TCP.

    docs/wire.md describes the messages; examples/c_publisher is such a program.

    Example:  mocapella node bridge --listen 127.0.0.1:7450
    """
    from mocapella.live.bridging import run_bridge
    from mocapella.live.signals import stop_on_signals
    from mocapella.sources.bridge import BridgeSettings

    host, port = _parted(listen, ":", "--listen", "127.0.0.1:7450")
    warn_if_open("the bridge is", host, port)
    with stop_on_signals() as stop:
        write_json(json, run_bridge(BridgeSettings(host=host, port=port), connect, stop, say))


def datagrams(
    camera: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=PORT", help="A camera, as the rig calls it, and the UDP port it sends to; give one for each."
        ),
    ],
    markers: Annotated[
        str, typer.Option(metavar="NAME,NAME,…", help="Marker names, in the order of the pairs in a datagram.")
    ] = "red,yellow,green,blue,magenta,cyan",
    size: Size = None,
    host: Host = "127.0.0.1",
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(DatagramKeys)] = None,
    connect: Connect = DEFAULT_ADDRESS,
    json: JsonOut = None,
) -> None:
    """Serve cameras that send markers as text in UDP datagrams, `x,y;x,y;…`, as small programs on a Raspberry Pi do.

    docs/wire.md has the datagrams; examples/02_pi_camera.py sends them.

    Example:  mocapella node datagrams --camera left=5001 --camera right=5002 --host 0.0.0.0
    """
    from mocapella.live.datagrams import run_datagrams
    from mocapella.live.signals import stop_on_signals
    from mocapella.sources.datagram_settings import DatagramSettings

    keys = read_keys(DatagramKeys, settings_file, settings)
    datagram_settings = DatagramSettings(
        cameras=tuple(_parted(one, "=", "--camera", "left=5001") for one in camera),
        markers=tuple(name.strip() for name in markers.split(",")),
        size_px=parse_size(size or "640x480"),
        host=host,
        sd_px=keys.sd_px,
        delay=keys.delay_ms / 1000,
        zero_is_lost=keys.zero_is_lost,
        by_host=keys.by_host,
        start_to=None if keys.start_to is None else _parted(keys.start_to, ":", "start_to", "192.168.1.255:5000"),
        start_text=keys.start_text,
    )
    for _, port in datagram_settings.cameras:
        warn_if_open("the camera's port is", host, port)
    with stop_on_signals() as stop:
        write_json(json, run_datagrams(datagram_settings, connect, stop, say))


_Space = Annotated[str, typer.Option(metavar="NAME", help=SPACE_HELP)]


def osc(
    listen: Listen = "127.0.0.1:9000",
    space: _Space = "vr",
    name: Annotated[str, typer.Option("--name", metavar="SENSOR", help=NAME_HELP)] = "osc",
    connect: Connect = DEFAULT_ADDRESS,
    json: JsonOut = None,
) -> None:
    """Serve poses of another tracker that come by OSC: VMC's, VRChat's, or /mocapella/pose name x y z qx qy qz qw.

    Example:  mocapella node osc --listen 127.0.0.1:9000 --space vr
    """
    from mocapella.live.node_disk import open_link
    from mocapella.live.poses import run_osc
    from mocapella.live.signals import stop_on_signals

    host, port = _parted(listen, ":", "--listen", "127.0.0.1:9000")
    warn_if_open("the OSC input is", host, port)
    with stop_on_signals() as stop, open_link(connect, name, say=say) as link:
        summary = run_osc(link, (host, port), _space(space), stop, say)
    say(
        f"{name}: {summary['poses']} poses of {summary['datagrams']} datagrams; {summary['bad']} were no OSC, "
        f"{summary['unknown']} of other addresses"
    )
    write_json(json, summary)


def openvr(
    space: _Space = "vr",
    fps: Fps = None,
    name: Annotated[str, typer.Option("--name", metavar="SENSOR", help=NAME_HELP)] = "openvr",
    connect: Connect = DEFAULT_ADDRESS,
    json: JsonOut = None,
) -> None:
    """Serve the poses of a headset, its controllers and trackers, by the package openvr; names are serial numbers.

    SteamVR must run on this computer. --space is a name of your choice for its coordinate system. Without --fps, 90
    frames a second are sent, until Ctrl-C.

    Example:  mocapella node openvr --space vr
    """
    from mocapella.live.node_disk import open_link
    from mocapella.live.poses import run_openvr
    from mocapella.live.signals import stop_on_signals
    from mocapella.sources.openvr_poses import OpenVrPoses

    rate_hz = 90.0 if fps is None else fps
    check(1 <= rate_hz <= 1000, "--fps", rate_hz, "1 to 1000")
    with (
        stop_on_signals() as stop,
        OpenVrPoses(name, _space(space)) as source,
        open_link(connect, name, say=say) as link,
    ):
        summary = run_openvr(link, source, rate_hz, stop, say)
    write_json(json, summary)


def _space(name: str) -> str:
    if not 0 < len(name) <= 80:
        raise SettingsError(f"--space {name[:80]!r} cannot be used; give it 1 to 80 characters")
    return name


def _parted(text: str, at: str, option: str, example: str) -> tuple[str, int]:
    """Split a text at ``at`` into the part before it and the port number after it."""
    before, _, port = text.rpartition(at)
    if not before or not (port.isascii() and port.isdigit() and len(port) <= 5):
        raise SettingsError(f"{option} {text!r} cannot be used; write it as {example}")
    return before, int(port)
