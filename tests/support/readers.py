"""Find every function that decodes content from outside, in the sources and in what runs."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import CodeType, FrameType

from support.syntax import parsed

SOURCE = Path(__file__).resolve().parents[2] / "src" / "mocapella"
DECODERS = {
    "decode_text", "decode_json", "decode_msgpack", "decode_toml", "decode_csv", "decode_csv_rows", "decode_xml",
    "decode_pickled_texts", "Hdf5", "convert", "read_whole", "text_blocks",
    "FromString", "ParseFromString", "MergeFromString", "unpack", "unpack_from", "iter_unpack", "from_bytes",
    "frombuffer", "fromhex", "unhexlify", "b64decode", "imdecode", "decompress", "decompressobj", "recv", "recvfrom",
    "recvmsg", "recv_into",
}  # fmt: skip
"""Functions and methods that decode: of `mocapella.decoding`, of messages, and of binary forms."""
_ANY = re.compile("|".join(DECODERS))


def readers(source: str, place: str) -> set[str]:
    """Return ``place:qualified name`` of each function that mentions a decoder; one within another for itself."""
    found = set()
    waiting: list[tuple[ast.AST, str, str]] = [(parsed(source), "", "")]
    while waiting:
        node, names, function = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            function = names + node.name
            names = f"{function}.<locals>."
        elif isinstance(node, ast.ClassDef):
            names, function = f"{names}{node.name}.", ""
        elif function and _decodes(node):
            found.add(f"{place}:{function}")
        waiting += [(child, names, function) for child in ast.iter_child_nodes(node)]
    return found


def _decodes(node: ast.AST) -> bool:
    return (isinstance(node, ast.Name) and node.id in DECODERS) or (
        isinstance(node, ast.Attribute) and node.attr in DECODERS
    )


def all_readers() -> set[str]:
    """Return the functions that decode in all sources."""
    texts = {path: path.read_text(encoding="utf-8") for path in SOURCE.rglob("*.py") if path.stem[-4:] != "_pb2"}
    return {
        found
        for path, text in texts.items()
        if _ANY.search(text)
        for found in readers(text, path.relative_to(SOURCE).as_posix())
    }


@dataclass
class Called:
    """The functions of the sources that were called.

    Attributes:
        codes: of each function.
    """

    codes: set[CodeType] = field(default_factory=set)

    @property
    def names(self) -> set[str]:
        """``place:qualified name`` of each function."""
        paths = {code: Path(code.co_filename) for code in self.codes}
        return {
            f"{path.relative_to(SOURCE).as_posix()}:{code.co_qualname}"
            for code, path in paths.items()
            if path.is_relative_to(SOURCE)
        }


@contextmanager
def functions_called() -> Iterator[Called]:
    """Collect the functions that this thread calls meanwhile."""
    called = Called()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            called.codes.add(frame.f_code)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield called
    finally:
        sys.setprofile(before)


def codes_of(function: object) -> set[CodeType]:
    """Return the code of a function, or of a partial's function and of the functions among its arguments."""
    if isinstance(function, partial):
        return set().union(*(codes_of(one) for one in (function.func, *function.args, *function.keywords.values())))
    code = getattr(function, "__code__", None)
    return set() if code is None else {code}
