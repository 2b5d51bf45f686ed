"""The descriptor of a measure, which finds figures in a task of a study's recording, and the table of all measures."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from mocapella.registry import Table
from mocapella.studies.results import MeasuredFigure
from mocapella.studies.task_views import TaskViews

OBSTACLE: Final = ("obstacle",)
"""Tasks with an obstacle that hides a person."""
INTERACTIONS: Final = ("around-first", "around-second", "exchange")
"""Tasks where one person hides another."""


@dataclass(frozen=True)
class Measure:
    """Descriptor of a measure.

    Attributes:
        interface: version of the plug-in interface, see `mocapella.registry`.
        name: name of the measure in tables.
        summary: the measured quantities, in one line.
        quantities: the unit of each quantity by its name: `s`, `cm`, `%`, or empty for a count.
        find: function of a task that returns its figures; `mocapella.studies.task_views.TaskViews.figure` makes one.
        tasks: names of the tasks that it is meant for; None for all.
        hides: whether it needs the run with hidden joints, `mocapella.studies.task_views.TaskViews.hidden`.
    """

    interface: int
    name: str
    summary: str
    quantities: dict[str, str]
    find: Callable[[TaskViews], Iterable[MeasuredFigure]]
    tasks: tuple[str, ...] | None = None
    hides: bool = False

    def measures(self, task: str) -> bool:
        """Whether it is meant for a task."""
        return self.tasks is None or task in self.tasks


MEASURES: Final = Table("mocapella.measures", Measure, "measure")
"""All registered measures by name."""
