"""Compiled kernels are loaded from disk while all of their sources are the same, and no longer."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest
from support.forked import Forked

import mocapella
from mocapella import kernel_cache
from mocapella.kernel_cache import source_digest, sources_of

PACKAGE = Path(mocapella.__file__).parent
KERNELS = "\nfrom mocapella.compiled import njit\n"
SOURCES = {
    "stage/outer_kernels.py": KERNELS
    + "from mocapella.stage.inner_kernels import half\nfrom mocapella.stage import row\n",
    "stage/inner_kernels.py": KERNELS + "from mocapella.base.far_kernels import (\n    one,\n    two,\n)\n",
    "base/far_kernels.py": KERNELS + "from mocapella.stage.inner_kernels import half\none, two = 1, 2\n",
    "base/lonely_kernels.py": KERNELS + "alone = 1\n",
    "stage/row.py": "WIDTH = 3\n",
    "stage/other.py": "unrelated = 1\n",
}
WORK = """
from mocapella.compiled import njit
WIDTH = 3

@njit(cache=True)
def work(x):
    return WIDTH * x
"""
CALL = """
import sys
from numba.core import event
from work_kernels import work
compiled = []
class Heard(event.Listener):
    def on_start(self, told): compiled.append(told)
    def on_end(self, told): pass
with event.install_listener("numba:compile", Heard()):
    print(*(work(eval(x)) for x in sys.argv[1:]), len(compiled))
"""
"""Prints the results, and how often numba compiled for them."""
SLOW_SAVE = """
import time
from numba.core.caching import IndexDataCacheFile
load = IndexDataCacheFile._load_index
def slow(self):
    found = load(self)
    time.sleep(0.3)
    return found
IndexDataCacheFile._load_index = slow
"""

FULL_DISK = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
"""
"""As far as files go; POSIX only."""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    for name, text in SOURCES.items():
        source = tmp_path / name
        source.parent.mkdir(exist_ok=True)
        source.write_text(text, encoding="utf-8")
    return tmp_path


@pytest.fixture
def kernels(tmp_path: Path) -> Path:
    """The folder of a file of kernels that is of no package."""
    (tmp_path / "work_kernels.py").write_text(WORK, encoding="utf-8")
    return tmp_path


def digests(package: Path) -> dict[str, str]:
    """As a new process sees them: one reads each source once."""
    kernel_cache._contents.cache_clear()
    kernel_cache._exists.cache_clear()
    return {path.relative_to(package).as_posix(): source_digest(path, package) for path in package.rglob("*.py")}


def call(folder: Path, *arguments: str, code: str = CALL, **environment: str) -> list[str]:
    return Forked(folder, code, *arguments, **environment).output().split()


def entries(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*.nb[ci]"))


@pytest.mark.parametrize(
    ("changed", "other"),
    [
        ("base/far_kernels.py", {"stage/outer_kernels.py", "stage/inner_kernels.py", "base/far_kernels.py"}),
        ("stage/inner_kernels.py", {"stage/outer_kernels.py", "stage/inner_kernels.py", "base/far_kernels.py"}),
        ("stage/row.py", {"stage/outer_kernels.py", "stage/row.py"}),
        ("base/lonely_kernels.py", {"base/lonely_kernels.py"}),
        ("stage/other.py", {"stage/other.py"}),
    ],
)
def test_a_digest_changes_with_every_source_and_no_other_file(package: Path, changed: str, other: set[str]) -> None:
    before = digests(package)
    stat = (package / changed).stat()
    (package / changed).write_text(SOURCES[changed] + "# changed\n", encoding="utf-8")
    os.utime(package / changed, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    after = digests(package)
    assert {name for name in SOURCES if after[name] != before[name]} == other
    (package / changed).write_text(SOURCES[changed], encoding="utf-8")
    assert digests(package) == before


def test_sources_that_import_each_other_are_all_found(package: Path) -> None:
    names = ["base/far_kernels.py", "stage/inner_kernels.py", "stage/outer_kernels.py", "stage/row.py"]
    found = sources_of(package / "stage/outer_kernels.py", package)
    assert [path.relative_to(package).as_posix() for path in found] == names


def test_a_source_that_is_gone_counts_for_those_that_import_it(package: Path) -> None:
    before = digests(package)
    (package / "stage" / "row.py").unlink()
    after = digests(package)
    assert {name for name in after if after[name] != before[name]} == {"stage/outer_kernels.py"}


def test_kernels_of_this_package_see_their_sources() -> None:
    found = {path.relative_to(PACKAGE).as_posix() for path in sources_of(PACKAGE / "tracker" / "people_kernels.py")}
    assert {"tracker/people_kernels.py", "kinematics/articulated_kernels.py", "geometry/turn_kernels.py"} <= found
    assert re.fullmatch("[0-9a-f]{24}", source_digest(PACKAGE / "tracker" / "people_kernels.py"))


def test_numba_is_imported_in_one_place() -> None:
    importers = {
        path.name for path in PACKAGE.rglob("*.py") if re.search(r"^\s*(from|import) numba\b", path.read_text(), re.M)
    }
    assert importers == {"compiled.py", "kernel_cache.py", "kernel_dispatcher.py"}


def test_an_import_writes_nothing(kernels: Path) -> None:
    before = set(kernels.rglob("*"))
    given = kernels / "given"
    code = "import work_kernels, mocapella.tracker.people_kernels"
    assert call(kernels, code=code, NUMBA_CACHE_DIR=str(given), PYTHONDONTWRITEBYTECODE="1") == []
    assert set(kernels.rglob("*")) == before


def test_a_kernel_is_compiled_once_and_again_when_a_constant_changes(kernels: Path) -> None:
    source = kernels / "work_kernels.py"
    assert call(kernels, "2") == ["6", "1"]
    assert call(kernels, "2") == ["6", "0"]
    old, stat = entries(kernels), source.stat()
    # Neither the function nor the file's time and size change, which is all that numba would look at.
    source.write_text(WORK.replace("WIDTH = 3", "WIDTH = 4"), encoding="utf-8")
    os.utime(source, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert call(kernels, "2", PYTHONDONTWRITEBYTECODE="1", PYTHONPYCACHEPREFIX=str(kernels / "bytecode")) == ["8", "1"]
    new = entries(kernels)
    assert len(old) == len(new) == 2
    assert not set(old) & set(new)  # the old ones are removed


def test_entries_of_another_python_are_left_alone(kernels: Path) -> None:
    call(kernels, "2")
    (name,) = (entry for entry in entries(kernels) if entry.endswith(".nbi"))
    other = kernels / "__pycache__" / re.sub(r"\.py\d+", ".py399", name)
    other.write_bytes(b"of another Python")
    call(kernels, "2.5")
    assert other.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="a limit of POSIX stands for a full disk")
def test_on_a_full_disk_kernels_still_run(kernels: Path) -> None:
    assert call(kernels, "2", code=FULL_DISK + CALL, PYTHONDONTWRITEBYTECODE="1") == ["6", "1"]
    assert call(kernels, "2") == ["6", "1"]
    assert call(kernels, "2") == ["6", "0"]


def test_processes_that_start_together_save_all_that_they_compile(kernels: Path) -> None:
    arguments = ("2", "2.5", "2j", "True")
    code = SLOW_SAVE + CALL
    given = str(kernels / "given")
    processes = [Forked(kernels, code, argument, NUMBA_CACHE_DIR=given) for argument in arguments]
    outs = [process.output().split() for process in processes]
    assert [out[0] for out in outs] == ["6", "7.5", "6j", "3"]
    assert call(kernels, *arguments, NUMBA_CACHE_DIR=given) == ["6", "7.5", "6j", "3", "0"]


def test_without_a_folder_beside_the_source_the_users_cache_is_taken(kernels: Path) -> None:
    (kernels / "__pycache__").write_text("no folder")
    home = {name: str(kernels / "home") for name in ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA")}
    assert call(kernels, "2", PYTHONDONTWRITEBYTECODE="1", **home) == ["6", "1"]
    assert len(entries(kernels / "home")) == 2
    assert call(kernels, "2", PYTHONDONTWRITEBYTECODE="1", **home) == ["6", "0"]


def test_where_nothing_can_be_written_kernels_still_run(kernels: Path) -> None:
    (kernels / "__pycache__").write_text("no folder")
    (kernels / "home").write_text("no folder, either")
    home = {name: str(kernels / "home" / "cache") for name in ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA")}
    assert call(kernels, "2", PYTHONDONTWRITEBYTECODE="1", **home) == ["6", "1"]
    assert entries(kernels) == []


ONLY_COMPILED = """
from work_kernels import work
from mocapella.compiled import NotCompiledError, only_compiled
try:
    with only_compiled():
        print(work(2))
except NotCompiledError as error:
    print("not compiled:", error)
"""
SLOW_COMPILE = """
import time
from numba.core.compiler import Compiler
compile_ir = Compiler.compile_extra
def slow(self, function):
    time.sleep(1.0)
    return compile_ir(self, function)
Compiler.compile_extra = slow
"""


@pytest.mark.parametrize("folders", [{}, {"NUMBA_CACHE_DIR": "given"}])
def test_where_compiling_is_forbidden_only_kernels_on_disk_run(kernels: Path, folders: dict[str, str]) -> None:
    refused = Forked(kernels, ONLY_COMPILED, **folders)
    assert refused.output() == "not compiled: work_kernels.work(int64,)\n"
    assert entries(kernels) == []
    assert call(kernels, "2", **folders) == ["6", "1"]
    assert Forked(kernels, ONLY_COMPILED, **folders).output() == "6\n"


def test_processes_that_start_together_compile_a_kernel_once(kernels: Path) -> None:
    processes = [Forked(kernels, SLOW_COMPILE + CALL, "2") for _ in range(3)]
    outs = [process.output().split() for process in processes]
    assert sorted(outs) == [["6", "0"], ["6", "0"], ["6", "1"]]


def test_a_kernel_whose_compilation_was_killed_is_compiled_by_the_next(kernels: Path) -> None:
    killed = Forked(kernels, SLOW_COMPILE.replace("1.0", "60") + CALL, "2")
    while not list(kernels.rglob("*.claim")):
        assert not killed.ended()
    waits = Forked(kernels, CALL, "2")
    killed.kill()
    assert waits.output(timeout=60).split() == ["6", "1"]


def test_a_claim_that_is_never_given_back_does_not_stop_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_cache, "CLAIM_S", 0.05)
    with kernel_cache._claimed(tmp_path / "a.claim"), kernel_cache._claimed(tmp_path / "a.claim"):
        pass


TWO_KERNELS = """
from mocapella.compiled import njit

@njit(cache=True)
def inverse(x):
    if x == 0.0:
        raise ZeroDivisionError("no inverse")
    return 1.0 / x

@njit(cache=True)
def work(x):
    return inverse(x) + inverse(2.0 * x)
"""
CALL_INVERSE = CALL.replace("import work", "import inverse as work")


@pytest.fixture
def two_kernels(tmp_path: Path) -> Path:
    """The folder of a kernel that calls another one."""
    (tmp_path / "work_kernels.py").write_text(TWO_KERNELS, encoding="utf-8")
    return tmp_path


def test_a_callee_gets_machine_code_when_python_calls_it(two_kernels: Path) -> None:
    assert call(two_kernels, "2.0") == ["0.75", "2"]
    assert call(two_kernels, "2.0") == ["0.75", "0"]
    assert call(two_kernels, code=ONLY_COMPILED.replace("import work", "import inverse as work")) == [
        *["not", "compiled:", "work_kernels.inverse(int64,)"]
    ]
    assert call(two_kernels, "2.0", code=CALL_INVERSE) == ["0.5", "1"]
    assert call(two_kernels, "2.0", code=CALL_INVERSE) == ["0.5", "0"]


def test_kernels_compile_in_any_order(two_kernels: Path) -> None:
    assert call(two_kernels, "2.0", code=CALL_INVERSE) == ["0.5", "1"]
    assert call(two_kernels, "2.0") == ["0.75", "1"]  # the machine code of the callee serves as LLVM code
    both = CALL.replace("import work", "import inverse, work")
    both = both.replace("work(eval(x))", "(work(eval(x)), inverse(eval(x)), work(eval(x)))")
    assert call(two_kernels, "4.0", code=both) == ["(0.375,", "0.25,", "0.375)", "0"]


def test_an_error_of_a_callee_reaches_python(two_kernels: Path) -> None:
    code = "from work_kernels import work\ntry:\n    work(0.0)\nexcept ZeroDivisionError as error:\n    print(error)\n"
    for _ in ("compiled", "loaded"):
        assert call(two_kernels, code=code) == ["no", "inverse"]
