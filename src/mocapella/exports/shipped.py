"""The exports that ship with Mocapella."""

from __future__ import annotations

from typing import Final

from mocapella.exports.export import Export

CSV: Final = Export(
    interface=1,
    name="csv",
    summary="The study log: the thesis' 87 columns, a row for each sensor's view of each person.",
    parts=("people",),
    command="mocapella.cli.export:csv",
)
ARMS: Final = Export(
    interface=1,
    name="arms",
    summary="Arms in the world: a row for each joint of each arm, with its state.",
    parts=("arms",),
    command="mocapella.cli.export:arms",
)
JSON: Final = Export(
    interface=1,
    name="json",
    summary="Everything: a line of JSON for each result, with all fields of its parts.",
    parts=None,
    command="mocapella.cli.export:json_lines",
)
