"""Messages in a row on a stream, each after its length as a varint: protobuf's ``writeDelimitedTo``."""

from __future__ import annotations

from collections.abc import Iterator

from mocapella.errors import WireError
from mocapella.schema.checks import MAX_MESSAGE_BYTES

_LONGEST_VARINT = 5
"""Bytes; four hold every length that is allowed, and some writers always take five."""


def delimited(message: bytes) -> bytes:
    """The message after its length, as it goes onto a stream."""
    length, prefix = len(message), bytearray()
    while length > 0x7F:
        prefix.append(length & 0x7F | 0x80)
        length >>= 7
    prefix.append(length)
    return bytes(prefix) + message


class DelimitedReader:
    """Cuts a stream that arrives in pieces of any size into messages.

    A length is checked as soon as it is complete, before the message that it announces is waited for.
    """

    def __init__(self, limit: int = MAX_MESSAGE_BYTES) -> None:
        self._limit = limit
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        """Bytes of a message that has begun and is not complete."""
        return len(self._buffer)

    def feed(self, piece: bytes) -> Iterator[bytes]:
        """The messages that are complete with this piece.

        Raises:
            WireError: a length is no varint or above the limit; what follows cannot be made sense of.
        """
        self._buffer += piece
        while (found := self._length()) is not None:
            begin, length = found
            if len(self._buffer) < begin + length:
                return
            message = bytes(self._buffer[begin : begin + length])
            del self._buffer[: begin + length]
            yield message

    def _length(self) -> tuple[int, int] | None:
        """Where the first message begins and how long it is; None where its length is not complete."""
        length = 0
        for place, byte in enumerate(self._buffer[:_LONGEST_VARINT]):
            length |= (byte & 0x7F) << 7 * place
            if byte < 0x80:
                if length > self._limit:
                    raise WireError(f"a message of {length} bytes is announced; at most {self._limit} are read")
                return place + 1, length
        if len(self._buffer) >= _LONGEST_VARINT:
            raise WireError("no length before the message; write each with its length first, as writeDelimitedTo does")
        return None
