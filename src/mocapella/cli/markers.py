"""``mocapella node markers``: detect coloured markers in a camera's images."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.console import Console
from rich.table import Table

from mocapella.cli.command_settings import KeySpec, SettingsFile, read_keys, set_option
from mocapella.cli.common import (
    DEFAULT_ADDRESS,
    RIG_HELP,
    Connect,
    JsonOut,
    Seed,
    console,
    need_cameras,
    say,
    write_json,
)
from mocapella.cli.nodes import DROP_AFTER_MS, LOOP, REPORT, Epoch, EpochFromInput, NodeKeys, SensorName, read_epoch
from mocapella.cli.pictures import (
    CameraKeys,
    Fps,
    Profile,
    Size,
    Source,
    check_state,
    tell_state,
    wishes,
)
from mocapella.errors import InputError, SettingsError, one_of

if TYPE_CHECKING:
    from mocapella.model.camera import Camera
    from mocapella.sensing.colour_profile import ColourProfile
    from mocapella.sensing.tags import TagDetector
    from mocapella.sources.picture_source import PictureSource


THESIS_RATES_HZ: Final = (60, 90)
"""Frame rates of the RHOT thesis' cameras [Hz]."""


@dataclass(frozen=True)
class MarkerKeys(CameraKeys, NodeKeys):
    """Settings of `node markers`."""

    loop: Annotated[bool, LOOP] = False
    drop_after_ms: Annotated[float, DROP_AFTER_MS] = 100.0
    report: Annotated[float, REPORT] = 10.0
    timing: Annotated[
        int | None,
        KeySpec("Time the stages and measure the markers' jitter over this many frames, then stop.", "frames", least=2),
    ] = None
    prerender: Annotated[
        int,
        KeySpec("Render so many images of a scene beforehand and repeat them at --fps; 0: none.", "images", 0, 1000),
    ] = 0


def markers(
    source: Source,
    profile: Profile = None,
    name: SensorName = None,
    connect: Connect = DEFAULT_ADDRESS,
    size: Size = None,
    fps: Fps = None,
    tags: Annotated[
        str | None,
        typer.Option(
            metavar="DICT[:ID,ID,…]",
            help="Detect square tags, too, such as APRILTAG_36h11:7,8 or 4X4_50; their corners are tag7.0 to tag7.3.",
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help=f"{RIG_HELP} With the setting timing: include undistortion."),
    ] = None,
    seed: Seed = 0,
    settings_file: SettingsFile = None,
    settings: Annotated[list[str] | None, set_option(MarkerKeys)] = None,
    epoch: Epoch = None,
    epoch_from_input: EpochFromInput = False,
    json: JsonOut = None,
) -> None:
    """Serve a camera: find the coloured markers in its pictures, and send where they are.

    docs/markers.md says how colours are learnt, what the counts mean, and what to do about warnings.

    Example:  mocapella node markers camera:0 --profile left.json
    """
    need_cameras("node markers")
    from mocapella.live.camera_node import CameraNodeSettings
    from mocapella.live.camera_service import CameraService
    from mocapella.live.marker_node import run_marker_node
    from mocapella.live.marker_work import MarkerWork
    from mocapella.live.node_disk import open_link
    from mocapella.live.signals import stop_on_signals
    from mocapella.live.stage_times import StageTimes
    from mocapella.sources.acquisition import Acquisition
    from mocapella.sources.open_pictures import RENDERED, open_pictures

    known = _profile(profile)
    keys = read_keys(MarkerKeys, settings_file, settings)
    wanted = wishes(size, fps, keys.fourcc, keys.controls, known)
    pictures = open_pictures(source, wanted, loop=keys.loop, seed=seed, prerender=keys.prerender)
    if known is None:
        known = _pointed_at(pictures)
    sensor = _name(name, known, profile)
    camera = None if rig is None else _camera(rig, sensor)
    if keys.timing is not None and known is None:
        raise SettingsError(
            "the setting timing needs colours; give --profile FILE (mocapella calibrate colours learn makes one)"
        )
    node_settings = CameraNodeSettings(keys.drop_after_ms / 1e3, keys.report)
    with Acquisition(pictures, say=say) as acquisition:
        check_state(acquisition.state, known, profile, source)
        tell_state(sensor, pictures, acquisition.state)
        work = MarkerWork(sensor, acquisition, known, tags=None if tags is None else _tags(sensor, tags))
        times = None if keys.timing is None else StageTimes(keys.timing, len(work.names))
        zero = read_epoch() if epoch_from_input else epoch
        if zero is None and source.startswith(RENDERED):
            zero = 0.0  # cameras of one scene see the same, whenever they are started
        wait = not (pictures.live or epoch_from_input or epoch is not None or times is not None)
        # From here on standard input is watched: it ends when the parent process does.
        with (
            stop_on_signals() as stop,
            CameraService(work, profile, say=say) as service,
            open_link(connect, sensor, keys.disk(), say=say) as link,
        ):
            summary = run_marker_node(
                link, acquisition, work, service, node_settings,
                epoch=zero, stop=stop, say=say, times=times, camera=camera, wait=wait,
            )  # fmt: skip
    say(f"{sensor}: {summary.published} frames published; {work.words()}")
    for problem in summary.report["problems"]:
        say(f"{sensor}: {problem}")
    if times is not None:
        show_times(
            summary.stages or {}, summary.jitter or {}, summary.processor_ms, console if json == "-" else Console()
        )
    write_json(json, asdict(summary))


def show_times(
    stages: dict[str, dict[str, float]],
    jitter: dict[str, dict[str, float]],
    processor_ms: float | None,
    out: Console,
) -> None:
    """Print the times of the stages, what the program needs of a processor core, and the jitter of each marker.

    Args:
        stages: `StageTimes.table`.
        jitter: `StageTimes.jitter`.
        processor_ms: processor time of an image in all of the program's threads [ms]; None is not printed.
        out: where to print.
    """
    frames = int(stages["all"]["frames"]) if "all" in stages else 0
    table = Table(title=f"milliseconds over {frames} frames", title_justify="left")
    for heading in ("stage", "mean", "median", "sd", "99 %", "max"):
        table.add_column(heading, justify="left" if heading == "stage" else "right")
    for stage, row in stages.items():
        table.add_row(stage, *(f"{row[key]:.3f}" for key in ("mean_ms", "median_ms", "sd_ms", "p99_ms", "max_ms")))
    out.print(table)
    if processor_ms:
        shares = ", ".join(f"{0.1 * rate * processor_ms:.1f} % at {rate} a second" for rate in THESIS_RATES_HZ)
        out.print(f"processor: {processor_ms:.2f} ms an image in all threads; of one core {shares}")
    table = Table(title="standard deviation of a centre, jitter where nothing moves", title_justify="left")
    for heading in ("marker", "x, px", "y, px", "frames"):
        table.add_column(heading, justify="left" if heading == "marker" else "right")
    for name, row in jitter.items():
        table.add_row(name, f"{row['x_px']:.3f}", f"{row['y_px']:.3f}", str(row["seen"]))
    out.print(table)


def _tags(sensor: str, text: str) -> TagDetector:
    from mocapella.sensing.tags import TagDetector, TagSettings

    dictionary, _, ids = text.partition(":")
    numbers = [number.strip() for number in ids.split(",")] if ids else []
    if not all(number.isascii() and number.isdigit() and len(number) < 6 for number in numbers):
        raise SettingsError(f"--tags {text!r} cannot be used; write it as APRILTAG_36h11 or APRILTAG_36h11:7,8")
    return TagDetector(sensor, TagSettings(dictionary, tuple(map(int, numbers))))


def _profile(path: Path | None) -> ColourProfile | None:
    from mocapella.sensing.colour_profile import load_profile

    return load_profile(path) if path is not None and path.exists() else None


def _pointed_at(pictures: PictureSource) -> ColourProfile | None:
    """Return the colour profile of a rendered scene, which needs no clicks; None for other sources."""
    from mocapella.sources.simulate.rendered_camera import RenderedCamera

    return pictures.profile() if isinstance(pictures, RenderedCamera) else None


def _name(name: str | None, known: ColourProfile | None, profile: Path | None) -> str:
    from mocapella.model.observations import check_sensor_name

    if known is None:
        if name is None:
            raise SettingsError(
                "no colours yet: give --profile FILE (mocapella calibrate colours learn makes one), or --name and "
                "learn them in the view"
            )
        return check_sensor_name(name)
    if name is not None and name != known.camera:
        raise InputError(
            f"the colours are of another camera than {name!r}", file=profile or "the scene", field="camera",
            value=known.camera, fix="load that camera's profile, or learn the colours anew",
        )  # fmt: skip
    return known.camera


def _camera(rig: Path, sensor: str) -> Camera:
    from mocapella.model.camera_rig_file import load_camera_rig

    cameras = load_camera_rig(rig).cameras
    if sensor not in cameras:
        fix = f"it has {one_of(sensor, cameras)}"
        raise InputError("has no such camera", file=rig, field="cameras", value=sensor, fix=fix)
    return cameras[sensor].camera
