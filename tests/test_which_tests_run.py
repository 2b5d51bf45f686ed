"""Which tests a run leaves out, and which may run more than once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

PLACES = (
    "live/test_server.py::test_a",
    "viewer/test_viewer.py::test_b",
    "test_readme.py::test_c",
    "fusion/test_d.py::test_d",
)
SLOW = "evaluation/test_e.py::test_e"


class Item:
    """A test of which only its name and marks are known."""

    def __init__(self, nodeid: str, *marks: str) -> None:
        self.nodeid, self.marks = nodeid, list(marks)

    def add_marker(self, mark: Any) -> None:
        self.marks.append(mark if isinstance(mark, str) else mark.name)

    def get_closest_marker(self, name: str) -> str | None:
        return name if name in self.marks else None


def run(request: pytest.FixtureRequest, *arguments: str, marks: str = "", words: str = "") -> tuple[list[Item], int]:
    """The tests that a run with these arguments would have, and how many it would leave out."""
    (conftest,) = (one for one in request.config.pluginmanager.get_plugins() if hasattr(one, "PROGRAMS"))
    left_out: list[Item] = []

    def deselected(items: list[Item]) -> None:
        left_out.extend(items)

    config = SimpleNamespace(
        args=list(arguments),
        option=SimpleNamespace(markexpr=marks, keyword=words),
        hook=SimpleNamespace(pytest_deselected=deselected),
    )
    items = [*(Item(f"tests/{place}") for place in PLACES), Item(f"tests/{SLOW}", "slow")]
    conftest.pytest_collection_modifyitems(config, items)
    assert len(items) + len(left_out) == len(PLACES) + 1
    return items, len(left_out)


def test_only_what_keeps_real_time_or_starts_programs_is_run_again(request: pytest.FixtureRequest) -> None:
    items, _ = run(request, "tests")
    names = [f"tests/{place}" for place in PLACES]
    assert {item.nodeid: item.marks for item in items} == dict(
        zip(names, (["real_time", "flaky"], ["real_time", "flaky"], ["flaky"], []), strict=True)
    )


@pytest.mark.parametrize("arguments", [["tests"], ["tests/evaluation"], []])
def test_a_run_of_all_or_a_folder_leaves_slow_tests_out(request: pytest.FixtureRequest, arguments: Any) -> None:
    items, left_out = run(request, *arguments)
    assert left_out == 1
    assert not any("slow" in item.marks for item in items)


@pytest.mark.parametrize(
    ("arguments", "chosen"),
    [
        (["tests/evaluation/test_e.py"], {}),
        ([f"tests/{SLOW}"], {}),
        (["tests"], {"marks": "slow"}),
        (["tests"], {"marks": "not real_time"}),
        (["tests"], {"words": "e"}),
    ],
)
def test_who_names_files_tests_words_or_marks_gets_them(
    request: pytest.FixtureRequest, arguments: Any, chosen: dict[str, str]
) -> None:
    items, left_out = run(request, *arguments, **chosen)
    assert left_out == 0
    assert sum("slow" in item.marks for item in items) == 1
