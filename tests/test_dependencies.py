"""The pinned dependencies agree with pyproject.toml and cover what is installed; faults and silence are told."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterator
from importlib.metadata import requires
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scripts.dependencies import (
    PINS,
    CannotAskError,
    RealUv,
    WrongPinsError,
    _with_tools,
    disagreements,
    main,
    read_pins,
    verdict,
)

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / PINS).read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
HASH = f"--hash=sha256:{64 * '0'}"


def project(bound: str) -> dict[str, Any]:
    """A `pyproject.toml` with one dependency, one extra, and one bound."""
    metadata = {
        "dependencies": ["One_Name>=2"],
        "optional-dependencies": {"more": ["other>=1 ; sys_platform == 'win32'"]},
    }
    return {"project": metadata, "tool": {"uv": {"constraint-dependencies": [bound]}}}


def needed(name: str, extras: frozenset[str], seen: set[str]) -> Iterator[str]:
    """Names of all packages that an installed package needs here."""
    for line in requires(name) or []:
        wanted = Requirement(line)
        wanted_name = canonicalize_name(wanted.name)
        if wanted_name in seen or not any(
            wanted.marker is None or wanted.marker.evaluate({"extra": extra}) for extra in extras or {""}
        ):
            continue
        seen.add(wanted_name)
        yield wanted_name
        yield from needed(wanted_name, frozenset(wanted.extras), seen)


def test_the_pins_agree_with_the_project() -> None:
    assert disagreements(TEXT, PROJECT) == []
    assert len(read_pins(TEXT)) > len(PROJECT["project"]["dependencies"])


def test_whatever_the_core_needs_here_is_pinned() -> None:
    pinned = {pin.name for pin in read_pins(TEXT)}
    names = set(needed("mocapella", frozenset(), set()))
    assert {"numpy", "cffi", "llvmlite"} <= names  # of a dependency, too
    assert names <= pinned


@pytest.mark.parametrize(
    ("pins", "fault"),
    [
        (f"one-name==2.0 \\\n    {HASH}\nother==1 {HASH}", None),
        (f"one-name==2.0 \\\n    {HASH}\nother==1 ; sys_platform == 'win32' {HASH}", None),
        (f"other==1 {HASH}", "one-name has no pin"),
        (f"one-name==2.0 {HASH}", "other has no pin"),
        (f"one-name==2.0\nother==1 {HASH}", "one-name has no hash"),
        (f"one-name==2.0 --hash=sha256:00\nother==1 {HASH}", "one-name has no hash"),
        (f"one-name==1.9 {HASH}\nother==1 {HASH}", "one-name==1.9 is not One_Name>=2"),
        (f"one-name==2.1 {HASH}\nother==1 {HASH}", "one-name==2.1 is not one.name<2.1"),
        (f"--index-url https://a.example/b\none-name==2.0 {HASH}\nother==1 {HASH}", "https://a.example/b"),
    ],
)
def test_a_fault_of_the_pins_is_told(pins: str, fault: str | None) -> None:
    found = disagreements(pins, project("one.name<2.1"))
    assert found == [] if fault is None else len(found) == 1 and fault in found[0]


def test_a_pin_has_its_marker_and_all_hashes() -> None:
    one, other = read_pins(
        f"# head\na.b==1 ; x == 'y' and z < '3' \\\n    {HASH} \\\n    {HASH}\nc==2 \\\n    {HASH}\n"
    )
    assert (one.name, one.version, one.marker, len(one.hashes)) == ("a-b", "1", "x == 'y' and z < '3'", 2)
    assert (other.name, other.version, other.marker, len(other.hashes)) == ("c", "2", "", 1)


UNKNOWN = {"name": "a", "skip_reason": "not found"}
CLEAN = {"name": "b", "version": "1", "vulns": []}
FAULTY = {
    "name": "c",
    "version": "2",
    "vulns": [{"id": "X-1", "fix_versions": ["3"]}, {"id": "X-2", "fix_versions": []}],
}


def test_packages_that_no_service_knows_are_not_without_faults() -> None:
    assert verdict({"dependencies": [UNKNOWN, UNKNOWN]}) == ([], 0, 2)
    assert verdict({"dependencies": [UNKNOWN, CLEAN]}) == ([], 1, 1)
    faults, asked, skipped = verdict({"dependencies": [CLEAN, FAULTY, UNKNOWN]})
    assert faults == ["c 2: X-1, fixed in 3", "c 2: X-2, fixed in no version yet"]
    assert (asked, skipped) == (2, 1)


def auditor(*answers: list[dict[str, Any]], status: Exception | None = None) -> Callable[..., str]:
    """Stand in for pip-audit: one report a run, then end with ``status``."""
    left = iter(answers)

    def run(*arguments: str, cwd: Path | None = None) -> str:
        report = next(left, None)
        if report is not None:
            Path(arguments[arguments.index("--output") + 1]).write_text(json.dumps({"dependencies": report}))
        if status is not None:
            raise status
        return ""

    return run


@pytest.mark.parametrize(
    ("uv", "status", "strict_status", "words"),
    [
        (lambda: auditor([CLEAN], [CLEAN], [CLEAN]), 0, 0, "no known fault in 2 packages; 0 could not"),
        (lambda: auditor([CLEAN], [CLEAN, UNKNOWN], []), 0, 2, "audit: "),
        (lambda: auditor([UNKNOWN]), 0, 2, "NOT CHECKED"),
        (lambda: auditor(status=WrongPinsError("no connection")), 0, 2, "NOT CHECKED"),
        (lambda: auditor(status=CannotAskError("no registry")), 0, 2, "NOT CHECKED: no registry"),
        (lambda: auditor([CLEAN], [FAULTY, UNKNOWN], [], status=WrongPinsError("found")), 1, 1, "c 2: X-1"),
        (lambda: auditor([FAULTY], [CLEAN], [FAULTY], status=WrongPinsError("found")), 1, 1, "c 2: X-2"),
    ],
)
def test_an_audit_fails_for_a_fault_and_says_what_it_could_not_ask(
    uv: Callable[[], Any], status: int, strict_status: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["audit"], uv()) == status
    assert words in "".join(capsys.readouterr())
    assert main(["audit", "--strict"], uv()) == strict_status


def resolver(change: Callable[[str], str]) -> Callable[..., str]:
    """Stand in for `uv pip compile`, which changes the file that it is given."""

    def run(*arguments: str, cwd: Path | None = None) -> str:
        path = Path(arguments[arguments.index("--output-file") + 1])
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
        return ""

    return run


def test_pins_that_would_be_resolved_otherwise_fail_and_new_files_of_a_version_do_not(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["check"], resolver(lambda text: text)) == 0
    assert main(["check"], resolver(lambda text: text.replace("sha256:", f"sha256:{64 * '1'} --hash=sha256:", 1))) == 0
    assert "pins agree" in capsys.readouterr().out
    assert main(["check"], resolver(lambda text: f"{text}\nnew==1 {HASH}\n")) == 1
    assert "resolved again, these differ: new" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("script", "error", "words"),
    [
        ("echo 'error: Request failed after 3 retries'>&2; exit 2", CannotAskError, "3 retries"),
        ("echo 'hint: the network was disabled'>&2; exit 1", CannotAskError, "disabled"),
        ("echo 'error: No solution found'>&2; exit 1", WrongPinsError, "No solution"),
        ("exec sleep 600", CannotAskError, "no answer of `uv pip compile`"),
    ],
)
def test_uv_that_cannot_ask_is_told_from_uv_that_refuses(
    script: str, error: type[Exception], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "uv"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o700)
    monkeypatch.setenv("UV", str(program))
    with pytest.raises(error, match=words):
        RealUv(0.2 if "sleep" in script else 60.0)("pip", "compile")


def test_ci_runs_all_commands() -> None:
    steps = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for command in ("check", "sbom", "audit"):
        assert f"run run python -m scripts.dependencies {command}\n" in steps


def test_tools_that_cannot_be_installed_are_no_fault_of_the_pins() -> None:
    def fails(*_: str, **__: Path) -> str:
        raise WrongPinsError("error: no version of a tool\nno solution")

    with pytest.raises(CannotAskError, match="no solution"):
        _with_tools(fails, "build")
