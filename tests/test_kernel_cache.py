"""What was compiled is kept while its sources are as they were, and no longer than that."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mocapella
from mocapella.kernel_cache import COMPILED, STAMPS, discard_stale, kept_in

SOURCES = {
    "stage/outer_kernels.py": COMPILED
    + "from mocapella.stage.inner_kernels import half\nfrom mocapella.stage import row\n",
    "stage/inner_kernels.py": COMPILED + "from mocapella.base.far_kernels import (\n    one,\n    two,\n)\n",
    "base/far_kernels.py": COMPILED + "one, two = 1, 2\n",
    "base/lonely_kernels.py": COMPILED + "alone = 1\n",
    "stage/row.py": "WIDTH = 3\n",
    "stage/other.py": "unrelated = 1\n",
}


@pytest.fixture
def package(tmp_path: Path) -> Path:
    for name, text in SOURCES.items():
        source = tmp_path / name
        source.parent.mkdir(exist_ok=True)
        source.write_text(text, encoding="utf-8")
    discard_stale(tmp_path)
    compile_all(tmp_path)
    return tmp_path


def compile_all(package: Path) -> None:
    for name in SOURCES:
        if name.endswith("_kernels.py"):
            index(package, name).parent.mkdir(exist_ok=True)
            index(package, name).write_bytes(b"compiled")


def index(package: Path, name: str) -> Path:
    source = package / name
    return source.parent / "__pycache__" / f"{source.stem}.work-12.py311.nbi"


def left(package: Path) -> set[str]:
    return {name for name in SOURCES if index(package, name).exists()}


ALL = {name for name in SOURCES if name.endswith("_kernels.py")}


def test_what_is_as_it_was_is_kept(package: Path) -> None:
    assert discard_stale(package) == []
    assert left(package) == ALL


@pytest.mark.parametrize(
    ("changed", "stale"),
    [
        ("base/far_kernels.py", {"stage/outer_kernels.py", "stage/inner_kernels.py", "base/far_kernels.py"}),
        ("stage/inner_kernels.py", {"stage/outer_kernels.py", "stage/inner_kernels.py"}),
        ("stage/row.py", {"stage/outer_kernels.py"}),
        ("base/lonely_kernels.py", {"base/lonely_kernels.py"}),
        ("stage/other.py", set()),
    ],
)
def test_what_imports_a_changed_file_is_compiled_anew(package: Path, changed: str, stale: set[str]) -> None:
    (package / changed).write_text(SOURCES[changed] + "# changed\n", encoding="utf-8")
    assert set(discard_stale(package)) == stale
    assert left(package) == ALL - stale
    assert discard_stale(package) == []


@pytest.mark.parametrize("stamps", [b"", b"[]", b"\xff\x00", b'{"stage/inner_kernels.py": 7}'])
def test_stamps_that_are_none_are_no_proof(package: Path, stamps: bytes) -> None:
    (package / "__pycache__" / STAMPS).write_bytes(stamps)
    assert set(discard_stale(package)) == ALL
    assert left(package) == set()


def test_a_file_that_is_gone_or_new_concerns_those_that_import_it(package: Path) -> None:
    (package / "stage" / "row.py").unlink()
    assert discard_stale(package) == ["stage/outer_kernels.py"]


def test_whatever_is_compiled_imports_what_looks_at_it() -> None:
    folder = Path(mocapella.__file__).parent
    sources = {path.relative_to(folder).as_posix(): path.read_text(encoding="utf-8") for path in folder.rglob("*.py")}
    by_numba = {
        name for name, text in sources.items() if re.search(r"^\s*(from numba import|import numba)", text, re.M)
    }
    assert by_numba == {"compiled.py"}
    assert "geometry/lens_kernels.py" in {name for name, text in sources.items() if COMPILED in text}


def test_the_package_itself_is_looked_at_when_a_kernel_is_imported() -> None:
    folder = Path(mocapella.__file__).parent
    code = "import mocapella.geometry.lens_kernels; from mocapella.kernel_cache import discard_stale; "
    code += "from pathlib import Path; print(discard_stale(Path(mocapella.__file__).parent))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert (folder / "__pycache__" / STAMPS).is_file()


def test_what_is_kept_elsewhere_is_looked_at_there(package: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert set(discard_stale(package, cache)) == ALL
    kept = kept_in(package / "stage", cache) / "inner_kernels.half-3.py311.nbi"
    kept.parent.mkdir()
    kept.write_bytes(b"compiled")
    (package / "base/far_kernels.py").write_text(COMPILED + "one, two = 1, 3\n", encoding="utf-8")
    assert "base/far_kernels.py" in discard_stale(package)  # beside the sources; the other has stamps of its own
    assert kept.exists()
    assert "stage/inner_kernels.py" in discard_stale(package, cache)
    assert not kept.exists()


def test_numba_keeps_elsewhere_what_it_is_told_to_where_it_is_looked_for(tmp_path: Path) -> None:
    code = "from mocapella.geometry.lens_kernels import distort; distort(*[0.1] * 7)"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    folder = Path(mocapella.__file__).parent
    assert list(kept_in(folder / "geometry", tmp_path).glob("lens_kernels.distort-*.nbi"))
    assert (kept_in(folder, tmp_path) / STAMPS).is_file()
