"""Check that only this user can write to the folder of compiled kernels: numba loads pickles and machine code there."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from mocapella.sources.source import Finding

_WHAT = "compiled kernels"


def kernel_folder_finding() -> Finding:
    """Return `doctor`'s finding about the folder of compiled kernels."""
    from mocapella.geometry.turn_kernels import turned

    path = turned.stats.cache_path
    if path is None:
        advice = "name a folder of your own in NUMBA_CACHE_DIR; without one, every start compiles again"
        return Finding(_WHAT, "note", "no folder can be written", advice)
    return folder_finding(Path(path))


def folder_finding(folder: Path) -> Finding:
    """Return the finding about a folder: a problem if another user can put files there or into a folder above it."""
    open_ = next((one for one in (folder, *folder.parents) if _others_write(one, above=one != folder)), None)
    if open_ is None:
        return Finding(_WHAT, "ok", f"{folder}; only you can write there")
    return Finding(
        _WHAT,
        "problem",
        f"other users can write to {open_}, and so run code as you",
        f"chmod go-w {open_}, remove the files in {folder}, or name a folder of your own in NUMBA_CACHE_DIR",
    )


def _others_write(folder: Path, *, above: bool) -> bool:
    """Return whether another user can replace files there; in a folder above it, a sticky bit prevents that."""
    try:
        found = folder.stat()
    except OSError:  # not made yet
        return False
    if not hasattr(os, "getuid"):
        return False
    if found.st_uid not in (0, os.getuid()):
        return True
    if above and found.st_mode & stat.S_ISVTX:
        return False
    if found.st_mode & stat.S_IWOTH:
        return True
    return bool(found.st_mode & stat.S_IWGRP) and _shared(found.st_gid)


def _shared(group: int) -> bool:
    """Whether a group has a member besides this user and root."""
    import grp
    import pwd

    mine = pwd.getpwuid(os.getuid()).pw_name
    try:
        members = set(grp.getgrgid(group).gr_mem)
    except KeyError:
        members = set()
    members |= {user.pw_name for user in pwd.getpwall() if user.pw_gid == group}
    return bool(members - {mine, "root"})
