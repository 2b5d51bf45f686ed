"""A public class has a name of its own, so that an import, a report or an error names one class; and the rule bites."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

from support.syntax import parsed

SOURCE = Path(__file__).resolve().parent.parent / "src" / "mocapella"


def classes(statements: Iterable[ast.stmt]) -> Iterator[str]:
    """Names of the classes that a module defines at its top level, also under an `if`, `try` or `with`."""
    for node in statements:
        if isinstance(node, ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.If | ast.Try | ast.With):
            blocks = [node.body, getattr(node, "orelse", []), getattr(node, "finalbody", [])]
            blocks += [handler.body for handler in getattr(node, "handlers", [])]
            for block in blocks:
                yield from classes(block)


def shared_names(source: Path) -> dict[str, list[str]]:
    """Public class names that several modules below a folder define, each with these modules' paths."""
    defined: defaultdict[str, list[str]] = defaultdict(list)
    for path in sorted(source.rglob("*.py")):
        module = parsed(path.read_text(encoding="utf-8"))
        for name in sorted({name for name in classes(module.body) if not name.startswith("_")}):
            defined[name].append(path.relative_to(source).as_posix())
    return {name: paths for name, paths in sorted(defined.items()) if len(paths) > 1}


def planted(source: Path, modules: dict[str, str]) -> Path:
    """Write modules, by path, below a folder."""
    for path, text in modules.items():
        (source / path).parent.mkdir(parents=True, exist_ok=True)
        (source / path).write_text(text, encoding="utf-8")
    return source


def test_a_public_class_name_is_of_one_module() -> None:
    assert shared_names(SOURCE) == {}


def test_the_modules_are_found() -> None:
    found = {path.relative_to(SOURCE).parts[0] for path in SOURCE.rglob("*.py")}
    assert {"errors.py", "model", "sources", "viewer"} <= found
    assert "BodyFrame" in classes(ast.parse((SOURCE / "model" / "observations.py").read_text(encoding="utf-8")).body)


def test_the_rule_bites(tmp_path: Path) -> None:
    twice = planted(
        tmp_path,
        {
            "model/scene.py": "class Scene:\n    pass\n",
            "sources/simulate/rendered.py": "class Scene:\n    pass\n\n\nclass Sensor:\n    pass\n",
            "viewer/stages.py": "from mocapella.model.scene import Scene\n",
        },
    )
    assert shared_names(twice) == {"Scene": ["model/scene.py", "sources/simulate/rendered.py"]}


def test_the_rule_bites_for_a_class_under_a_condition(tmp_path: Path) -> None:
    under = (
        "if True:\n    {}\n",
        "if True:\n    pass\nelse:\n    {}\n",
        "try:\n    pass\nexcept ImportError:\n    {}\n",
        "try:\n    pass\nfinally:\n    {}\n",
    )
    for text in under:
        twice = planted(tmp_path, {"a.py": "class Scene: ...\n", "b.py": text.format("class Scene: ...")})
        assert shared_names(twice) == {"Scene": ["a.py", "b.py"]}


def test_private_and_nested_classes_and_other_definitions_may_share_a_name(tmp_path: Path) -> None:
    module = "class _State: ...\n\n\nclass {}:\n    class Row: ...\n\n\ndef make() -> None:\n    class Local: ...\n"
    assert shared_names(planted(tmp_path, {"a.py": module.format("First"), "b.py": module.format("Second")})) == {}


def test_two_forms_of_a_class_in_one_module_are_one_name(tmp_path: Path) -> None:
    forms = "try:\n    class Scene: ...\nexcept ImportError:\n    class Scene: ...\n"
    assert shared_names(planted(tmp_path, {"a.py": forms})) == {}
