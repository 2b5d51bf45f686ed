"""The report has everything and nothing from outside, escapes what it is given, and opens without a network."""

from __future__ import annotations

import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.browser import FLAGS
from support.study_results import MEANS_CM, figures, gathered, strip, study

from mocapella import __version__
from mocapella.errors import SettingsError
from mocapella.studies.hypotheses import HypothesisVerdict, StudyStatistics
from mocapella.studies.picture_files import StudyPicture
from mocapella.studies.report import ReportDetails, cell_text, report_html, running_versions, table_html, write_report
from mocapella.studies.results import FileResults, StudyFinding, StudyResults
from mocapella.studies.tables import StudyTable, TableColumn

SECTIONS = [
    "Summary", "Participants and recordings", "Data quality and exclusions", "Tables", "Hypotheses", "Pictures",
    "Methods", "How to repeat and cite",
]  # fmt: skip
A4_PX = 680
"""Width of a page of A4 within its margins, at 96 dots per inch."""
SVG = StudyPicture("bars", "Bars", "Drawn.", "stand-still", {"svg": b"<svg xmlns='http://www.w3.org/2000/svg'/>"})
TABLE = StudyTable(
    "walk", "Walk", (TableColumn("placement"), TableColumn("Δd", "cm"), TableColumn("pairs")),
    (("parallel", 8.876, 6802), ("90", float("nan"), None)), ("A note.",),
)  # fmt: skip
NONE = StudyStatistics((), (HypothesisVerdict("H3", "", "H3 is not measured."),))


class Tags(HTMLParser):
    """The elements of a page, with their attributes, and its text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words += data


def small(seed: int = 0) -> StudyResults:
    only = {key: mean for key, mean in MEANS_CM.items() if key[0] == "walk"}
    found = study(seed, participants=4, means_cm=only)
    return msgspec.structs.replace(found, strips=(strip(), strip(person=1)), measured=figures())


def page_of(**more: Any) -> str:
    return report_html(small(), (TABLE,), NONE, (SVG,), ReportDetails(**more))


def test_it_has_its_sections_in_order_and_says_how_to_repeat_it() -> None:
    page = page_of(title="My study", command="mocapella study analyze logs --out out", settings={"methods": "default"})
    assert re.findall(r"<h2>(.*?)</h2>", page) == SECTIONS
    words = Tags(page).words
    for expected in (
        "4 participants, 3 placements of the sensors, 1 task, 1 method: 12 recordings with 12,000 rows, of which "
        "11,520 (96.0 %) are in the differences. The section on data quality lists 1 fault of the recordings.",
        "scenario 4 after 8 read as 8", "rows without a partner", "the file ends within a row",
        "mocapella study analyze logs --out out", "H3 is not measured.", "methods", f"version {__version__}", "A note.",
    ):  # fmt: skip
        assert expected in words, expected
    for name in running_versions():
        assert name in words


def test_it_loads_nothing_and_runs_nothing() -> None:
    found = Tags(page_of()).found
    assert not {"script", "link", "iframe", "object", "base", "form"} & {tag for tag, _ in found}
    for tag, attributes in found:
        for name in ("src", "href"):
            assert attributes.get(name, "data:").startswith(("data:", "#")), (tag, attributes)
        assert not any(name.startswith("on") for name in attributes)


@given(
    name=st.one_of(
        st.text(min_size=1, max_size=20), st.just("</td><script>alert(1)</script>"), st.just("'\"><img src=x>")
    )
)
def test_a_name_of_a_file_stays_a_name(name: str) -> None:
    plain, odd = (_with_names(each) for each in ("a", name))
    assert [tag for tag, _ in Tags(odd).found] == [tag for tag, _ in Tags(plain).found]
    assert [sorted(each) for _, each in Tags(odd).found] == [sorted(each) for _, each in Tags(plain).found]
    assert not re.search("[\u202a-\u202e\x00-\x08]", odd)


def _with_names(name: str) -> str:
    found = FileResults(name, 3, 2, ("Head",), (), origin={"method": name})
    results = StudyResults((found,), ("Head",), (), (), (), (StudyFinding(name, name, name),))
    table = StudyTable("t", name, (TableColumn(name, name),), ((name,), (None,)), (name,))
    picture = StudyPicture("p", name, name, name, SVG.files)
    statistics = StudyStatistics((table,), (HypothesisVerdict("H1", name, name),))
    details = ReportDetails(name, name, {name: name}, {"Mocapella": name})
    return report_html(results, (table,), statistics, (picture,), details)


def test_cells_are_numbers_with_their_digits_or_a_dash() -> None:
    assert [cell_text(cell, 2) for cell in (1.005, 7, "x", None, float("nan"))] == ["1.00", "7", "x", "–", "–"]
    lines = "".join(table_html(TABLE))
    assert "<th scope='col'>Δd [cm]</th>" in lines
    assert "<td class='text'>parallel</td><td>8.88</td><td>6802</td>" in lines
    assert list(table_html(msgspec.structs.replace(TABLE, rows=()))) == []


def test_tables_with_a_section_of_their_own_are_shown_once() -> None:
    again = msgspec.structs.replace(TABLE, name="recordings", title="Recordings")
    page = report_html(small(), (TABLE, again), NONE, (), None)
    assert page.count("<h3>Recordings</h3>") == 1
    assert page.count("<h3>Walk</h3>") == 1


def test_a_study_of_nothing_has_a_report() -> None:
    page = report_html(StudyResults((), (), (), (), (), ()), (), NONE, ())
    assert "0 participants" in page
    assert "No fault of the recordings was found." in page


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    tables = write_report(small(), (TABLE,), folder, ReportDetails("Study <1>"))
    assert [table.name for table in tables] == [
        "intervals", "h1-within-limit", "h2-placements", "h2-pairs", "h2-drift", "h3-filled",
    ]  # fmt: skip
    return folder


@pytest.mark.slow
def test_its_files_are_there_and_nothing_is_overwritten(written: Path, tmp_path: Path) -> None:
    assert sorted(path.name for path in written.iterdir()) == ["pictures", "report.html"]
    stems = {path.stem for path in (written / "pictures").iterdir()}
    assert len(list((written / "pictures").iterdir())) == 3 * len(stems) == 18
    page = (written / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/svg+xml;base64,") == len(stems)
    for fault in ("report.html", "pictures"):
        (tmp_path / fault).mkdir()
        with pytest.raises(SettingsError, match=f"{fault} exists, and a report is never overwritten"):
            write_report(gathered((), ()), (), tmp_path)
        (tmp_path / fault).rmdir()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_browser_without_a_network_shows_it(written: Path) -> None:
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        context = chromium.new_context(offline=True)
        shown(context.new_page(), written / "report.html")
        chromium.close()


def shown(page: Any, path: Path) -> None:
    faults: list[str] = []
    requests: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda message: faults.append(message.text))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(path.as_uri())
    for width in (1200, 400):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        sizes = page.evaluate("Array.from(document.images, (one) => [one.naturalWidth, one.clientWidth])")
        assert len(sizes) == 6
        assert all(natural > 100 and 100 < client <= width for natural, client in sizes)
    page.emulate_media(media="print")
    page.set_viewport_size({"width": A4_PX, "height": 900})
    assert page.evaluate("document.documentElement.scrollWidth") <= A4_PX
    assert page.evaluate("getComputedStyle(document.querySelector('nav')).display") == "none"
    assert page.title() == "Study <1>"
    assert [url for url in requests if not url.startswith("data:")] == [path.as_uri()]
    assert faults == []
