"""Functions that the tests of engines run in other processes, which import this module."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mocapella.errors import InputError
from mocapella.recording.study_log import read_study_log
from mocapella.studies.engines import Failed, run_each
from mocapella.studies.method_results import results_of_methods


def sums(seed: int) -> Any:
    """Numbers whose last bits depend on the order of operations."""
    values = np.random.default_rng(seed).normal(size=(200, 3))
    return seed, values.sum(axis=0), float(np.linalg.norm(values @ values.T)), os.fspath(Path("a"))


def some_fail(number: int) -> int:
    if number % 2:
        raise InputError("is odd", file=f"log-{number}.csv", fix="give another")
    return number


def all_break(number: int) -> int:
    raise ZeroDivisionError(f"{number}")


def process(_: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def waits_the_first_time(item: tuple[str, int]) -> tuple[int, int]:
    """Write the process' number, and wait; where the file is there, return the numbers of item and process."""
    folder, number = item
    file = Path(folder) / f"{number}.pid"
    if number == 0 and not file.exists():
        partial = file.with_suffix(".part")
        partial.write_text(str(os.getpid()))
        partial.rename(file)
        time.sleep(600)
    (Path(folder) / f"{number}-{os.getpid()}-{time.monotonic_ns()}.ran").touch()
    return number, os.getpid()


def dies(number: int) -> int:
    if number == 1:
        os._exit(9)
    return number


def sleeps(item: tuple[str, int]) -> None:
    (Path(item[0]) / f"{os.getpid()}.pid").touch()
    time.sleep(600)


def main() -> None:
    """Run `sleeps` on an engine, until Ctrl-C."""
    folder, engine = sys.argv[1:]
    try:
        run_each(sleeps, [(folder, number) for number in range(4)], engine)
    except KeyboardInterrupt:
        print("interrupted", flush=True)


def measured_files(file: str) -> bytes:
    """All that the thesis' method and our measures find in a study log."""
    results = results_of_methods(read_study_log(file), ["stand-still"])
    arrays = [array.tobytes() for one in results.views for array in (one.views, one.fused)]
    return b"".join([*arrays, msgspec.msgpack.encode([results.measured, results.findings])])


def plain(results: list[Any]) -> list[Any]:
    """Results as values that can be compared, to the bit."""
    return [one if isinstance(one, Failed) else [np.asarray(part).tobytes() for part in one] for one in results]


if __name__ == "__main__":
    main()
