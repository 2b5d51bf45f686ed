"""The origin of a take: a checksum of its files, and one line for users."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from support.take_making import info, record

from mocapella.errors import InputError
from mocapella.recording.take import Command, TakeInfo
from mocapella.recording.take_origin import TakeOrigin, sha256_of
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter

SETTINGS = {"people": {"smoothing": "kalman"}, "rig": "x" * 99 + "\ny\n", "hand": "h" * 99}
CHANGES = {"method": "stand-still", "settings": SETTINGS, "none": {}}
ORIGIN = TakeOrigin("walk-1.mcap", "ab" * 32, "cd" * 16, "0.1.0", CHANGES)


def test_the_checksum_is_of_all_files_in_their_order(tmp_path: Path) -> None:
    parts = [tmp_path / "a", tmp_path / "b"]
    for part, content in zip(parts, (b"one", b"two" * 1_000_000), strict=True):
        part.write_bytes(content)
    assert sha256_of(parts) == hashlib.sha256(b"one" + b"two" * 1_000_000).hexdigest()
    assert sha256_of(parts[::-1]) != sha256_of(parts)
    with pytest.raises(InputError, match="gone"):
        sha256_of([tmp_path / "gone"])


def test_it_is_one_line_that_names_the_changes() -> None:
    text = str(ORIGIN)
    assert text.startswith(
        "tracked again from walk-1.mcap (take cdcdcdcd, SHA-256 abababababababab…): method stand-still"
    )
    assert "; people.smoothing kalman; rig of 2 lines; hand hhh" in text
    assert "h…; none {}" in text
    assert "\n" not in text
    assert len(text) < 250
    assert str(TakeOrigin("log.csv", "ab" * 32)).endswith("log.csv (SHA-256 abababababababab…): nothing changed")


def test_arguments_of_a_crafted_command_are_none() -> None:
    assert Command(0, 0, {"verb": "name", "arguments": {"person": 1}}).arguments == {"person": 1}
    for values in ({}, {"arguments": None}, {"arguments": [1]}):
        assert Command(0, 0, values).arguments == {}


def test_a_take_keeps_it_and_others_have_none(tmp_path: Path) -> None:
    for name, origin in (("a", ORIGIN), ("b", None)):
        own = info()
        made = TakeInfo(own.setup, own.started_unix_ns, own.started_ns, own.method_settings, origin=origin)
        writer = TakeWriter.create(tmp_path / f"{name}.mcap", info=made, reserve_bytes=0)
        record(writer, 0, 2)
        writer.close()
        assert read_take(tmp_path / f"{name}.mcap").info.origin == origin
