"""``mocapella silhouettes``: body models fitted to the silhouettes that calibrated cameras see, in videos or live."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import app
from mocapella.cli.common import (
    DEFAULT_VIEW_PORT,
    JsonOut,
    Seconds,
    console,
    need_cameras,
    say,
    telling_of_compiling,
    working,
    write_json,
)
from mocapella.cli.markers import Fourcc
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from threading import Event

    from mocapella.cli.silhouette_live import LiveWishes
    from mocapella.live.silhouette_run import SilhouetteRun, Step
    from mocapella.live.silhouette_view import SilhouetteView
    from mocapella.model.camera import CameraRig
    from mocapella.model.twist_tree import TreePose
    from mocapella.recording.followed_bodies import FollowedBody
    from mocapella.sources.frame_set import FrameSource
    from mocapella.sources.video import Frames
    from mocapella.tracker.silhouette_start import Body


@app.command()
def silhouettes(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME=]SOURCE…",
            help="A video or a folder of images of each camera, or live: camera:0, /dev/video0, http://… or rtsp://…; "
            "in any order, called as in the rig.",
        ),
    ] = None,
    rig: Annotated[Path, typer.Option(metavar="FILE", help="The calibrated cameras, a TOML.")] = Path("rig.toml"),
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PERSON=]FILE[:FRAME]",
            help="Where the bodies are at first: JSON of named joints in metres, of one or of several people by name, "
            "or what this command wrote before; may be repeated.",
        ),
    ] = None,
    points: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PERSON=]POINTS",
            help="Instead of --start: the first frame's 2D keypoints, as triangulate takes them; may be repeated, or "
            "a folder of OpenPose's folders.",
        ),
    ] = None,
    model: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PERSON=]NAME",
            help="male, female, legs, or a rigged .glb or .gltf file; male. May be repeated, one a person.",
        ),
    ] = None,
    height: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PERSON=]METRES",
            help="Of the person; without it, as large as the start's joints say. May be repeated, one a person.",
        ),
    ] = None,
    background: Annotated[
        list[str] | None,
        typer.Option(metavar="[NAME=]VIDEO", help="The empty room, as a camera sees it; may be repeated."),
    ] = None,
    frames: Annotated[str | None, typer.Option(metavar="odd|even|FROM:TO:STEP", help="Which frames to use.")] = None,
    hz: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Frames a second, where the files do not say it, or not rightly; what to ask cameras for.",
        ),
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
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Take videos as if they were cameras: at their own pace; what it has no time for is dropped."
        ),
    ] = False,
    empty_room: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="Live: for so long nobody is in the images; then somebody may come to the start."
        ),
    ] = None,
    seconds: Seconds = None,
    fourcc: Fourcc = None,
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
            metavar="DIR|FILE.mp4",
            help="Write the images with the models' outlines, and the images' where they are outside (red) or inside "
            "(blue) of them.",
        ),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Show it in the browser meanwhile, and until Ctrl-C.")] = False,
    view_port: Annotated[
        int | None, typer.Option(metavar="PORT", min=1, max=65535, help="View port; by default 7448, or a free one.")
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the view's URL, open no browser.")] = False,
) -> None:
    """Fit body models to the silhouettes of one or several people in videos of calibrated cameras, or live.

    docs/silhouettes.md describes how to film, what a start is, the results, and what the messages mean.

    Example:  mocapella silhouettes cam1.mp4 cam2.mp4 --rig rig.toml --start joints.json --json out.json

    Live:  mocapella silhouettes left=camera:0 right=camera:2 --start joints.json --empty-room 3 --view --json out.json
    """
    need_cameras("silhouettes")
    from mocapella.cli.silhouette_live import LiveWishes, wait_for_people
    from mocapella.cli.silhouette_start import StartWishes, find_start, learn
    from mocapella.live.stopping import stop_on_signals
    from mocapella.model.camera_rig_file import load_camera_rig
    from mocapella.recording.followed_bodies import read_followed_people
    from mocapella.sources.video import parse_frames

    live_wishes = LiveWishes(
        _inputs(sources, hz), live, hz, other_size, fourcc, empty_room, seconds, frames, background or ()
    )
    live_wishes.verify()
    wanted = parse_frames(frames)
    earlier = None if beside is None else read_followed_people(beside)
    wishes = StartWishes(start or (), points or (), model or (), height or (), order)
    with ExitStack() as closing:
        with working("reading …", status=INTERRUPTED), telling_of_compiling("the method silhouettes"):
            cameras = load_camera_rig(rig)
            shown = _opened(live_wishes, cameras, wanted, closing)
            tell: list[Callable[[Step], None]] = []
            if overlay is not None:
                writer = _Overlays(overlay, shown, wanted.step)
                closing.callback(writer.close)
                tell.append(writer.write)
            found = find_start(wishes, cameras, wanted)
            poses = {name: pose for name, (_, pose) in found.items()}
            run = _started(found, shown, ", ".join(start or ["--points"]), steady=not no_steadiness)
            if background:
                learn(run, background, cameras, shown, other_size)
        if live_wishes.live and (background or empty_room is not None):
            wait_for_people(run, shown, poses, empty_room, view=view)
        with stop_on_signals() as stop, telling_of_compiling("the method silhouettes"):
            page = None
            if view:
                page = open_view(run, poses, view_port, no_browser=no_browser)
                closing.callback(page.close)
                tell.append(page.tell)
            whole = _follow(run, shown, stop, seconds, tell)
            result = as_result(
                run, {name: body for name, (body, _) in found.items()}, shown, rig, steady=not no_steadiness
            )
            write_json(json, result)
            if json != "-":
                show(run, Console(highlight=False), shown.summary())
            if plot is not None:
                draw_angles(result, earlier, plot, str(beside))
            if page is not None and whole and not (stop.is_set() or seconds is not None):
                say("the view stays until Ctrl-C")
                page.stay(stop)
    if not whole:
        say("stopped before the end: what there is by now was written")
        raise typer.Exit(INTERRUPTED)


def _opened(wishes: LiveWishes, cameras: CameraRig, wanted: Frames, closing: ExitStack) -> FrameSource:
    """The cameras, or the videos."""
    from mocapella.cli.silhouette_live import open_live
    from mocapella.sources.video_set import VideoSet

    if wishes.live:
        return closing.enter_context(open_live(wishes, cameras))
    paths = {name: Path(path) for name, path in wishes.sources.items()}
    return VideoSet(paths, cameras, frames=wanted, rate_hz=wishes.hz, other_size=wishes.other_size)


def _started(
    found: Mapping[str, tuple[Body, TreePose]], shown: FrameSource, words: str, *, steady: bool
) -> SilhouetteRun:
    """The run, with all where they start."""
    from mocapella.cli.silhouette_start import begin
    from mocapella.live.silhouette_run import SilhouetteRun
    from mocapella.tracker.silhouette_settings import SilhouetteSettings

    settings = SilhouetteSettings() if steady else SilhouetteSettings(steadiness=None)
    run = SilhouetteRun({name: body.mesh for name, (body, _) in found.items()}, shown.rig, settings, say)
    for note in shown.notes:
        run.note(note)
    begin(run, {name: pose for name, (_, pose) in found.items()}, shown.start_ns, words)
    return run


def _inputs(sources: Sequence[str] | None, hz: float | None) -> dict[str, str]:
    """Videos or cameras by name; the rate is looked at, too."""
    from mocapella.cli.calibrate import named_inputs
    from mocapella.settings import check

    check(hz is None or 0 < hz <= 1000, "--hz", hz, "above 0, at most 1000")
    if not sources:
        raise SettingsError("no videos are named; name one for each camera: mocapella silhouettes cam1.mp4 cam2.mp4 …")
    return named_inputs(sources)


def open_view(
    run: SilhouetteRun, starts: Mapping[str, TreePose], port: int | None, *, no_browser: bool
) -> SilhouetteView:
    """Serve the view, say where, and open it."""
    from mocapella.cli.demo import choose_port
    from mocapella.cli.serve import say_url
    from mocapella.live.silhouette_view import SilhouetteView

    page = SilhouetteView("127.0.0.1", choose_port(port, DEFAULT_VIEW_PORT), run, starts)
    say_url(page.url)
    if not no_browser:
        webbrowser.open(page.url)
    return page


def _follow(
    run: SilhouetteRun,
    shown: FrameSource,
    stop: Event,
    seconds: float | None,
    tell: Sequence[Callable[[Step], None]],
) -> bool:
    """Frame by frame; False where it was stopped before the end. Live cameras have no other end."""
    from mocapella.cli.silhouette_live import follow_live
    from mocapella.sources.live_set import LiveSet

    if isinstance(shown, LiveSet):
        follow_live(run, shown, stop, seconds, tell)
        return True
    whom = ", ".join(filter(None, run.meshes))
    columns = (
        TextColumn(f"following {whom}".strip(), markup=False), BarColumn(), MofNCompleteColumn(), TextColumn("frames"),
        TimeRemainingColumn(),
    )  # fmt: skip
    said = len(shown.notes)
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("following", total=shown.count)
        for step in run.steps(shown):
            for each in tell:
                each(step)
            progress.advance(task)
            if stop.is_set():
                return shown.count is not None and len(run.took_s) == shown.count
    for note in shown.notes[said:]:
        run.note(note)
    return True


def as_result(
    run: SilhouetteRun, bodies: Mapping[str, Body], shown: FrameSource, rig: Path, *, steady: bool
) -> dict[str, Any]:
    """What ``--json`` writes, and ``--start`` reads: one body that nobody named, or people by name."""
    from mocapella.recording.followed_bodies import ALONE, PEOPLE_FORMAT, VERSION

    how = {"rig": str(rig), "cameras": shown.described(), "rate_hz": shown.rate_hz, "steadiness": steady}
    whole = {**run.summary(), **shown.summary()}
    people = {name: _body_result(run, name, body) for name, body in bodies.items()}
    if ALONE in people:
        (one,) = people.values()
        frames, summary = one.pop("frames"), one.pop("summary")
        return {**one, **how, "summary": {**summary, **whole}, "frames": frames}
    return {"format": PEOPLE_FORMAT, "version": VERSION, **how, "summary": whole, "people": people}


def _body_result(run: SilhouetteRun, name: str, body: Body) -> dict[str, Any]:
    import msgspec

    from mocapella.recording.followed_bodies import FollowedBody

    said = msgspec.to_builtins(FollowedBody(body.model, run.rows[name], body.height_m, body.proportions.known))
    frames = said.pop("frames")
    return {
        **{key: said.pop(key) for key in ("format", "version")}, **said, "summary": run.summary_of(name),
        "frames": frames,
    }  # fmt: skip


def show(run: SilhouetteRun, out: Console, summary: Mapping[str, Any] = MappingProxyType({})) -> None:
    """The table for a person, and what the images' source tells of the run."""
    import numpy as np

    named = [name for name in run.rows if name]
    table = Table(box=SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    for words in (*(["person"] if named else []), "camera", "frames", "overlap", "least", "left out"):
        table.add_column(words, justify="left" if words in ("person", "camera") else "right")
    for person, rows in run.rows.items():
        for k, name in enumerate(run.rig.cameras):
            overlaps = [row.overlap[name] for row in rows if name in row.overlap]
            median, least = (f"{np.median(overlaps):.1%}", f"{min(overlaps):.1%}") if overlaps else ("–", "–")
            whose = [Text(person if k == 0 else "")] if named else []
            left_out = str(sum(name in row.left_out for row in rows))
            table.add_row(*whose, name, str(len(overlaps)), median, least, left_out)
    out.print(table)
    if run.took_s:
        lost = {name: sum(row.lost for row in rows) for name, rows in run.rows.items()}
        gone = ", ".join(f"{count} of them without {name or 'anybody'}" for name, count in lost.items() if count)
        took = f"{1e3 * np.median(run.took_s):.0f} ms a frame"
        dropped = ", ".join(f"{name} {count}" for name, count in summary.get("dropped", {}).items())
        told = f"; pictures dropped: {dropped}" if dropped else ""
        out.print(f"{len(run.took_s)} frames{f', {gone}' if gone else ''}; {took}{told}", markup=False)


def draw_angles(result: Mapping[str, Any], earlier: Mapping[str, FollowedBody] | None, path: Path, beside: str) -> None:
    """Each joint's angle [°] over time [s]: each person's in a colour, an earlier run's dashed.

    Of one person alone, this run's is blue, and the earlier one's orange.

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

    people: Mapping[str, Any] = result.get("people", {"": result})
    runs = []
    for k, (name, one) in enumerate(people.items()):
        before = (earlier or {}).get(name)
        if before is not None:
            points = [(row.time_s, row.angles) for row in before.frames]
            colour, line = (f"C{k}", "--") if name else ("tab:orange", "-")
            runs.append((colour, line, f"{name}, {beside}" if name else beside, points))
        points = [(row["time_s"], row["angles"]) for row in one["frames"]]
        runs.append((f"C{k}" if name else "tab:blue", "-", name or "this run", points))
    missing = [name for name in earlier or {} if name not in people]
    if missing:
        say(f"--beside {beside}: not drawn, for it is of {', '.join(missing) or 'a body without a name'}")
    names = list(dict.fromkeys(key for *_, points in runs for _, angles in points[:1] for key in angles))
    if not names:
        say(f"--plot {path}: no plot, because the model has no joints, or there is no frame")
        return
    columns = 4
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(3.2 * columns, 1.9 * rows), layout="constrained")
    handles: dict[str, Any] = {}
    for axes, name in zip(figure.subplots(rows, columns, sharex=True, squeeze=False).ravel(), names, strict=False):
        for colour, line, label, points in runs:
            there = [(at, np.degrees(angles[name])) for at, angles in points if name in angles]
            if there:
                (handles[label],) = axes.plot(
                    *zip(*there, strict=True), color=colour, linestyle=line, label=label, linewidth=1
                )
        axes.set_title(f"{name} [°]", fontsize=8)
        axes.tick_params(labelsize=7)
    figure.supxlabel("time [s]", fontsize=8)
    if len(handles) > 1:
        figure.legend(list(handles.values()), list(handles), loc="outside upper right", fontsize=8, ncols=len(handles))
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise SettingsError(f"--plot {path}: {error}; name a .png or .svg in a folder that exists") from error
    say(f"plot in {path}")


class _Overlays:
    """Writes every step's images with the outlines."""

    def __init__(self, path: Path, shown: FrameSource, step: int) -> None:
        from mocapella.sensing.outline_picture import OverlayWriter

        sizes = {name: placed.camera.size_px for name, placed in shown.rig.cameras.items()}
        self._writer = OverlayWriter(path, shown.rate_hz / step, sizes)

    def write(self, step: Step) -> None:
        """One step's."""
        self._writer.write(step.frame, step.pictures())

    def close(self) -> None:
        """Finish."""
        self._writer.close()
