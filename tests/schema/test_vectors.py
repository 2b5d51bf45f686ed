"""The test vectors, both ways: the bytes say these values, and these values give the bytes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vectors.generate import values, vectors

from mocapella.model.observations import body_frame
from mocapella.model.topology import topology
from mocapella.schema import decode_frame, decode_scene, decode_truth, encode_frame
from mocapella.schema.delimited import DelimitedReader

FOLDER = Path(__file__).resolve().parent.parent / "vectors"
NAMES = sorted(path.stem for path in FOLDER.glob("*.bin"))
MESSAGES = [name for name in NAMES if not name.startswith("stream")]
FRAMES = [name for name in NAMES if name.startswith("frame")]
DECODERS: dict[str, Any] = {
    "BodyFrame": decode_frame,
    "MarkerFrame": decode_frame,
    "PoseFrame": decode_frame,
    "DepthFrame": decode_frame,
    "ArmFrame": decode_frame,
    "ImageFrame": decode_frame,
    "KeypointFrame": decode_frame,
    "OtherFrame": decode_frame,
    "Scene": decode_scene,
    "Truth": decode_truth,
}


def read(name: str) -> tuple[bytes, dict[str, Any]]:
    return (FOLDER / f"{name}.bin").read_bytes(), json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def test_every_vector_that_the_script_writes_is_there_and_no_other() -> None:
    assert sorted(vectors()) == NAMES
    assert sorted(path.stem for path in FOLDER.glob("*.json")) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_the_script_writes_the_files_as_they_are(name: str) -> None:
    data, content = read(name)
    made, made_values = vectors()[name]
    if name.startswith("depth"):  # Zstandard's versions pack the same numbers into other bytes
        assert values(decode_frame(made)) == values(decode_frame(data))
        made = data
    assert made == data
    assert {"bytes": len(data), "hex": data.hex(), **made_values} == content


@pytest.mark.parametrize("name", MESSAGES)
def test_the_bytes_say_the_values(name: str) -> None:
    data, content = read(name)
    decoded = DECODERS[content["message"]](data)
    assert values(decoded) == {key: content[key] for key in content if key not in ("bytes", "hex")}


@pytest.mark.parametrize("name", FRAMES)
def test_the_values_give_the_bytes(name: str) -> None:
    data, content = read(name)
    numbers = {key: int(content[key]) for key in ("node_id", "sequence", "time_ns", "sent_ns")}
    arrays = {key: _array(content[key]) for key in ("depth_px", "orientations") if content[key] is not None}
    frame = body_frame(
        content["sensor"],
        topology(content["topology"]),
        positions=_array(content["positions_m"]),
        states=content["joint_states"],
        tracking_ids=[int(identity) for identity in content["tracking_ids"]],
        tracked=content["tracked"],
        clipped_edges=content["clipped_edges"],
        depth_size_px=(content["depth_width_px"], content["depth_height_px"]),
        tilt=content["tilt_rad"],
        height=content["height_m"],
        **numbers,
        **arrays,
    )
    assert encode_frame(frame) == data


def test_the_stream_is_its_frames_in_a_row() -> None:
    data, content = read("stream_two_frames")
    assert list(DelimitedReader().feed(data)) == [read(name)[0] for name in content["stream"]]


def _array(lists: Any) -> np.ndarray:
    return np.array(lists, dtype=np.float64)  # null becomes NaN
