"""Programs of the tests' own: what is forked behaves as what Python starts."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from support.programs import start

PROGRAM = """
import atexit, os, sys, time
atexit.register(print, "the end")
print(sys.argv[1:], os.getcwd(), os.environ["ONE"], __name__)
print("an error", file=sys.stderr)
if sys.argv[1] == "wait":
    print("waiting", flush=True)
    time.sleep(600)
sys.exit(int(sys.argv[1]))
"""


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], subprocess.Popen[str]]:
    (tmp_path / "tiny_program.py").write_text(PROGRAM)
    monkeypatch.setenv("ONE", "1")

    def begin(argument: str) -> subprocess.Popen[str]:
        with (tmp_path / "out").open("w") as out, (tmp_path / "err").open("w") as err:
            return start(tmp_path, "tiny_program", [argument], out, err)  # type: ignore[return-value]

    return begin


@pytest.mark.parametrize("status", [0, 1, 7])
def test_it_has_its_own_arguments_folder_environment_output_and_status(
    run: Callable[[str], subprocess.Popen[str]], tmp_path: Path, status: int
) -> None:
    process = run(str(status))
    assert process.wait(60.0) == process.poll() == process.returncode == status
    assert (tmp_path / "out").read_text() == f"['{status}'] {tmp_path} 1 __main__\nthe end\n"
    assert (tmp_path / "err").read_text() == "an error\n"


def test_signals_end_it_as_they_end_any_process_and_it_can_be_waited_for(
    run: Callable[[str], subprocess.Popen[str]], tmp_path: Path
) -> None:
    first, second = run("wait"), run("wait")
    with pytest.raises(subprocess.TimeoutExpired):
        first.wait(0.01)
    assert first.poll() is None
    assert os.getpgid(first.pid) == os.getpgid(0)
    first.kill()
    second.terminate()
    assert (first.wait(60.0), second.wait(60.0)) == (-signal.SIGKILL, -signal.SIGTERM)
    first.kill()  # of what has ended, nothing
