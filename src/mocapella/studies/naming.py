"""Names of the numbers in a study's logs: its own tasks, placements and codes, by its protocol and its sessions.

A study log has numbers only. In a study's folder (`mocapella.studies.study_folder`) each participant's session has the
plan that was followed, also where the protocol was edited later; the protocol has the names for all other logs.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import msgspec

from mocapella.errors import MocapellaError
from mocapella.evaluation.study_pairs import PLACEMENT_NAMES, TASKS
from mocapella.model.session import PLACEMENTS
from mocapella.studies.participants import number_of
from mocapella.studies.protocol import Placement, PlannedTask, StudyProtocol, load_protocol
from mocapella.studies.results import StudyFinding, StudyOrder
from mocapella.studies.state_file import SavedSession, edits_of, load_session
from mocapella.studies.study_folder import LOGS, PARTICIPANTS, PROTOCOL, SESSION, read_manifest
from mocapella.studies.task_runs import empty_runs

NOT_SAID: Final = "not said"
"""Name of a placement that a recording does not state."""
_THESIS: Final = {number: PLACEMENT_NAMES[name] for name, number in PLACEMENTS.items()}
_LOG: Final = re.compile(r"^(\d+)-")


class RecordingNames(msgspec.Struct, frozen=True):
    """Names of the numbers in one recording; without one, a number has the thesis' name or is its own.

    Attributes:
        codes: the participant's code by ``Study_Id``.
        placements: by ``Kinect_Config``.
        tasks: by ``Scenario_Id``.
        method: tracking method whose views a study log has; empty for the thesis' own.
    """

    codes: dict[int, str] = {}
    placements: dict[int, str] = {}
    tasks: dict[int, str] = {}
    method: str = ""

    def code(self, number: int) -> str:
        """Return a participant's code."""
        return self.codes.get(number, str(number))

    def placement(self, number: int) -> str:
        """Return the name of a placement; `NOT_SAID` for a negative number."""
        return self.placements.get(number) or (NOT_SAID if number < 0 else _THESIS.get(number, f"placement-{number}"))

    def task(self, number: int) -> str:
        """Return the name of a task."""
        return self.tasks.get(number) or TASKS.get(number, f"scenario-{number}")


class StudyNames(msgspec.Struct, frozen=True):
    """Names of the numbers in all recordings of a study.

    Attributes:
        folder: the study's folder.
        general: the names in the present protocol.
        plans: the planned tasks of each session, by the participant's code.
        order: the order of tasks and placements in the protocol; tasks and placements of edited protocols follow.
        methods: tracking method of each log of a task, by its path in the folder, as the manifest has it.
        findings: sessions that cannot be read or whose protocol was edited, and tasks without a tracked person.
    """

    folder: Path
    general: RecordingNames
    plans: dict[str, tuple[PlannedTask, ...]]
    order: StudyOrder
    methods: dict[str, str] = {}
    findings: tuple[StudyFinding, ...] = ()

    def of(self, path: Path) -> RecordingNames:
        """Return the names in a recording: its own task's if it is the log of one, else its session's."""
        parts = path.absolute().relative_to(self.folder).parts if path.absolute().is_relative_to(self.folder) else ()
        plan = self.plans.get(parts[1]) if len(parts) > 2 and parts[0] == PARTICIPANTS else None
        if plan is None:
            return self.general
        number = _LOG.match(path.name)
        if number and parts[2] == LOGS and 1 <= int(number[1]) <= len(plan):
            plan = (plan[int(number[1]) - 1],)
        return msgspec.structs.replace(
            self.general,
            placements=_distinct((one.placement.number, shown(one.placement)) for one in plan),
            tasks=_distinct((one.task.scenario, one.task.name) for one in plan),
            method=self.methods.get("/".join(parts), ""),
        )


def shown(placement: Placement) -> str:
    """Return the name of a placement in tables: right and left are one, as in the thesis, if it is one of its own."""
    thesis = PLACEMENTS.get(placement.name) == placement.number
    return PLACEMENT_NAMES[placement.name] if thesis else placement.name


def names_of_study(folder: Path) -> StudyNames | None:
    """Return the names of the study that a folder is, or belongs to; None if there is no protocol in or above it."""
    absolute = folder.absolute()
    study = next((one for one in (absolute, *absolute.parents) if (one / PROTOCOL).is_file()), None)
    if study is None:
        return None
    try:
        protocol = load_protocol(study / PROTOCOL)
    except MocapellaError as error:
        finding = StudyFinding("", f"the protocol cannot be read: {error}", "tasks and placements have numbers")
        return StudyNames(study, RecordingNames(), {}, StudyOrder(), findings=(finding,))
    findings: list[StudyFinding] = []
    sessions = dict(_sessions(study, protocol, findings))
    plans = {code: session.state.plan for code, session in sessions.items()}
    planned = [one for plan in plans.values() for one in plan]
    placements = [*protocol.placements, *(one.placement for one in planned)]
    tasks = [*protocol.tasks, *(one.task for one in planned)]
    general = RecordingNames(
        {number_of(code): code for code in protocol.codes},
        _distinct((one.number, shown(one)) for one in protocol.placements),
        _distinct((one.scenario, one.name) for one in protocol.tasks),
    )
    order = StudyOrder(
        tuple(dict.fromkeys(one.name for one in tasks)), tuple(dict.fromkeys(shown(one) for one in placements))
    )
    return StudyNames(study, general, plans, order, _methods(study, findings), tuple(findings))


def _methods(study: Path, findings: list[StudyFinding]) -> dict[str, str]:
    """Return the method of each file of the manifest that was made by one method."""
    try:
        rows = read_manifest(study).files
    except MocapellaError as error:
        findings.append(StudyFinding("", f"the manifest cannot be read: {error}", "logs count as the thesis' method's"))
        return {}
    methods = {row.path: row.settings.get("methods") for row in rows}
    return {path: str(found[0]) for path, found in methods.items() if isinstance(found, list) and len(found) == 1}


def _sessions(study: Path, protocol: StudyProtocol, findings: list[StudyFinding]) -> Iterator[tuple[str, SavedSession]]:
    """Yield the sessions by code; add their faults to the findings."""
    for file in sorted((study / PARTICIPANTS).glob(f"*/{SESSION}")):
        code = file.parent.name
        try:
            session = load_session(file)
        except MocapellaError as error:
            findings.append(
                StudyFinding(
                    "", f"the session of {code} cannot be read: {error}", "the present protocol names its tasks"
                )
            )
            continue
        if edited := edits_of(session, protocol):
            what = f"participant {code}: {edited.partition(';')[0]}"
            findings.append(StudyFinding("", what, "the session's own plan names its tasks"))
        for run in empty_runs(session.events):
            what = (
                f"participant {code}: nobody was tracked in {run.task} ({run.placement}, repetition {run.repetition})"
            )
            findings.append(StudyFinding("", what, "this task is left out"))
        yield code, session


def _distinct(numbered: Iterable[tuple[int, str]]) -> dict[int, str]:
    """Return the name of each number; no name of a number that several names have."""
    found: dict[int, set[str]] = {}
    for number, name in numbered:
        found.setdefault(number, set()).add(name)
    return {number: names.pop() for number, names in found.items() if len(names) == 1}
