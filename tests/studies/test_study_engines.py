"""An item gives the same on every engine; what is lost or fails costs itself only; what cannot be used is named."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import engine_items
from support.dask_processes import PATIENCE_S, TESTS, scheduler, wait_for, worker

from mocapella.errors import EngineError, SettingsError
from mocapella.studies import engines
from mocapella.studies.engines import Engine, Failed, cores, parse_engine, run_each

ITEMS = list(range(12))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The engine of a scheduler with two workers."""
    folder = tmp_path_factory.mktemp("dask")
    with scheduler(folder) as (address, _), worker(folder, address, "one"), worker(folder, address, "two"):
        yield f"dask:{address}"


@given(st.lists(st.integers(0, 1000), max_size=20))
def test_results_are_in_the_order_of_the_items_and_each_is_told_once(items: list[int]) -> None:
    told: dict[int, Any] = {}
    results = run_each(engine_items.some_fail, items, on_done=lambda index, result: told.update({index: result}))
    assert results == [told[index] for index in range(len(items))]
    assert [one for one in results if not isinstance(one, Failed)] == [item for item in items if item % 2 == 0]


def test_an_item_with_an_error_of_ours_is_named_and_the_others_go_on() -> None:
    results = run_each(engine_items.some_fail, [0, 1, 2])
    assert results == [0, Failed("1", "log-1.csv: is odd; give another"), 2]


@pytest.mark.parametrize(
    ("text", "engine"),
    [
        ("local", Engine(False, 0)),
        ("local:3", Engine(False, 3)),
        ("dask", Engine(True, cores())),
        ("dask:2", Engine(True, 2)),
        ("dask:box.example:8786", Engine(True, 0, "tcp://box.example:8786")),
        ("dask:tls://10.0.0.5:8786/", Engine(True, 0, "tls://10.0.0.5:8786")),
        ("dask:[::1]:8786", Engine(True, 0, "tcp://[::1]:8786")),
    ],
)
def test_an_engine_is_read_from_its_name(text: str, engine: Engine) -> None:
    assert parse_engine(text) == engine


@pytest.mark.parametrize(
    "text", ["", "spark", "local:", "local:0", "local:a:1", "dask:", "dask:box", "dask:box:99999", "dask:\x1b[2J:1"]
)
def test_an_unknown_engine_is_refused_with_the_known_ones(text: str) -> None:
    with pytest.raises(SettingsError, match="known: local, local:PROCESSES, dask, dask:PROCESSES and dask:HOST") as no:
        parse_engine(text)
    assert str(no.value).isprintable()


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SettingsError, match="cluster"):
        run_each(engine_items.sums, ITEMS, "dask")


def test_nothing_is_started_for_no_items(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert run_each(engine_items.sums, [], "dask") == run_each(engine_items.sums, [], "local:2") == []


def test_an_address_without_a_scheduler_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "CONNECT_S", 1.0)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
    with pytest.raises(EngineError, match=f"no Dask scheduler answers at tcp://{address}; start one with"):
        run_each(engine_items.sums, ITEMS, f"dask:{address}")


def test_a_server_that_says_nothing_is_no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "CONNECT_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(EngineError, match="no Dask scheduler answers"):
            run_each(engine_items.sums, ITEMS, f"dask:{address}")


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local:2", "dask:2", "cluster"])
def test_every_engine_gives_the_same_to_the_bit(engine: str, request: pytest.FixtureRequest) -> None:
    name = request.getfixturevalue("cluster") if engine == "cluster" else engine
    told: list[int] = []
    results = run_each(engine_items.sums, ITEMS, name, on_done=lambda index, _: told.append(index))
    assert engine_items.plain(results) == engine_items.plain(run_each(engine_items.sums, ITEMS))
    assert sorted(told) == ITEMS
    assert len(set(run_each(engine_items.process, ITEMS, name)) - {os.getpid()}) == 2


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local:2", "dask:2", "cluster"])
def test_errors_of_ours_are_results_and_others_end_the_call(engine: str, request: pytest.FixtureRequest) -> None:
    name = request.getfixturevalue("cluster") if engine == "cluster" else engine
    assert run_each(engine_items.some_fail, ITEMS, name) == run_each(engine_items.some_fail, ITEMS)
    with pytest.raises(ZeroDivisionError):
        run_each(engine_items.all_break, ITEMS, name)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local:2", "dask:2", "cluster"])
def test_a_killed_worker_costs_its_item_only(engine: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    name = request.getfixturevalue("cluster") if engine == "cluster" else engine
    items = [(str(tmp_path), number) for number in range(6)]
    done: list[int] = []

    def on_done(index: int, _: Any) -> None:
        done.append(index)
        if len(done) == 5:  # all but the first, which waits, or is not even imported
            wait_for((tmp_path / "0.pid").is_file, "the first item")
            os.kill(int((tmp_path / "0.pid").read_text()), signal.SIGKILL)

    results = run_each(engine_items.waits_the_first_time, items, name, on_done)
    assert [number for number, _ in results] == list(range(6))
    assert done[-1] == 0
    assert len(list(tmp_path.glob("*.ran"))) == 6


@pytest.mark.slow
def test_an_item_that_ends_every_worker_is_given_up() -> None:
    results = run_each(engine_items.dies, [0, 1, 2], "dask:2")
    assert (results[0], results[2]) == (0, 2)
    assert isinstance(results[1], Failed)
    assert "workers were lost while they ran it" in results[1].problem
    with pytest.raises(EngineError, match="processes were killed 3 times without a result"):
        run_each(engine_items.dies, [1], "local:1")


@pytest.mark.slow
def test_a_scheduler_without_workers_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "WORKERS_S", 0.5)
    with (
        scheduler(tmp_path) as (address, _),
        pytest.raises(EngineError, match=f"has no workers; start some with `dask worker {address}`"),
    ):
        run_each(engine_items.sums, ITEMS, f"dask:{address}")


OTHER_VERSION = """
from distributed import versions
if not hasattr(versions, "as_it_is"):  # it is run more than once
    versions.as_it_is = versions._version_cached
versions._version_cached = lambda package: "1.0" if package == "{package}" else versions.as_it_is(package)
"""


@pytest.mark.slow
def test_a_scheduler_of_another_version_is_named(tmp_path: Path) -> None:
    preload = tmp_path / "other_version.py"
    preload.write_text(OTHER_VERSION.format(package="distributed"))
    with (
        scheduler(tmp_path, "--preload", str(preload)) as (address, _),
        pytest.raises(EngineError, match=r"the scheduler has distributed 1\.0, and this process 202"),
    ):
        run_each(engine_items.sums, ITEMS, f"dask:{address}")


@pytest.mark.slow
def test_a_worker_of_another_version_is_named(tmp_path: Path) -> None:
    preload = tmp_path / "other_version.py"
    preload.write_text(OTHER_VERSION.format(package="numba"))
    with (
        scheduler(tmp_path) as (address, _),
        worker(tmp_path, address, "one", "--preload", str(preload)),
        pytest.raises(EngineError, match=r"the worker tcp://.* has numba 1\.0, and this process 0"),
    ):
        run_each(engine_items.sums, ITEMS, f"dask:{address}")


@pytest.mark.slow
@pytest.mark.parametrize(("lost", "words"), [("scheduler", "was lost"), ("worker", "has lost its last worker")])
def test_a_cluster_that_is_lost_is_named(
    lost: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "QUIET_S", 1.0)
    with scheduler(tmp_path) as (address, process), worker(tmp_path, address, "one") as only:

        def end(index: int, _: Any) -> None:
            wait_for((tmp_path / "0.pid").is_file, "the waiting item")
            (process if lost == "scheduler" else only).send_signal(signal.SIGTERM)

        items = [(str(tmp_path), 1), (str(tmp_path), 0)]
        with pytest.raises(EngineError, match=rf"{words}.* with 1 items left"):
            run_each(engine_items.waits_the_first_time, items, f"dask:{address}", end)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local:2", "dask:2"])
@pytest.mark.parametrize("group", [True, False])
def test_ctrl_c_ends_all_processes_that_were_started(engine: str, group: bool, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "support.engine_items", str(tmp_path), engine],
        cwd=TESTS,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    wait_for(lambda: len(list(tmp_path.glob("*.pid"))) == 2, "two items")
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) >= 2
    (os.killpg if group else os.kill)(process.pid, signal.SIGINT)
    said, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, said) == (0, b"interrupted\n"), errors
    assert psutil.wait_procs(children, timeout=PATIENCE_S)[1] == []


@pytest.mark.slow
def test_the_cluster_listens_to_this_machine_only(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "support.engine_items", str(tmp_path), "dask:1"], cwd=TESTS, start_new_session=True
    )
    try:
        wait_for(lambda: list(tmp_path.glob("*.pid")), "an item")
        every = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
        listening = [c.laddr.ip for one in every for c in one.net_connections() if c.status == psutil.CONN_LISTEN]
        assert listening
        assert set(listening) == {"127.0.0.1"}
    finally:
        os.killpg(process.pid, signal.SIGINT)
        process.wait(PATIENCE_S)
