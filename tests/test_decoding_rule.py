"""Only `mocapella.decoding` calls the decoders of the libraries; every exception is listed with its reason.

docs/decisions/0024-files-are-doors.md says why.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest
from support.syntax import nodes_of

SOURCE = Path(__file__).resolve().parent.parent / "src" / "mocapella"
DOOR = "decoding/"

UNSAFE = {
    "msgspec": {"convert"},
    "msgspec.json": {"decode", "Decoder"},
    "msgspec.msgpack": {"decode", "Decoder"},
    "msgspec.toml": {"decode"},
    "msgspec.yaml": {"decode"},
    "json": {"load", "loads", "JSONDecoder"},
    "tomllib": {"load", "loads"},
    "csv": {"reader", "DictReader"},
    "gzip": {"open", "decompress", "GzipFile"},
    "bz2": {"open", "decompress", "BZ2File"},
    "lzma": {"open", "decompress", "LZMAFile"},
    "zlib": {"decompress", "decompressobj"},
    "zipfile": {"ZipFile"},
    "pickle": {"load", "loads", "Unpickler"},
    "h5py": {"File"},
    "xml.etree.ElementTree": {"fromstring", "parse", "iterparse", "XML"},
    "marshal": {"load", "loads"},
    "cv2": {"imdecode", "imdecodemulti", "imread", "imreadmulti"},
    "polars": {"scan_parquet", "read_parquet", "read_csv", "scan_csv", "read_ipc", "scan_ipc"},
    "np": {"dtype", "load", "loadtxt", "genfromtxt", "fromstring", "fromfile", "memmap"},
}
"""Functions by module as it is called in sources. `np.dtype` is fine with a literal."""
WHOLE = {"read_text", "read_bytes"}
"""Methods that read a file of any size."""

NAMES = WHOLE.union(*UNSAFE.values())

ALLOWED = {
    "kernel_cache.py: read_bytes": "reads this program's sources",
    "settings.py: msgspec.convert": "its mappings come from `decoding`",
    "fusion/facing_model.py: read_bytes": "reads a file of this program",
    "fusion/joint_bias.py: read_bytes": "reads a file of this program",
    "kinematics/body_model.py: read_text": "reads a file of this program",
    "model/gltf.py: np.dtype": "of a table of its own",
    "model/hand.py: read_text": "reads a file of this program",
    "model/memory.py: np.dtype": "of a text that it has checked",
    "model/topology.py: read_text": "reads a file of this program",
    "viewer/study_page.py: read_text": "reads a file of this program",
    "recording/body_csv.py: np.loadtxt": "of blocks that `decoding` has read",
    "recording/study_log.py: csv.reader": "of blocks that `decoding` has read",
    "recording/study_log.py: gzip.GzipFile": "writes",
    "sensing/images.py: cv2.imdecode": "the door of images: reads the header first",
    "sources/simulate/keypoint_errors.py: read_bytes": "reads a file of this program",
    "sources/simulate/measured.py: read_bytes": "reads a file of this program",
    "studies/planner/planned_room.py: read_text": "reads a file of this program",
    "tracker/limb_recovery.py: json.loads": "a generator's state has integers of 128 bits; `recalling` guards it",
    "exports/motion_page.py: read_text": "reads a file of this program",
    "studies/protocol.py: read_bytes": "reads a file of this program",
    "viewer/page.py: read_bytes": "reads a file of this program",
}
"""By ``path: what``, the reason."""


def unsafe(source: str) -> set[str]:
    """Return the unsafe functions that a module mentions, called or not; not `np.dtype` of literals."""
    nodes = nodes_of(source)
    harmless = {
        id(node.func) for node in nodes if isinstance(node, ast.Call) and node.args and _is_literal(node.args[0])
    } | {id(node.value) for node in nodes if isinstance(node, ast.Subscript)}  # np.dtype[np.float64] is a type
    found = set()
    for node in nodes:
        if isinstance(node, ast.Attribute) and node.attr in NAMES:
            owner = ast.unparse(node.value).replace("numpy", "np")
            if node.attr in WHOLE:
                found.add(node.attr)
            elif node.attr in UNSAFE.get(owner, ()) and not (node.attr == "dtype" and id(node) in harmless):
                found.add(f"{owner}.{node.attr}")
        elif isinstance(node, ast.ImportFrom):
            unsafe_names = UNSAFE.get(str(node.module), set())
            found |= {f"{node.module}.{alias.name}" for alias in node.names if alias.name in unsafe_names}
    return found


def _is_literal(node: ast.AST) -> bool:
    names = [n for n in ast.walk(node) if isinstance(n, ast.Name)]
    return not names or isinstance(node, ast.Tuple | ast.List)


@cache
def found() -> set[str]:
    places = {path.relative_to(SOURCE).as_posix(): path for path in SOURCE.rglob("*.py")}
    return {
        f"{place}: {what}"
        for place, path in places.items()
        if not place.startswith(DOOR)
        for what in unsafe(path.read_text(encoding="utf-8"))
    }


def test_no_other_module_calls_a_decoder_of_a_library() -> None:
    assert found() - ALLOWED.keys() == set()


def test_every_exception_is_still_needed() -> None:
    assert ALLOWED.keys() - found() == set()


@pytest.mark.parametrize(
    "planted",
    [
        "msgspec.json.decode(data)",
        "msgspec.json.Decoder(int).decode",
        "msgspec.msgpack.decode(data)",
        "msgspec.convert(data, int)",
        "json.loads(text)",
        "json.load(file)",
        "tomllib.loads(text)",
        "csv.DictReader(file)",
        "gzip.decompress(data)",
        "gzip.open(path)",
        "zlib.decompressobj()",
        "h5py.File(path)",
        "pickle.loads(data)",
        "cv2.imdecode(data, 1)",
        "cv2.imread(name)",
        "np.dtype(text)",
        "numpy.load(path)",
        "np.loadtxt(path)",
        "Path(name).read_text()",
        "path.read_bytes()",
    ],
)
def test_the_rule_bites(planted: str) -> None:
    assert unsafe(f"def f():\n    return {planted}\n") != set()


@pytest.mark.parametrize(
    "planted",
    [
        "from json import loads",
        "from xml.etree.ElementTree import fromstring",
        "from tomllib import loads",
        "from msgspec import convert",
    ],
)
def test_the_rule_bites_for_an_import(planted: str) -> None:
    assert unsafe(planted) != set()


@pytest.mark.parametrize(
    "fine",
    ["json.dumps(x)", "msgspec.json.encode(x)", "np.dtype('<f4')", "csv.writer(f)", "zlib.crc32(x)"],
)
def test_the_rule_lets_others_through(fine: str) -> None:
    assert unsafe(f"x = {fine}") == set()
