"""``mocapella demo silhouettes``: track a rendered person by the silhouettes in four cameras."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Final

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mocapella.cli.common import console, need_cameras, say, telling_of_compiling, working, write_json
from mocapella.errors import SettingsError, one_of

if TYPE_CHECKING:
    from threading import Event

    from mocapella.evaluation.silhouette_truth import TruthMeter
    from mocapella.live.silhouette_run import SilhouetteRun, Step
    from mocapella.sources.simulate.corruption import Corruption
    from mocapella.sources.simulate.silhouette_scene import SilhouetteScene

RATE_HZ: Final = 60.0
SCENE: Final = "runner"
CORRUPTIONS: Final = {
    "noise": "15 % of the pixels are replaced by random ones",
    "rectangles": "six rectangles in every image",
    "wrong": "one frame in twenty shows something else",
}


def run_demo(
    scene: str | None,
    seed: int,
    corrupt: str | None,
    *,
    seconds: float | None,
    fit: Mapping[str, Any],
    view: bool,
    view_port: int | None,
    no_browser: bool,
    json: str | None,
) -> None:
    """Render a scene, track it, show it, and print the errors against the ground truth.

    Args:
        scene: name of the scene; None for the demo's; ``help`` prints the names and exits.
        seed: random seed of the scene, the corruption, and the error of the initial pose.
        corrupt: key of `CORRUPTIONS`; None leaves the images as rendered.
        seconds: duration, including the display of the result in the view [s]; None: the whole scene, until Ctrl-C.
        fit: settings of the fit, as of `fit_settings`.
        view: whether the live view is served.
        view_port: its TCP port; None for the default or a free one.
        no_browser: whether the view is not opened in the browser.
        json: target of the result, as of `write_json`.

    Raises:
        SettingsError: an unknown scene or corruption.
    """
    need_cameras("demo silhouettes")
    from mocapella.cli.silhouettes import open_view
    from mocapella.evaluation.silhouette_truth import TruthMeter, rough_start
    from mocapella.live.signals import stop_on_signals
    from mocapella.live.silhouette_run import SilhouetteRun
    from mocapella.recording.bodies_file import ALONE
    from mocapella.settings import parse
    from mocapella.sources.simulate.silhouette_scene import scene_names, silhouette_scene
    from mocapella.tracker.frame_sync import FrameSyncSettings
    from mocapella.tracker.initial_body import InitialBody
    from mocapella.tracker.silhouette_settings import SilhouetteSettings
    from mocapella.tracker.silhouettes import SilhouettesTracker

    name = scene or SCENE
    if name == "help":
        typer.echo("\n".join(scene_names()))
        raise typer.Exit
    wrong = _corruption(corrupt, seed)
    settings = parse(SilhouetteSettings, fit)
    with working("making the room …", status=0), telling_of_compiling("the rendered body and the method silhouettes"):
        made = silhouette_scene(name, seed=seed, cameras=4, size_px=(640, 480), fps=RATE_HZ, corruption=wrong)
        body = InitialBody(made.mesh, rough_start(made.pose(0), made.mesh.tree.limits, seed))
        sync = FrameSyncSettings(period_s=1.0 / RATE_HZ)
        run = SilhouetteRun(SilhouettesTracker({ALONE: body}, made.rig, settings, sync=sync), say)
        made.images(0)  # compiles once a machine
    meter = TruthMeter(made.mesh.joint_names)
    said = "" if corrupt is None else f", {CORRUPTIONS[corrupt]}"
    say(f"rendering {name} before four cameras, {len(made)} frames{said} (Ctrl-C ends)")
    with ExitStack() as closing, stop_on_signals() as stop, telling_of_compiling("the method silhouettes"):
        page = None
        if view:
            page = open_view(run, view_port, no_browser=no_browser)
            closing.callback(page.close)
        begin_s = time.monotonic()
        for step in _shown(run, made, stop, seconds):
            _score(meter, made, step)
            if page is not None:
                page.tell(step)
        result = _result(name, run, meter, len(made))
        write_json(json, result)
        _tell(result)
        if page is not None and not stop.is_set():
            left = None if seconds is None else max(0.0, seconds - (time.monotonic() - begin_s))
            say("the view stays until Ctrl-C" if left is None else f"the view stays for {left:.0f} s")
            page.stay(stop, left)


def _corruption(corrupt: str | None, seed: int) -> Corruption | None:
    from mocapella.sources.simulate.corruption import Corruption

    if corrupt is None:
        return None
    if corrupt not in CORRUPTIONS:
        raise SettingsError(f"corrupt is {corrupt!r}; it must be one of {one_of(corrupt, CORRUPTIONS)}")
    return {
        "noise": Corruption(noise=0.15, seed=seed),
        "rectangles": Corruption(rectangles=6, seed=seed),
        "wrong": Corruption(wrong=0.05, seed=seed),
    }[corrupt]


def _shown(run: SilhouetteRun, made: SilhouetteScene, stop: Event, seconds: float | None) -> Iterator[Step]:
    """Yield each step after its tracking, until the last frame, the end of the time, or ``stop``."""
    from mocapella.sources.frame_set import FrameSet

    names, end_s = list(made.rig.cameras), None if seconds is None else time.monotonic() + seconds
    columns = (TextColumn("following"), BarColumn(), MofNCompleteColumn(), TextColumn("frames"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("following", total=len(made))
        for k in range(len(made)):
            if stop.is_set() or (end_s is not None and time.monotonic() >= end_s):
                return
            yield run.step(FrameSet.at_rate(k, RATE_HZ, dict(zip(names, made.images(k), strict=True))))
            progress.advance(task)


def _score(meter: TruthMeter, made: SilhouetteScene, step: Step) -> None:
    ((k, found),) = ((step.frame, one.followed) for one in step.people.values())
    masks = dict(zip(made.rig.cameras, made.masks(k), strict=True))
    outlines = {name: one.outline for name, one in found.seen.items()}
    meter.update(found.pose, found.landmarks, outlines, (made.pose(k), made.landmarks(k), masks))


def _result(name: str, run: SilhouetteRun, meter: TruthMeter, frames: int) -> dict[str, Any]:
    import msgspec

    from mocapella.recording.bodies_file import ALONE

    score = meter.score
    return {
        "scene": name,
        "scene_frames": frames,
        "score": None if score is None else msgspec.to_builtins(score),
        "summary": {**run.summary_of(ALONE), **run.summary()},
    }


def _tell(result: dict[str, Any]) -> None:
    score = result["score"]
    if score is None:
        say("no frame was followed")
        return
    say(
        f"{score['frames']} frames: angles {score['angle_deg']:.1f}° off in the median, {score['angle_mean_deg']:.1f}° "
        f"in the mean; joints {score['joints_mm']:.0f} mm in the median; overlap with the truth "
        f"{score['overlap']:.1%}; {result['summary']['median_ms']:.0f} ms a frame"
    )
