"""What a door is: a reader of content from outside, with damaged copies of valid inputs."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmarks._mutations import flip_bits, insert, splice, truncate
from benchmarks._text_mutations import drop_stretch, repeat_token, replace_token

Damage = Callable[[bytes, random.Random, Sequence[bytes]], bytes]
BYTES: Final[tuple[Damage, ...]] = (flip_bits, truncate, insert, splice)
TEXT: Final[tuple[Damage, ...]] = (*BYTES, replace_token, replace_token, replace_token, repeat_token, drop_stretch)


@dataclass(frozen=True)
class Door:
    """A reader of content from outside.

    Attributes:
        name: of it.
        share: of all inputs, relative to the other doors: small for what is slow.
        inputs: yields a callable for each damaged input, which reads it, and the input's bytes for a report.
    """

    name: str
    share: float
    inputs: Callable[[random.Random], Iterator[tuple[Callable[[], Any], bytes]]]


def of_bytes(
    name: str, valid: Sequence[bytes], read: Callable[[bytes], Any], damage: Sequence[Damage], share: float = 1.0
) -> Door:
    """Return the door of a reader of bytes."""

    def inputs(rng: random.Random) -> Iterator[tuple[Callable[[], Any], bytes]]:
        while True:
            data = rng.choice(damage)(rng.choice(valid), rng, valid)
            yield (lambda data=data: read(data)), data

    read_valid(name, valid, read)
    return Door(name, share, inputs)


def read_valid(name: str, valid: Sequence[bytes], read: Callable[[bytes], Any]) -> None:
    """Check that a door opens to its seeds: refused ones would test nothing."""
    for seed in valid:
        try:
            read(seed)
        except Exception as error:
            raise AssertionError(f"{name}: the valid input is refused: {error!r}") from error


def of_file(
    name: str, path: Path, valid: Sequence[bytes], read: Callable[[Path], Any], damage: Sequence[Damage], *,
    share: float = 0.1,
) -> Door:  # fmt: skip
    """Return the door of a reader of a file; ``path`` is where its inputs are written."""

    def written(data: bytes) -> None:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        read(path)

    return of_bytes(name, valid, written, damage, share)
