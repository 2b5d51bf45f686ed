"""The generated module says what the .proto says; who edits one without the other finds out here."""

from __future__ import annotations

import ast
import shutil
import subprocess
from pathlib import Path

import google.protobuf
import pytest
from google.protobuf import descriptor_pb2

from mocapella.schema import mocapella_pb2

FOLDER = Path(mocapella_pb2.__file__).parent


def compiled(proto: str, folder: Path) -> descriptor_pb2.FileDescriptorProto:
    """What protoc makes of the text."""
    protoc = shutil.which("protoc")
    if protoc is None:
        pytest.skip("needs protoc (Debian: protobuf-compiler)")
    (folder / "mocapella.proto").write_text(proto, encoding="utf-8")
    out = folder / "set.bin"
    arguments = [protoc, f"--proto_path={folder}", f"--descriptor_set_out={out}", "mocapella.proto"]
    subprocess.run(arguments, check=True, timeout=60)
    return descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes()).file[0]


def fields(file: descriptor_pb2.FileDescriptorProto) -> dict[str, tuple[int, int, int, str]]:
    return {
        f"{message.name}.{field.name}": (field.number, field.type, field.label, field.type_name)
        for message in file.message_type
        for field in message.field
    }


def generated() -> descriptor_pb2.FileDescriptorProto:
    file = descriptor_pb2.FileDescriptorProto()
    mocapella_pb2.DESCRIPTOR.CopyToProto(file)
    return file


def test_every_field_is_as_the_proto_has_it(tmp_path: Path) -> None:
    file = compiled((FOLDER / "mocapella.proto").read_text(encoding="utf-8"), tmp_path)
    assert fields(generated()) == fields(file)
    assert (generated().package, generated().syntax) == (file.package, file.syntax)


def test_a_changed_proto_would_be_noticed(tmp_path: Path) -> None:
    text = (FOLDER / "mocapella.proto").read_text(encoding="utf-8")
    file = compiled(text.replace("float tilt_rad = 10;", "double tilt_rad = 10;"), tmp_path)
    assert fields(generated()) != fields(file)


def test_the_types_name_every_field_of_every_message() -> None:
    stub = ast.parse((FOLDER / "mocapella_pb2.pyi").read_text(encoding="utf-8"))
    typed = {
        message.name: {line.target.id for line in message.body if isinstance(line, ast.AnnAssign)}
        for message in stub.body
        if isinstance(message, ast.ClassDef)
    }
    for message in generated().message_type:
        names = {field.name for field in message.field}
        assert typed.pop(message.name) == names | {f"{name.upper()}_FIELD_NUMBER" for name in names}
    assert typed == {}


def test_it_is_generated_for_the_oldest_protobuf_that_is_allowed() -> None:
    head = (FOLDER / "mocapella_pb2.py").read_text(encoding="utf-8")[:400]
    assert "Protobuf Python Version: 4.25." in head  # later generators refuse older libraries
    assert (4, 25) <= tuple(int(part) for part in google.protobuf.__version__.split(".")[:2]) < (8, 0)
