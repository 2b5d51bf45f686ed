"""Nothing between the door and the view asks of which kind a frame, part, tracker or method is: it asks a descriptor.

`docs/decisions/0016-descriptors.md` says why. A tracker may name the frame types that its own descriptor takes.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest
from support.syntax import nodes_of, parsed

from mocapella.detectors import DETECTORS
from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.part_types import PART_TYPES
from mocapella.tracker import METHODS

SOURCE = Path(__file__).resolve().parent.parent / "src" / "mocapella"
ROOMS = ("live", "viewer", "tracker", "detectors", "cli")
FRAMES = frozenset(one.type.__name__ for one in FRAME_TYPES.values())
PARTS = frozenset(one.type.__name__ for one in PART_TYPES.values())
NAMES = frozenset((*METHODS, *DETECTORS, *FRAME_TYPES))
"""Of methods, detectors and frame types."""

ALLOWED: dict[str, str] = {}
"""By ``path: what``, the reason."""


def trackers() -> frozenset[str]:
    """Names of the classes of the room `tracker` that are trackers: they have ``update`` and ``snapshot``."""
    found = set()
    for path in (SOURCE / "tracker").rglob("*.py"):
        for node in parsed(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                methods = {one.name for one in node.body if isinstance(one, ast.FunctionDef)}
                found |= {node.name} if {"update", "snapshot", "restore"} <= methods else set()
    return frozenset({*found, "KeepsLayout"})


KINDS = FRAMES | PARTS | trackers()


def named(node: ast.AST | None) -> Iterator[str]:
    """Last parts of the names in an expression."""
    for one in ast.walk(node) if node is not None else ():
        if isinstance(one, ast.Name):
            yield one.id
        elif isinstance(one, ast.Attribute):
            yield one.attr


def strings(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Constant strings that are compared with: by themselves, or in a tuple, list or set."""
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
        elif isinstance(node, ast.Tuple | ast.List | ast.Set):
            yield from strings(node.elts)
        elif isinstance(node, ast.Call) and set(named(node.func)) & {"frozenset", "set", "tuple"}:
            yield from strings(node.args)
        elif isinstance(node, ast.MatchValue):
            yield from strings([node.value])
        elif isinstance(node, ast.MatchOr):
            yield from strings(node.patterns)


def is_type_of(node: ast.AST) -> bool:
    """Whether it is ``type(x)`` or ``x.__class__``."""
    return (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "type") or (
        isinstance(node, ast.Attribute) and node.attr == "__class__"
    )


def asked(source: str, may_name: Iterable[str] = ()) -> list[str]:
    """Where a module asks of which kind something is; ``may_name`` are classes that it may ask for."""
    kinds = KINDS - set(may_name)
    found = []
    for node in nodes_of(source):
        classes: set[str] = set()
        words: set[str] = set()
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id in ("isinstance", "issubclass"):
                classes = set(named(node.args[1]))
        elif isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            words = set(strings(sides))
            if any(map(is_type_of, sides)):
                classes = {name for side in sides for name in named(side)}
        elif isinstance(node, ast.MatchClass):
            classes = set(named(node.cls))
        elif isinstance(node, ast.match_case):
            words = set(strings([node.pattern]))
        found += [f"line {_line(node)} asks for {name}" for name in sorted(classes & kinds)]
        found += [f"line {_line(node)} compares with {word!r}" for word in sorted(words & NAMES)]
    return found


def _line(node: ast.AST) -> int:
    return int(getattr(node, "lineno", 0) or getattr(getattr(node, "pattern", None), "lineno", 0))


def without_lines(path: str, problems: Iterable[str]) -> set[str]:
    """Problems by path and what, so that a list of them outlives other changes of the module."""
    return {f"{path}: {problem.partition(' ')[2].partition(' ')[2]}" for problem in problems}


@cache
def taken_by_module() -> dict[str, frozenset[str]]:
    """For each module of the room `tracker`, the frame classes that a method takes whose tracker imports it."""
    taken: dict[str, set[str]] = {}
    for method in METHODS.values():
        frames = {one.__name__ for one in method.frame_types}
        for module in reached(method.make.__module__):
            taken.setdefault(module, set()).update(frames)
    return {module: frozenset(frames) for module, frames in taken.items()}


def reached(module: str) -> set[str]:
    """A module of the room `tracker`, and those of the room that it imports, and so on."""
    seen, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        path = SOURCE.parent / f"{name.replace('.', '/')}.py"
        if name in seen or not name.startswith("mocapella.tracker.") or not path.exists():
            continue
        seen.add(name)
        for node in nodes_of(path.read_text(encoding="utf-8")):
            if isinstance(node, ast.ImportFrom) and node.module:
                waiting += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            elif isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names]
    return seen


def not_its_own(source: str, taken: Iterable[str]) -> list[str]:
    """Frame classes that a tracker's module mentions and no method takes that uses it."""
    return sorted(set(named(parsed(source))) & FRAMES - set(taken))


def modules(*rooms: str) -> list[Path]:
    return [path for room in rooms for path in sorted((SOURCE / room).rglob("*.py"))]


def name_of(path: Path) -> str:
    return ".".join(("mocapella", *path.relative_to(SOURCE).with_suffix("").parts))


def test_no_module_asks_of_which_kind_something_is() -> None:
    found = set()
    for path in modules(*ROOMS):
        place = path.relative_to(SOURCE).as_posix()
        own = taken_by_module().get(name_of(path), frozenset()) if place.startswith("tracker/") else frozenset()
        found |= without_lines(place, asked(path.read_text(encoding="utf-8"), own))
    assert found - ALLOWED.keys() == set()


def test_a_tracker_mentions_only_frames_that_its_method_takes() -> None:
    found = {
        name_of(path): not_its_own(path.read_text(encoding="utf-8"), taken_by_module().get(name_of(path), ()))
        for path in modules("tracker")
    }
    assert {module: mentioned for module, mentioned in found.items() if mentioned} == {}


def test_every_exception_is_still_needed() -> None:
    found = set()
    for path in modules(*ROOMS):
        found |= without_lines(path.relative_to(SOURCE).as_posix(), asked(path.read_text(encoding="utf-8")))
    assert ALLOWED.keys() - found == set()


@pytest.mark.parametrize(
    "planted",
    [
        "isinstance(frame, BodyFrame)",
        "isinstance(frame, observations.BodyFrame)",
        "isinstance(frame, (int, MarkerFrame))",
        "isinstance(part, TrackedArm | TrackedHand)",
        "issubclass(type(frame), ArmFrame)",
        "type(frame) is PoseFrame",
        "type(frame) in (PoseFrame, ArmFrame)",
        "frame.__class__ == DepthFrame",
        "isinstance(self._tracker, DefaultTracker)",
        "method == 'hands'",
        "setup.method != 'stand-still'",
        "method in ('arms', 'hands')",
        "method in {'arms', 'hands'}",
        "kind in frozenset(('markers',))",
        "'line-skeleton' == detector",
    ],
)
def test_the_rule_bites(planted: str) -> None:
    assert asked(f"def f(x):\n    return 1 if {planted} else 2\n") != []


@pytest.mark.parametrize("pattern", ["BodyFrame()", "scene.Person(id=1)", "'hands'", "'hands' | 'other'"])
def test_the_rule_bites_for_a_match(pattern: str) -> None:
    assert asked(f"match x:\n    case {pattern}:\n        pass\n") != []


@pytest.mark.parametrize(
    "fine",
    [
        "isinstance(error, OSError)",
        "isinstance(frame, UnknownFrame)",
        "name == 'left'",
        "method == other",
        "METHODS['hands']",
        "{'hands': 1}",
        "kind.counted is None",
    ],
)
def test_the_rule_lets_other_questions_through(fine: str) -> None:
    assert asked(f"x = {fine}\n") == []


def test_the_rule_knows_the_trackers() -> None:
    assert {"DefaultTracker", "StandStillTracker", "HandsTracker", "ArmsTracker"} <= trackers()


def test_a_tracker_may_ask_for_frames_of_its_own_method_only() -> None:
    assert asked("isinstance(frame, MarkerFrame)", ["MarkerFrame"]) == []
    assert asked("isinstance(frame, MarkerFrame)", ["ArmFrame"]) != []
    assert not_its_own("from a import MarkerFrame\nx: MarkerFrame", ["MarkerFrame"]) == []
    assert not_its_own("from a import MarkerFrame\nx: MarkerFrame", ["ArmFrame"]) == ["MarkerFrame"]
    taken = taken_by_module()
    assert taken["mocapella.tracker.stand_still"] == {"BodyFrame"}
    assert "ArmFrame" in taken["mocapella.tracker.people_arms"]
