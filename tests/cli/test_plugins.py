"""Plug-ins in real processes: a good one is a verb like ours, a bad one costs a line and nothing else."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from support.distributions import BAD, distribution, lamps, source_text
from support.programs import Program, free_port, result, run, wait_until

from mocapella.live.signals import STARTED_BY_US
from mocapella.sources.source import SOURCES

SKIPPED = sorted([*BAD, "typed-wrong"])


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of distributions that the processes of a test have."""
    folder = lamps(tmp_path / "packages")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]))
    return folder


def skipped(text: str) -> list[str]:
    """The names of the lines about plug-ins that are skipped."""
    return sorted(line.split("'")[1] for line in text.splitlines() if line.startswith("lamps 1.0: mocapella.source"))


@pytest.mark.slow
def test_a_plug_ins_verb_is_listed_and_runs(packages: Path, tmp_path: Path) -> None:
    (packages / "good_command.py").write_text("print('imported')\n" + (packages / "good_command.py").read_text())
    listed = run(tmp_path, "node", "--help")
    assert "good Lamps." in " ".join(listed.stdout.split())
    assert "imported" not in listed.stdout
    assert "Serve a lamp." in run(tmp_path, "node", "good", "--help").stdout
    done = run(tmp_path, "node", "good", "--loud")
    assert (done.returncode, done.stdout) == (0, "imported\nlamp True\n")
    assert skipped(done.stderr) == SKIPPED


def test_a_bad_verb_that_is_asked_for_is_one_line(packages: Path, tmp_path: Path) -> None:
    done = run(tmp_path, "node", "later")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("mocapella: source 'later' of lamps 1.0 cannot be used: it was")


def test_a_verb_whose_command_cannot_be_imported_is_one_line(packages: Path, tmp_path: Path) -> None:
    (packages / "good_command.py").write_text("import no_such_module_of_lamps\n")
    done = run(tmp_path, "node", "good")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("mocapella: good_command:run cannot be imported (ModuleNotFound")


@pytest.mark.slow
@pytest.mark.parametrize("words", [("replay", "no-take"), ("export", "csv", "no-take"), ("node", "replay", "no-take",
    "--sensor", "a")], ids=" ".join)  # fmt: skip
def test_each_verb_tells_once_and_goes_on(packages: Path, tmp_path: Path, words: tuple[str, ...]) -> None:
    done = run(tmp_path, *words)
    assert skipped(done.stderr) == SKIPPED
    assert "no such file" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_serve_tells_once_with_its_view_and_tracks(packages: Path, tmp_path: Path) -> None:
    ports = ["--port", str(free_port()), "--set", f"view_port={free_port()}"]
    with Program(tmp_path, "serve", "serve", *ports, "--method", "stand-still") as serve:
        wait_until("the view", serve.said("live view: "))
        wait_until("the server", serve.said("waiting for sensors"))
        assert serve.end() == 0
    assert skipped(serve.output) == SKIPPED


@pytest.mark.slow
def test_a_view_of_its_own_tells(packages: Path, tmp_path: Path) -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    with Program(tmp_path, "view", "view", "--connect", address, "--view-port", str(free_port())) as view:
        wait_until("the view waits", view.said("no server at"))
        assert view.end() == 0
    assert skipped(view.output) == SKIPPED


def test_a_process_that_ours_started_does_not_tell_again(
    packages: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(STARTED_BY_US, "1")
    assert skipped(run(tmp_path, "node", "good").stderr) == []


@pytest.mark.slow
def test_the_doctor_has_a_finding_for_each(packages: Path, tmp_path: Path) -> None:
    findings = [one for one in result(tmp_path, "doctor") if one["what"] == "plug-in lamps 1.0"]
    assert [one["found"] for one in findings if one["verdict"] == "ok"] == ["source good"]
    notes = {one["found"].split(":")[0]: one for one in findings if one["verdict"] == "note"}
    assert sorted(name.split()[-1] for name in notes) == SKIPPED
    assert all(one["advice"] for one in notes.values())
    assert notes["mocapella.sources later"]["advice"] == "update the package or Mocapella"


@pytest.mark.slow
def test_a_source_whose_look_fails_costs_the_doctor_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = source_text("torch").replace("command=", 'looks="torch_lamp:look", command=')
    points = {"mocapella.sources": {"torch": "torch_lamp:SOURCE"}}
    folder = distribution(tmp_path / "p", "torch", points, {"torch_lamp.py": f"{text}def look():\n    return 1 / 0\n"})
    monkeypatch.setenv("PYTHONPATH", str(folder))
    findings = {one["what"]: one for one in result(tmp_path, "doctor")}
    assert findings["source torch"]["found"] == "could not look (ZeroDivisionError: division by zero)"
    assert findings["cameras"]


def test_help_imports_no_descriptor_and_no_verb_of_a_node(tmp_path: Path) -> None:
    """So that it stays quick."""
    code = "from mocapella.cli import run\ntry:\n    run({})\nfinally:\n    import sys; print(*sys.modules)"
    for words, wanted in ((["--help"], False), (["node", "--help"], True)):
        loaded = set(_python(tmp_path, code.format(words)).splitlines()[-1].split())
        assert ("mocapella.sources.shipped" in loaded) == wanted
        commands = {source.command.partition(":")[0] for source in SOURCES.values()}
        assert not loaded & {*commands, "mocapella.cli.export", "mocapella.tracker", "zenoh", "numpy"}


def _python(folder: Path, code: str) -> str:
    import subprocess

    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False).stdout
