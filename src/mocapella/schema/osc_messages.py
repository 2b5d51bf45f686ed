"""Encode OSC messages and bundles.

OSC 1.0 (M. Wright, *The Open Sound Control 1.0 Specification*, 2002); `mocapella.sources.osc` decodes it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from typing import Final

MOST_BYTES: Final = 1400
"""Largest size of a bundle of several messages [bytes]; a larger datagram may be split on its way, and lost sooner."""
_HEAD: Final = b"#bundle\0" + struct.pack(">Q", 1)  # the time tag 1: at once
_FORBIDDEN: Final = frozenset(" #*,/?[]{}")


def osc_message(address: str, *values: float | str) -> bytes:
    """Encode a message: an int is an int32, a float a float32, a text a string.

    Args:
        address: begins with ``/``; it and all texts have no null character.
        values: the arguments.
    """
    types, content = ",", b""
    for value in values:
        if isinstance(value, str):
            types, content = types + "s", content + _padded(value)
        elif isinstance(value, int):
            types, content = types + "i", content + struct.pack(">i", value)
        else:
            types, content = types + "f", content + struct.pack(">f", value)
    return _padded(address) + _padded(types) + content


def osc_bundles(messages: Iterable[bytes], most_bytes: int = MOST_BYTES) -> Iterator[bytes]:
    """Put messages into few bundles of at most ``most_bytes``, in their order; a larger message has its own bundle."""
    bundle = _HEAD
    for message in messages:
        part = struct.pack(">i", len(message)) + message
        if len(bundle) + len(part) > most_bytes and bundle != _HEAD:
            yield bundle
            bundle = _HEAD
        bundle += part
    if bundle != _HEAD:
        yield bundle


def osc_name(text: str) -> str:
    """Return a text as one part of an address: characters that OSC reserves, and those it does not print, become ``_``.

    The result is ASCII, as OSC asks for, and not empty.
    """
    return "".join("_" if one in _FORBIDDEN or not "!" <= one <= "~" else one for one in text) or "_"


def _padded(text: str) -> bytes:
    data = text.encode()
    return data + b"\0" * (4 - len(data) % 4)
