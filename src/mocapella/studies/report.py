"""The report of a study: one HTML file that needs no network, and the folder of its pictures."""

from __future__ import annotations

import base64
import html
import math
import platform
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import msgspec

from mocapella import __version__
from mocapella.errors import SettingsError, visible
from mocapella.model.names import plural
from mocapella.studies.hypotheses import HypothesisVerdict, StudyStatistics, study_statistics
from mocapella.studies.picture_files import StudyPicture
from mocapella.studies.pictures import study_pictures
from mocapella.studies.pooled_tasks import natural_order, placement_rank, task_rank
from mocapella.studies.results import StudyResults
from mocapella.studies.tables import StudyTable, TableColumn

LIBRARIES: Final = ("numpy", "scipy", "statsmodels", "matplotlib", "polars")
"""Packages whose versions a report states."""
REPORT_FILE: Final = "report.html"
PICTURE_FOLDER: Final = "pictures"
HYPOTHESES: Final = {
    "H1": "H1: views lie within 5 cm of one another",
    "H2": "H2: views are consistent over placements and time",
    "H3": "H3: occluded joints are filled",
}
_STYLE: Final = """
:root{color-scheme:light}
*{box-sizing:border-box}
body{font:15px/1.45 system-ui,sans-serif;color:#111;background:#fff;max-width:72rem;margin:0 auto;padding:1rem}
h1{font-size:1.7rem;line-height:1.2;overflow-wrap:anywhere}
h2{font-size:1.25rem;margin-top:2.2rem;border-bottom:2px solid #0072B2;padding-bottom:.2rem}
h3{font-size:1rem;margin:1.6rem 0 .4rem}
p,li,figcaption,dd{overflow-wrap:anywhere}
nav ul{columns:2;padding-left:1.2rem}
.table{overflow-x:auto;max-width:100%}
table{border-collapse:collapse;font-size:13px;font-variant-numeric:tabular-nums}
th,td{padding:.2rem .45rem;text-align:right;white-space:nowrap;border-bottom:1px solid #ddd}
th{border-bottom:2px solid #444;vertical-align:bottom;white-space:normal}
td.text,th.text{text-align:left}
td.long{white-space:normal;min-width:14rem}
tbody tr:nth-child(even){background:#f4f6f8}
.note{color:#444;font-size:13px;margin:.2rem 0}
figure{margin:1rem 0 1.6rem}
figure img{max-width:100%;height:auto;display:block}
figcaption{font-size:13px;color:#222}
code{background:#f0f2f4;padding:.1rem .3rem;overflow-wrap:anywhere;white-space:pre-wrap}
dt{font-weight:600}
dd{margin:0 0 .4rem 1rem}
@media (max-width:600px){nav ul{columns:1}}
@media print{
@page{margin:15mm}
body{max-width:none;padding:0;font-size:10pt}
nav{display:none}
.table{overflow:visible}
table{font-size:6pt}
th,td{padding:.1rem .14rem;white-space:normal}
td.text{overflow-wrap:break-word}
td.long{min-width:0}
h2,h3{break-after:avoid}
tr,figure{break-inside:avoid}
thead{display:table-header-group}
}
"""

_POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""Content security policy: the page loads nothing from outside."""
_SHOWN_APART: Final = ("participants", "recordings", "cleaning", "findings")
"""Names of the tables that other sections of the report make themselves."""
_LONG: Final = 40
"""Number of characters above which a text in a table is broken into lines."""

_METHODS: Final = (
    "Δx, Δy and Δz are the distances along the axes between one joint's positions in two aligned views of a person; Δd "
    "is their Euclidean length. Positions are in the reference sensor's camera space. A participant's value is the "
    "mean over all pairs of views of a task, then over the joints.",
    "H1: one-sided tests of the participants' means against 5 cm. H2: analysis of variance with repeated measures over "
    "placement and task, corrected by Greenhouse and Geisser's ε, or Friedman's test where the residuals are not "
    "normal; a mixed model where participants lack conditions; paired tests of the placements; and tests of the "
    "participants' slopes over time. H3: the figures of the measure of occluded joints. All p values of one table are "
    "corrected by Holm's method. Intervals are 95 %: Student's t, and a bootstrap (BCa) with a fixed seed.",
)


class ReportDetails(msgspec.Struct, frozen=True):
    """What a report states beside the results.

    Attributes:
        title: its heading.
        command: command line that makes it again; empty if there is none.
        settings: settings used, by name.
        versions: versions of the programs, by name; by default the running versions.
    """

    title: str = "Study"
    command: str = ""
    settings: Mapping[str, str] = {}
    versions: Mapping[str, str] = {}


def running_versions() -> dict[str, str]:
    """Return the versions of Mocapella, Python and the libraries that compute and draw."""
    found = {"Mocapella": __version__, "Python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def write_report(
    results: StudyResults, tables: Sequence[StudyTable], out_folder: Path, details: ReportDetails | None = None
) -> tuple[StudyTable, ...]:
    """Test the hypotheses, draw the pictures, and write `report.html` and the folder `pictures` (SVG, PDF, PNG).

    Nothing is overwritten. The report is written last.

    Args:
        results: what the recordings give.
        tables: tables that the report shows first.
        out_folder: an existing folder.
        details: title, command line and settings.

    Returns:
        The tables of the tests, for the table files.

    Raises:
        SettingsError: statsmodels or matplotlib is not installed, or a report or pictures are there already.
        OSError: a file cannot be written.
    """
    page, folder = out_folder / REPORT_FILE, out_folder / PICTURE_FOLDER
    for path in (page, folder):
        if path.exists():
            raise SettingsError(f"{path} exists, and a report is never overwritten; name another folder with --out")
    statistics = study_statistics(results)
    pictures = study_pictures(results)
    text = report_html(results, tables, statistics, pictures, details)
    folder.mkdir()
    for picture in pictures:
        for ending, content in picture.files.items():
            with (folder / f"{picture.name}.{ending}").open("xb") as file:
                file.write(content)
    with page.open("x", encoding="utf-8") as file:
        file.write(text)
    return statistics.tables


def report_html(
    results: StudyResults,
    tables: Sequence[StudyTable],
    statistics: StudyStatistics,
    pictures: Sequence[StudyPicture],
    details: ReportDetails | None = None,
) -> str:
    """Return the report as one HTML page, which loads nothing and runs no script.

    Args:
        results: what the recordings give.
        tables: tables of the analysis; recordings, cleaning and findings have sections of their own.
        statistics: tables and verdicts of the tests.
        pictures: with their files in SVG.
        details: title, command line and settings.
    """
    details = details or ReportDetails()
    sections = {
        "Summary": _summary(results, statistics.verdicts),
        "Participants and recordings": _recordings(results),
        "Data quality and exclusions": _quality(results),
        "Tables": (line for table in tables if table.name not in _SHOWN_APART for line in table_html(table)),
        "Hypotheses": _hypotheses(statistics),
        "Pictures": (line for picture in pictures for line in _figure(picture)),
        "Methods": _methods(results, details),
        "How to repeat and cite": _repeating(details),
    }
    return "\n".join(_page(details.title, sections)) + "\n"


def _page(title: str, sections: Mapping[str, Iterator[str]]) -> Iterator[str]:
    yield "<!doctype html>\n<html lang='en'>\n<head>\n<meta charset='utf-8'>"
    yield "<meta name='viewport' content='width=device-width, initial-scale=1'>"
    yield f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
    yield f"<title>{escaped(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>"
    yield f"<h1>{escaped(title)}</h1>\n<nav><ul>"
    yield from (f"<li><a href='#s{k}'>{escaped(name)}</a></li>" for k, name in enumerate(sections))
    yield "</ul></nav>"
    for k, (name, lines) in enumerate(sections.items()):
        yield f"<section id='s{k}'>\n<h2>{escaped(name)}</h2>"
        yield from lines
        yield "</section>"
    yield "</body>\n</html>"


def escaped(text: object) -> str:
    """Return a text for HTML, also within quotes; control and direction characters are shown as escapes."""
    return html.escape(visible(str(text)))


def _paragraphs(lines: Sequence[str]) -> Iterator[str]:
    yield from (f"<p>{escaped(line)}</p>" for line in lines)


def _summary(results: StudyResults, verdicts: Sequence[HypothesisVerdict]) -> Iterator[str]:
    keys = [one.key for one in results.summaries]
    people, tasks = ({getattr(key, name) for key in keys} for name in ("participant", "task"))
    placements, methods = ({getattr(key, name) for key in keys} for name in ("placement", "method"))
    rows, used = sum(file.rows for file in results.files), sum(file.used for file in results.files)
    share = f" ({100 * used / rows:.1f} %)" if rows else ""
    findings = plural(len(results.findings), "fault", "faults")
    yield from _paragraphs([
        f"{plural(len(people), 'participant', 'participants')}, {plural(len(placements), 'placement', 'placements')} "
        f"of the sensors, {plural(len(tasks), 'task', 'tasks')}, {plural(len(methods), 'method', 'methods')}: "
        f"{plural(len(results.files), 'recording', 'recordings')} with {rows:,} rows, of which {used:,}{share} are in "
        f"the differences. The section on data quality lists {findings} of the recordings.",
    ])  # fmt: skip
    yield "<ul>"
    yield from (f"<li>{_verdict(one)}</li>" for one in verdicts)
    yield "</ul>"


def _verdict(one: HypothesisVerdict) -> str:
    about = f"{escaped(one.hypothesis)}, {escaped(one.about)}" if one.about else escaped(one.hypothesis)
    return f"<strong>{about}</strong>: {escaped(one.text)}"


def _recordings(results: StudyResults) -> Iterator[str]:
    conditions: dict[str, dict[str, set[str]]] = {}
    for one in results.summaries:
        conditions.setdefault(one.key.participant, {}).setdefault(one.key.placement, set()).add(one.key.task)
    rows = tuple(
        (who, place, ", ".join(sorted(conditions[who][place], key=partial(task_rank, results.order))))
        for who in sorted(conditions, key=natural_order)
        for place in sorted(conditions[who], key=partial(placement_rank, results.order))
    )
    columns = tuple(map(TableColumn, ("participant", "placement", "tasks")))
    yield from table_html(StudyTable("participants", "Participants", columns, rows))
    files = tuple((file.file, file.rows, file.used, len(file.findings)) for file in results.files)
    columns = tuple(map(TableColumn, ("recording", "rows", "rows used", "faults")))
    yield from table_html(StudyTable("recordings", "Recordings", columns, files))


def _quality(results: StudyResults) -> Iterator[str]:
    steps: dict[tuple[str, bool], list[int]] = {}
    for file in results.files:
        for step in file.cleaning:
            steps.setdefault((step.step, step.removed), []).append(step.rows)
    rows = tuple(
        (name, "removed" if removed else "changed", sum(counts), sum(count > 0 for count in counts))
        for (name, removed), counts in steps.items()
    )
    columns = tuple(map(TableColumn, ("step", "effect", "rows", "recordings")))
    yield from table_html(StudyTable("cleaning", "Cleaning", columns, rows))
    if not results.findings:
        yield "<p>No fault of the recordings was found.</p>"
        return
    faults = tuple((one.file or "all", one.what, one.effect, one.rows or None) for one in results.findings)
    columns = tuple(map(TableColumn, ("recording", "fault", "what was done", "rows")))
    yield from table_html(StudyTable("findings", "Faults and exclusions", columns, faults))


def _hypotheses(statistics: StudyStatistics) -> Iterator[str]:
    for name, title in HYPOTHESES.items():
        yield f"<h3>{escaped(title)}</h3>"
        yield from (f"<p>{_verdict(one)}</p>" for one in statistics.verdicts if one.hypothesis == name)
    for table in statistics.tables:
        yield from table_html(table)


def table_html(table: StudyTable) -> Iterator[str]:
    """Yield the lines of a table with its title and notes; columns of texts are aligned left."""
    if not table.rows:
        return
    texts = [all(isinstance(row[k], str | None) for row in table.rows) for k in range(len(table.columns))]
    longest = [max(len(str(row[k])) for row in table.rows) for k in range(len(table.columns))]
    kinds = [
        f" class='{'text long' if size > _LONG else 'text'}'" if text else ""
        for text, size in zip(texts, longest, strict=True)
    ]
    yield f"<h3>{escaped(table.title)}</h3>\n<div class='table' tabindex='0'><table>\n<thead><tr>"
    for column, kind in zip(table.columns, kinds, strict=True):
        unit = f" [{escaped(column.unit)}]" if column.unit else ""
        yield f"<th scope='col'{kind}>{escaped(column.title)}{unit}</th>"
    yield "</tr></thead>\n<tbody>"
    for row in table.rows:
        cells = (
            f"<td{kind}>{escaped(cell_text(cell, column.digits))}</td>"
            for cell, column, kind in zip(row, table.columns, kinds, strict=True)
        )
        yield f"<tr>{''.join(cells)}</tr>"
    yield "</tbody></table></div>"
    yield from (f"<p class='note'>{escaped(note)}</p>" for note in table.notes)


def cell_text(cell: str | float | int | None, digits: int) -> str:
    """Return a table's cell as text: a dash for None and NaN, and numbers with so many digits after the point."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "–"
    return f"{cell:.{digits}f}" if isinstance(cell, float) else str(cell)


def _figure(picture: StudyPicture) -> Iterator[str]:
    content = base64.b64encode(picture.files["svg"]).decode("ascii")
    title = escaped(f"{picture.title}. {picture.about}")
    yield f"<figure id='{escaped(picture.name)}'>"
    yield f"<figcaption><strong>{title}.</strong> {escaped(picture.caption)}</figcaption>"
    yield f"<img alt='{title}' src='data:image/svg+xml;base64,{content}'></figure>"


def _methods(results: StudyResults, details: ReportDetails) -> Iterator[str]:
    yield from _paragraphs(_METHODS)
    yield "<h3>Versions</h3>\n<dl>"
    for name, value in (details.versions or running_versions()).items():
        yield f"<dt>{escaped(name)}</dt><dd>{escaped(value)}</dd>"
    yield "</dl>"
    if details.settings:
        yield "<h3>Settings</h3>\n<dl>"
        yield from (f"<dt>{escaped(name)}</dt><dd>{escaped(value)}</dd>" for name, value in details.settings.items())
        yield "</dl>"
    if origins := sorted({json_text(file.origin) for file in results.files if file.origin}):
        yield "<h3>What made the recordings</h3>"
        yield from (f"<p><code>{escaped(origin)}</code></p>" for origin in origins)


def json_text(value: Any) -> str:
    """Return a value as JSON with sorted keys."""
    return msgspec.json.encode(value, order="sorted").decode("utf-8")


def _repeating(details: ReportDetails) -> Iterator[str]:
    own = (details.versions or running_versions()).get("Mocapella", __version__)
    if details.command:
        yield f"<p>This command makes the report again:</p>\n<p><code>{escaped(details.command)}</code></p>"
    yield from _paragraphs([
        f"Cite the program as: Mocapella, version {own}. The differences and their tables follow the KinectMultiTrack "
        "study (2015). State the number of participants and the exclusions beside every figure of this report.",
    ])  # fmt: skip
