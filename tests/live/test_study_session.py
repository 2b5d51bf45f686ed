"""A study's session with whole processes and a real browser, from the first instruction to the report."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import pytest
from support.browser import FLAGS
from support.programs import Program, free_port, run_here, wait_until

from mocapella.recording.study_log import read_study_log
from mocapella.recording.take_reader import read_take
from mocapella.studies.protocol import load_protocol
from mocapella.studies.state_file import load_session
from mocapella.studies.study_folder import give_consent, new_study, open_study, verify_study
from mocapella.studies.task_runs import valid_runs

CHROMIUM = shutil.which("chromium")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH")]
TASKS = 10
NOW = datetime(2026, 11, 30, 9, tzinfo=UTC)


def protocol() -> str:
    """Ten tasks, of which one has a step that ends by itself."""
    head = """
title = "Ten tasks"
participants = { codes = ["P07"] }
consent = "Two sensors record your joints."
[block]
width_m = 1.925
depth_m = 1.87
start = "middle"
points = [{ name = "middle", x_m = 0, y_m = 0 }, { name = "front", x_m = 0, y_m = 0.9 }]
[[placements]]
name = "right-45"
number = 1
text = "Put the other sensor at 45 degrees."
"""
    tasks = [
        f'[[tasks]]\nname = "task-{n}"\nscenario = {n}\n'
        f'steps = [{{ text = "Do number {n}.", {"seconds = 2.0, " if n == 2 else ""}stand = ["middle"] }}]\n'
        for n in range(1, TASKS + 1)
    ]
    return head + "".join(tasks)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield made
        made.close()


class Researcher:
    """The researcher's page."""

    def __init__(self, browser: Any, url: str) -> None:
        self.page = browser.new_page(viewport={"width": 1280, "height": 720})
        self.page.set_default_timeout(120_000)
        self.page.goto(url)

    def sees(self, where: str, text: str) -> None:
        self.page.locator(where, has_text=text).wait_for()

    def phase(self, name: str) -> None:
        self.page.wait_for_function(f"document.body.dataset.phase === '{name}'")

    def has_logged(self, task: str) -> None:
        """Wait until the task has so many results that some were captured, not only tracked, while it was running."""
        words = f"logging {task}: "
        self.page.wait_for_function(
            "words => parseInt(document.querySelector('#checks').textContent.split(words)[1]) >= 60", arg=words
        )

    def key(self, key: str) -> None:
        self.page.keyboard.press(key)


def address_of(program: Program, line: str) -> str:
    wait_until(f"the line {line!r}", program.said(f"\n{line}"), timeout=180)
    return program.output.partition(f"\n{line}")[2].split()[0]


def test_ten_tasks_from_the_first_instruction_to_the_report_with_a_kill_in_the_middle(
    tmp_path: Path, browser: Any
) -> None:
    study = new_study(tmp_path / "study", protocol().encode(), by="op-1", at=NOW)
    port, view_port = free_port(), free_port()
    serve = (
        "study", "run", "study", "--by", "op-1", "--sensors", "2", "--method", "stand-still", "--port", str(port),
        "--set", f"view_port={view_port}", "--set", "frames=30",
    )  # fmt: skip
    with ExitStack() as stack:
        server = stack.enter_context(Program(tmp_path, "serve", *serve))
        url = address_of(server, "study: ")
        nodes = []
        for name in ("front", "right"):
            words = ("simulate", "--scene", "stand", "--sensor", name, "--connect", f"tls/127.0.0.1:{port}")
            nodes.append(stack.enter_context(Program(tmp_path, name, "node", *words)))
        researcher = Researcher(browser, url)
        screen = browser.new_page(viewport={"width": 1280, "height": 720})
        screen.goto(address_of(server, "study, the participant's screen: "))
        researcher.page.locator("#begin").click()
        researcher.sees("#reply", "P07 has not consented")
        give_consent(open_study(study.path), "P07", date(2026, 11, 30), by="op-1", at=NOW)
        researcher.page.locator("#begin").click()
        researcher.sees("#advice", "Put the other sensor")
        researcher.sees("#checks", "2 of 2 sensors")
        researcher.sees("#checks", "nothing is logged")
        researcher.key("n")
        researcher.phase("instruction")
        researcher.sees("#checks", "views whole")
        for number in range(1, TASKS + 1):
            researcher.sees("#plan .now", f"task-{number}")
            researcher.key("n")
            if number != 2:
                researcher.phase("running")
                screen.locator("#instruction", has_text=f"Do number {number}.").wait_for()
            if number == 3:
                researcher.key("m")
                researcher.page.keyboard.type("a cat came in")
                researcher.key("Enter")
                researcher.key("p")
                researcher.phase("paused")
                researcher.sees("#checks", "nothing is logged")
                researcher.key("p")
                researcher.phase("running")
                researcher.key("r")  # again, from its instruction
                researcher.phase("instruction")
                researcher.key("n")
                researcher.phase("running")
            if number == 5:
                researcher.page.wait_for_function("parseInt(document.querySelector('#time').textContent.slice(2)) >= 2")
                server.end(signal.SIGKILL)
                researcher.page.locator("#lost").wait_for(state="visible")
                server = stack.enter_context(Program(tmp_path, "again", *serve))
                wait_until("it goes on", server.said("participant P07 goes on at task-5 (paused)"), timeout=180)
                researcher.phase("paused")
                researcher.key("p")
                researcher.phase("running")
            if number != 2:
                researcher.has_logged(f"task-{number}")
                researcher.key("n")
            researcher.phase("between")  # the second task's step ended by itself
            researcher.key("n")
        researcher.phase("done")
        screen.locator("#instruction", has_text="Thank you").wait_for()
        wait_until("the take is whole", server.said("recorded "))
        for node in nodes:
            assert node.end() == 0
        assert server.end() == 0
        screen.close()
        researcher.page.close()
    assert "Traceback" not in server.output
    looks_whole(study.path)
    done = run_here(tmp_path, "study", "analyze", "study", "--out", "results")
    assert done.returncode == 0, done.stderr
    report = (tmp_path / "results" / "report.html").read_text(encoding="utf-8")
    assert "1 participant" in report
    for number in range(1, TASKS + 1):
        assert f"task-{number}" in report
    assert "scenario-" not in report
    assert "sensor to fused" in report


def looks_whole(path: Path) -> None:
    own = path / "participants" / "P07"
    session = load_session(own / "session.json")
    runs = valid_runs(session.events)
    assert [run.task for run in runs] == [f"task-{n}" for n in range(1, TASKS + 1)]
    assert [event.note for event in session.events if event.what == "mark"] == ["a cat came in"]
    assert session.state.phase == "done"
    take = read_take(own / "right-45.mcap")
    noted = [command.arguments for command in take.commands() if command.values["verb"] == "study-event"]
    assert [event["what"] for event in noted] == [event.what for event in session.events][1:]  # the take begins later
    labels = [run.info.setup.scenario for run in take.runs]
    assert set(labels) == {"", *(f"task-{n}" for n in range(1, TASKS + 1))}
    for run in take.runs:
        if run.info.setup.scenario:
            assert len(list(take.scenes(run.number))) > 0, run.info.setup.scenario
    logs = sorted((own / "logs").glob("*.csv.gz"))
    assert [log.name for log in logs] == [f"{n:03}-right-45-task-{n}-1.csv.gz" for n in range(1, TASKS + 1)]
    rows = read_study_log(logs[2])
    assert set(rows.scenario_id.tolist()) == {3}
    assert set(rows.study_id.tolist()) == {7}
    assert verify_study(path).whole
    assert load_protocol(path / "protocol.toml").title == "Ten tasks"
