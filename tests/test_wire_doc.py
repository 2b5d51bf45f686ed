"""`docs/wire.md` says what the code does: keys, verbs, limits, vectors, joint counts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import pytest

from mocapella.live.camera_service import CameraServiceSettings
from mocapella.live.relaying import CALM_S
from mocapella.live.session import Session
from mocapella.model.frame_types import HISTORY_FRAMES
from mocapella.model.session import Setup
from mocapella.model.topology import topology, topology_names
from mocapella.schema import MAX_BODIES, MAX_MESSAGE_BYTES, MAX_SCENE_BYTES, SCHEMA_VERSION
from mocapella.schema.arms import MAX_ARMS, MAX_REASON
from mocapella.schema.checks import MAX_NAME
from mocapella.schema.depth import MAX_DEPTH_PX, MAX_DEPTH_SIDE_PX, UNITS_M
from mocapella.schema.marker_datagrams import MAX_DATAGRAM_BYTES, MAX_MARKERS, DatagramProblem
from mocapella.sources.bridge import BridgeSettings
from mocapella.sources.bridge_messages import BridgeStart, read_message
from mocapella.sources.datagram_settings import DatagramSettings
from mocapella.wire import keys
from mocapella.wire.questions import MAX_ANSWER_BYTES, MAX_QUESTION_BYTES, Question
from mocapella.wire.session import DEFAULT_ADDRESS

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "wire.md").read_text(encoding="utf-8")
NODE = keys.NodeKey("SENSOR", 0x1234)


def test_every_key_is_listed() -> None:
    fixed = [keys.SCENE, keys.STATUS, keys.SERVER_ALIVE, keys.of_command("<verb>")]
    of_nodes = [
        keys.of_node(kind, NODE)
        for kind in ("live", "record", "truth", "clock", "ask", "join", "leave", "alive/sensor")
    ]
    for key in [*fixed, *(key.replace("SENSOR/0000000000001234", "<sensor>/<node>") for key in of_nodes)]:
        assert f"| `{key}` |" in TEXT


def test_every_verb_is_listed() -> None:
    for verb in (*Session(Setup()).verbs, "record", "record-stop", "status"):
        assert f"`{verb}`" in TEXT


def test_every_question_and_its_arguments_are_listed() -> None:
    for kind in get_args(Question):
        rows = [line for line in TEXT.splitlines() if line.startswith(f"| `{kind.__struct_config__.tag}` |")]
        assert len(rows) == 1
        assert all(f"`{name}`" in rows[0] for name in kind.__struct_fields__)
    desk, kib = CameraServiceSettings(), 2**10
    assert f"at most {MAX_QUESTION_BYTES // kib} KiB, an answer at most {MAX_ANSWER_BYTES // kib**2} MiB" in TEXT
    assert f"At most {desk.waiting} questions\nwait and {desk.a_second} a second are answered" in TEXT
    assert f"The last {desk.pictures} that were asked for are kept" in TEXT


def test_the_limits_are_those_of_the_code() -> None:
    bridge = BridgeSettings()
    mib = 2**20
    for said in (
        f"at most {MAX_MESSAGE_BYTES // mib} MiB; a `Scene` or `Truth` at most {MAX_SCENE_BYTES // mib} MiB",
        f"at most {MAX_BODIES} bodies",
        f"schema version {SCHEMA_VERSION}",
        f"1 to {MAX_DEPTH_SIDE_PX} each, at most {MAX_DEPTH_PX} pixels in all",
        f"| {UNITS_M[0]:g} to {UNITS_M[1]:g} |",
        f"at most {MAX_ARMS}, each with an id of its own",
        f"1 to {MAX_NAME}, at most {MAX_NAME}, at most {MAX_REASON} characters",
        f"not complete after {bridge.message_timeout:g} s",
        f"none for {bridge.idle_timeout:g} s",
        f"those beyond {bridge.max_connections}",
        f"(at most {bridge.max_sensors})",
        f"{bridge.host}:{bridge.port}",
        f"`{DEFAULT_ADDRESS}`",
    ):
        assert said in TEXT


@pytest.mark.parametrize("name", ["kinect_v1", "kinect_v2"])
def test_the_topologies_have_as_many_joints_as_it_says(name: str) -> None:
    assert name in topology_names()
    assert f"`{name}` has {len(topology(name))}" in TEXT


def test_every_vector_is_listed() -> None:
    for path in (ROOT / "tests" / "vectors").glob("*.bin"):
        assert f"| `{path.stem}` |" in TEXT


def test_what_it_says_of_acknowledgements_is_so() -> None:
    section = TEXT[TEXT.index("### Acknowledgements") : TEXT.index("### In C\n")]
    example = next(line.strip() for line in section.splitlines() if line.startswith('    {"say"'))
    start = read_message(example.encode())
    assert isinstance(start, BridgeStart)
    assert start.node_id == 0x0123456789ABCDEF  # of the test vectors
    assert set(json.loads(example)) == {"say", *BridgeStart.__struct_fields__}
    for field in BridgeStart.__struct_fields__:
        assert f"`{field}`" in section
    assert f"`window {HISTORY_FRAMES}`" in section
    assert f"was heard for {CALM_S:g} s" in section
    for message in ('{"say": "here"}', '{"say": "end"}'):
        assert f"`{message}`" in section
        read_message(message.encode())


def test_what_it_says_of_datagrams_is_so() -> None:
    settings = DatagramSettings((("left", 5001),), ("red",))
    for said in (
        f"At most {MAX_DATAGRAM_BYTES} bytes and {MAX_MARKERS} markers",
        f"at most {settings.max_rate_hz:g} frames a second",
        f"silent for {settings.source_timeout:g} s",
        f"the text `{settings.start_text}`",
    ):
        assert said in TEXT
    assert settings.start_every == 1.0
    section = " ".join(TEXT[TEXT.index("## Markers as text") :].split())
    assert all(f"`{problem}`" in section for problem in DatagramProblem)


def test_links_lead_somewhere() -> None:
    for target in TEXT.split("](")[1:]:
        path = target.split(")")[0].partition("#")[0]
        if path:
            assert (ROOT / "docs" / path).exists(), path
