"""Messages that are not quite ours: valid ones, damaged in the ways that networks and strangers damage them."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Any, Final

HUGE: Final = (2**31 - 1, 2**32 - 1, 2**62, 2**64 - 1)
STRANGE_BYTES: Final = (
    b"",
    b"\0" * 7,
    b"\xff" * 8,
    b"\0\0\xc0\x7f" * 75,  # NaN in every coordinate of a body
    b"\0\0\x80\x7f" * 75,  # infinity
    b"\xff\xff\x7f\x7f" * 75,  # the largest float32
    b"\xff" * 25,
    b"\x02" * 25,
)
STRANGE_TEXTS: Final = ("", "kinect_v1", "kinect_v3", "../front", "front\n", "ß", "x" * 5000)


def flip_bits(message: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    damaged = bytearray(message)
    for _ in range(rng.randint(1, 8)):
        damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def truncate(message: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    return message[: rng.randrange(len(message))]


def insert(message: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    at = rng.randrange(len(message))
    return message[:at] + rng.randbytes(rng.randint(1, 40)) + message[at:]


def splice(message: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others)
    return message[: rng.randrange(len(message))] + other[rng.randrange(len(other)) :]


def noise(message: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    return rng.randbytes(rng.randrange(400))


def claim_huge_length(message: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    """Another field at the end, which says that it is far longer than the message."""
    tag = varint(rng.randint(1, 30) << 3 | 2)
    return message + tag + varint(rng.choice(HUGE)) + rng.randbytes(rng.randrange(20))


def replace_field(message: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    """A field once more at the end, whose value protobuf takes instead of the first; well formed, and strange."""
    field = rng.randint(1, 19)
    form = rng.randrange(4)
    if form == 0:
        return message + varint(field << 3) + varint(rng.choice((0, 1, 2, 3, *HUGE)))
    if form == 1:
        return message + varint(field << 3 | 5) + rng.choice((b"\0\0\xc0\x7f", b"\0\0\x80\xff", b"\xff\xff\x7f\x7f"))
    value = rng.choice(STRANGE_BYTES) if form == 2 else rng.choice(STRANGE_TEXTS).encode()
    return message + varint(field << 3 | 2) + varint(len(value)) + value


MUTATIONS: Final[tuple[Callable[[bytes, random.Random, Sequence[bytes]], bytes], ...]] = (
    flip_bits,
    truncate,
    insert,
    splice,
    noise,
    claim_huge_length,
    replace_field,
)


def mutated(messages: Sequence[bytes], count: int, seed: int) -> Any:
    """``count`` damaged copies of ``messages``, the same ones for the same seed."""
    rng = random.Random(seed)
    for _ in range(count):
        yield rng.choice(MUTATIONS)(rng.choice(messages), rng, messages)


def varint(value: int) -> bytes:
    """A number as protobuf writes it: seven bits a byte, the lowest first, the top bit says that more follow."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
