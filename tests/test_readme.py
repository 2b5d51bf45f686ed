"""The README's commands run as they are printed, in their order, as a new user would run them."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from support.programs import wait_until

from mocapella.wire.reader import send_command
from mocapella.wire.session import DEFAULT_ADDRESS, open_reader

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", TEXT, flags=re.DOTALL)
    for line in block.splitlines()
    if line.strip()
]
GO_ON = {"uv run mocapella demo": "live view: http", "uv run mocapella serve --sensors 2": "live view: http"}
"""Commands that run until Ctrl-C, and what they print when they are ready."""
NODES = [command for command in COMMANDS if command.startswith("uv run mocapella node simulate")]


def environment() -> dict[str, str]:
    """As printed means without options: uv is told of the project by its own variables, and writes nothing here."""
    return {**os.environ, "UV_PROJECT": str(ROOT), "UV_NO_SYNC": "1", "COLUMNS": "200", "BROWSER": "true"}


def start(command: str, folder: Path, log: Path) -> subprocess.Popen[bytes]:
    with log.open("wb") as out:
        return subprocess.Popen(
            command.split(),
            cwd=folder,
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=out,
            start_new_session=True,
        )


def wait_for(text: str, log: Path, process: subprocess.Popen[bytes], timeout: float = 90.0) -> None:
    deadline = time.monotonic() + timeout
    while text not in log.read_text(encoding="utf-8", errors="replace"):
        assert process.poll() is None, log.read_text(encoding="utf-8", errors="replace")
        assert time.monotonic() < deadline, f"no {text!r} in:\n{log.read_text(encoding='utf-8', errors='replace')}"
        time.sleep(0.1)


def wait_for_tracking() -> None:
    """The README says when to record."""
    session = open_reader(DEFAULT_ADDRESS)
    try:
        wait_until("tracking", lambda: send_command(session, "status").status.phase == "tracking", timeout=90.0)
    finally:
        session.close()


def end(process: subprocess.Popen[bytes]) -> int:
    """Ctrl-C: uv passes it on."""
    process.send_signal(signal.SIGINT)
    return process.wait(60.0)


def clear_away(process: subprocess.Popen[bytes]) -> None:
    """What a failed run left: uv's process and those that it started, which are a group of their own."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def test_the_first_two_commands_are_the_demo_and_the_tests() -> None:
    assert COMMANDS[:2] == ["uv run mocapella demo", "uv run pytest"]


def test_every_file_that_it_names_is_there() -> None:
    links = [link for link in re.findall(r"\]\(([^)]+)\)", TEXT) if not link.startswith("http")]
    assert links
    assert [link for link in links if not (ROOT / link.partition("#")[0]).exists()] == []


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("uv") is None, reason="needs uv, which the README's commands begin with")
def test_the_commands_run_as_they_are_printed(tmp_path: Path) -> None:
    # One after the other as the README has them; this run of the tests stands for `uv run pytest`.
    assert set(GO_ON) <= set(COMMANDS)
    running: list[tuple[str, subprocess.Popen[bytes], Path]] = []
    try:
        for number, command in enumerate(COMMANDS):
            if command == "uv run pytest":
                continue
            log = tmp_path / f"{number}.log"
            if command.startswith("uv run mocapella record"):
                wait_for_tracking()
            # The benchmarks are of the source tree, like the tests: they are run where the README lies.
            process = start(command, ROOT if "-m benchmarks" in command else tmp_path, log)
            if command in GO_ON:
                running.append((command, process, log))
                wait_for(GO_ON[command], log, process)
            elif command in NODES:
                running.append((command, process, log))
                wait_for("serving tls/", log, process)
            else:
                assert process.wait(200.0) == 0, f"{command}\n{log.read_text(encoding='utf-8', errors='replace')}"
            if command == "uv run mocapella demo":
                assert end(running.pop()[1]) == 0, log.read_text(encoding="utf-8", errors="replace")
        for command, process, log in reversed(running):
            assert end(process) == 0, f"{command}\n{log.read_text(encoding='utf-8', errors='replace')}"
        running.clear()
    finally:
        for _, process, _ in running:
            clear_away(process)
    assert (tmp_path / "takes" / "take-1.mcap").exists()
    assert (tmp_path / "takes" / "take-1.csv").exists()
