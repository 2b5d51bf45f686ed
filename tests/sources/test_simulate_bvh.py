"""BVH files: what the parser makes of good ones, and what it says of broken ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError, SettingsError
from mocapella.model.bvh import parse_bvh, read_bvh
from mocapella.sources.simulate import load_scene
from mocapella.sources.simulate.body import BODY, JOINT, facing, joint_positions
from mocapella.sources.simulate.retarget import bvh_motion, joint_columns
from mocapella.sources.simulate.scenarios import STILL_S

FILES = (
    ("bvh-python/test_freebvh.bvh", 69, 168),
    ("bvh-python/test_mocapbank.bvh", 455, 60),
    ("PyMO/AV_8Walk_Meredith_HVHA_Rep1.bvh", 1064, 72),
)

ARM = """HIERARCHY
ROOT Shoulder
{
  OFFSET 9 9 9
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Upper Arm
  {
    OFFSET 0 -3 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -2 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3 0 0 0 0 0 0
1 2 3 90 0 0 0 90 0
"""


def test_a_tree_with_its_channels_and_end_sites() -> None:
    bvh = parse_bvh(ARM)
    assert [joint.name for joint in bvh.joints] == ["Shoulder", "Upper Arm", "Upper Arm end"]
    assert [joint.parent for joint in bvh.joints] == [-1, 0, 1]
    assert bvh.joints[1].channels == ("Zrotation", "Xrotation", "Yrotation")
    assert (bvh.frame_s, bvh.channels.shape) == (0.04, (2, 9))
    # A quarter turn about z takes −y to x; the forearm's quarter turn about its own x then takes −y to −z.
    np.testing.assert_allclose(bvh.positions()[0], [[1, 2, 3], [1, -1, 3], [1, -3, 3]], atol=1e-12)
    np.testing.assert_allclose(bvh.positions()[1], [[1, 2, 3], [4, 2, 3], [4, 2, 1]], atol=1e-12)


@given(st.permutations("XYZ"), st.lists(st.floats(-180, 180), min_size=3, max_size=3))
def test_rotations_apply_in_the_order_of_the_file(order: list[str], angles: list[float]) -> None:
    channels = " ".join(f"{axis}rotation" for axis in order)
    text = ARM.replace("CHANNELS 3 Zrotation Xrotation Yrotation", f"CHANNELS 3 {channels}")
    row = "1 2 3 0 0 0 " + " ".join(str(angle) for angle in angles)
    bvh = parse_bvh(text.replace("1 2 3 90 0 0 0 90 0", row))
    expected = np.array([0.0, -2.0, 0.0])
    for axis, angle in reversed(list(zip(order, np.radians(angles), strict=True))):
        i, (c, s) = "XYZ".index(axis), (np.cos(angle), np.sin(angle))
        j, k = (i + 1) % 3, (i + 2) % 3
        expected[j], expected[k] = c * expected[j] - s * expected[k], s * expected[j] + c * expected[k]
    np.testing.assert_allclose(bvh.positions()[1, 2] - bvh.positions()[1, 1], expected, atol=1e-9)


STILL = "ROOT a\n{\nOFFSET 0 0 0\nCHANNELS 0\n}\nMOTION\nFrames: 1\nFrame Time: 1\n"
CHAIN = "".join(f"JOINT j{i} {{ OFFSET 0 1 0 CHANNELS 0\n" for i in range(1001))

BROKEN = [
    ("", 1, "ends where HIERARCHY"),
    ("hello", 1, "HIERARCHY should stand here"),
    (ARM.replace("OFFSET 0 -3 0", "OFFSET 0 x 0"), 8, "field OFFSET y: 'x': is no usable number"),
    (ARM.replace("OFFSET 0 -3 0", "OFFSET 0 nan 0"), 8, "field OFFSET y: 'nan'"),
    (ARM.replace("OFFSET 0 -3 0", "OFFSET 0 -1e308 0"), 8, "field OFFSET y: '-1e308'"),
    (ARM.replace("1 2 3 90", "1 2 1e300 90"), 20, "field channel 3: '1e300'"),
    (ARM.replace("CHANNELS 3 Z", "CHANNELS 7 Z"), 9, "field CHANNELS: '7'"),
    (ARM.replace("CHANNELS 3 Zrot", "CHANNELS 3 Zrott"), 9, "'Zrottation'.*did you mean Zrotation"),
    (ARM.replace("CHANNELS 3 Z", "CHANNELS 3 X"), 9, "'Xrotation': stands twice"),
    (ARM.replace("Frames: 2", "Frames: 3"), 20, "field Frames: 3: 2 rows of motion"),
    (ARM.replace("Frames: 2", "Frames: -2"), 17, "field Frames: '-2'"),
    (ARM.replace("Frames: 2", "Frames: 99999999999999"), 17, "out of range"),
    (ARM.replace("Time: 0.04", "Time: 0"), 18, "field Frame Time"),
    (ARM.replace("1 2 3 90 0 0 0 90 0", "1 2 3 90"), 20, "4 numbers; the joints have 9 channels"),
    (ARM.replace("1 2 3 90 0 0 0 90 0", "1 2 3 90 0 0 0 abc 0"), 20, "field channel 8: 'abc'"),
    (ARM.replace("1 2 3 90 0 0 0 90 0", "1 2 3 90 0 0 0 inf 0"), 20, "field channel 8: 'inf'"),
    (ARM[: ARM.index("MOTION")].rstrip()[:-1], 14, "ends where JOINT, End Site or }"),
    (ARM.replace("MOTION", "ROOT Other { OFFSET 0 0 0 CHANNELS 0 }\nMOTION"), 16, "MOTION should stand here"),
    (ARM.replace("JOINT Upper Arm", "ROOT Upper Arm"), 6, "a second root"),
    (ARM.replace("OFFSET 0 -2 0", "OFFSET 0 -2 0 End Site"), 12, "an end site inside an end site"),
    (ARM.replace("JOINT Upper Arm\n  {", "JOINT {"), 6, "the joint has no name"),
    ("HIERARCHY\n" + STILL, 9, "no joint has a channel"),
    ("HIERARCHY\nROOT a { OFFSET 0 0 0 CHANNELS 0\n" + CHAIN, 1002, "more than 1000 joints"),
]


@pytest.mark.parametrize(("text", "row", "message"), BROKEN)
def test_a_broken_file_is_named_with_row_field_and_value(text: str, row: int, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse_bvh(text, "arm.bvh")
    assert caught.value.row == row
    assert str(caught.value).startswith(f"arm.bvh: row {row}: ")
    assert "\n" not in str(caught.value)


@given(st.integers(0, len(ARM) - 1), st.sampled_from("{}0x-\n ROT"))
def test_a_file_with_one_wrong_letter_is_read_or_refused_but_never_crashes(at: int, letter: str) -> None:
    try:
        bvh = parse_bvh(ARM[:at] + letter + ARM[at + 1 :])
    except InputError:
        return
    assert np.isfinite(bvh.positions()).all()


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_bvh(tmp_path / "none.bvh")
    with pytest.raises(InputError, match="cannot be read"):
        read_bvh(tmp_path)
    (tmp_path / "bytes.bvh").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="is no text"):
        read_bvh(tmp_path / "bytes.bvh")


def test_a_skeleton_without_a_persons_joints_is_refused() -> None:
    with pytest.raises(InputError, match=r"these joints are missing: .*Head.*name the joints as one of motionbuilder"):
        joint_columns(parse_bvh(ARM), "arm.bvh")


@pytest.mark.parametrize(("name", "frames", "columns"), FILES)
def test_real_files_of_other_tools_load(mocap_files: Path, name: str, frames: int, columns: int) -> None:
    bvh = read_bvh(mocap_files / name)
    assert bvh.channels.shape == (frames, columns)
    assert np.isfinite(bvh.positions()).all()


@pytest.mark.parametrize(("name", "frames", "columns"), FILES)
def test_real_files_walk_as_people(mocap_files: Path, name: str, frames: int, columns: int) -> None:
    bvh = read_bvh(mocap_files / name)
    motion = bvh_motion(bvh, (0.2, 2.5), 1.75, np.random.default_rng(0))
    p = joint_positions(motion.root, motion.directions, motion.lengths)
    assert motion.duration_ns / 1e9 >= STILL_S + (frames - 1) * bvh.frame_s
    np.testing.assert_allclose(facing(p[: round(STILL_S * 50)])[:, 2], -1, atol=1e-6)
    assert p[..., 1].min() > -1e-9
    assert 1.3 < p[0, JOINT["Head"], 1] < 1.8
    assert (motion.lengths[1:] > 0).all()
    # The first pose of the file, of which bones on both sides of the body are about equally long.
    for joint in ("Elbow", "Wrist", "Knee", "Ankle"):
        left, right = motion.lengths[JOINT[f"{joint}Left"]], motion.lengths[JOINT[f"{joint}Right"]]
        assert left == pytest.approx(right, rel=0.05)
    # It comes back to its beginning.
    assert np.linalg.norm(p[-1] - p[0], axis=-1).max() < 0.05


def test_a_person_without_legs_to_measure_is_refused(mocap_files: Path) -> None:
    text = (mocap_files / FILES[1][0]).read_text()
    flat = "\n".join("OFFSET 0 0 0" if line.strip().startswith("OFFSET") else line for line in text.splitlines())
    with pytest.raises(InputError, match=r"flat\.bvh: field OFFSET: the legs have no length"):
        bvh_motion(parse_bvh(flat), (0.0, 2.5), 1.75, np.random.default_rng(0), file="flat.bvh")


def test_directions_are_those_of_the_file(mocap_files: Path) -> None:
    bvh = read_bvh(mocap_files / "bvh-python/test_mocapbank.bvh")
    columns, positions = joint_columns(bvh), bvh.positions()
    motion = bvh_motion(bvh, (0.0, 2.5), 1.75, np.random.default_rng(0))
    first = motion.directions[round((STILL_S + 1.6) * 50)]

    def angle(a: np.ndarray, b: np.ndarray) -> float:
        return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))

    bones = [(BODY.joints[a], BODY.joints[b]) for a, b in BODY.bones]
    own = {b: positions[0, columns[b]] - positions[0, columns[a]] for a, b in bones if a in columns and b in columns}
    for one, other in (("KneeLeft", "AnkleLeft"), ("ElbowRight", "WristRight"), ("KneeLeft", "KneeRight")):
        assert angle(first[JOINT[one]], first[JOINT[other]]) == pytest.approx(angle(own[one], own[other]), abs=1e-6)


def test_a_file_in_the_room_and_its_unit(mocap_files: Path) -> None:
    file = mocap_files / "bvh-python/test_mocapbank.bvh"
    room = load_scene("exchange", bvh=file, bvh_person=2, bvh_metres_per_unit=0.01)
    at = room.positions_at(0)
    positions = read_bvh(file).positions()
    thigh = np.linalg.norm(at[1, JOINT["KneeLeft"]] - at[1, JOINT["HipLeft"]])
    columns = joint_columns(read_bvh(file))
    own = np.median(np.linalg.norm(positions[:, columns["KneeLeft"]] - positions[:, columns["HipLeft"]], axis=1))
    assert thigh == pytest.approx(own * 0.01)
    with pytest.raises(SettingsError, match="metres_per_unit"):
        load_scene("stand", bvh=file, bvh_metres_per_unit=1.0)
    with pytest.raises(SettingsError, match="bvh_person is 3; it must be from 1 to 2"):
        load_scene("exchange", bvh=file, bvh_person=3)
