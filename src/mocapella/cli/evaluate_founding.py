"""``mocapella lab evaluate founding``: the founding experiment in simulation, with the tables of the real one."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import msgspec
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mocapella.cli.app import evaluate_app
from mocapella.cli.common import JsonOut, console, participant_numbers, write_json
from mocapella.cli.evaluate import Methods, Seeds, failures, show
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from mocapella.evaluation.apart_causes import ApartCauses

COMPARED: Final = ("stationary", "steps", "walk")
"""Tasks of the founding experiment."""
_PLACEMENTS: Final = ("parallel", "45", "90")
_CAUSES: Final = (
    ("apart_cm", "Δd cm"),
    ("turned_deg", "motion wrong by °"),
    ("left_cm", "Δd of the best motion cm"),
    ("steady_cm", "constant in a session cm"),
    ("shared_cm", "the same for all cm"),
    ("swapped_percent", "labels swapped %"),
    ("spread_cm", "way from the mean place cm"),
)
"""Fields of `ApartCauses` and their titles."""


@evaluate_app.command("founding")
def founding(
    recorded: Annotated[
        Path | None,
        typer.Argument(metavar="FOLDER", help="Folder of the real study logs, to print their figures beside."),
    ] = None,
    methods: Methods = "stand-still",
    seeds: Seeds = "0,1,2",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="Folder to keep the simulated study logs in; a log is never overwritten."
        ),
    ] = None,
    json: JsonOut = None,
) -> None:
    """Simulate the founding experiment: stationary, steps and walk before sensors parallel, 45° and 90° apart.

    Each seed is a participant. The study logs are scored as the real ones are: docs/evaluation.md.

    Example:  mocapella lab evaluate founding --seeds 0,1,2 --methods stand-still,default --out simulated
    """
    from mocapella.evaluation.apart_causes import causes_by_task
    from mocapella.evaluation.kinectmultitrack import evaluate
    from mocapella.evaluation.methods import check_methods
    from mocapella.evaluation.study_tables import rounded
    from mocapella.studies.founding import write_founding_logs

    numbers = participant_numbers(seeds, "--seeds") or []
    chosen = [name.strip() for name in methods.split(",") if name.strip()]
    check_methods(chosen)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory())) if out is None else _folder(out)
        with console.status("simulating …") as status:
            write_founding_logs(folder, numbers, lambda text: status.update(f"simulating {text} …"))
            # Other logs in the folder are not of this experiment.
            simulated = evaluate(folder, chosen, numbers, lambda text: status.update(f"scoring {text} …"))
            simulated["data"] = "simulated" if out is None else str(out)
            tell = lambda text: status.update(f"scoring the real {text} …")  # noqa: E731
            real = None if recorded is None else rounded(evaluate(recorded, chosen, None, tell))
            status.update("fitting the best motion of each log …")
            causes = {"simulated": causes_by_task(folder, numbers)}
            if recorded is not None:
                causes["recorded"] = causes_by_task(recorded)
    builtin = rounded(msgspec.to_builtins(causes))
    result = {"seeds": numbers, "simulated": rounded(simulated), "recorded": real, "causes": builtin}
    write_json(json, result)
    if json != "-":
        terminal = Console()
        show(result["simulated"], terminal)
        if real is not None:
            show_beside(result["simulated"], real, terminal)
        show_causes(causes, terminal)
    if failures(result["simulated"]):
        raise typer.Exit(1)


def show_beside(simulated: dict[str, Any], recorded: dict[str, Any], out: Console) -> None:
    """Print the mean Δd of the simulated and of the recorded experiment beside each other, by method and task.

    Both are results of `mocapella.evaluation.kinectmultitrack.evaluate` of the same methods.
    """
    for method in simulated["methods"]:
        table = Table(
            title=f"{method}: Δd in cm, simulated / recorded", title_justify="left", box=SIMPLE_HEAD, show_edge=False
        )
        table.add_column("", no_wrap=True)
        for placement in _PLACEMENTS:
            table.add_column(placement, justify="right", no_wrap=True)
        for task in COMPARED:
            pairs = [
                " / ".join(_mean_dd(of["methods"][method], task, placement) for of in (simulated, recorded))
                for placement in _PLACEMENTS
            ]
            table.add_row(task, *pairs)
        out.print(table)


def show_causes(causes: Mapping[str, Mapping[str, Mapping[str, ApartCauses]]], out: Console) -> None:
    """Print why the logged views lie apart: of each task and placement, simulated and recorded beside each other.

    Args:
        causes: by ``simulated`` and perhaps ``recorded``, task and placement.
        out: where to print.
    """
    table = Table(
        title="why the logged views lie apart: " + " / ".join(causes),
        title_justify="left", box=SIMPLE_HEAD, show_edge=False,
    )  # fmt: skip
    table.add_column("", no_wrap=True)
    for _, title in _CAUSES:
        table.add_column(title, justify="right")
    for task in COMPARED:
        for placement in _PLACEMENTS:
            found = [of.get(task, {}).get(placement) for of in causes.values()]
            cells = [" / ".join("–" if one is None else f"{getattr(one, name):.1f}" for one in found)
                     for name, _ in _CAUSES]  # fmt: skip
            table.add_row(f"{task} {placement}", *cells)
    out.print(table)


def _mean_dd(scored: dict[str, Any], task: str, placement: str) -> str:
    mean = scored["tasks"].get(task, {}).get(placement, {}).get("dd_cm", {}).get("mean")
    return "–" if mean is None else f"{mean:.1f}"


def _folder(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError(f"--out {folder}: {error.strerror}; name a folder that can be made") from error
    return folder
