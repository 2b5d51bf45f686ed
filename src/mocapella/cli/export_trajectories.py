"""The commands of ``mocapella export`` that write trajectories: tables, arrays and marker files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli import INTERRUPTED
from mocapella.cli.common import JsonOut, say, working, write_json
from mocapella.errors import SettingsError, TakeExistsError, one_of

if TYPE_CHECKING:
    from mocapella.exports.export import Export
    from mocapella.model.trajectories import Trajectories

SPACES: Final = ("world", "opensim", "sensor:NAME")
_FORBIDDEN: Final = '/\\:*?"<>|'
"""Characters that some file system does not allow in the name of a file."""


@dataclass(frozen=True)
class _Wishes:
    """The options of an export."""

    people: tuple[str, ...]
    rate_hz: float | None
    space: str
    raw: bool
    force: bool


def export(
    context: typer.Context,
    takes: Annotated[
        list[Path], typer.Argument(metavar="TAKE...", help="Takes: files, or their names without .mcap.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="PATH", help="File or folder to write to. By default beside each take."),
    ] = None,
    people: Annotated[
        str | None,
        typer.Option("--people", metavar="NAME,NAME,…", help="Individuals to write, such as person_1; all by default."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate", metavar="HZ", help="Constant frame rate. By default the results' own times, or where a format "
            "has a constant rate, that of the fastest sensor.",
        ),
    ] = None,
    space: Annotated[
        str,
        typer.Option(
            "--space", metavar="SPACE", help="Coordinates: world, opensim (X forward, Y up) or sensor:NAME (its camera "
            "space).",
        ),
    ] = "world",
    raw: Annotated[
        bool, typer.Option("--raw/--fused", help="Each sensor's own skeletons, or the fused people.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
    json: JsonOut = None,
) -> None:  # fmt: skip
    """Positions are in metres in the world. Results without a known keypoint have no rows.

    Each kind of results (people, hands, arms, bodies, objects, points) has a file of its own if a take has several. A
    format for one individual has a file for each. An existing file is not replaced without --force. docs/export.md
    describes all formats.

    Example:  mocapella export trc walk-1 --people person_1
    """
    from mocapella.cli.recordings import find_recording, open_take
    from mocapella.exports.export import EXPORTS

    chosen = EXPORTS.find(str(context.info_name))
    wishes = _Wishes(tuple(name for name in (people or "").split(",") if name), rate, _space(space), raw, force)
    found = [find_recording(take) for take in takes]
    if out is not None and not out.is_dir() and len(found) > 1:
        raise SettingsError(f"--out {out}: there are {len(found)} takes; name a folder that exists")
    rows = []
    for path in found:
        with working(f"reading {path.name} …", status=INTERRUPTED):
            some = _trajectories(open_take(path), wishes)
        files = list(_planned(chosen, some, _base(path, out, chosen), wishes))
        for file, _ in files:
            if file.exists() and not force:
                raise TakeExistsError(f"{file} exists; add --force to replace it, or name another file with --out")
        written: list[dict[str, Any]] = []
        for file, one in files:
            with working(f"writing {file} …", status=INTERRUPTED):
                count, notes = _write(chosen, one, file, wishes)
            say(f"{count} frames of {', '.join(one.individuals)} in {file}")
            for note in notes:
                say(f"{file}: {note}")
            row = {"path": str(file), "frames": count, "individuals": list(one.individuals)}
            written.append({**row, "notes": notes} if notes else row)
        problems = list(open_take(path).problems)
        for problem in problems:
            say(f"{path.name}: {problem}")
        rows.append({"take": str(path), "files": written, "take_problems": problems})
    write_json(json, rows)


def _space(text: str) -> str:
    if text not in SPACES[:2] and not text.removeprefix("sensor:") != text.strip():
        raise SettingsError(f"--space {text!r}: known: {one_of(text, SPACES)}")
    return text


def _trajectories(take: Any, wishes: _Wishes) -> dict[str, Trajectories]:
    """Return the trajectories to write, by kind.

    Raises:
        SettingsError: the take has none of them.
    """
    from mocapella.model.trajectories import PARTS, VIEWS
    from mocapella.recording.take_trajectories import take_trajectories

    sensor = wishes.space.removeprefix("sensor:") if wishes.space.startswith("sensor:") else None
    found = take_trajectories(take, (VIEWS,) if wishes.raw else tuple(PARTS), sensor=sensor)
    if not found:
        what = "results with a sensor's own skeletons" if wishes.raw else "results"
        raise SettingsError(f"{take.path.name} has no {what}; `mocapella take info {take.path.name}` shows its content")
    known = [name for some in found.values() for name in some.individuals]
    for name in wishes.people:
        if name not in known:
            raise SettingsError(f"--people: {take.path.name} has no {name!r}; it has {one_of(name, known)}")
    if not wishes.people:
        return found
    chosen = {kind: [name for name in wishes.people if name in some.individuals] for kind, some in found.items()}
    return {kind: found[kind].of(names) for kind, names in chosen.items() if names}


def _base(take: Path, out: Path | None, export: Export) -> Path:
    """Return the path of the files without the ending."""
    if out is None:
        return take.with_suffix("")
    if out.is_dir():
        return out / take.stem
    return out.with_name(out.name.removesuffix(export.suffix))


def _planned(
    export: Export, found: dict[str, Trajectories], base: Path, wishes: _Wishes
) -> Iterator[tuple[Path, Trajectories]]:
    """Yield the files to write and the trajectories in each."""
    for kind, some in found.items():
        name = base.name if len(found) == 1 else f"{base.name}.{kind}"
        if not export.alone:
            yield base.with_name(name + export.suffix), some
            continue
        for one in some.individuals:
            own = name if len(some.individuals) == 1 else f"{name}.{_file_name(one)}"
            yield base.with_name(own + export.suffix), some.of([one])


def _file_name(individual: str) -> str:
    return "".join("-" if letter in _FORBIDDEN or not letter.isprintable() else letter for letter in individual)


def _write(export: Export, trajectories: Trajectories, file: Path, wishes: _Wishes) -> tuple[int, list[str]]:
    """Write a file; return its number of frames, and sentences for the user."""
    from mocapella.exports.new_file import new_file
    from mocapella.exports.trc_file import T_OPENSIM_WORLD
    from mocapella.model.resampling import resampled
    from mocapella.registry import load

    if export.constant_rate or wishes.rate_hz is not None:
        trajectories = resampled(trajectories, wishes.rate_hz)
    if wishes.space == "opensim":
        trajectories = trajectories.moved(T_OPENSIM_WORLD)
    write: Callable[[Trajectories, Path], list[str] | None] = load(export.write)
    with new_file(file, force=wishes.force) as part:
        notes = write(trajectories, part) or []
    return len(trajectories), notes
