"""Print how well tracked people agree with the keypoints of each camera: `triangulate` and films share it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from mocapella.library.people_report import PeopleReport


def show_people(report: PeopleReport, out: Console) -> None:
    """Print a table of the people and one of the cameras."""
    people = _table("person", "frames", "measured", "inferred", "residual px")
    for name, one in report.people.items():
        people.add_row(
            name, f"{100 * one.share:.0f} %", f"{100 * one.measured:.0f} %", f"{100 * one.inferred:.0f} %",
            _px(one.residual_px),
        )  # fmt: skip
    out.print(people)
    cameras = _table("camera", "detections", "used", "keypoints", "rejected", "residual px")
    for name, camera in report.cameras.items():
        cameras.add_row(
            name, str(camera.detections), str(camera.used), str(camera.keypoints),
            f"{100 * camera.rejected_share:.1f} %", _px(camera.residual_px),
        )  # fmt: skip
    out.print(cameras)


def people_row(report: PeopleReport) -> dict[str, Any]:
    """Return the report as a JSON object; unknown residuals are null."""
    import msgspec

    def known(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: known(one) for name, one in value.items()}
        return None if isinstance(value, float) and not math.isfinite(value) else value

    row: dict[str, Any] = known(msgspec.to_builtins(report))
    return row


def _table(*columns: str) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    for number, words in enumerate(columns):
        table.add_column(words, justify="right" if number else "left")
    return table


def _px(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else ""
