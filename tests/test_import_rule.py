"""Who may import whom, as data; and every line of it is shown to bite."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.syntax import nodes_of

SOURCE = Path(__file__).resolve().parent.parent / "src" / "mocapella"

BASE = {"errors", "decoding", "conventions", "settings", "compiled", "kernel_calls", "steps", "registry"}
MODEL = BASE | {"geometry", "model"}
STAGES = {"sensing", "calibration", "association", "fusion", "smoothing", "kinematics"}
EDGES = {"sources", "wire", "recording", "exports", "streams"}
DETECTORS = MODEL | STAGES | {"detectors"}
TRACKER = MODEL | STAGES | {"tracker"}
LIVE = {"schema", "viewer", "supervision"}

MAY_IMPORT: dict[str, set[str]] = {
    "errors": set(),
    "kernel_dispatcher": set(),
    "kernel_cache": {"kernel_dispatcher"},
    "compiled": {"kernel_cache", "kernel_dispatcher"},
    "kernel_calls": {"compiled"},
    "conventions": set(),
    "decoding": {"errors"},
    "settings": {"errors", "decoding", "conventions"},
    "registry": {"errors"},
    "supervision": {"errors", "model"},
    "steps": set(),
    "geometry": BASE,
    "model": MODEL,
    "schema": MODEL,
    **dict.fromkeys(STAGES, MODEL),
    "detectors": DETECTORS,
    "tracker": TRACKER,
    "sources": MODEL | {"schema", "sensing", "supervision"},
    "comparison": MODEL,
    **{edge: MODEL | {"schema", "supervision"} for edge in EDGES - {"sources", "exports"}},
    "exports": MODEL | {"schema", "supervision", "comparison"},
    "viewer": MODEL,
    "evaluation": TRACKER | DETECTORS | {"recording", "sources", "comparison"},
    "studies": TRACKER | DETECTORS | {"recording", "schema", "sources", "exports", "evaluation", "comparison"},
    "live": TRACKER | DETECTORS | EDGES | LIVE | {"studies"},
    "cli": TRACKER
    | DETECTORS
    | EDGES
    | {"schema", "viewer", "studies", "evaluation", "live", "library", "supervision", "comparison"},
    "library": TRACKER | EDGES | {"schema", "supervision", "live", "comparison"},
    "testing": TRACKER | {"schema", "sources", "wire"},
}
"""Which rooms a room may import, beside itself; none may import `testing`. `docs/decisions/0001-rooms.md` says why."""

PURE = {"geometry", "model", *STAGES, "detectors", "tracker", "evaluation", "comparison"}
IMPURE_MODULES = {"asyncio", "threading", "socket", "time", "multiprocessing", "subprocess"}
DECODES_IMAGES = {"sensing", "sources"}


def imported(source: str) -> Iterator[str]:
    """The dotted names of all modules that a module imports, wherever in it."""
    for node in nodes_of(source):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                yield "." * node.level + (node.module or "")
            elif node.module == "mocapella":
                yield from (f"mocapella.{alias.name}" for alias in node.names)
            elif node.module:
                yield node.module


def violations(room: str, source: str) -> list[str]:
    """What a module of that room imports and may not."""
    found = []
    for name in imported(source):
        top, _, rest = name.partition(".")
        other = rest.partition(".")[0]
        if not top:
            found.append(f"{room} imports {name} relatively")
        elif top == "mocapella" and other in MAY_IMPORT and other != room and other not in MAY_IMPORT[room]:
            found.append(f"{room} imports {other}")
        elif room in PURE and top in IMPURE_MODULES:
            found.append(f"{room} imports {top}")
        elif top == "cv2" and room not in DECODES_IMAGES:
            found.append(f"{room} imports cv2")
    return found


def modules() -> list[Path]:
    return [path for path in sorted(SOURCE.rglob("*.py")) if path.parent != SOURCE or path.stem in MAY_IMPORT]


def room_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def test_a_module_imports_only_what_its_room_may() -> None:
    found = {
        str(path.relative_to(SOURCE)): violations(room_of(path), path.read_text(encoding="utf-8")) for path in modules()
    }
    assert len(found) > 500
    assert {name: imports for name, imports in found.items() if imports} == {}


def test_every_room_is_in_the_rule() -> None:
    rooms = {room_of(path) for path in SOURCE.rglob("*.py")} - {"__init__", "__main__"}
    assert rooms <= set(MAY_IMPORT)


@pytest.mark.parametrize("room", sorted(MAY_IMPORT))
def test_the_rule_bites_for_every_forbidden_room(room: str) -> None:
    for other in set(MAY_IMPORT) - MAY_IMPORT[room] - {room}:
        for planted in (
            f"import mocapella.{other}",
            f"from mocapella.{other} import x",
            f"from mocapella import {other}",
        ):
            assert violations(room, f"def f():\n    {planted}\n") == [f"{room} imports {other}"]


def test_the_program_does_not_import_what_is_for_tests() -> None:
    assert [room for room, others in MAY_IMPORT.items() if "testing" in others] == []
    assert violations("cli", "from mocapella.testing import FakeServer") == ["cli imports testing"]


@pytest.mark.parametrize("room", sorted(MAY_IMPORT))
def test_the_rule_lets_the_allowed_through(room: str) -> None:
    for other in MAY_IMPORT[room] | {room}:
        assert violations(room, f"from mocapella.{other} import x") == []


@pytest.mark.parametrize("room", sorted(PURE))
def test_the_rule_bites_for_clocks_threads_and_sockets(room: str) -> None:
    for module in IMPURE_MODULES:
        assert violations(room, f"import {module}") == [f"{room} imports {module}"]


def test_the_rule_bites_for_images_and_relative_imports() -> None:
    assert violations("viewer", "import cv2") == ["viewer imports cv2"]
    assert violations("detectors", "import cv2") == ["detectors imports cv2"]
    assert violations("sensing", "import cv2") == []
    assert violations("live", "from . import server") == ["live imports . relatively"]
