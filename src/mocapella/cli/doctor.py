"""``mocapella doctor``: check installed packages, ports and devices, and advise on each problem."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import re
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mocapella import __version__
from mocapella.cli.app import SET_UP, app
from mocapella.cli.common import (
    DEFAULT_PORT,
    DEFAULT_TAKES,
    DEFAULT_VIEW_PORT,
    BusPort,
    JsonOut,
    ViewPort,
    console,
    write_json,
)
from mocapella.cli.kernel_folder import kernel_folder_finding
from mocapella.cli.plugins import plugin_findings
from mocapella.errors import AddressInUseError, BusError, PluginError
from mocapella.sources.source import Finding

_BROWSERS = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "firefox", "firefox-esr"),
    *("microsoft-edge", "brave-browser", "vivaldi", "opera", "safari"),
)
_MARKS = {"ok": "[green]ok[/green]", "note": "[yellow]note[/yellow]", "problem": "[red]problem[/red]"}


@app.command(rich_help_panel=SET_UP)
def doctor(
    port: BusPort = DEFAULT_PORT,
    view_port: ViewPort = DEFAULT_VIEW_PORT,
    takes: Annotated[Path, typer.Option("--takes", metavar="FOLDER", help="Folder of the takes.")] = DEFAULT_TAKES,
    json: JsonOut = None,
) -> None:
    """Check this machine: report missing packages and devices for each task, with advice.

    The table is on standard output, or with --json - on standard error. Exit status 1 when something that the main job
    needs is wrong.

    Example:  mocapella doctor --json -
    """
    findings = list(examine(port, view_port, takes))
    table = Table(title=f"mocapella {__version__} on {platform.system()} {platform.machine()}", show_lines=False)
    for heading in ("", "what", "found", "what to do"):
        table.add_column(heading, overflow="fold")
    for finding in findings:
        table.add_row(_MARKS[finding.verdict], *map(escape, (finding.what, finding.found, finding.advice)))
    problems = [finding.what for finding in findings if finding.verdict == "problem"]
    # It is the result of this command, which may be piped or kept; other verbs only speak of theirs.
    out = console if json == "-" else Console(highlight=False)
    out.print(table)
    out.print(f"to be mended: {', '.join(problems)}" if problems else "the main job can be done here", markup=False)
    write_json(json, [asdict(finding) for finding in findings])
    if problems:
        raise typer.Exit(1)


def examine(port: int, view_port: int, takes: Path) -> Iterator[Finding]:
    """Run all checks of this machine, and yield their findings.

    Args:
        port: TCP port of the bus.
        view_port: TCP port of the live view.
        takes: folder of the takes.
    """
    yield _python()
    yield from _core_packages()
    yield from _extras()
    yield from plugin_findings()
    yield from _source_looks()
    yield from keypoint_detectors()
    yield _port("bus port", port, "--port")
    yield _port("view port", view_port, "--view-port")
    yield _disk(takes)
    yield kernel_folder_finding()
    yield _browser()
    yield _clock()


def _python() -> Finding:
    return Finding("Python", "ok", f"{platform.python_version()} ({sys.executable})")


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _required() -> dict[str, list[str]]:
    """Return the packages that Mocapella requires, by extra; the core's under the empty name."""
    needs: dict[str, list[str]] = {"": []}
    for need in importlib.metadata.requires("mocapella") or []:
        name = re.match(r"[A-Za-z0-9._-]+", need)
        extra = re.search(r"extra == ['\"]([^'\"]+)", need)
        if name is not None:
            needs.setdefault(extra[1] if extra else "", []).append(name[0])
    return needs


def _core_packages() -> Iterator[Finding]:
    versions = {package: _version(package) for package in _required()[""]}
    missing = [package for package, version in versions.items() if version is None]
    if missing:
        yield Finding("core packages", "problem", f"missing: {', '.join(missing)}", "uv sync")
        return
    yield Finding("core packages", "ok", ", ".join(f"{package} {version}" for package, version in versions.items()))


def _extras() -> Iterator[Finding]:
    for extra, packages in _required().items():
        if not extra:
            continue
        missing = [package for package in packages if _version(package) is None]
        if missing:
            advice = f"only if you need it: uv sync --extra {extra} (elsewhere: install 'mocapella[{extra}]')"
            yield Finding(f"extra {extra}", "note", f"not installed: {', '.join(missing)}", advice)
        else:
            yield Finding(f"extra {extra}", "ok", ", ".join(f"{name} {_version(name)}" for name in packages))


def _source_looks() -> Iterator[Finding]:
    """Yield the findings of all sources about their devices."""
    from mocapella.sources.source import SOURCES

    looks = {source.looks: source.name for source in SOURCES.values() if source.looks}  # some share one
    for reference, name in looks.items():
        try:
            yield from _looked(reference)
        except PluginError as error:
            yield Finding(f"source {name}", "note", str(error), "tell the authors of its package")


def keypoint_detectors() -> Iterator[Finding]:
    """Yield for each detector of people's keypoints whether it can be used."""
    from mocapella.detectors.keypoint_detector import KEYPOINT_DETECTORS

    for name, detector in KEYPOINT_DETECTORS.items():
        problem, _, advice = detector.missing().partition(": ")
        if problem:
            yield Finding(f"keypoint detector {name}", "note", problem, f"only for webcams and films: {advice}")
        else:
            needs = "; it needs --model FILE" if detector.model == "required" else ""
            yield Finding(f"keypoint detector {name}", "ok", f"can be used{needs}")


def _looked(reference: str) -> list[Finding]:
    from mocapella.registry import load

    try:
        return list(load(reference)())
    except Exception as error:  # a stranger's function may raise anything
        raise PluginError(f"could not look ({type(error).__name__}: {error})") from error


def _port(what: str, port: int, option: str) -> Finding:
    from mocapella.live.launch import check_port_free

    try:
        check_port_free("127.0.0.1", port, option)
    except BusError as error:
        found = "in use" if isinstance(error, AddressInUseError) else "cannot be listened at"
        return Finding(f"{what} {port}", "note", found, str(error))
    return Finding(f"{what} {port}", "ok", "free")


def _disk(takes: Path) -> Finding:
    from mocapella.recording.disk import GIB

    folder = takes.absolute()
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    found = f"{free / GIB:.1f} GiB free at {folder}"
    if free < 2 * GIB:
        advice = (
            "a recording leaves 1 GiB free (serve --set reserve_gib); make room, or name another folder with --takes"
        )
        return Finding("disk for takes", "problem", found, advice)
    return Finding("disk for takes", "ok", found)


def _browser() -> Finding:
    import webbrowser

    installed = next((path for name in _BROWSERS if (path := shutil.which(name)) is not None), None)
    try:
        opener = webbrowser.get()
    except webbrowser.Error:
        advice = "open the URL that demo and serve print, in a browser of this machine"
        if installed is None:
            return Finding("browser", "note", "none found", advice)
        no_screen = sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
        why = "no screen (DISPLAY) to open it on" if no_screen else "Python does not know how to open it"
        return Finding("browser", "note", f"{installed}; {why}", advice)
    return Finding("browser", "ok", installed or str(getattr(opener, "name", "the system's")))


def _clock() -> Finding:
    resolution = time.get_clock_info("monotonic").resolution
    if resolution > 1e-3:
        return Finding("monotonic clock", "note", f"{resolution * 1e3:.1f} ms", "latencies will be no finer than this")
    return Finding("monotonic clock", "ok", f"{resolution * 1e9:.0f} ns")
