"""Damaged input for every reader of files and messages: what escapes our errors, how long it takes, and what memory.

Valid inputs are damaged in bytes, in words (`_text_mutations`) and, of takes, in contents whose checksums are made
right again (`_take_mutations`). The same seed gives the same inputs, on any number of processes. ``--inputs 1e8`` asks
for so many, ``--processes 1`` for one process instead of one for each core. ``--slice 2/5`` reads the second fifth of
them: all slices together read the same inputs as one long run.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, MutableSequence, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, NamedTuple

from benchmarks._feeding import MOST_BYTES, MOST_SECONDS, SEED, Report, Watch, feed
from benchmarks.harness import Row, at_most, cores, measured

INPUTS: Final = 1_000_000
QUICK: Final = 4_000
PIECE: Final = 20_000
"""Inputs of a door of share 1 that a process reads at a time, after which its limit of memory begins anew."""

PARTS: Final = (
    "frames", "skeletons", "scenes", "people of scenes", "truths", "bridge stream", "marker datagrams", "OSC",
    "bus keys", "V4L2 controls",
    "requests for frames", "answers about frames", "numbers of frames", "clocks", "replies", "statuses",
    "replies to nodes", "questions", "expected people", "questions of the view",
    "answers", "corners of boards", "commands", "rings",
    "camera rigs", "sensor layouts", "hands", "boards", "runs of takes", "accounts of takes", "bodies' builds",
    "colours", "settings", "pairing codes", "key files", "session keys", "view tokens", "page requests",
    "page messages", "study logs", "study logs, packed", "Azure Kinect tables", "Kinect v2 tables", "image tracks",
    "keypoints", "detections of a video", "tables of detections", "HDF5 of detections", "calibrations of cameras",
    "point recordings", "distances", "timestamps", "boxes of an MP4", "followed bodies", "named joints",
    "space alignments", "depth sidecars", "BVH", "keypoint tables", "joint maps", "C3D", "TRC", "facing models",
    "bias models", "depth images", "images .png", "images .jpg", "images .bmp", "images .tiff", "images .webp",
    "meshes .glb", "meshes .gltf", "settings files", "layout files", "rig files",
    "hand files", "board files", "colour files", "reference points", "numbers of a camera", "rooms to plan",
    "scene files", "sensor errors", "errors of detectors",
    "bodies with meshes", "references to images", "unpacked streams", "study logs in Parquet", "study protocols",
    "study sessions",
    "memories of stand-still", "memories of default",
    "memories of arms", "memories of one-webcam", "memories of hands", "memories of silhouettes",
    "memories of webcams", "contents of takes",
)  # fmt: skip
"""Names of the doors."""


class Piece(NamedTuple):
    """A number of inputs of one door; ``number`` counts the pieces of the door."""

    door: str
    number: int
    inputs: int


class Fed(NamedTuple):
    """The results by door, and the pieces whose process died, each with the number of the input."""

    reports: list[Report]
    crashes: list[str]


def run(
    quick: bool = False,
    parts: Sequence[str] = (),
    inputs: int | None = None,
    processes: int | None = None,
    slice_of: tuple[int, int] = (1, 1),
) -> list[Row]:
    fed = feed_all(inputs or (QUICK if quick else INPUTS), parts, processes or cores(), slice_of)
    for report in fed.reports:
        tell(report)
    for crash in fed.crashes:
        print(f"a process died while it read {crash}", file=sys.stderr)
    return [measured("fuzz: processes that died", len(fed.crashes), "", goal=at_most(0)), *rows_of(fed.reports)]


def feed_all(inputs: int, parts: Sequence[str], processes: int, slice_of: tuple[int, int] = (1, 1)) -> Fed:
    """Feed damaged inputs to all doors or some.

    Args:
        inputs: how many, of all doors together; each door has at least one.
        parts: names of the doors; all if empty.
        processes: how many to use.
        slice_of: which slice of the inputs, from 1, and of how many.
    """
    context: Any = get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="mocapella-fuzz-", dir=_memory_disk()) as folder:
        for worker in range(processes):  # each takes one of these folders
            (Path(folder) / str(worker)).mkdir()
        taken = context.Value("i", 0)
        now = context.RawArray("q", 1 << 20)
        with ProcessPoolExecutor(processes, context, _begin, (folder, taken, now)) as pool:
            shares = pool.submit(_shares).result()
            wanted = {name: shares[name] for name in shares if not parts or name in parts}
            pieces = list(pieces_of(wanted, inputs, slice_of))
            return _collected([(piece, pool.submit(_feed, slot, piece)) for slot, piece in enumerate(pieces)], now)


def pieces_of(shares: dict[str, float], inputs: int, slice_of: tuple[int, int] = (1, 1)) -> Iterator[Piece]:
    """Return the pieces of all doors, or those of a slice; they do not depend on the number of processes."""
    return islice(_all_pieces(shares, inputs), slice_of[0] - 1, None, slice_of[1])


def _all_pieces(shares: dict[str, float], inputs: int) -> Iterator[Piece]:
    total = sum(shares.values())
    for name, share in shares.items():
        left, size = max(1, round(inputs * share / total)), max(1, round(PIECE * share))
        for number in range(-(-left // size)):
            yield Piece(name, number, min(size, left - number * size))


def _collected(pieces: Sequence[tuple[Piece, Future[Report]]], now: MutableSequence[int]) -> Fed:
    reports: dict[str, Report] = {}
    crashes = []
    for slot, (piece, future) in enumerate(pieces):
        try:
            reports.setdefault(piece.door, Report(piece.door)).add(future.result())
        except BrokenProcessPool:
            if now[slot]:
                crashes.append(f"{piece.door}, piece {piece.number}, input {now[slot]}")
    return Fed([one for one in reports.values() if one.inputs], crashes)


def rows_of(reports: Sequence[Report]) -> list[Row]:
    """Return the rows of all doors together, and of each its rate."""
    fed, seconds = sum(one.inputs for one in reports), sum(one.whole_s for one in reports)
    slowest = max(reports, key=lambda one: one.slowest_s)
    starved, most = sum(one.starved for one in reports), MOST_BYTES >> 20
    return [
        measured(f"fuzz: escaped of {fed:,} inputs", sum(one.escapes for one in reports), "errors", goal=at_most(0)),
        measured("fuzz: refused", 100 * sum(one.refused for one in reports) / fed, "%"),
        measured(f"fuzz: slowest input ({slowest.name})", slowest.slowest_s, "s", goal=at_most(MOST_SECONDS)),
        measured(f"fuzz: inputs that want more than {most} MiB", starved, "inputs", goal=at_most(0)),
        measured("fuzz: rate, one process", fed / seconds, "inputs/s"),
        *(
            measured(f"fuzz: {one.name}, {one.inputs:,} inputs", one.inputs / max(one.seconds, 1e-9), "inputs/s")
            for one in reports
        ),
    ]


def tell(report: Report) -> None:
    """Print what escaped, with its first input, to standard error."""
    for place, (count, data) in report.escaped.items():
        print(f"{report.name}: {count} × {place}: {data[:200]!r}", file=sys.stderr)


def _memory_disk() -> str | None:
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


_OWN: dict[str, Any] = {}
"""Of a process that feeds: its doors, and where it notes which input it reads."""


def _begin(folder: str, taken: Any, now: MutableSequence[int]) -> None:
    """Make the doors of a new process."""
    from benchmarks._doors import doors

    with taken.get_lock():
        own, taken.value = Path(folder) / str(taken.value), taken.value + 1
    _silence_libraries()
    _OWN.update(doors={door.name: door for door in doors(own)}, now=now)


def _silence_libraries() -> None:
    """Libraries of images print a line for each damaged one; what the process says of its own end is kept."""
    import cv2

    cv2.setNumThreads(1)  # a thread's stack counts as memory
    kept = os.fdopen(os.dup(2), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    sys.stderr = kept


def _shares() -> dict[str, float]:
    return {name: door.share for name, door in _OWN["doors"].items()}


def _feed(slot: int, piece: Piece) -> Report:
    with Watch() as watch:
        at = memoryview(_OWN["now"]).cast("B").cast("q")[slot : slot + 1]
        return feed(_OWN["doors"][piece.door], piece.inputs, f"{SEED}.{piece.number}", watch=watch, now=at)
