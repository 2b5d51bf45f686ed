"""``mocapella study``: analyse the recordings of a study with participants."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mocapella.cli import DAMAGED
from mocapella.cli.app import study_app
from mocapella.cli.common import JsonOut, Participants, console, say, write_json
from mocapella.cli.evaluate import Methods

if TYPE_CHECKING:
    from mocapella.studies.naming import StudyNames
    from mocapella.studies.results import StudyResults
    from mocapella.studies.tables import StudyTable

_SHOWN_FINDINGS = 12


def _check_out(path: Path) -> Path:
    from mocapella.studies.table_files import check_new_folder

    return check_new_folder(path)


@study_app.command()
def analyze(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the study's logs and takes, of any names.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="New folder for the results; nothing is overwritten.", callback=_check_out
        ),
    ],
    participants: Participants = None,
    methods: Methods = "stand-still",
    engine: Annotated[
        str,
        typer.Option(
            "--engine",
            metavar="NAME",
            help="Where recordings are analysed: local, local:PROCESSES, dask (all cores) or dask:HOST:PORT.",
        ),
    ] = "local",
    tables_only: Annotated[
        bool, typer.Option("--tables-only", help="Write the tables alone: no tests, pictures and report.")
    ] = False,
    json: JsonOut = None,
) -> None:
    """Clean a study's recordings, tabulate how far the sensors' views of a person lie apart, and write a report.

    docs/studies.md describes the cleaning and the formulas. Exit status: 3 if a recording could not be read, or only
    in part, and the rest was analysed.

    Example:  mocapella study analyze recordings/ --out results/
    """
    from mocapella.errors import EvaluationError
    from mocapella.evaluation.methods import settings_used
    from mocapella.studies.analysis import check_participants, merge
    from mocapella.studies.naming import names_of_study
    from mocapella.studies.recordings import find_recordings
    from mocapella.studies.study_tables import tables_of
    from mocapella.studies.table_files import new_folder, write_tables
    from mocapella.studies.whole_analysis import analyze_recordings, check_methods, measured_tables

    found, names = find_recordings(folder), names_of_study(folder)
    codes = None if participants is None else [_code(part.strip(), names) for part in participants.split(",")]
    named = list(dict.fromkeys(name.strip() for name in methods.split(",") if name.strip()))
    check_methods(named)
    with console.status("reading …") as status:
        files = analyze_recordings(
            found.paths,
            participants=codes,
            methods=named,
            engine=engine,
            names=names,
            on_done=lambda name: status.update(f"analysed {name.replace('[', '(')} …"),
        )
        findings = (*found.findings, *(names.findings if names is not None else ()))
        results = merge(files, findings, None if names is None else names.order)
        check_participants(results, codes)
        tables = (*tables_of(results), *measured_tables(results))
        reports = bool(results.summaries) and not tables_only
        with new_folder(out) as made:
            if reports:
                from mocapella.studies.report import ReportDetails, write_report

                status.update("testing hypotheses, drawing pictures …")
                words = ["mocapella", "study", "analyze", str(folder), "--out", str(out), "--methods", ",".join(named)]
                words += [] if participants is None else ["--participants", participants]
                settings = {"participants": participants or "all"} | {name: settings_used(name) for name in named}
                tables += write_report(results, tables, made, ReportDetails(folder.name, shlex.join(words), settings))
            (made / "tables").mkdir()
            write_tables(made / "tables", tables)
    write_json(json, _as_json(results, tables, out))
    if json != "-":
        _show(results, tables)
    say(f"tables in {out / 'tables'}" + (f", report: {out / 'report.html'}" if reports else ""))
    if not results.summaries:
        raise EvaluationError(f"{folder}: no two views of a person at one time; the findings in {out} say why")
    if not all(one.whole for one in results.files):
        raise typer.Exit(DAMAGED)


def _code(text: str, names: StudyNames | None) -> str:
    """Return a participant's code in the study's folder, also by the number in the logs."""
    return names.general.code(int(text)) if names is not None and text.isdecimal() else text


def _as_json(results: StudyResults, tables: tuple[StudyTable, ...], out: Path) -> dict[str, Any]:
    import msgspec

    from mocapella.evaluation.study_tables import rounded

    value: dict[str, Any] = rounded(
        {
            "out": str(out),
            "rows": sum(one.rows for one in results.files),
            "used": sum(one.used for one in results.files),
            "participants": sorted({part.key.participant for part in results.summaries}),
            "findings": msgspec.to_builtins(results.findings),
            "tables": {table.name: msgspec.structs.asdict(table) | _columns(table) for table in tables},
        }
    )
    return value


def _columns(table: StudyTable) -> dict[str, Any]:
    import msgspec

    return {"columns": msgspec.to_builtins(table.columns)}


def _show(results: StudyResults, tables: tuple[StudyTable, ...]) -> None:
    out = Console()
    people = {part.key.participant for part in results.summaries}
    rows, used = (sum(getattr(one, name) for one in results.files) for name in ("rows", "used"))
    out.print(f"{len(results.files)} recordings of {len(people)} participants, {rows} rows, {used} of them in pairs")
    for table in tables:
        if table.name.startswith("overall"):
            out.print(_printed(table))
    for finding in results.findings[:_SHOWN_FINDINGS]:
        out.print(Text(f"{finding.file + ': ' if finding.file else ''}{finding.what}: {finding.effect}"))
    more = len(results.findings) - _SHOWN_FINDINGS
    if more > 0:
        out.print(f"and {more} more findings, in the table findings")


def _printed(table: StudyTable) -> Table:
    from mocapella.studies.table_files import cell_text, heading

    printed = Table(title=Text(table.title), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    for k, column in enumerate(table.columns):
        is_text = any(isinstance(row[k], str) for row in table.rows)
        printed.add_column(Text(heading(column)), justify="left" if is_text else "right")
    for row in table.rows:
        printed.add_row(*(Text(cell_text(value, column)) for value, column in zip(row, table.columns, strict=True)))
    return printed
