"""Which tests may run more than once."""

from __future__ import annotations

from typing import Any

import pytest


class Item:
    """A test of which only its name and marks are known."""

    def __init__(self, nodeid: str) -> None:
        self.nodeid, self.marks = nodeid, list[str]()

    def add_marker(self, mark: Any) -> None:
        self.marks.append(mark if isinstance(mark, str) else mark.name)


def test_only_what_keeps_real_time_or_starts_programs_is_run_again(request: pytest.FixtureRequest) -> None:
    (conftest,) = (one for one in request.config.pluginmanager.get_plugins() if hasattr(one, "PROGRAMS"))
    places = (
        "live/test_server.py::test_a",
        "viewer/test_viewer.py::test_b",
        "test_readme.py::test_c",
        "fusion/test_d.py::test_d",
    )
    names = [f"tests/{place}" for place in places]
    items = [Item(name) for name in names]
    conftest.pytest_collection_modifyitems(items)
    assert {item.nodeid: item.marks for item in items} == dict(
        zip(names, (["real_time", "flaky"], ["real_time", "flaky"], ["flaky"], []), strict=True)
    )
