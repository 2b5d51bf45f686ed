"""``mocapella lab evaluate silhouettes-…``: effect of the smoothness prior on bodies fitted to silhouettes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.command_settings import NoKeys, SettingsFile, lines_of_dataclass, read_settings, set_option
from mocapella.cli.common import JsonOut, Plot, console, participant_numbers, say, seconds_option, write_json
from mocapella.cli.evaluate import Seeds
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.tracker.silhouette_settings import SilhouetteSettings

Bodies = Annotated[
    str,
    typer.Option(
        "--bodies",
        metavar="NAME,NAME,…",
        help="Body mesh used for tracking: the subject's own, or one of the proportions measured in the first frame.",
    ),
]


def _silhouettes_keys(_: typer.Context) -> Iterator[str]:
    """Yield the settings of the method, for ``--set help``."""
    from mocapella.tracker.silhouette_settings import SilhouetteSettings

    yield from lines_of_dataclass(SilhouetteSettings, "Settings of the method silhouettes:")


Settings = Annotated[list[str] | None, set_option(NoKeys, _silhouettes_keys)]
SceneSeconds = Annotated[float | None, seconds_option("Of each scene; by default at its end.")]
_SEEDS = "100"
_COMMANDS: Final = {
    "knee-bend": (
        "own,measured",
        "Measure what the penalty on jitter leaves of a knee bend: its peak, how late it comes, and the feet's jitter.",
    ),
    "runner": (
        "own,measured",
        "Follow a runner in images with noise and random rectangles, with the penalty on jitter and without.",
    ),
    "acrobatics": (
        "own,measured",
        "Track a cartwheel and a flick-flack with some completely wrong frames.",
    ),
    "loss": (
        "own",
        "Cover all cameras for 0.8 s during a knee bend and a cartwheel, and see whether the body is found again.",
    ),
    "weight": (
        "own",
        "Follow clean and noisy images with one and the same weight of the penalty on jitter, for many weights.",
    ),
    "one-camera": (
        "own",
        "Follow people with one camera alone, with the penalty on jitter and without, and report the uncertain angles.",
    ),
}
"""Bodies and purpose of each experiment."""


def _command(name: str, usual: str, about: str) -> None:
    """Register an experiment as a command."""

    def command(
        seeds: Seeds = _SEEDS, bodies: Bodies = usual, seconds: SceneSeconds = None, plot: Plot = None,
        settings_file: SettingsFile = None, settings: Settings = None, json: JsonOut = None,
    ) -> None:  # fmt: skip
        _experiment(name, seeds, bodies, seconds, plot, json, method_settings(settings_file, settings))

    called = f"silhouettes-{name}"
    command.__doc__ = (
        f"{about}\n\ndocs/evaluation.md says how everything is scored.\n\n"
        f"Example:  mocapella lab evaluate {called} --plot {name}.png"
    )
    evaluate_app.command(called)(command)


for _name, (_usual, _about) in _COMMANDS.items():
    _command(_name, _usual, _about)


def method_settings(file: Path | None, pairs: Sequence[str] | None) -> SilhouetteSettings:
    """Parse the settings of the method that an experiment runs with.

    Raises:
        InputError, SettingsError: as in `read_settings` and `parse`; or ``steadiness`` is null, which is the
            experiment's to choose.
    """
    from mocapella.settings import parse
    from mocapella.tracker.silhouette_settings import SilhouetteSettings

    _, given = read_settings(NoKeys, file, pairs)
    if "steadiness" in given and given["steadiness"] is None:
        raise SettingsError(
            "setting steadiness is null, but the experiment compares runs with the penalty and without; leave it out"
        )
    return parse(SilhouetteSettings, given, where="settings of silhouettes")


def _experiment(
    name: str, seeds: str, bodies: str, seconds: float | None, plot: Path | None, json: str | None,
    settings: SilhouetteSettings,
) -> None:  # fmt: skip
    import msgspec

    from mocapella.cli.evaluate import split_names
    from mocapella.evaluation.silhouette_experiments import EXPERIMENTS, plot_movements, plot_weights, run
    from mocapella.evaluation.silhouette_one_camera import plot_one_camera, run_one_camera

    numbers, chosen = participant_numbers(seeds, "--seeds") or [], split_names(bodies)
    rows: Sequence[Any]
    draw: Callable[[Path], None]
    with console.status("rendering …") as status:
        if name == "one-camera":
            rows, of_one = run_one_camera(numbers, seconds, chosen, status.update, settings=settings)
            draw = partial(plot_one_camera, of_one)
        else:
            rows, shown = run(name, numbers, seconds, chosen, status.update, settings=settings)
            movements = partial(plot_movements, shown, EXPERIMENTS[name].hinges)
            draw = partial(plot_weights, rows) if name == "weight" else movements
    write_json(json, {"experiment": name, "seeds": numbers, "rows": msgspec.to_builtins(rows)})
    if plot is not None:
        draw(plot)
        say(f"plot in {plot}")
    if json != "-":
        (show_one_camera if name == "one-camera" else show_runs)(rows, Console())


_ACCURACY = ("angles\n°", "sd\n°", "hinges\n°", "sd\n°", "marks\nmm", "95 %", "IoU\n%")
_STEADINESS = ("jitter\nm/s²", "feet\nm/s²", "true\nm/s²", "knees\nkept %", "late\nframes")
_LOSS = ("blind\nframes", "lost\nframes", "end\n°")
_OFF = ("depth\nmm", "95 %", "across\nmm", "95 %", "jitter\ndepth", "\nacross", "away\n%", "IoU\n%")
_FREE = ("four\ncameras", "one\ncamera", "all")


def show_runs(rows: Any, out: Console) -> None:
    """Print the rows of `mocapella.evaluation.silhouette_experiments.run` as tables."""
    for headings, figures_of in ((_ACCURACY, _accuracy), (_STEADINESS, _steadiness), (_LOSS, _loss)):
        _table([(row, figures_of(row)) for row in rows], headings, out)
    out.print("marks: landmarks; jitter: acceleration of their error; feet: that of ankles and", highlight=False)
    out.print("toes as such, beside the true one; blind: frames without a camera that counted;", highlight=False)
    out.print("end: joint error of the last ten frames", highlight=False)
    _problems(rows, out)


def show_one_camera(rows: Any, out: Console) -> None:
    """Print the rows of `mocapella.evaluation.silhouette_one_camera.run_one_camera` as tables."""
    _table([(row.run, _off(row)) for row in rows], _OFF, out)
    out.print("depth, across: error of the landmarks along the camera's axis and across it, and", highlight=False)
    out.print("its jitter, m/s²; away: frames in which the body is not where the person is", highlight=False)
    _table([(row.run, (row.outlines_of_many, row.outlines, row.free)) for row in rows], _FREE, out, digits=2)
    out.print("uncertainty of the least certain direction, m or rad: of the outlines of four", highlight=False)
    out.print("cameras, of this one, and with all that holds the body", highlight=False)
    _problems([row.run for row in rows], out)


def _table(rows: Any, headings: Sequence[str], out: Console, digits: int = 1) -> None:
    """Print a row for each run; the first row of its weights names it."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for heading in ("", "penalty", *headings):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    before, line = None, 0
    for row, figures in rows:
        run = (row.scene, row.seed, row.body, row.images)
        before, line = run, line + 1 if run == before else 0
        words = (f"{row.scene} {row.seed}", f"  {row.images}, {row.body}")
        told = ("–" if x is None else str(x) if isinstance(x, int) else f"{x:.{digits}f}" for x in figures)
        table.add_row(words[line] if line < len(words) else "", _penalty(row.weight), *told)
    out.print(table)


def _problems(rows: Any, out: Console) -> None:
    for row in rows:
        if row.outcome.problem:
            what = f"{row.scene} {row.seed}, {row.images}, {row.body} body, penalty {_penalty(row.weight)}"
            out.print(f"{what}: {row.outcome.problem}", highlight=False)


def _off(row: Any) -> tuple[float, ...]:
    sizes = row.depth_mm, row.depth_p95_mm, row.across_mm, row.across_p95_mm
    return *map(round, (*sizes, row.depth_jitter, row.across_jitter, 100 * row.away)), 100 * row.run.overlap


def _accuracy(row: Any) -> tuple[float | None, ...]:
    s = row.score
    return s.angle_deg, s.angle_sd_deg, s.hinge_deg, s.hinge_sd_deg, s.median_mm, s.p95_mm, 100 * row.overlap


def _steadiness(row: Any) -> tuple[float | None, ...]:
    s, kept = row.score, None if row.kept is None else 100 * row.kept
    return s.jitter, s.feet, s.true_feet, kept, row.lag


def _loss(row: Any) -> tuple[float | None, ...]:
    return row.blind, row.lost, row.outcome.late_deg


def _penalty(weight: float) -> str:
    return f"× {weight:g}" if weight else "none"
