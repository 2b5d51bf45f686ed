"""Pinned dependencies: pin them with hashes, check the pins, list what is installed (SBOM), ask for known faults.

uv run python -m scripts.dependencies pin|check|sbom|audit

`pin` writes `constraints/tested.txt`. The others are steps of CI: they fail for a fault, but not for want of a network,
which they report; with ``--strict`` they fail for that too.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PINS = Path("constraints/tested.txt")
"""All dependencies of the core and of every extra, each with its version and the SHA-256 of its files."""
SBOM_TOOL = "cyclonedx-bom==7.5.0"
AUDIT_TOOL = "pip-audit==2.10.1"
HEAD = "# Made by `uv run python -m scripts.dependencies pin`. SECURITY.md says how to install with it.\n"
PATIENCE_S = 30.0
"""Seconds until a command of CI counts as unanswered."""
PROBE = "cryptography"
"""Package that is asked about first: a service that does not know it is not asked about the others."""
NOT_REACHED = (
    *("network was disabled", "Request failed", "Could not connect", "Failed to fetch", "error sending request"),
    *("not found in the package registry", "Failed to download", "Failed to extract"),
)
"""What uv prints if the registry does not answer, or lacks a package that others have."""
PIN = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^ ;\\]+)(?: ; (?P<marker>[^\\]+))?")


class CannotAskError(Exception):
    """The package registry or the list of known faults did not answer."""


class WrongPinsError(Exception):
    """The pins do not agree with ``pyproject.toml``, or a pinned package has a known fault."""


@dataclass(frozen=True)
class Pin:
    """One version of a package, where ``marker`` holds (everywhere if empty), and its files' SHA-256 in hexadecimal."""

    name: str
    version: str
    marker: str
    hashes: tuple[str, ...]


def read_pins(text: str) -> list[Pin]:
    """Parse a constraints file in pip's format."""
    pins = []
    for entry in text.replace("\\\n", " ").splitlines():
        if found := PIN.match(entry):
            marker = (found["marker"] or "").partition(" --hash")[0].strip()
            hashes = tuple(re.findall(r"--hash=sha256:([0-9a-f]{64})\b", entry))
            pins.append(Pin(canonicalize_name(found["name"]), found["version"], marker, hashes))
    return pins


def disagreements(text: str, project: Mapping[str, Any]) -> list[str]:
    """Compare pins with the bounds of a parsed ``pyproject.toml``: one line for each fault, none if they agree.

    This asks nobody: it does not notice a dependency of a dependency that has no pin.
    """
    pins = read_pins(text)
    faults = [f"{pin.name} has no hash" for pin in pins if not pin.hashes]
    faults += [f"an address is in the file: {found}" for found in re.findall(r"\w+://\S+", text)]
    metadata = project["project"]
    wanted = sum(metadata["optional-dependencies"].values(), metadata["dependencies"])
    for line in wanted:
        name = canonicalize_name(Requirement(line).name)
        if not any(pin.name == name for pin in pins):
            faults.append(f"{name} has no pin")
    for line in (*wanted, *project["tool"]["uv"]["constraint-dependencies"]):
        bounds = Requirement(line)
        faults += [
            f"{pin.name}=={pin.version} is not {bounds.name}{bounds.specifier}"
            for pin in pins
            if pin.name == canonicalize_name(bounds.name) and not bounds.specifier.contains(pin.version)
        ]
    return faults


def verdict(report: Mapping[str, Any]) -> tuple[list[str], int, int]:
    """Read pip-audit's JSON: the known faults, one line each; how many packages were asked about; how many were not.

    pip-audit ends with status 0 and *No known vulnerabilities found* also if it could ask about no package.
    """
    faults, asked, skipped = [], 0, 0
    for package in report["dependencies"]:
        if "skip_reason" in package:
            skipped += 1
            continue
        asked += 1
        for fault in package["vulns"]:
            remedy = ", ".join(fault["fix_versions"]) or "no version yet"
            faults.append(f"{package['name']} {package['version']}: {fault['id']}, fixed in {remedy}")
    return faults, asked, skipped


Uv = Callable[..., str]
"""Run uv with these arguments in the project's folder, or in ``cwd``; see `RealUv`."""


class RealUv:
    """uv, whose runs together may take ``patience_s`` seconds."""

    def __init__(self, patience_s: float) -> None:
        self._until = time.monotonic() + patience_s

    def __call__(self, *arguments: str, cwd: Path = ROOT) -> str:
        """Run uv and return what it printed.

        Raises:
            CannotAskError: the registry or the service did not answer.
            WrongPinsError: uv refused, or the program that it ran; the text is theirs.
        """
        command = [os.environ.get("UV", "uv"), *arguments]
        with subprocess.Popen(
            command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        ) as process:
            try:
                output, errors = process.communicate(timeout=max(0.0, self._until - time.monotonic()))
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)  # also the program that uv runs
                raise CannotAskError(f"no answer of `uv {' '.join(arguments[:2])}` in time") from None
        if process.returncode == 0:
            return output
        if any(words in errors for words in NOT_REACHED):
            raise CannotAskError(errors.strip().splitlines()[-1])
        raise WrongPinsError(errors.strip())


def compile_pins(uv: Uv, into: Path, *options: str) -> None:
    """Resolve the core and all extras for every system; the versions that ``into`` has already are kept."""
    uv(
        *("pip", "compile", "pyproject.toml", "--quiet", "--universal", "--python-version", "3.11", "--all-extras"),
        *("--generate-hashes", "--no-header", "--no-annotate", "--no-emit-index-url", "--no-emit-find-links"),
        *(*options, "--output-file", str(into)),
    )


def pin(uv: Uv) -> str:
    """Write the pins again, with the newest versions that ``pyproject.toml`` allows."""
    path = ROOT / PINS
    path.parent.mkdir(exist_ok=True)
    compile_pins(uv, path, "--upgrade")
    path.write_text(HEAD + path.read_text(encoding="utf-8"), encoding="utf-8")
    return f"{len(read_pins(path.read_text(encoding='utf-8')))} pins in {PINS}"


def check(uv: Uv) -> str:
    """Compare the pins with ``pyproject.toml``, and with what uv resolves from both."""
    text = (ROOT / PINS).read_text(encoding="utf-8")
    if faults := disagreements(text, tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))):
        raise WrongPinsError("\n".join(faults))
    with tempfile.TemporaryDirectory() as folder:
        again = Path(folder, "tested.txt")
        again.write_text(text, encoding="utf-8")
        compile_pins(uv, again)
        resolved = again.read_text(encoding="utf-8")
    # A file that was uploaded later adds a hash, and each uv writes markers in its own way: versions have to agree.
    old, new = ({(p.name, p.version) for p in read_pins(t)} for t in (text, resolved))
    if old != new:
        raise WrongPinsError(f"resolved again, these differ: {', '.join(sorted({name for name, _ in old ^ new}))}")
    return f"{len(old)} pins agree with pyproject.toml"


def sbom(uv: Uv, into: Path) -> str:
    """Install the core with the pins, each file's hash verified, and write a CycloneDX list of all packages."""
    into.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _with_tools(uv, "build", "--quiet", "--wheel", "--out-dir", name)
        (wheel,) = folder.glob("*.whl")
        digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
        (folder / "core.txt").write_text(f"./{wheel.name} --hash=sha256:{digest}\n", encoding="utf-8")
        uv("venv", "--quiet", "--python", sys.executable, f"{name}/venv")
        pins = ("--require-hashes", "--constraint", str(ROOT / PINS), "--requirement", "core.txt")
        uv("pip", "install", "--quiet", "--python", f"{name}/venv", *pins, cwd=folder)
        tool = ("tool", "run", "--quiet", "--from", SBOM_TOOL, "cyclonedx-py", "environment", "--no-validate")
        options = ("--output-reproducible", "--pyproject", "pyproject.toml", "--output-file", str(into.resolve()))
        _with_tools(uv, *tool, *options, f"{name}/venv")
    parts = json.loads(into.read_text(encoding="utf-8"))["components"]
    return f"{len(parts)} packages in {into}, all installed with a pinned hash"


def _with_tools(uv: Uv, *arguments: str) -> None:
    """Run uv with tools that are no dependencies of the project; if they cannot be installed, nothing was checked."""
    try:
        uv(*arguments)
    except WrongPinsError as error:
        raise CannotAskError((str(error).splitlines() or ["it failed"])[-1]) from None


def audit(uv: Uv, strict: bool) -> str:
    """Ask pip-audit's service for known faults of every pinned version.

    Raises:
        CannotAskError: the service does not know `PROBE`, or with ``strict`` any other package.
        WrongPinsError: a version has a known fault.
    """
    pins = read_pins((ROOT / PINS).read_text(encoding="utf-8"))
    if not verdict(_ask(uv, [one for one in pins if one.name == PROBE]))[1]:
        raise CannotAskError(f"pip-audit's service does not know {PROBE}")
    first = list({one.name: one for one in reversed(pins)}.values())  # pip-audit reads one version of each package
    others = [one for one in pins if one not in first]
    reports = [_ask(uv, part) for part in (first, others) if part]
    faults, asked, skipped = verdict({"dependencies": [entry for one in reports for entry in one["dependencies"]]})
    if faults:
        raise WrongPinsError("\n".join(faults))
    if strict and skipped:
        raise CannotAskError(f"pip-audit's service does not know {skipped} of {asked + skipped} packages")
    return f"no known fault in {asked} packages; {skipped} could not be asked about"


def _ask(uv: Uv, pins: list[Pin]) -> Any:
    """Return pip-audit's report."""
    with tempfile.TemporaryDirectory() as folder:
        wanted, report = Path(folder, "wanted.txt"), Path(folder, "report.json")
        wanted.write_text("".join(f"{one.name}=={one.version}\n" for one in pins), encoding="utf-8")
        tool = ("tool", "run", "--quiet", "--from", AUDIT_TOOL, "pip-audit", "--no-deps", "--disable-pip")
        options = ("--progress-spinner", "off", "--timeout", "5", "--format", "json", "--output", str(report))
        try:
            uv(*tool, *options, "--requirement", str(wanted))
        except WrongPinsError as error:  # status 1, with or without a report: a finding, or a service out of reach
            if not report.exists():
                raise CannotAskError(str(error).splitlines()[-1]) from None
        return json.loads(report.read_text(encoding="utf-8"))


def main(arguments: list[str] | None = None, uv: Uv | None = None) -> int:
    """Run one command and return its status: 1 for a fault, 2 for no answer to ``pin`` or with ``--strict``, else 0."""
    parser = argparse.ArgumentParser(prog="python -m scripts.dependencies", description=str(__doc__).partition("\n")[0])
    parser.add_argument("command", choices=("pin", "check", "sbom", "audit"))
    parser.add_argument("--strict", action="store_true", help="status 2 if something could not be asked")
    parser.add_argument("--output", type=Path, default=Path("artifacts/sbom.json"), help="file of sbom")
    chosen = parser.parse_args(arguments)
    uv = uv or RealUv(600.0 if chosen.command == "pin" else PATIENCE_S)
    try:
        match chosen.command:
            case "pin":
                result = pin(uv)
            case "check":
                result = check(uv)
            case "sbom":
                result = sbom(uv, chosen.output)
            case _:
                result = audit(uv, chosen.strict)
    except CannotAskError as error:
        print(f"{chosen.command}: NOT CHECKED: {error}", file=sys.stderr)
        return 2 if chosen.strict or chosen.command == "pin" else 0
    except WrongPinsError as error:
        print(f"{chosen.command}: {error}", file=sys.stderr)
        return 1
    print(f"{chosen.command}: {result}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
