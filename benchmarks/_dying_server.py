"""``mocapella`` with a thread that dies: python -m benchmarks._dying_server THREAD FOLDER WORDS ….

Once the file ``die`` is in the folder, the thread of that name runs out of memory at its next work. It first writes the
monotonic time [ns] to the file ``died``.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from mocapella.cli import main
from mocapella.supervision import Boundary


def plant(name: str, folder: Path) -> None:
    """Let the thread of that name die in `Boundary.run`."""
    usual = Boundary.run

    def run(self: Boundary, what: str, work: Callable[[], object]) -> str:
        if threading.current_thread().name == name and (folder / "die").exists():
            (folder / "died").write_text(str(time.monotonic_ns()))
            raise MemoryError("planted")
        return usual(self, what, work)

    Boundary.run = run  # type: ignore[method-assign]


if __name__ == "__main__":
    plant(sys.argv[1], Path(sys.argv[2]))
    sys.argv[1:3] = []
    main()
