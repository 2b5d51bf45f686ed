"""Files and folders of exports: written in a hidden folder, moved once complete, and replaced only if wished."""

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
        path: the file that appears, complete or not at all, or the folder of files, if a folder is written.
        force: whether an existing file is replaced. Of an existing folder, the files of equal names are replaced one by
            one; others, such as what another program made of them, stay.

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
            files = sorted(part.iterdir()) if part.is_dir() else [part]
            for file in files:
                file.chmod(usual_mode())
            if part.is_dir():
                part.chmod(usual_mode() | (usual_mode() & 0o444) >> 2)  # who may read it may enter it
            if part.is_dir() and path.is_dir():
                for file in files:
                    file.replace(path / file.name)
            else:
                part.replace(path)
    except OSError as error:
        fix = "; name a file in a folder that exists" if isinstance(error, FileNotFoundError) else ""
        raise SettingsError(f"{path} cannot be written: {error.strerror or error}{fix}") from error
