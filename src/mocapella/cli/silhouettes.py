"""``mocapella silhouettes``: a body model fitted to the silhouettes in the videos of calibrated cameras."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import app
from mocapella.cli.common import (
    DEFAULT_VIEW_PORT,
    JsonOut,
    console,
    need_cameras,
    say,
    telling_of_compiling,
    working,
    write_json,
)
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from threading import Event

    from mocapella.live.silhouette_run import SilhouetteRun, Step
    from mocapella.live.silhouette_view import SilhouetteView
    from mocapella.model.twist_tree import TreePose
    from mocapella.recording.followed_bodies import FollowedBody
    from mocapella.sources.video_set import VideoSet
    from mocapella.tracker.silhouette_start import Body


@app.command()
def silhouettes(
    videos: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME=]VIDEO…",
            help="A video or a folder of images of each camera, in any order; called as in the rig.",
        ),
    ] = None,
    rig: Annotated[Path, typer.Option(metavar="FILE", help="The calibrated cameras, a TOML.")] = Path("rig.toml"),
    start: Annotated[
        str | None,
        typer.Option(
            metavar="FILE[:FRAME]",
            help="Where the body is at first: JSON of named joints in metres, or what this command wrote before.",
        ),
    ] = None,
    points: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="POINTS",
            help="Instead of --start: the first frame's 2D keypoints, as triangulate takes them; may be repeated, or "
            "a folder of OpenPose's folders.",
        ),
    ] = None,
    model: Annotated[
        str | None, typer.Option(metavar="NAME", help="male, female, legs, or a rigged .glb or .gltf file; male.")
    ] = None,
    height: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="Of the person; without it, as large as the start's joints say."),
    ] = None,
    background: Annotated[
        list[str] | None,
        typer.Option(metavar="[NAME=]VIDEO", help="The empty room, as a camera sees it; may be repeated."),
    ] = None,
    frames: Annotated[str | None, typer.Option(metavar="odd|even|FROM:TO:STEP", help="Which frames to use.")] = None,
    hz: Annotated[
        float | None, typer.Option(metavar="HZ", help="Frames a second, where the files do not say it, or not rightly.")
    ] = None,
    other_size: Annotated[
        str | None,
        typer.Option(
            metavar="crop|scale", help="Images of another size than the calibration's: border cut off, or all scaled."
        ),
    ] = None,
    order: Annotated[str, typer.Option(metavar="NAME", help="OpenPose's order of points: BODY_25B or BODY_25.")] = (
        "BODY_25B"
    ),
    no_steadiness: Annotated[
        bool, typer.Option("--no-steadiness", help="Fit every frame for itself: without the penalty on jitter.")
    ] = False,
    json: JsonOut = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw the joints' angles over time, where matplotlib is installed."),
    ] = None,
    beside: Annotated[
        Path | None, typer.Option(metavar="FILE", help="In the plot, beside an earlier result of this command.")
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR|FILE.mp4", help="Write the images with the model's outline (green) and the image's (red)."
        ),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Show it in the browser meanwhile, and until Ctrl-C.")] = False,
    view_port: Annotated[
        int | None, typer.Option(metavar="PORT", min=1, max=65535, help="View port; by default 7448, or a free one.")
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the view's URL, open no browser.")] = False,
) -> None:
    """Fit a body model to the silhouettes of a person in the videos of calibrated cameras, frame by frame.

    docs/silhouettes.md describes how to film, what a start is, the results, and what the messages mean.

    Example:  mocapella silhouettes cam1.mp4 cam2.mp4 --rig rig.toml --start joints.json --json out.json
    """
    need_cameras("silhouettes")
    from mocapella.cli.silhouette_start import StartWishes, begin, find_start, learn
    from mocapella.live.silhouette_run import SilhouetteRun
    from mocapella.live.stopping import stop_on_signals
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.recording.followed_bodies import read_followed_body
    from mocapella.sources.video import parse_frames
    from mocapella.sources.video_set import VideoSet
    from mocapella.tracker.silhouettes import SilhouetteSettings

    inputs = _inputs(videos, hz, height)
    wanted = parse_frames(frames)
    earlier = None if beside is None else read_followed_body(beside)
    wishes = StartWishes(start, points or (), model, height, order)
    settings = SilhouetteSettings(steadiness=None) if no_steadiness else SilhouetteSettings()
    with working("reading …", status=INTERRUPTED), telling_of_compiling("the method silhouettes"):
        cameras = load_camera_rig(rig)
        shown = VideoSet(inputs, cameras, frames=wanted, rate_hz=hz, other_size=other_size)
        writer = None if overlay is None else _Overlays(overlay, shown.rate_hz / wanted.step)
        body, pose = find_start(wishes, cameras, wanted)
        run = SilhouetteRun(body.mesh, shown.rig, shown.rate_hz, settings, say)
        for note in shown.notes:
            run.note(note)
        begin(run, pose, wanted, start or "--points")
        if background:
            learn(run, background, cameras, shown, other_size)
    with ExitStack() as closing, stop_on_signals() as stop, telling_of_compiling("the method silhouettes"):
        tell, page = [], None
        if writer is not None:
            closing.callback(writer.close)
            tell.append(writer.write)
        if view:
            page = open_view(run, pose, view_port, no_browser=no_browser)
            closing.callback(page.close)
            tell.append(page.tell)
        whole = _follow(run, shown, stop, tell)
        result = as_result(run, body, shown, rig, steady=not no_steadiness)
        write_json(json, result)
        if json != "-":
            show(run, Console(highlight=False))
        if plot is not None:
            draw_angles(result, earlier, plot, str(beside))
        if page is not None and whole:
            say("the view stays until Ctrl-C")
            page.stay(stop)
    if not whole:
        say("stopped before the end: what there is by now was written")
        raise typer.Exit(INTERRUPTED)


def _inputs(videos: Sequence[str] | None, hz: float | None, height: float | None) -> dict[str, Path]:
    """Videos by name; the numbers are looked at, too."""
    from mocapella.cli.calibrate import named_inputs
    from mocapella.settings import check

    check(hz is None or 0 < hz <= 1000, "--hz", hz, "above 0, at most 1000")
    check(height is None or 0.5 <= height <= 2.5, "--height", height, "0.5 to 2.5 m")
    if not videos:
        raise SettingsError("no videos are named; name one for each camera: mocapella silhouettes cam1.mp4 cam2.mp4 …")
    return {name: Path(path) for name, path in named_inputs(videos).items()}


def open_view(run: SilhouetteRun, start: TreePose, port: int | None, *, no_browser: bool) -> SilhouetteView:
    """Serve the view, say where, and open it."""
    from mocapella.cli.demo import choose_port
    from mocapella.cli.serve import say_url
    from mocapella.live.silhouette_view import SilhouetteView

    page = SilhouetteView("127.0.0.1", choose_port(port, DEFAULT_VIEW_PORT), run, start)
    say_url(page.url)
    if not no_browser:
        webbrowser.open(page.url)
    return page


def _follow(run: SilhouetteRun, shown: VideoSet, stop: Event, tell: Sequence[Callable[[Step], None]]) -> bool:
    """Frame by frame; False where it was stopped before the end."""
    columns = (TextColumn("following"), BarColumn(), MofNCompleteColumn(), TextColumn("frames"), TimeRemainingColumn())
    said = len(shown.notes)
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("following", total=shown.count)
        for step in run.steps(shown):
            for each in tell:
                each(step)
            progress.advance(task)
            if stop.is_set():
                return shown.count is not None and len(run.rows) == shown.count
    for note in shown.notes[said:]:
        run.note(note)
    return True


def as_result(run: SilhouetteRun, body: Body, shown: VideoSet, rig: Path, *, steady: bool) -> dict[str, Any]:
    """What ``--json`` writes, and ``--start`` reads."""
    import msgspec

    from mocapella.recording.followed_bodies import FollowedBody

    whose = FollowedBody(body.model, run.rows, body.height_m, body.proportions.known)
    said = msgspec.to_builtins(whose)
    frames = said.pop("frames")
    cameras = {
        name: {"video": str(shown.videos[name].path), "size_px": list(shown.videos[name].size_px)}
        for name in run.rig.cameras
    }
    return {
        **{name: said.pop(name) for name in ("format", "version")},
        **said,
        "rig": str(rig),
        "cameras": cameras,
        "rate_hz": shown.rate_hz,
        "steadiness": steady,
        "summary": run.summary(),
        "frames": frames,
    }


def show(run: SilhouetteRun, out: Console) -> None:
    """The table for a person."""
    import numpy as np

    table = Table(box=SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    for words in ("camera", "frames", "overlap", "least", "left out"):
        table.add_column(words, justify="left" if words == "camera" else "right")
    for name in run.rig.cameras:
        overlaps = [row.overlap[name] for row in run.rows if name in row.overlap]
        median, least = (f"{np.median(overlaps):.1%}", f"{min(overlaps):.1%}") if overlaps else ("–", "–")
        table.add_row(name, str(len(overlaps)), median, least, str(sum(name in row.left_out for row in run.rows)))
    out.print(table)
    lost = sum(row.lost for row in run.rows)
    if run.rows:
        gone = f", {lost} of them without anybody" if lost else ""
        out.print(f"{len(run.rows)} frames{gone}; {1e3 * np.median(run.took_s):.0f} ms a frame")


def draw_angles(result: Mapping[str, Any], earlier: FollowedBody | None, path: Path, beside: str) -> None:
    """Each joint's angle [°] over time [s], this run's in blue, an earlier one's in orange.

    Raises:
        SettingsError: it cannot be written there.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        say(
            f"--plot {path}: no plot, because matplotlib is not installed: uv sync --extra plots "
            "(elsewhere: install 'mocapella[plots]')"
        )
        return
    import numpy as np

    runs = [("tab:blue", "this run", [(row["time_s"], row["angles"]) for row in result["frames"]])]
    if earlier is not None:
        runs.insert(0, ("tab:orange", beside, [(row.time_s, row.angles) for row in earlier.frames]))
    names = list(runs[-1][2][0][1]) if runs[-1][2] else []
    if not names:
        say(f"--plot {path}: no plot, because the model has no joints, or there is no frame")
        return
    columns = 4
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(3.2 * columns, 1.9 * rows), layout="constrained")
    for axes, name in zip(figure.subplots(rows, columns, sharex=True, squeeze=False).ravel(), names, strict=False):
        for colour, label, points in runs:
            there = [(at, np.degrees(angles[name])) for at, angles in points if name in angles]
            axes.plot(*zip(*there, strict=True), color=colour, label=label, linewidth=1) if there else None
        axes.set_title(f"{name} [°]", fontsize=8)
        axes.tick_params(labelsize=7)
    figure.supxlabel("time [s]", fontsize=8)
    if earlier is not None:
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", fontsize=8, ncols=2)
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise SettingsError(f"--plot {path}: {error}; name a .png or .svg in a folder that exists") from error
    say(f"plot in {path}")


class _Overlays:
    """Writes every step's images with the outlines."""

    def __init__(self, path: Path, rate_hz: float) -> None:
        from mocapella.sensing.outline_picture import OverlayWriter

        self._writer = OverlayWriter(path, rate_hz)

    def write(self, step: Step) -> None:
        """One step's."""
        self._writer.write(step.row.frame, step.pictures())

    def close(self) -> None:
        """Finish."""
        self._writer.close()
