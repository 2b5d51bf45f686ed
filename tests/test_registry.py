"""Tables of descriptors: what other packages register is used or, where it cannot be, named and skipped."""

from __future__ import annotations

import ast
import importlib
import io
import os
import subprocess
import sys
import threading
import tokenize
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path

import pytest
from support.distributions import BAD, distribution, lamps, source_text

from mocapella.errors import PluginError, SettingsError
from mocapella.registry import Table, load, plugin_points, wrong_groups
from mocapella.sources.source import SOURCES, Source

SOURCE = Path(__file__).resolve().parent.parent / "src" / "mocapella"
MECHANISM = {
    "registry.py": (),
    "tracker/method.py": ("Method",),
    "detectors/detector.py": ("Detector",),
    "model/frame_types.py": ("MessageFormat", "FrameType"),
    "model/part_types.py": ("PartType",),
    "sources/source.py": ("Source",),
    "exports/export.py": ("Export",),
    "streams/stream.py": ("Stream",),
}
"""The registry and the descriptors: of a module the classes, or all of it."""
INSTALLED = {(point.group, point.name, point.value) for point in plugin_points()}
"""Entry points of plug-ins that somebody has installed beside Mocapella; the tests below leave them out."""
OURS = {name: source for name, source in SOURCES.items() if name not in SOURCES.plugins()}


def points_without_installed(**wanted: str) -> EntryPoints:
    """What `importlib.metadata.entry_points` returns, without `INSTALLED`."""
    found = entry_points()
    every = (point for group in found.groups for point in found.select(group=group))
    return EntryPoints(p for p in every if (p.group, p.name, p.value) not in INSTALLED).select(**wanted)


@pytest.fixture(autouse=True)
def without_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocapella.registry.entry_points", points_without_installed)


def sources() -> Table[Source]:
    """A table that has read nothing yet."""
    return Table("mocapella.sources", Source, "source")


@pytest.fixture
def lamp_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Table[Source]:
    monkeypatch.syspath_prepend(str(lamps(tmp_path)))
    return sources()


def test_what_a_package_registers_is_found_after_ours(lamp_sources: Table[Source]) -> None:
    assert lamp_sources["good"].summary == "Lamps."
    assert list(lamp_sources) == [*OURS, "good"]
    assert lamp_sources.plugins() == {"good": "lamps 1.0"}
    assert lamp_sources.package("good") == "lamps 1.0"
    assert lamp_sources.package("simulate").startswith("mocapella ")


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_used_is_named_and_skipped(lamp_sources: Table[Source], name: str) -> None:
    lamp_sources.plugins()
    (skipped,) = [one for one in lamp_sources.skipped if one.name == name]
    assert (skipped.group, skipped.package) == ("mocapella.sources", "lamps 1.0")
    assert BAD[name][1] in skipped.why
    assert "\n" not in str(skipped)
    assert set(OURS) < set(lamp_sources)


def test_each_bad_one_is_skipped_once_however_often_it_is_wanted(lamp_sources: Table[Source]) -> None:
    for _ in range(2):
        lamp_sources.plugins()
        assert "later" not in lamp_sources
    assert sorted(one.name for one in lamp_sources.skipped) == sorted(BAD)


def test_a_bad_one_that_is_asked_for_is_an_error_with_its_package(lamp_sources: Table[Source]) -> None:
    with pytest.raises(PluginError, match=r"source 'later' of lamps 1\.0 cannot be used: it was written for"):
        lamp_sources.find("later")
    with pytest.raises(SettingsError, match=r"unknown source 'godo'; known: .*\(did you mean good\?\)"):
        lamp_sources.find("godo")


def test_ours_come_before_a_strangers_of_the_same_name(lamp_sources: Table[Source]) -> None:
    assert lamp_sources["simulate"] is OURS["simulate"]


def test_of_two_strangers_with_one_name_the_first_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("alpha", "beta"):
        folder = tmp_path / package
        module = f"{package}_twice"
        points = {"mocapella.sources": {"twice": f"{module}:SOURCE"}}
        distribution(folder, package, points, {f"{module}.py": source_text("twice", command=f"{module}:run")})
        monkeypatch.syspath_prepend(str(folder))
    table = sources()
    assert table["twice"].command == "alpha_twice:run"
    assert [str(one) for one in table.skipped] == [
        "beta 1.0: mocapella.sources 'twice' is skipped: alpha 1.0 has this name; uninstall one of the two"
    ]


def test_the_same_package_found_twice_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for copy in ("one", "two"):
        modules = {"twin_lamp.py": source_text("twin")}
        monkeypatch.syspath_prepend(
            str(distribution(tmp_path / copy, "twin", {"mocapella.sources": {"twin": "twin_lamp:SOURCE"}}, modules))
        )
    table = sources()
    assert table.plugins() == {"twin": "twin 1.0"}
    assert table.skipped == ()


def test_a_group_that_there_is_not_is_named(lamp_sources: Table[Source]) -> None:
    assert {point.name for point in plugin_points()} == {"good", *BAD, "typed-wrong"}
    (wrong,) = wrong_groups([lamp_sources.group])
    assert "'typed-wrong' is skipped: there is no such group; known: mocapella.sources" in str(wrong)


def test_a_descriptor_may_be_set_for_this_process() -> None:
    table = sources()
    mine = Source(1, "mine", "", (), "nowhere:run")
    table["mine"] = mine
    assert table.find("mine") is mine
    assert table.package("mine") == ""
    del table["mine"]
    assert "mine" not in table


def test_a_reference_that_leads_nowhere_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "raising_lamp.py").write_text("raise ValueError('first\\nsecond')\n")
    importlib.invalidate_caches()
    for reference in ("no_such_lamp:X", "raising_lamp:X", "mocapella.errors:Nothing"):
        with pytest.raises(PluginError, match=f"{reference} cannot be imported") as refused:
            load(reference)
        assert "\n" not in str(refused.value)


def lines_of_code(source: str, names: tuple[str, ...]) -> int:
    """Lines that are no blank line, comment or docstring; of the classes of these names, or of all."""
    tree = ast.parse(source)
    nodes = [n for n in tree.body if isinstance(n, ast.ClassDef) and n.name in names] if names else tree.body
    taken = {line for n in nodes for line in range(min([n.lineno, *_decorators(n)]), (n.end_lineno or 0) + 1)}
    texts = [n for n in ast.walk(tree) if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)]
    taken -= {line for n in texts for line in range(n.lineno, (n.end_lineno or 0) + 1)}
    idle = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    busy = {line for t in tokens if t.type not in idle for line in range(t.start[0], t.end[0] + 1)}
    return len(taken & busy)


def _decorators(node: ast.stmt) -> list[int]:
    return [one.lineno for one in getattr(node, "decorator_list", [])]


def test_the_mechanism_is_below_300_lines_of_code() -> None:
    counts = {path: lines_of_code((SOURCE / path).read_text("utf-8"), names) for path, names in MECHANISM.items()}
    assert sum(counts.values()) < 300, counts
    assert min(counts.values()) > 0


def test_lines_are_counted_without_blank_lines_comments_and_docstrings() -> None:
    text = '"""A."""\n\nimport a  # why\n\n# b\n@a.b\nclass C:\n    """D.\n\n    E."""\n\n    x: int = (\n'
    text += "        1\n    )\n"
    assert lines_of_code(text, ()) == 6
    assert lines_of_code(text, ("C",)) == 5


def test_a_thread_that_reads_while_another_fills_the_table_sees_all_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server decodes the first frames of two nodes at once; a part of the table would refuse all later ones."""
    table, seen = sources(), list[set[str]]()

    def found(group: str) -> EntryPoints:
        if not seen:
            seen.append(set())
            other = threading.Thread(target=lambda: seen.append(set(table)))
            other.start()
            other.join(60.0)
        return points_without_installed(group=group)

    monkeypatch.setattr("mocapella.registry.entry_points", found)
    assert set(table) == set(OURS) == seen[1]


@pytest.mark.slow
def test_a_plug_in_that_somebody_has_installed_changes_no_test(tmp_path: Path) -> None:
    modules = {"zebra_lamp.py": source_text("zebra")}
    folder = distribution(tmp_path, "zebra", {"mocapella.sources": {"zebra": "zebra_lamp:SOURCE"}}, modules)
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    words = ["-q", "-n", "0", "-p", "no:cacheprovider", "-m", "not slow", __file__]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words], capture_output=True, text=True, check=False, timeout=300,
        env={**os.environ, "PYTHONPATH": path}, cwd=SOURCE.parents[1],
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:]
