"""Each reader of a text refuses content that libraries trip over, in one line of our own errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mocapella.calibration.sensor_layout import decode_layout, is_layout, load_layout
from mocapella.errors import InputError, MocapellaError
from mocapella.fusion import facing_model, joint_bias
from mocapella.model.board import load_board, parse_board
from mocapella.model.body_builds import mesh_of_build
from mocapella.model.camera_rig_file import decode_camera_rig, is_camera_rig, load_camera_rig
from mocapella.model.hand_file import decode_hand_shape, load_hand_shape
from mocapella.model.space import load_space
from mocapella.recording.bodies_file import read_json
from mocapella.recording.take import decode_run
from mocapella.sensing.colour_profile import decode_profile, load_profile
from mocapella.sources.depth_files import read_sidecar
from mocapella.sources.simulate.measured import errors_from_json
from mocapella.viewer.page_messages import decode_page_message
from mocapella.wire.questions import read_answer, read_question

DIGITS = b"1" * 5000
JSON = {
    "digits": b'{"version": ' + DIGITS + b"}",
    "nesting": b'{"version": ' + b"[" * 50_000,
    "no text": b'{"version": "\xff"}',
    "half a character": b'{"version": "\\ud800"}',
    "nothing": b"",
}
TOML = {
    "digits": b"columns = " + DIGITS,
    "nesting": b"columns = " + b"[" * 50_000,
    "no text": b'columns = "\xff"',
    "long key": b"a." * 30_000 + b"a = 1",
    "no date": b"columns = 1979-99-99",
}
OF_JSON: dict[str, Callable[[bytes], Any]] = {
    "layout": decode_layout,
    "hand": decode_hand_shape,
    "colours": decode_profile,
    "run": lambda data: decode_run(data, "a.mcap"),
    "facing": lambda data: facing_model.from_json(data, "facing.json"),
    "bias": lambda data: joint_bias.from_json(data, "bias.json"),
    "errors": lambda data: errors_from_json(data, "errors.json"),
    "build": lambda data: mesh_of_build(data.decode("utf-8", "surrogateescape")),
    "question": read_question,
    "answer": read_answer,
}
OF_TOML: dict[str, Callable[[bytes], Any]] = {"board": parse_board, "rig": decode_camera_rig}
FILES: dict[str, tuple[Callable[[Path], Any], bytes]] = {
    "layout": (load_layout, JSON["digits"]),
    "hand": (load_hand_shape, JSON["no text"]),
    "colours": (load_profile, JSON["nesting"]),
    "bodies": (read_json, JSON["digits"]),
    "board": (load_board, TOML["digits"]),
    "rig": (load_camera_rig, TOML["no text"]),
    "space": (load_space, TOML["nesting"]),
    "sidecar": (read_sidecar, TOML["digits"]),
}


def refusal(call: Callable[[], Any]) -> str:
    with pytest.raises(MocapellaError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("reader", OF_JSON)
def test_json_that_libraries_trip_over_is_refused(reader: str) -> None:
    for content in JSON.values():
        refusal(lambda content=content: OF_JSON[reader](content))


@pytest.mark.parametrize("reader", OF_TOML)
def test_toml_that_libraries_trip_over_is_refused(reader: str) -> None:
    for content in TOML.values():
        refusal(lambda content=content: OF_TOML[reader](content))


@pytest.mark.parametrize("reader", FILES)
def test_a_refused_file_is_named(reader: str, tmp_path: Path) -> None:
    read, content = FILES[reader]
    path = tmp_path / "crafted.txt"
    path.write_bytes(content)
    assert "crafted.txt" in refusal(lambda: read(path))


def test_what_a_file_may_be_is_asked_without_an_error() -> None:
    assert not any(is_layout(content) for content in JSON.values())
    assert not any(is_camera_rig(content) for content in TOML.values())


def test_a_field_whose_name_has_control_characters_is_named_in_one_line() -> None:
    """Also the names of a damaged message's fields come into errors, and from there into logs and terminals."""
    message = {"type": "ViewerCameraMessage", "fov": 1.0, "fa\n\x1b[2J": 0}
    with pytest.raises(InputError, match="unknown field") as caught:
        decode_page_message(msgspec.msgpack.encode(message))
    assert str(caught.value).isprintable()
    with pytest.raises(InputError) as caught:
        raise InputError("has no \r\n end", file="a\nb", field="c\x1b")
    assert str(caught.value) == r"a\nb: field c\x1b: has no \r\n end"
