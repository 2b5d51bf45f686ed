"""Texts that are not quite valid: JSON, TOML and tables, changed where a reader of them may trip."""

from __future__ import annotations

import random
import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

TOKENS: Final = re.compile(rb'"(?:[^"\\\n]|\\.)*"|-?\d[\d.eE+-]*|[A-Za-z_][\w-]*|[\[\]{}(),:=;]')
NUMBERS: Final = (
    b"0", b"-0", b"-1", b"1e999", b"NaN", b"nan", b"inf", b"1e308", b"-1e308", b"1e-320", b"0x7f", b"true", b"null",
    b"9223372036854775808", b"18446744073709551616", b"1" * 40, b"9" * 5000, b"0." + b"3" * 3000, b"1_000",
    b"1979-05-27",
)  # fmt: skip
TEXTS: Final = (
    b'""', b'"\\u0000"', b'"\\ud800"', b'"=1+1"', b'"\xff\xfe"', b'"\xe2\x80\xae"', b'"x\\u001b[2J"', b'"CON"', b"''",
    b'"' + b"x" * 5000 + b'"',
)  # fmt: skip
NESTS: Final = (b"[" * 3000, b'{"a":' * 3000, b"[" * 70 + b"]" * 70, b"a." * 3000, b"[]", b"{}", b"[[]]", b"[1,[2]]")


def replace_token(text: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    """Replace a word, a number or a bracket by another, by nothing, or by a strange one."""
    found = _tokens(text)
    if not found:
        return text
    begin, end = rng.choice(found)
    strange = rng.choice((NUMBERS, TEXTS, NESTS, (b"",)))
    other = text[slice(*rng.choice(found))]
    return text[:begin] + rng.choice((*rng.sample(strange, 1), other)) + text[end:]


def repeat_token(text: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    """Write a stretch of the text several times."""
    found = _tokens(text)
    if not found:
        return text
    (begin, _), (_, end) = sorted((rng.choice(found), rng.choice(found)))
    return text[:begin] + text[begin:end] * rng.choice((2, 3, 50)) + text[end:]


def drop_stretch(text: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    """Leave out everything between two places."""
    begin, end = sorted((rng.randrange(len(text) + 1), rng.randrange(len(text) + 1)))
    return text[:begin] + text[end:]


@lru_cache(maxsize=256)
def _tokens(text: bytes) -> list[tuple[int, int]]:
    """Places of tokens in the beginning of a text: a large one is not searched whole."""
    return [match.span() for match in TOKENS.finditer(text[:20_000])]
