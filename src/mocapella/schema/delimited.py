"""Length-delimited messages on a byte stream, each preceded by its length as a varint (``writeDelimitedTo``)."""

from __future__ import annotations

from collections.abc import Iterator

from mocapella.errors import WireError
from mocapella.schema.checks import MAX_MESSAGE_BYTES

_LONGEST_VARINT = 5
"""Longest varint in bytes; four hold every valid length, and some writers always use five."""


def delimited(message: bytes) -> bytes:
    """Return a message's bytes, preceded by the message's length as a varint, for writing to a stream."""
    length, prefix = len(message), bytearray()
    while length > 0x7F:
        prefix.append(length & 0x7F | 0x80)
        length >>= 7
    prefix.append(length)
    return bytes(prefix) + message


class DelimitedReader:
    """Splits a byte stream, received in chunks of any size, into messages.

    A message's length is checked as soon as it has arrived, before the message's content has.

    Args:
        limit: largest length of a message, in bytes.
    """

    def __init__(self, limit: int = MAX_MESSAGE_BYTES) -> None:
        self._limit = limit
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        """Number of received bytes of the last, incomplete message."""
        return len(self._buffer)

    def feed(self, piece: bytes) -> Iterator[bytes]:
        """Yield the messages that the stream's next chunk completes, without their lengths; none if it completes none.

        An incomplete message is kept for the next call. Even the chunk is stored only when the result is iterated.

        Raises:
            WireError: a length is no varint, or above the limit; the remaining stream is then unusable.
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
        """Return the offset and length of the first message; None if its length is incomplete."""
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
