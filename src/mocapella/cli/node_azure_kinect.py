"""``mocapella node azure-kinect``: the bodies of an Azure Kinect or Orbbec Femto."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from mocapella.cli.command_settings import KeySpec, SettingsFile, read_keys, set_option
from mocapella.cli.common import DEFAULT_ADDRESS, Connect, JsonOut, say, write_json
from mocapella.cli.nodes import NAME_HELP, NodeKeys
from mocapella.cli.pictures import Fps


@dataclass(frozen=True)
class AzureKinectKeys(NodeKeys):
    """Settings of `node azure-kinect`."""

    libraries: Annotated[
        Path | None,
        KeySpec("Folder to search first for libk4a and libk4abt; then MOCAPELLA_K4A and the usual ones.", "folder"),
    ] = None
    processing: Annotated[
        str,
        KeySpec("What finds the bodies.", choices=("gpu", "cpu", "cuda", "tensorrt", "directml")),
    ] = "gpu"
    mounted: Annotated[
        str,
        KeySpec(
            "How the sensor is turned, seen from in front of it.",
            choices=("upright", "clockwise", "counterclockwise", "upside-down"),
        ),
    ] = "upright"
    model: Annotated[Path | None, KeySpec("Network of the body tracker; by default the library's own.", "file")] = None


def azure_kinect(
    device: Annotated[
        str,
        typer.Argument(metavar="[DEVICE]", help="Number of the camera, from 0, or its serial number."),
    ] = "0",
    name: Annotated[str, typer.Option("--name", metavar="SENSOR", help=NAME_HELP)] = "azure-kinect",
    fps: Fps = None,
    connect: Connect = DEFAULT_ADDRESS,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(AzureKinectKeys)] = None,
    json: JsonOut = None,
) -> None:
    """Serve the bodies of an Azure Kinect or Orbbec Femto, until Ctrl-C.

    The vendor's libraries libk4a and libk4abt find the bodies; `mocapella doctor` says whether they are installed, and
    docs/sensors.md where they come from. Without --fps, 30 images a second are taken.

    Example:  mocapella node azure-kinect --name left

    Example:  mocapella node azure-kinect 000123456789 --name right --set processing=cpu --fps 5
    """
    from mocapella.live.azure_kinect_node import run_azure_kinect
    from mocapella.live.node_disk import open_link
    from mocapella.live.signals import stop_on_signals
    from mocapella.settings import check
    from mocapella.sources.azure_kinect import AzureKinect, AzureKinectSettings
    from mocapella.sources.k4a_libraries import FPS

    keys = read_keys(AzureKinectKeys, settings_file, settings)
    check(fps is None or fps in FPS, "--fps", fps, "5, 15 or 30")
    how = AzureKinectSettings(30 if fps is None else int(fps), keys.processing, keys.mounted, keys.model)
    folders = () if keys.libraries is None else (keys.libraries,)
    source = AzureKinect(name, device, how, folders=folders)
    say(f"{name}: opening {source.name}, and loading its body tracker …")
    with source, stop_on_signals() as stop, open_link(connect, name, keys.disk(), say=say) as link:
        say(f"{name}: {source.name} is camera {source.serial} (Ctrl-C ends)")
        summary = run_azure_kinect(link, source, stop, say)
    say(
        f"{name}: {summary['published']} frames published; {summary['dropped']} images dropped, because the body "
        "tracker is slower than the camera"
    )
    write_json(json, summary)
