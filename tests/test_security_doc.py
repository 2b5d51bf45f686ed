"""What SECURITY.md promises beside the doors that have tests of their own: no code in data, and loopback by default."""

from __future__ import annotations

import ast
import ipaddress
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.commands import commands_below, root, visible_options
from support.syntax import nodes_of

from mocapella.wire.roles import users_of

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
RUNS_DATA = {"pickle", "_pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "jsonpickle"}
CALLS = {"eval", "exec", "compile", "__import__"}


def code_in_data(source: str) -> Iterator[str]:
    """What a module could run out of data: imports that unpickle, and calls that evaluate text."""
    for node in nodes_of(source):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.partition(".")[0] in RUNS_DATA)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in RUNS_DATA:
            yield str(node.module)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CALLS:
            yield node.func.id
        elif isinstance(node, ast.keyword) and node.arg == "allow_pickle" and ast.unparse(node.value) != "False":
            yield "allow_pickle"


def test_no_module_runs_code_that_is_data() -> None:
    found = {
        str(path.relative_to(ROOT)): names
        for path in (ROOT / "src").rglob("*.py")
        if (names := list(code_in_data(path.read_text(encoding="utf-8"))))
    }
    assert found == {}


@pytest.mark.parametrize(
    "line",
    ["import pickle", "from pickle import loads", "import dill.source", "eval('1')", "np.load(f, allow_pickle=True)"],
)
def test_code_in_data_would_be_noticed(line: str) -> None:
    assert list(code_in_data(line))
    assert not list(code_in_data("np.load(f, allow_pickle=False); re.compile('a'); import json"))


def test_whatever_listens_listens_on_loopback_unless_told_otherwise() -> None:
    listening = [
        (name, option.opts[0], str(option.default))
        for name, command in commands_below(root())
        for option in visible_options(command)
        if option.opts[0] in ("--host", "--listen")
    ]
    assert {"serve", "view", "node bridge", "node datagrams", "node osc"} <= {name for name, _, _ in listening}
    for name, option, default in listening:
        assert ipaddress.ip_address(default.partition(":")[0]).is_loopback, f"{name} {option} {default}"


def test_each_role_is_in_the_table() -> None:
    for user in users_of(["NAME"]):
        assert all(f"`{part}`" in TEXT for part in user.replace("+", " +").split())
