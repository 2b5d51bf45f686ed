"""Run a function over items in this process, in a few processes, or on a Dask cluster: the same results to the bit.

    results = run_each(analyse, files, "dask", on_done=progress)

| engine | runs in |
|---|---|
| `local` | this process |
| `local:4` | four processes of this machine |
| `dask` | a Dask cluster that is started on this machine and ended with the call, a process for each core |
| `dask:4` | the same with four processes |
| `dask:HOST:PORT` | the workers of a Dask scheduler, which is left running |

Function and items are sent by pickle, so the function must be at the top of an importable module. A script that uses
several processes needs ``if __name__ == "__main__":``.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import re
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, Final, TypeVar

import msgspec

from mocapella.errors import EngineError, MocapellaError, SettingsError, visible
from mocapella.exports.needs import needed

Item = TypeVar("Item")
Result = TypeVar("Result")
OnDone = Callable[[int, Any], None]

CONNECT_S: Final = 5.0
"""Longest time to connect to a scheduler [s]."""
WORKERS_S: Final = 10.0
"""Longest time to wait for the first worker of a scheduler [s]."""
QUIET_S: Final = 10.0
"""After this time without a result, the engine checks that the scheduler still has workers [s]."""
MOST_DEATHS: Final = 3
"""Number of lost workers after which an item, or a set of processes without a result in between, is given up."""
_ADDRESS: Final = re.compile(r"(?P<scheme>[a-z]+://)?(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):(?P<port>\d{1,5})/?")
_ENGINES: Final = "local, local:PROCESSES, dask, dask:PROCESSES and dask:HOST:PORT"
_OF_SCHEDULER: Final = ("python", "dask", "distributed")
_OF_WORKERS: Final = ("mocapella", "numpy", "scipy", "numba")


class Engine(msgspec.Struct, frozen=True):
    """Where items are processed.

    Attributes:
        dask: whether by Dask, otherwise by processes of Python's own.
        processes: number of processes to start; 0 for none: this process, or the workers of ``address``.
        address: address of a running Dask scheduler, such as ``tcp://10.0.0.5:8786``; empty if none is used.
    """

    dask: bool
    processes: int
    address: str = ""


class Failed(msgspec.Struct, frozen=True):
    """The result of an item that could not be processed.

    Attributes:
        item: the item's text, cut to 200 characters.
        problem: the error, in one line.
    """

    item: str
    problem: str


def parse_engine(text: str) -> Engine:
    """Parse the name of an engine, as in the table of this module.

    Raises:
        SettingsError: unknown engine, number of processes or address; lists the engines.
    """
    name, _, rest = text.partition(":")
    if name in ("local", "dask"):
        if not rest and not text.endswith(":"):
            return Engine(name == "dask", cores() if name == "dask" else 0)
        if rest.isdecimal() and 1 <= int(rest) <= 1024:
            return Engine(name == "dask", int(rest))
        found = _ADDRESS.fullmatch(rest)
        if name == "dask" and found and int(found["port"]) < 65536:
            return Engine(True, 0, f"{found['scheme'] or 'tcp://'}{found['host']}:{found['port']}")
    raise SettingsError(f"unknown engine {visible(text)[:100]!r}; known: {_ENGINES}")


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_each(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    engine: str = "local",
    on_done: OnDone = lambda index, result: None,
) -> list[Result | Failed]:
    """Call a function with each item, and return the results in the items' order.

    An item whose function raises a `MocapellaError` gives a `Failed`; the others go on. So does an item that ended
    `MOST_DEATHS` Dask workers. Any other error of the function ends the call. Where a worker is killed, its item is
    run again; without Dask, all items that were running are. Processes that the call started end with it, also after
    Ctrl-C.

    Args:
        function: a function at the top of an importable module; depends on its item only.
        items: the items, which can be pickled.
        engine: see the table of this module.
        on_done: called in this process after each item with its index and result, in the order of completion.

    Raises:
        SettingsError: an unknown engine, or Dask is not installed.
        EngineError: no scheduler or no worker answers at the address, or one has other versions
            than this process; the scheduler, its last worker or too many processes were lost.
    """
    where = parse_engine(engine)
    guarded = partial(_guarded, function)
    results: dict[int, Result | Failed] = {}

    def done(index: int, result: Any) -> None:
        results[index] = result
        on_done(index, result)

    if not where.dask and not where.processes:
        for index, item in enumerate(items):
            done(index, guarded(item))
    elif items:
        (_run_dask if where.dask else _run_processes)(where, [partial(guarded, item) for item in items], done)
    return [results[index] for index in range(len(items))]


def _guarded(function: Callable[[Item], Result], item: Item) -> Result | Failed:
    try:
        return function(item)
    except MocapellaError as error:
        return Failed(_text_of(item), str(error))


def _text_of(item: object) -> str:
    return visible(str(item)[:200])


def _run_processes(engine: Engine, calls: Sequence[partial[Any]], done: OnDone) -> None:
    """Run calls in new processes; where one is killed, start others for the calls that have no result yet."""
    waiting, deaths = dict(enumerate(calls)), 0
    while waiting:
        before = len(waiting)
        with _pool(min(engine.processes, before)) as pool:
            try:
                futures: dict[Future[Any], int] = {pool.submit(call): index for index, call in waiting.items()}
                for future in as_completed(futures):
                    result = future.result()
                    del waiting[futures[future]]
                    done(futures[future], result)
            except BrokenProcessPool:
                deaths = 1 if len(waiting) < before else deaths + 1
        if deaths >= MOST_DEATHS:
            raise EngineError(
                f"processes were killed {deaths} times without a result; is there enough memory? Try fewer processes"
            )


@contextmanager
def _pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"))
    try:
        yield pool
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _run_dask(engine: Engine, calls: Sequence[partial[Any]], done: OnDone) -> None:
    """Run calls on a Dask cluster, see `run_each`."""
    distributed = needed("distributed", extra="cluster")
    with _connected(distributed, engine, len(calls)) as client:
        # A call has a key of its own: Dask would else give equal calls one result.
        futures = {client.submit(call, pure=False): index for index, call in enumerate(calls)}
        while futures:
            for future, result in _finished(distributed, client, futures, engine):
                index = futures.pop(future)
                future.release()
                if isinstance(result, distributed.KilledWorker):
                    problem = f"{MOST_DEATHS} workers were lost while they ran it; is there enough memory?"
                    done(index, Failed(_text_of(calls[index].args[-1]), problem))
                elif isinstance(result, BaseException):
                    raise result
                else:
                    done(index, result)


def _finished(distributed: Any, client: Any, futures: Mapping[Any, int], engine: Engine) -> list[tuple[Any, Any]]:
    """Wait for results; return them, or errors of the function, in the order of the items. Empty after `QUIET_S`."""
    try:
        finished = distributed.wait(list(futures), timeout=QUIET_S, return_when="FIRST_COMPLETED").done
        ordered = sorted(finished, key=futures.__getitem__)
        return [(each, each.exception() if each.status == "error" else each.result()) for each in ordered]
    except TimeoutError:
        if client.status == "running" and not client.scheduler_info()["workers"]:
            problem = f"the scheduler{_at(engine)} has lost its last worker with {len(futures)} items left"
            raise EngineError(problem) from None
        return []
    except (OSError, distributed.CancelledError) as error:
        raise EngineError(f"the scheduler{_at(engine)} was lost with {len(futures)} items left") from error


def _at(engine: Engine) -> str:
    return f" at {engine.address}" if engine.address else ""


@contextmanager
def _connected(distributed: Any, engine: Engine, calls: int) -> Iterator[Any]:
    """Connect to the engine's scheduler, or start a cluster on this machine that ends with the context.

    The cluster admits only this process: a key and a certificate of its own are made for it.
    """
    with ExitStack() as ended:
        target: Any = engine.address
        if not engine.address:
            folder = ended.enter_context(tempfile.TemporaryDirectory(prefix="mocapella-dask-"))
            target = ended.enter_context(
                distributed.LocalCluster(
                    n_workers=min(engine.processes, calls),
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    security=True,
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                    local_directory=folder,
                    silence_logs=logging.CRITICAL,
                )
            )
        else:
            _check_scheduler(distributed, engine)
        with warnings.catch_warnings():  # of other versions of workers, which `_check_workers` names
            warnings.simplefilter("ignore", distributed.versions.VersionMismatchWarning)
            client = ended.enter_context(distributed.Client(target, timeout=CONNECT_S, set_as_default=False))
        ended.enter_context(client.as_current())
        if engine.address:
            _check_workers(client, engine)
        yield client


def _check_scheduler(distributed: Any, engine: Engine) -> None:
    """Check that a scheduler answers, and its versions, before a client connects: it may not understand another one.

    Raises:
        EngineError: no scheduler answers, or a version differs.
    """

    async def versions() -> Any:
        arguments = distributed.Security().get_connection_args("client")
        async with distributed.core.rpc(engine.address, connection_args=arguments) as scheduler:
            return await scheduler.versions()

    try:
        theirs = asyncio.run(asyncio.wait_for(versions(), CONNECT_S))
    except (OSError, ValueError, TypeError) as error:
        raise EngineError(
            f"no Dask scheduler answers{_at(engine)}; start one with `dask scheduler`, or use the engine dask alone"
        ) from error
    ours = distributed.versions.get_versions()
    _compare("the scheduler", theirs["packages"], ours["packages"], _OF_SCHEDULER)


def _check_workers(client: Any, engine: Engine) -> None:
    """Check that the scheduler has workers, and their versions.

    Raises:
        EngineError: there is no worker, or a version differs.
    """
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError as error:
        raise EngineError(
            f"the scheduler{_at(engine)} has no workers; start some with `dask worker {engine.address}`"
        ) from error
    found = client.get_versions(packages=list(_OF_WORKERS))
    for address, worker in found["workers"].items():
        ours = found["client"]["packages"]
        _compare(f"the worker {address}", worker["packages"], ours, (*_OF_SCHEDULER, *_OF_WORKERS))


def _compare(whose: str, theirs: Mapping[str, Any], ours: Mapping[str, Any], packages: Iterable[str]) -> None:
    """Check that packages have the same versions there and here; of Python, the first two numbers count."""
    for package in packages:
        there, here = (_version(each, package) for each in (theirs, ours))
        if there != here:
            raise EngineError(
                f"{whose} has {package} {there or 'not at all'}, and this process {here or 'not at all'}; "
                "install the same versions on all machines"
            )


def _version(packages: Mapping[str, Any], package: str) -> str:
    text = str(packages.get(package) or "")
    return ".".join(text.split(".")[:2]) if package == "python" else text
