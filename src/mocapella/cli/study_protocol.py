"""The commands of ``mocapella study`` for the protocol and the folder."""

from __future__ import annotations

from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer

from mocapella.cli import INTERRUPTED
from mocapella.cli.app import study_app
from mocapella.cli.common import JsonOut, console, say, working, write_json
from mocapella.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mocapella.studies.protocol import PlannedTask


def _day(text: str | None) -> str | None:
    """Check a date of the command line; return it."""
    if text is not None:
        try:
            date.fromisoformat(text)
        except ValueError:
            raise SettingsError(f"{text[:40]!r} is no date; write it as YEAR-MONTH-DAY, such as 2026-11-30") from None
    return text


StudyDir = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the study.")]
Code = Annotated[str, typer.Argument(metavar="CODE", help="The participant's code, such as P07; never a name.")]
Operator = Annotated[
    str,
    typer.Option(
        "--by",
        metavar="CODE",
        envvar="MOCAPELLA_OPERATOR",
        show_envvar=False,
        help="Your code for the manifest, such as OP1; without it, the variable MOCAPELLA_OPERATOR.",
    ),
]


@study_app.command()
def new(
    folder: StudyDir,
    by: Operator,
    protocol: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Protocol to copy: one that ships, or a TOML file.")
    ] = "kinectmultitrack",
    json: JsonOut = None,
) -> None:
    """Make the folder of a new study, with a copy of its protocol.

    The founding study's protocol, kinectmultitrack, ships. docs/studies-protocol.md describes the file.

    Example:  mocapella study new my-study --by OP1
    """
    from mocapella.studies.protocol import load_protocol, protocol_bytes
    from mocapella.studies.study_folder import new_study

    load_protocol(protocol)  # names the file in its errors
    study = new_study(folder, protocol_bytes(protocol), by=by, at=datetime.now(UTC))
    say(f"{folder}: {study.protocol.title}; edit {folder / 'protocol.toml'} before the first participant comes")
    write_json(json, {"path": str(folder), "title": study.protocol.title, "participants": list(study.protocol.codes)})


@study_app.command()
def check(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A protocol (TOML), or the name of one that ships.")],
    json: JsonOut = None,
) -> None:
    """Check a protocol, and print the plan of its first participant with the least times.

    Example:  mocapella study check reaching.toml
    """
    from mocapella.studies.protocol import load_protocol, plan

    protocol = load_protocol(file)
    codes = protocol.codes
    say(f"{protocol.title}: {len(codes)} participants, {codes[0]} to {codes[-1]}")
    say(f"tasks: {protocol.task_order}; placements: {protocol.placement_order}; seed {protocol.seed}")
    planned = plan(protocol, codes[0])
    _print_plan(codes[0], planned)
    write_json(json, {"participants": list(codes), "plan": _rows(planned)})


@study_app.command()
def tasks(
    study: Annotated[Path, typer.Argument(metavar="DIR|FILE", help="Folder of the study, or a protocol (TOML).")],
    code: Code,
    json: JsonOut = None,
) -> None:
    """Print a participant's tasks in their order.

    If the participant's session has begun, the session's own plan is printed, not the protocol's.

    Example:  mocapella study tasks my-study P07
    """
    from mocapella.studies.protocol import load_protocol, plan
    from mocapella.studies.state_file import reopen_session
    from mocapella.studies.study_folder import SESSION, open_study

    if not study.is_dir():
        planned = plan(load_protocol(study), code)
    else:
        opened = open_study(study)
        session = opened.participant(code) / SESSION
        planned = plan(opened.protocol, code)
        if session.exists():
            reopened = reopen_session(session, opened.protocol)
            planned = reopened.session.state.plan
            if reopened.edited:
                say(reopened.edited)
    _print_plan(code, planned)
    write_json(json, {"participant": code, "plan": _rows(planned)})


@study_app.command()
def verify(
    folder: StudyDir,
    add: Annotated[
        str | None,
        typer.Option(
            "--add",
            metavar="CODE",
            help="Add new files to the manifest, and sessions and a protocol that changed; CODE is yours.",
        ),
    ] = None,
    json: JsonOut = None,
) -> None:
    """Compare every file of a study with its manifest: missing, changed and unknown files.

    A session that has not ended is in progress: its file may change.

    Exit status: 1 if anything is.

    Example:  mocapella study verify my-study
    """
    from mocapella.studies.study_folder import add_files, may_change, open_study, verify_study

    study = open_study(folder)
    with working(f"reading {folder} …", status=INTERRUPTED):
        found = verify_study(folder)
        if add is not None and not found.purging:
            new = [*found.unknown, *filter(may_change, found.changed), *found.ongoing]
            files = [folder / name for name in new if not (folder / name).is_symlink()]
            say(f"{len(add_files(study, files, by=add, at=datetime.now(UTC)))} files added to the manifest")
            found = verify_study(folder)
    for what, names in (("missing", found.missing), ("changed", found.changed), ("not in the manifest", found.unknown)):
        for name in names:
            say(f"{what}: {name}")
    for name in found.ongoing:
        say(f"in progress: {name}")
    if found.purging:
        say("a purge was interrupted; call `mocapella study purge` again with the same code")
    say(f"{folder}: {found.files} files, {'all as in the manifest' if found.whole else 'not as in the manifest'}")
    write_json(json, {**msgspec.to_builtins(found), "whole": found.whole})
    if not found.whole:
        raise typer.Exit(1)


@study_app.command()
def consent(
    folder: StudyDir,
    code: Code,
    by: Operator,
    given: Annotated[
        str | None,
        typer.Option("--given", metavar="DATE", help="Day of the consent; today by default.", callback=_day),
    ] = None,
    json: JsonOut = None,
) -> None:
    """Note that a participant agreed to the protocol's text of consent, and until when the data may be kept.

    Example:  mocapella study consent my-study P07 --by OP1
    """
    from mocapella.studies.study_folder import give_consent, open_study

    day = date.fromisoformat(given) if given else datetime.now(UTC).astimezone().date()
    record = give_consent(open_study(folder), code, day, by=by, at=datetime.now(UTC))
    until = f"until {record.retain_until}" if record.retain_until else "without a limit"
    say(f"{code}: consent of {record.given}; the data may be kept {until}")
    write_json(json, msgspec.to_builtins(record))


@study_app.command()
def due(
    folder: StudyDir,
    on: Annotated[
        str | None, typer.Option("--on", metavar="DATE", help="Day to judge by; today by default.", callback=_day)
    ] = None,
    json: JsonOut = None,
) -> None:
    """List the participants whose retention has ended, and those who have files and no consent.

    Example:  mocapella study due my-study
    """
    from mocapella.studies.study_folder import due_participants, open_study, participants_without_consent

    study = open_study(folder)
    day = date.fromisoformat(on) if on else datetime.now(UTC).astimezone().date()
    ended, without = due_participants(study, day), participants_without_consent(study)
    for record in ended:
        say(f"{record.participant}: kept until {record.retain_until}; `mocapella study purge` removes the data")
    for code in without:
        say(f"{code}: no consent; `mocapella study consent` notes it")
    if not ended and not without:
        say("nobody")
    write_json(json, {"due": msgspec.to_builtins(ended), "without_consent": list(without)})


@study_app.command()
def purge(
    folder: StudyDir,
    code: Code,
    by: Operator,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for the code to be typed.")] = False,
    json: JsonOut = None,
) -> None:
    """Remove one participant from a study: takes, logs, events, consent, results and rows of the manifest.

    Afterwards all bytes of the folder are searched for the code and for the checksums of the removed files, in
    compressed files, too. An interrupted purge goes on when it is called again. Exit status: 1 if anything is left.

    Example:  mocapella study purge my-study P07 --by OP1
    """
    import secrets

    from mocapella.studies.purge import purge as remove
    from mocapella.studies.purge import purging_code
    from mocapella.studies.study_folder import open_study

    open_study(folder)
    if not yes and purging_code(folder) != code:
        _ask_for(code, folder)
    with working(f"removing {code} …", status=INTERRUPTED):
        report = remove(folder, code, by=by, at=datetime.now(UTC), salt=secrets.token_hex(16))
    found = report.search
    say(f"removed: {report.files} files of the participant ({report.size_bytes} bytes), {report.results} of results")
    say(f"searched: {found.files} files ({found.size_bytes} bytes)")
    for trace in found.traces:
        say(f"left: {trace.what} in {trace.file}, {trace.place}")
    for what in found.unsearched:
        say(f"not searched: {what}")
    for what in report.out_of_reach:
        say(f"out of reach: {what}")
    write_json(json, {**msgspec.to_builtins(report), "proven": report.proven})
    if not report.proven:
        raise typer.Exit(1)


@study_app.command()
def logs(folder: StudyDir, by: Operator, json: JsonOut = None) -> None:
    """Write the logs of all finished tasks that have none: the thesis' 87 columns, fused people, and events.

    They are cut out of the participants' takes, and added to the manifest with them. docs/studies-protocol.md describes
    them.

    Example:  mocapella study logs my-study --by OP1
    """
    from mocapella.studies.study_folder import PARTICIPANTS, SESSION, open_study
    from mocapella.studies.task_log import write_logs

    study = open_study(folder)
    result: dict[str, Any] = {}
    for session in sorted((folder / PARTICIPANTS).glob(f"*/{SESSION}")):
        code = session.parent.name
        with working(f"writing the logs of {code} …", status=INTERRUPTED):
            written = write_logs(study, code, by=by, at=datetime.now(UTC))
        fresh = [log for log in written if log.files and not log.empty]
        say(f"{code}: {len(fresh)} logs written, {sum(log.rows for log in fresh)} rows")
        for log in written:
            if log.empty:
                where = f"{log.run.task} ({log.run.placement}, repetition {log.run.repetition})"
                say(f"{code}: nobody was tracked in {where}; it has no log")
        result[code] = [{**msgspec.to_builtins(log.run), "files": [str(file) for file in log.files]} for log in fresh]
    if not result:
        say("no participant has a session")
    write_json(json, result)


def _ask_for(code: str, folder: Path) -> None:
    """Have the code typed, before anything is removed.

    Raises:
        SettingsError: another text is typed, or the input ends.
    """
    try:
        typed = typer.prompt(f"All data of {code} in {folder} will be removed. Type the code", err=True)
    except typer.Abort:
        typed = ""
    if typed.strip() != code:
        raise SettingsError(f"nothing was removed; type {code!r} when asked, or add --yes")


def _rows(planned: Sequence[PlannedTask]) -> list[dict[str, Any]]:
    """Return a plan's rows: each task with its least beginning and duration [s]."""
    rows, at_s = [], 0.0
    for one in planned:
        rows.append(
            {
                "placement": one.placement.name,
                "task": one.task.name,
                "scenario": one.task.scenario,
                "repetition": one.repetition,
                "steps": len(one.task.steps),
                "from_s": at_s,
                "at_least_s": one.task.timed_s,
            }
        )
        at_s += one.task.timed_s + one.task.pause_s
    return rows


def _print_plan(code: str, planned: Sequence[PlannedTask]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=f"{code}, least times", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for title in ("", "placement", "task", "scenario", "repetition", "steps", "from", "at least"):
        table.add_column(title, justify="left" if title in {"placement", "task"} else "right")
    for number, row in enumerate(_rows(planned), 1):
        minutes, seconds = divmod(round(row["from_s"]), 60)
        cells = [row[name] for name in ("placement", "task", "scenario", "repetition", "steps")]
        table.add_row(*map(str, (number, *cells, f"{minutes}:{seconds:02}", f"{row['at_least_s']:g} s")))
    console.print(table)
