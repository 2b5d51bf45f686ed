"""The public names of ``import mocapella``, as httpx tests its own: listed, sorted, documented, and fast to import."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mocapella

LIBRARY = Path(__file__).resolve().parents[2] / "docs" / "library.md"
SLOW = ("numpy", "numba", "scipy", "zenoh", "google.protobuf", "typing")


def test_every_exported_name_is_there_and_has_a_docstring() -> None:
    for name in mocapella.__all__:
        value = getattr(mocapella, name)
        assert name == "__version__" or (value.__doc__ and value.__module__.startswith("mocapella.library"))
    assert set(mocapella.__all__) == {"__version__", *mocapella._HOMES}
    with pytest.raises(AttributeError, match="no attribute 'loud'"):
        mocapella.loud  # noqa: B018


def test_the_names_are_sorted_and_dir_agrees() -> None:
    assert mocapella.__all__ == sorted(mocapella.__all__)
    assert list(mocapella._HOMES) == sorted(mocapella._HOMES)
    assert dir(mocapella) == mocapella.__all__


def test_type_checkers_see_the_same_names() -> None:
    text = inspect.getsource(mocapella)
    block = text[text.index("if TYPE_CHECKING:") : text.index("__version__ =")]
    names = re.findall(r"from mocapella\.library\S* import (.+)", block)
    assert sorted(name for line in names for name in line.split(", ")) == sorted(mocapella._HOMES)


def test_the_documentation_has_every_name() -> None:
    text = LIBRARY.read_text(encoding="utf-8")
    missing = [name for name in mocapella._HOMES if f"mocapella.{name}(" not in text and f"`{name}`" not in text]
    assert missing == []


def test_every_argument_of_a_function_is_in_its_docstring() -> None:
    for name in mocapella.__all__:
        value = getattr(mocapella, name)
        if inspect.isfunction(value) and len(inspect.signature(value).parameters) > 1:
            documented = value.__doc__ or ""
            named = set(re.findall(r"\w+", documented))
            assert set(inspect.signature(value).parameters) <= named, name


def test_the_import_loads_no_library() -> None:
    program = f"import sys, mocapella; print([name for name in {SLOW!r} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path[:0] = {sys.path!r}; {program}"],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert done.stdout == "[]\n"
