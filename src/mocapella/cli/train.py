"""``mocapella lab train``: train the shipped models again from recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella import __version__
from mocapella.cli.app import train_app
from mocapella.cli.common import (
    OUT_HELP,
    JsonOut,
    Participants,
    StudyFolder,
    console,
    participant_numbers,
    say,
    write_json,
)
from mocapella.errors import SettingsError

ModelFile = Annotated[Path, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} The trained model (JSON).")]

_COLUMNS = {
    "against_motion_percent": "against",
    "reversals_per_min": "reversals",
    "backward_kept_percent": "backward",
    "steps_wrong_percent": "Steps",
    "stationary_wrong_percent": "Stationary",
    "walk_differs_percent": "differs",
}
_CAPTION = (
    "against: % of Walk's moving frames; reversals: a minute of Walk; backward: % of the motion kept; "
    "Steps, Stationary: % of frames wrong; differs: % of Walk's frames, from the reference"
)


@train_app.command("facing")
def facing(
    folder: StudyFolder,
    out: ModelFile,
    participants: Participants = None,
    folds: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=2, help="Cross-validate with this number of folds of participants, and print the scores."
        ),
    ] = None,
    json: JsonOut = None,
) -> None:
    """Train the facing model: how a sensor's labels, a body's shape and motion depend on the direction people face.

    docs/methods/facing.md describes the method, and what the shipped model was trained on.

    Example:  mocapella lab train facing shared/data/kinectmultitrack --out facing.json --folds 2
    """
    from mocapella.evaluation.facing_sessions import TOPOLOGY, facing_sessions, left_out, split, trained_on
    from mocapella.fusion.facing_model import to_json
    from mocapella.fusion.facing_training import train

    chosen = participant_numbers(participants)
    _check_folder_of(out)
    with console.status("reading …") as status:
        sessions = facing_sessions(folder, chosen, lambda name: status.update(f"reading {name} …"))
        if folds is not None:
            split(sessions, folds)  # says before the work whether it can be done
        status.update("training …")
        model = train([session.sequence for session in sessions], TOPOLOGY.name)
        statement = {
            **trained_on(sessions),
            "command": "mocapella lab train facing DIR" + ("" if chosen is None else f" --participants {participants}"),
            "mocapella": __version__,
        }
        write_text(out, to_json(msgspec.structs.replace(model, trained_on=statement)))
        figures = {}
        if folds is not None:
            status.update(f"training {folds} times, without those who are tested …")
            scored = left_out(sessions, folds, model)
            figures = {name: msgspec.to_builtins(row) for name, row in scored.items()}
    say(f"{out}: {out.stat().st_size} bytes, of {len(sessions)} sessions of {len(statement['participants'])} people")
    write_json(json, {"out": str(out), "trained_on": statement, "left_out": figures})
    if figures and json != "-":
        Console().print(_table(figures, folds))


@train_app.command("bias")
def bias(
    folder: StudyFolder,
    out: ModelFile,
    participants: Participants = None,
    folds: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=2,
            help="Cross-validate with this number of folds of participants, and print the scores; keep the models.",
        ),
    ] = None,
    json: JsonOut = None,
) -> None:
    """Train the joint bias: a sensor's systematic error of each joint, by the person's facing relative to it.

    docs/methods/joint-bias.md describes the method, and what the shipped model was trained on. Only a model with folds
    can be scored on people whom it was trained on.

    Example:  mocapella lab train bias shared/data/kinectmultitrack --out joint_bias.json --folds 5
    """
    from mocapella.evaluation.bias_sessions import bias_sessions, learn, left_out
    from mocapella.evaluation.facing_sessions import split
    from mocapella.evaluation.study_tables import rounded
    from mocapella.fusion.joint_bias import read_model, to_json

    chosen = participant_numbers(participants)
    _check_folder_of(out)
    with console.status("reading …") as status:
        sessions = bias_sessions(folder, chosen, lambda name: status.update(f"tracking {name} …"))
        parts = [] if folds is None else split(sessions, folds)
        status.update("training …")
        model = learn(sessions, parts)
        options = "" if chosen is None else f" --participants {participants}"
        options += "" if folds is None else f" --folds {folds}"
        statement = {**model.trained_on, "command": "mocapella lab train bias DIR" + options, "mocapella": __version__}
        write_text(out, to_json(msgspec.structs.replace(model, trained_on=statement)))
        figures = {}
        if parts:
            model = read_model(out)  # evaluate the model exactly as written, to its last digit
            figures = rounded(left_out(sessions, model, lambda name: status.update(f"tracking {name} with it …")))
    say(f"{out}: {out.stat().st_size} bytes, of {len(sessions)} sessions of {len(statement['participants'])} people")
    write_json(json, {"out": str(out), "trained_on": statement, "left_out": figures})
    if figures and json != "-":
        _show_nearer(figures, folds, Console())


def _show_nearer(figures: dict[str, Any], folds: int | None, out: Console) -> None:
    """Print Δd without and with the bias correction, by row and placement, and for the fused skeleton."""
    placements = [name for name in ("parallel", "45", "90") if any(name in row for row in figures["with"].values())]
    title = f"people left out: {folds} folds; mean Δd, cm"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=0, show_edge=False)
    table.add_column("", no_wrap=True)
    table.add_column("bias", no_wrap=True)
    for words in (*placements, *(f"torso {name}" for name in placements)):
        table.add_column(words, justify="right")
    for row in (name for name in figures["with"] if name not in ("interactions", "fused")):
        for which in ("without", "with"):
            scored = figures[which][row]
            cells = [
                f"{scored[placement][figure]['mean']:.2f}" if placement in scored else "–"
                for figure in ("dd_cm", "torso_dd_cm")
                for placement in placements
            ]
            table.add_row(row if which == "without" else "", which, *cells)
    out.print(table)
    for part, title in (("interactions", "two people: Δd"), ("fused", "fused skeleton")):
        if not figures["with"][part]:
            continue
        table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=0, show_edge=False)
        for words in ("", "without", "with"):
            table.add_column(words, justify="right" if words else "left")
        for figure in figures["with"][part]:
            values = [figures[which][part][figure] for which in ("without", "with")]
            table.add_row(figure, *("–" if value is None else f"{value:.2f}" for value in values))
        out.print(table)


@train_app.command("sensor-errors")
def sensor_errors(
    folder: StudyFolder,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} The table (JSON).")],
    json: JsonOut = None,
) -> None:
    """Measure the errors of a Kinect v2's skeletons, for simulated sensors with the same errors.

    docs/simulation.md describes the measurement.

    Example:  mocapella lab train sensor-errors shared/data/kinectmultitrack --out kinect_v2_measured.json
    """
    from mocapella.evaluation.sensor_errors import as_simulated, measure
    from mocapella.sources.simulate.measured import errors_to_json

    with console.status("reading …") as status:
        errors = measure(folder, lambda name: status.update(f"reading {name} …"))
        measured_on = {
            **errors.measured_on,
            "command": "mocapella lab train sensor-errors DIR",
            "mocapella": __version__,
        }
        write_text(out, errors_to_json(msgspec.structs.replace(errors, measured_on=measured_on)))
        status.update("simulating …")
        simulated = as_simulated(errors)
    say(f"{out}: {out.stat().st_size} bytes, of {measured_on['sessions']} sessions")
    write_json(json, {"out": str(out), "measured_on": measured_on, "simulated": simulated})
    if json != "-":
        Console().print(_placements(measured_on["by_placement"], simulated))


@train_app.command("keypoint-errors")
def keypoint_errors(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the recordings with keypoints.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} The tables (JSON).")],
    json: JsonOut = None,
) -> None:
    """Measure the errors of detectors of keypoints, for simulated cameras with the same errors.

    docs/simulation.md describes the measurement.

    Example:  mocapella lab train keypoint-errors shared/data --out keypoint_errors.json
    """
    from mocapella.evaluation.keypoint_error_fit import fit_recordings
    from mocapella.sources.simulate.keypoint_body import GROUPS
    from mocapella.sources.simulate.keypoint_errors import CONFIDENCE_BINS, detectors_to_json

    _check_folder_of(out)
    with console.status("reading …") as status:
        found = fit_recordings(folder, lambda name: status.update(f"reading {name} …"))
    write_text(out, detectors_to_json(found))
    say(f"{out}: {out.stat().st_size} bytes, of {len(found)} detectors")
    write_json(json, {"out": str(out), "detectors": {name: msgspec.to_builtins(of) for name, of in found.items()}})
    if json == "-":
        return
    console_out = Console()
    for name, of in found.items():
        table = Table(title=f"{name}: core, % of the stature", title_justify="left", box=SIMPLE_HEAD)
        for words in ("confidence from", *map(str, CONFIDENCE_BINS), "missing %", "hidden %"):
            table.add_column(words, justify="left" if words.startswith("conf") else "right")
        for group, core, visible, own in zip(GROUPS, of.core, of.missing[0], of.missing[1], strict=True):
            table.add_row(group, *(f"{100 * sd:.2f}" for sd in core), f"{100 * visible:.1f}", f"{100 * own:.1f}")
        console_out.print(table)
        tail = ", ".join(f"{100 * share:.1f}" for share in of.tail_share[0])
        console_out.print(
            f"{of.measured_on['errors']} errors, {of.measured_on['hidden']} of hidden keypoints; tail {tail} % by\n"
            f"confidence, × {of.tail_ratio:g}; slow {100 * of.slow:.0f} % of the variance, {of.slow_s:g} s",
            highlight=False,
        )
        for recording, counted in of.measured_on["recordings"].items():
            console_out.print(f"{recording}: {', '.join(f'{k} {v}' for k, v in counted.items())}", highlight=False)


def _placements(recorded: dict[str, Any], simulated: dict[str, Any]) -> Table:
    table = Table(title="recorded / simulated", title_justify="left", box=SIMPLE_HEAD)
    figures = {
        "walk_dd_cm": "Walk Δd cm",
        "mirrored_better_percent": "mirrored better %",
        "bone_length_variation_percent": "bone length variation %",
        "stationary_jitter_mm": "jitter mm",
    }
    for words in ("", *figures.values()):
        table.add_column(words, justify="right")
    for placement, of in simulated.items():
        table.add_row(placement, *(f"{recorded[placement][figure]:.1f} / {of[figure]:.1f}" for figure in figures))
    return table


def _check_folder_of(out: Path) -> None:
    if not out.parent.is_dir():
        raise SettingsError(f"--out {out}: no folder {out.parent}; name a file in a folder that exists")


def write_text(path: Path, text: str) -> None:
    """Write a file atomically: it appears complete or not at all.

    Raises:
        SettingsError: it cannot be written there.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise SettingsError(f"--out {path}: {error.strerror}; name a file in a folder that exists") from error


def _table(figures: dict[str, dict[str, Any]], folds: int | None) -> Table:
    sessions = next(iter(figures.values()))["sessions"]
    title = f"people left out: {folds} folds, {sessions} sessions"
    table = Table(
        title=title, title_justify="left", caption=_CAPTION, caption_justify="left", box=SIMPLE_HEAD, padding=0
    )
    table.add_column("")
    for words in _COLUMNS.values():
        table.add_column(words, justify="right")
    for name, row in figures.items():
        table.add_row(name, *(f"{row[key]:.2f}" for key in _COLUMNS))
    return table
