"""Which exports a method's parts are offered, and what each leaves out."""

from __future__ import annotations

from mocapella.exports.export import exports_of
from mocapella.model.part_types import PART_TYPES


def test_exports_of_parts_are_those_that_have_one_of_them_and_those_of_everything() -> None:
    assert set(exports_of(PART_TYPES)) >= {"csv", "arms", "json"}
    assert {"arms", "json"} <= set(exports_of(["arms", "points"]))
    assert "csv" not in exports_of(["arms", "points"])
    assert "json" in exports_of([])
    assert not {"csv", "arms"} & set(exports_of([]))
