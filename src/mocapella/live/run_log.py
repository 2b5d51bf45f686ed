"""Structured log: one file of JSON lines for each run, in the user's state folder, with rotation.

A thread of its own writes the file, so that a slow disk slows nothing else.
"""

from __future__ import annotations

import json
import logging
import logging.handlers
import os
import queue
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from mocapella.supervision import printable

FOLDER_VARIABLE: Final = "MOCAPELLA_LOGS"
"""Environment variable with another folder for the logs."""
MOST_BYTES: Final = 5_000_000
"""Size of a file before it is rotated."""
KEPT_PIECES: Final = 2
"""Number of rotated files to keep for a run."""
KEPT_RUNS: Final = 50
"""Largest number of files in the folder, of all runs; the oldest are deleted when a file is begun."""
_WAITING: Final = 10_000
"""Largest number of entries that wait for the disk; further ones are lost."""
_LONGEST_TRACE: Final = 20_000


class JsonLines(logging.Formatter):
    """Formats an entry as one line of JSON, with the traceback of an error; every text is escaped."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line: an object with time (UTC), level, part, thread, text; if any, reason, count, traceback."""
        row = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created)) + f".{record.msecs:03.0f}Z",
            "level": record.levelname.lower(),
            "part": record.name.removeprefix("mocapella."),
            "thread": record.threadName,
            "text": printable(record.getMessage()),
        }
        for name in ("reason", "count"):
            if hasattr(record, name):
                row[name] = getattr(record, name)
        if record.exc_info:
            row["traceback"] = self.formatException(record.exc_info)[-_LONGEST_TRACE:]
        return json.dumps(row)


class _Waiting(logging.handlers.QueueHandler):
    """Passes entries to the writing thread; an entry that finds no room is lost."""

    def __init__(self, waiting: queue.Queue[logging.LogRecord], path: Path) -> None:
        super().__init__(waiting)
        self.path = path

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        record.msg, record.args = record.getMessage(), None
        return record

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - the name of the base class
        """Lose the entry."""


class _File(logging.handlers.RotatingFileHandler):
    """Writes the file, which is made with its first entry."""

    def _open(self) -> Any:
        folder = Path(self.baseFilename).parent
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _delete_oldest(folder)
        return super()._open()

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - the name of the base class
        """Lose the entry: neither a full nor a read-only disk may stop a session."""


class _Terminal(logging.Handler):
    """Prints warnings as one line, unless another line has their text; tracebacks are in the file only.

    A terminal that is closed gets nothing, and the caller no error.
    """

    def emit(self, record: logging.LogRecord) -> None:
        if not getattr(record, "told", False) and sys.stderr is not None:
            with suppress(OSError, ValueError):
                sys.stderr.write(printable(record.getMessage()) + "\n")


class RunLog:
    """The log of this run: all that this package logs from INFO on until `close`; warnings are also printed.

    Args:
        command: name of the command that runs; the file is named after it.
        folder: folder of the file; None for `log_folder`.

    Attributes:
        path: path of the file, which is made with the first entry.
    """

    def __init__(self, command: str, folder: Path | None = None) -> None:
        began = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        self.path = (folder or log_folder(os.environ)) / f"{command}-{began}-{os.getpid()}.jsonl"
        self._file = _File(self.path, maxBytes=MOST_BYTES, backupCount=KEPT_PIECES, encoding="utf-8", delay=True)
        self._file.setFormatter(JsonLines())
        waiting: queue.Queue[logging.LogRecord] = queue.Queue(_WAITING)
        self._listener = logging.handlers.QueueListener(waiting, self._file)
        self._listener.start()
        self._handlers: tuple[logging.Handler, ...] = (_Terminal(logging.WARNING), _Waiting(waiting, self.path))
        _logger().setLevel(logging.INFO)
        for handler in self._handlers:
            _logger().addHandler(handler)

    def close(self) -> None:
        """Write what waits, and end the log; may be called twice."""
        handlers, self._handlers = self._handlers, ()
        if not handlers:
            return
        for handler in handlers:
            _logger().removeHandler(handler)
        self._listener.stop()
        self._file.close()


def log_in_use() -> str:
    """Return the path of this process's log file; empty if it has none."""
    return next((str(one.path) for one in _logger().handlers if isinstance(one, _Waiting)), "")


def _logger() -> logging.Logger:
    return logging.getLogger("mocapella")


def log_folder(environment: Mapping[str, str]) -> Path:
    """Return the folder of the logs: the value of `FOLDER_VARIABLE`, or a folder in the user's state folder.

    ``environment`` has the environment variables. The folder may not exist yet.
    """
    if environment.get(FOLDER_VARIABLE):
        return Path(environment[FOLDER_VARIABLE])
    if sys.platform == "win32":
        base = Path(environment.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Logs"
    else:
        base = Path(environment.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return base / "mocapella" / "logs"


def _delete_oldest(folder: Path) -> None:
    files = sorted(folder.glob("*.jsonl*"), key=lambda path: path.stat().st_mtime)
    for path in files[: max(0, len(files) - KEPT_RUNS + 1)]:
        path.unlink(missing_ok=True)
