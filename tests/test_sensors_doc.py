"""docs/sensors.md says of every topology what its file says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mocapella.model.skeleton import SKELETON
from mocapella.model.topology import topology, topology_names
from mocapella.recording.body_csv import FARTHEST_M, NEAREST_M
from mocapella.sources.recorded_track import MAX_STEP_BACK

TEXT = (Path(__file__).resolve().parent.parent / "docs" / "sensors.md").read_text(encoding="utf-8")
ROWS = {cells[0]: cells for cells in re.findall(r"^\| `(\w+)` \| ([^|]+) \| (\d+) \| ([^|]*)\|$", TEXT, re.MULTILINE)}
NAMES = {
    "HandTip": "hand tips",
    "Hand": "hands",
    "Thumb": "thumbs",
    "Wrist": "wrists",
    "Ankle": "ankles",
    "Foot": "feet",
}


def test_every_topology_of_bodies_is_in_the_table() -> None:
    assert set(ROWS) == set(topology_names()) - {"hand"}


@pytest.mark.parametrize("name", ROWS)
def test_joints_are_counted_and_those_that_people_lack_are_named(name: str) -> None:
    kind = topology(name)
    _, _, joints, lacking = ROWS[name]
    assert int(joints) == len(kind)
    mapped = set(range(25)) if kind is SKELETON else set(kind.mappings[SKELETON.name])
    missing = {SKELETON.joints[joint] for joint in set(range(25)) - mapped}
    said = {word for word in re.split(", | and ", lacking.strip()) if word}
    assert said == {NAMES[joint.removesuffix("Left")] for joint in missing if joint.endswith("Left")}
    assert all(joint.endswith(("Left", "Right")) for joint in missing)


def test_the_limits_are_the_readers() -> None:
    assert (FARTHEST_M, NEAREST_M, MAX_STEP_BACK) == (100.0, 0.1, 0.5)
    assert "100 m away or all joints within 10 cm" in TEXT
    assert "out of order by up to half a second" in TEXT
