"""Compiled kernels that are kept are of the kernels as they are now.

numba keeps what it has compiled beside the source (or where ``NUMBA_CACHE_DIR`` says), and compiles anew where that one
file has changed. But kernels call kernels of other files, and have their constants, which are compiled into them: after
an update those would still be the old ones, and with another layout of their arrays they would write where they must
not. So what is kept of a file of kernels is thrown away whenever it, or a file that it imports, is not as it was.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Final

STAMPS: Final = "kernels.json"
COMPILED: Final = "\nfrom mocapella.compiled import njit\n"
"""What stands in every file that is compiled."""
_IMPORT: Final = re.compile(r"^from mocapella\.([\w.]+) import (?:\(([^)]*)\)|(.*))$", re.MULTILINE)


def discard_stale(package: Path, cache: Path | None = None) -> list[str]:
    """Throw away what was compiled of other sources than those that are there.

    Where nothing can be written (a package that is installed for all), numba keeps its files elsewhere, and nothing is
    done here.

    Args:
        package: the folder of the package.
        cache: where numba keeps what it compiles, if not beside the sources.

    Returns:
        The files of kernels of which it was thrown away, by their path in the package.
    """
    stamps = kept_in(package, cache) / STAMPS
    try:
        was = json.loads(stamps.read_bytes())
    except (OSError, ValueError):
        was = {}
    texts = {path.relative_to(package).as_posix(): path.read_text(encoding="utf-8") for path in package.rglob("*.py")}
    imports = {name: _imports(text, texts) for name, text in texts.items()}
    compiled = sorted(name for name, text in texts.items() if COMPILED in text)
    now = {name: _state(package, name, imports) for name in compiled}
    if now == was:
        return []
    stale = [name for name, state in now.items() if not isinstance(was, dict) or was.get(name) != state]
    with contextlib.suppress(OSError):
        for name in stale:
            source = package / name
            for index in kept_in(source.parent, cache).glob(f"{source.stem}.*.nbi"):
                index.unlink(missing_ok=True)
        stamps.parent.mkdir(exist_ok=True, parents=True)
        stamps.write_text(json.dumps(now), encoding="ascii")
    return stale


def kept_in(folder: Path, cache: Path | None) -> Path:
    """Where numba keeps what it compiles of the sources of a folder; ``cache`` is as of `discard_stale`."""
    if cache is None:
        return folder / "__pycache__"
    whole = str(folder.absolute())  # as numba names it: links are not followed
    return cache / f"{folder.name}_{hashlib.sha1(whole.encode(), usedforsecurity=False).hexdigest()}"


def _state(package: Path, name: str, imports: Mapping[str, list[str]]) -> str:
    """Of a file and all of the package that it imports: their names, sizes and times, in short."""
    seen, open_ = set[str](), [name]
    while open_:
        one = open_.pop()
        if one not in seen:
            seen.add(one)
            open_ += imports[one]
    stats = [(one, (package / one).stat()) for one in sorted(seen)]
    told = "\n".join(f"{one} {stat.st_size} {stat.st_mtime_ns}" for one, stat in stats)
    return hashlib.blake2s(told.encode(), digest_size=12).hexdigest()


def _imports(text: str, files: Container[str]) -> list[str]:
    """Which of the package's files a source imports from: ``from mocapella.a import b`` may be a/b.py, or a.py."""
    found = []
    for module, several, one in _IMPORT.findall(text):
        folder = module.replace(".", "/")
        names = [name.split(" as ")[0].strip() for name in (several or one).split("#")[0].split(",")]
        candidates = [f"{folder}.py", f"{folder}/__init__.py", *(f"{folder}/{name}.py" for name in names if name)]
        found += [path for path in candidates if path in files]
    return found
