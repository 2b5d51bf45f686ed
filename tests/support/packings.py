"""Compressed forms of bytes, by name."""

from __future__ import annotations

import gzip
import io
import zipfile
from collections.abc import Callable

import zstandard


def zipped(data: bytes) -> bytes:
    """Return a zip of one file."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("inner.txt", data)
    return out.getvalue()


PACKED: dict[str, Callable[[bytes], bytes]] = {"gzip": gzip.compress, "zstd": zstandard.compress, "zip": zipped}
