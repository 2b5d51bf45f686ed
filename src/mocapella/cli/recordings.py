"""Open recordings for commands: takes, which several commands read, and recordings to track."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from mocapella.cli.common import say
from mocapella.exports.export import EXPORTS, left_out
from mocapella.live.recorded_take import missing_of
from mocapella.live.recordings import find_recording
from mocapella.recording.take_reader import Take, read_take


def open_take(file: Path) -> Take:
    """Read a take, found as by `find_recording`; damaged entries are skipped. Repeated calls return the same object.

    Raises:
        InputError: the file is missing, empty, or no take; or nothing in it is readable.
        SchemaVersionError: the take was made with another message schema.
    """
    found = find_recording(file).absolute()
    is_now = found.stat()
    return _take(found, is_now.st_mtime_ns, is_now.st_size)


@lru_cache(maxsize=1)
def _take(path: Path, _modified_ns: int, _size: int) -> Take:
    take = read_take(path)
    take.skips = True
    return take


def tell_left_out(export: str, file: Path) -> None:
    """Print which parts of a take an export leaves out, and which packages of the take are not installed.

    Args:
        export: name of the export, a key of `EXPORTS`.
        file: the take.

    Raises:
        InputError, SchemaVersionError: as in `open_take`.
    """
    take = open_take(file)
    left = left_out(EXPORTS[export], take.part_counts)
    if left:
        parts = ", ".join(f"{name} ({count})" for name, count in left.items())
        say(f"{take.path.name}: left out by export {export}: {parts}; `mocapella export json` writes everything")
    for missing in missing_of(take):
        say(f"{take.path.name}: {missing}")
