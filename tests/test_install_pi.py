"""The script that installs on a Raspberry Pi: what it runs, and that it refuses a system of 32 bits."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = ROOT / "scripts" / "install_pi.sh"
PYTHON = """#!/bin/sh
echo "python $*" >> "$CALLS"
case "$1 $2" in
  "-c import picamera2, ensurepip") exit "$MISSING" ;;
  "-m venv") mkdir -p "$4/bin"; cp "$0" "$4/bin/python"; cp "$0" "$4/bin/pip" ;;
esac
"""

pytestmark = pytest.mark.skipif(shutil.which("sh") is None, reason="needs a shell")


def run(folder: Path, *, bits: int = 64, missing: int = 0) -> tuple[int, str, list[str]]:
    """Its exit status, what it says, and the commands that it called: stand-ins of python, pip, sudo and getconf."""
    tools, calls = folder / "tools", folder / "calls.txt"
    tools.mkdir()
    texts = {
        "python3": PYTHON,
        "sudo": '#!/bin/sh\necho "sudo $*" >> "$CALLS"\n',
        "getconf": f"#!/bin/sh\necho {bits}\n",
    }
    for name, text in texts.items():
        (tools / name).write_text(text)
        (tools / name).chmod(0o755)
    calls.write_text("")
    variables = {"PATH": f"{tools}:{os.environ['PATH']}", "CALLS": str(calls), "MISSING": str(missing)}
    command = ["sh", str(SCRIPT), str(folder / "env")]
    done = subprocess.run(
        command, env={**os.environ, **variables}, capture_output=True, text=True, timeout=60, check=False
    )
    return done.returncode, done.stdout + done.stderr, calls.read_text().splitlines()


def test_it_makes_an_environment_that_sees_the_systems_packages_and_compiles_nothing(tmp_path: Path) -> None:
    status, said, calls = run(tmp_path)
    assert status == 0, said
    assert f"python -m venv --system-site-packages {tmp_path}/env" in calls
    (pip,) = [call for call in calls if " install " in call]
    assert "--only-binary :all:" in pip
    assert f"-c {ROOT}/constraints/raspberry-pi.txt {ROOT}[cameras]" in pip
    assert not any(call.startswith("sudo") for call in calls)  # picamera2 is there
    assert f"installed: {tmp_path}/env/bin/mocapella" in said


def test_it_fetches_picamera2_where_it_is_missing(tmp_path: Path) -> None:
    status, said, calls = run(tmp_path, missing=1)
    assert status == 0, said
    assert "sudo apt-get install -y python3-picamera2 python3-venv" in calls


def test_a_system_of_32_bits_is_refused_before_anything_is_done(tmp_path: Path) -> None:
    status, said, calls = run(tmp_path, bits=32)
    assert (status, calls) == (1, [])
    assert "install the 64-bit Raspberry Pi OS" in said


@pytest.mark.parametrize(("python", "good", "bad"), [("3.11", "1.26.4", "2.2.0"), ("3.13", "2.2.4", "1.26.4")])
def test_numpy_is_that_of_the_systems_picamera2(python: str, good: str, bad: str) -> None:
    lines = (ROOT / "constraints" / "raspberry-pi.txt").read_text().splitlines()
    rules = [Requirement(line) for line in lines if not line.startswith("#")]
    (rule,) = [rule for rule in rules if rule.marker is not None and rule.marker.evaluate({"python_version": python})]
    assert good in rule.specifier
    assert bad not in rule.specifier
