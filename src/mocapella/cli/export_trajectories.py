"""The commands of ``mocapella export`` that write trajectories: tables, arrays and marker files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from mocapella.cli import DAMAGED, INTERRUPTED
from mocapella.cli.common import JsonOut, People, individual_names, say, working, write_json
from mocapella.errors import MocapellaError, SettingsError, TakeExistsError, one_of, visible

if TYPE_CHECKING:
    from mocapella.exports.export import Export
    from mocapella.model.trajectories import Trajectories
    from mocapella.recording.take_reader import Take

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
    humanoid: str | None
    force: bool


def export(
    context: typer.Context,
    takes: Annotated[
        list[Path], typer.Argument(metavar="TAKE...", help="Takes: files, or their names without .mcap.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="File or folder to write to. By default beside each take."),
    ] = None,
    people: People = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate", metavar="HZ", help="Constant frame rate. By default the results' own times, or where a format "
            "has a constant rate, that of the fastest sensor.",
        ),
    ] = None,
    space: Annotated[
        str | None,
        typer.Option(
            "--space", metavar="NAME", help="Coordinates: world, opensim (X forward, Y up) or sensor:NAME (its camera "
            "space). By default opensim in mot, sto and opensim, and world in other formats.",
        ),
    ] = None,
    raw: Annotated[
        bool, typer.Option("--raw/--fused", help="Each sensor's own skeletons, or the fused people.")
    ] = False,
    humanoid: Annotated[
        str | None,
        typer.Option(
            "--humanoid", metavar="NAME", help="Bones of animated skeletons: vrm, unity, mixamo, kinect or smpl. By "
            "default vrm for glb and usd, the tracked joints for bvh.",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
    json: JsonOut = None,
) -> None:  # fmt: skip
    """Each kind of results (people, hands, arms, bodies, objects, points) has a file of its own if a take has several.

    A format for one individual has a file for each. An existing file is not replaced without --force. docs/export.md
    describes the formats, their units and axes.

    Example:  mocapella export trc walk-1 --people person_0
    """
    from mocapella.exports.export import EXPORTS
    from mocapella.live.recordings import find_recording

    chosen = EXPORTS.find(str(context.info_name))
    humanoid_of = _humanoid(humanoid, chosen)
    wishes = _Wishes(
        individual_names(people), rate, _space(chosen.space if space is None else space), raw, humanoid_of, force
    )
    found = [find_recording(take) for take in takes]
    _check_out(out, found)
    rows, failed, damaged = [], False, False
    for path in found:
        try:
            row = _export_take(chosen, path, out, wishes)
        except MocapellaError as error:
            if len(found) == 1:
                raise
            say(_about(path, str(error)))
            rows.append({"take": str(path), "files": [], "take_problems": [str(error)]})
            failed = True
            continue
        damaged |= row.pop("damaged")
        failed |= row.pop("failed")
        rows.append(row)
    write_json(json, rows)
    if failed or damaged:
        raise typer.Exit(1 if failed else DAMAGED)


def _export_take(chosen: Export, path: Path, out: Path | None, wishes: _Wishes) -> dict[str, Any]:
    """Write the files of one take; return its row of ``--json``, and whether it is damaged."""
    from mocapella.cli.recordings import open_take, tell_left_out
    from mocapella.model.names import plural

    with working(f"reading {path.name} …", status=INTERRUPTED):
        take = open_take(path)
        tell_left_out(chosen.name, path)
        some = _trajectories(take, chosen, wishes)
    files = list(_planned(chosen, some, _base(path, out, chosen)))
    for file, _ in files:
        if os.path.lexists(file) and not wishes.force:
            raise TakeExistsError(
                f"{visible(str(file))} exists; add --force to replace it, or name another file with --out"
            )
    if out is not None and not out.suffix:
        out.mkdir(exist_ok=True)
    written: list[dict[str, Any]] = []
    problems = list(take.problems)
    for file, one in files:
        try:
            with working(f"writing {visible(str(file))} …", status=INTERRUPTED):
                count, notes = _write(chosen, one, file, wishes)
        except SettingsError as error:
            if len(files) == 1:
                raise
            problems.append(str(error))  # the other individuals have their files
            continue
        say(f"{plural(count, 'frame', 'frames')} of {', '.join(one.individuals)} in {visible(str(file))}")
        for note in notes:
            say(f"{visible(str(file))}: {note}")
        row = {"path": str(file), "frames": count, "individuals": list(one.individuals)}
        written.append({**row, "notes": notes} if notes else row)
    for problem in problems:
        say(_about(path, problem))
    return {"take": str(path), "files": written, "take_problems": problems, "damaged": take.damaged,
            "failed": len(written) < len(files)}  # fmt: skip


def _about(path: Path, text: str) -> str:
    """Return a sentence that begins with the take's name, once."""
    named, _, rest = text.partition(": ")
    if Path(named).name == path.name:
        text = rest
    return text if text.startswith(f"{path.name} ") else f"{path.name}: {text}"


def _check_out(out: Path | None, takes: list[Path]) -> None:
    """Check ``--out`` before any work: several takes need a folder, and names that differ."""
    if out is None:
        return
    if out.name.startswith(".") and not out.is_dir():
        raise SettingsError(f"--out {visible(str(out))}: name a file or a folder")
    folder = out.is_dir() or not out.suffix
    if len(takes) > 1 and not folder:
        raise SettingsError(f"--out {visible(str(out))}: there are {len(takes)} takes; name a folder")
    if folder and not out.is_dir() and (out.exists() or not out.parent.is_dir()):
        raise SettingsError(f"--out {visible(str(out))}: no folder can be made there; name one in a folder that exists")
    stems = [take.stem.casefold() for take in takes]
    for take, stem in zip(takes, stems, strict=True):
        if stems.count(stem) > 1:
            raise SettingsError(
                f"--out {visible(str(out))}: two takes are called {take.stem}, and one file would replace the other"
            )


def _space(text: str) -> str:
    text = text.strip()
    sensor = text.startswith("sensor:") and text != "sensor:"
    if text not in SPACES[:2] and not sensor:
        raise SettingsError(f"--space {text!r}: known: {one_of(text, SPACES)}")
    return text


def _humanoid(name: str | None, export: Export) -> str | None:
    """Return the humanoid of ``--humanoid``, checked."""
    if name is None:
        return None
    from mocapella.exports.export import EXPORTS
    from mocapella.model.humanoid_bones import humanoid_names

    if not export.humanoids:
        able = ", ".join(each.name for each in EXPORTS.values() if each.humanoids)
        raise SettingsError(f"--humanoid: {export.name} has no bones; formats that have: {able}")
    humanoid_names(name)
    return name


def _trajectories(take: Take, export: Export, wishes: _Wishes) -> dict[str, Trajectories]:
    """Return the trajectories to write, by kind.

    Raises:
        SettingsError: the take has none of them.
    """
    from mocapella.model.trajectories import VIEWS
    from mocapella.recording.take_trajectories import take_trajectories

    sensor = wishes.space.removeprefix("sensor:") if wishes.space.startswith("sensor:") else None
    found = take_trajectories(take, (VIEWS,) if wishes.raw else export.parts or (), sensor=sensor)
    if not found:
        what = "results with a sensor's own skeletons" if wishes.raw else f"results for {export.name}"
        raise SettingsError(f"{take.path.name} has no {what}; `mocapella take info {take.path.name}` shows its content")
    if export.humanoids and "people" in found and not found.keys().isdisjoint({"hands", "arms"}):
        from mocapella.model.humanoid_hands import with_hands

        found["people"] = with_hands(found["people"], found)
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
    if out.is_dir() or not out.suffix:
        return out / take.stem
    endings = (export.suffix, Path(export.suffix).suffix)  # .wide.csv, .csv
    return out.with_name(next((out.name.removesuffix(one) for one in endings if out.name.endswith(one)), out.name))


def _planned(export: Export, found: dict[str, Trajectories], base: Path) -> Iterator[tuple[Path, Trajectories]]:
    """Yield the files to write and the trajectories in each; names that differ in case only are numbered."""
    from mocapella.model.names import distinct

    plan: list[tuple[str, Trajectories]] = []
    for kind, some in found.items():
        name = base.name if len(found) == 1 else f"{base.name}.{kind}"
        if not export.alone:
            plan.append((name, some))
            continue
        for one in some.individuals:
            plan.append((name if len(some.individuals) == 1 else f"{name}.{_file_name(one)}", some.of(one)))
    alike = distinct(name.casefold() for name, _ in plan)
    for own, (name, some) in zip(alike, plan, strict=True):
        yield base.with_name(name + own[len(name.casefold()) :] + export.suffix), some


def _file_name(individual: str) -> str:
    return "".join("-" if letter in _FORBIDDEN or not letter.isprintable() else letter for letter in individual)


def _write(export: Export, trajectories: Trajectories, file: Path, wishes: _Wishes) -> tuple[int, list[str]]:
    """Write a file; return its number of frames, and sentences for the user."""
    from mocapella.exports.new_file import new_file
    from mocapella.exports.run_labels import left_out
    from mocapella.exports.trc_file import T_OPENSIM_WORLD
    from mocapella.model.resampling import check_rate, resampled
    from mocapella.registry import load

    if wishes.rate_hz is not None:
        check_rate(trajectories, wishes.rate_hz)
    if export.constant_rate or wishes.rate_hz is not None:
        trajectories = resampled(trajectories, wishes.rate_hz)
    if wishes.space == "opensim":
        trajectories = trajectories.moved(T_OPENSIM_WORLD)
    write: Callable[..., list[str] | None] = load(export.write)
    options = {"humanoid": wishes.humanoid} if export.humanoids else {}
    with new_file(file, force=wishes.force) as part:
        notes = write(trajectories, part, **options) or []
    if not export.with_labels:
        notes = notes + left_out(trajectories)
    return len(trajectories), notes
