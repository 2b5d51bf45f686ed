"""Which exports a method's parts are offered, and what each leaves out."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mocapella.exports.export import EXPORTS, exports_of, left_out
from mocapella.model.part_types import PART_TYPES


def test_exports_of_parts_are_those_that_have_one_of_them_and_those_of_everything() -> None:
    assert set(exports_of(PART_TYPES)) >= {"csv", "arms", "json"}
    assert {"arms", "json"} <= set(exports_of(["arms", "points"]))
    assert "study-log" not in exports_of(["arms", "points"])
    assert "json" in exports_of([])
    assert not {"study-log", "csv", "arms"} & set(exports_of([]))


@given(st.dictionaries(st.sampled_from(sorted(PART_TYPES)), st.integers(1, 10**6)))
def test_an_export_leaves_out_the_parts_that_it_has_not_and_no_others(parts: dict[str, int]) -> None:
    for export in EXPORTS.values():
        missing = left_out(export, parts)
        if export.parts is None:
            assert missing == {}
            continue
        assert missing.items() <= parts.items()
        assert missing.keys().isdisjoint(export.parts)
        assert parts.keys() - missing.keys() <= set(export.parts)
