"""Files of exports: written in a hidden folder and moved once complete, and replaced only if that is wished."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from mocapella.errors import SettingsError, TakeExistsError
from mocapella.model.whole_file import usual_mode


@contextmanager
def new_file(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a path of the same name to write to; move it to ``path`` afterwards, or remove it after an error.

    Args:
        path: the file that appears, complete or not at all.
        force: whether an existing file is replaced.

    Raises:
        TakeExistsError: the file exists, and ``force`` is not set.
        SettingsError: the file cannot be written.
    """
    if os.path.lexists(path) and not force:
        raise TakeExistsError(f"{path} exists; add --force to replace it, or name another file with --out")
    try:
        with TemporaryDirectory(prefix=".mocapella-", dir=path.parent) as folder:
            part = Path(folder) / path.name
            yield part
            part.chmod(usual_mode())
            part.replace(path)
    except OSError as error:
        fix = "; name a file in a folder that exists" if isinstance(error, FileNotFoundError) else ""
        raise SettingsError(f"--out {path}: {error.strerror or error}{fix}") from error
