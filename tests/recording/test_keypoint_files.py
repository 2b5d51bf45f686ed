"""BVH and CSV as trajectories: what is written comes back, other programs' files are read, bad ones are refused."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mocapella
from mocapella.errors import InputError, SettingsError
from mocapella.exports.arm_rows import STATES
from mocapella.exports.bvh_file import write_bvh
from mocapella.exports.trajectory_tables import write_csv
from mocapella.model.hand import LANDMARKS
from mocapella.model.topology import topology
from mocapella.model.trajectories import HAND_BONES, Trajectories
from mocapella.recording import keypoint_csv
from mocapella.recording.keypoint_csv import NO_TIMES, read_csv_keypoints
from mocapella.recording.known_keypoints import known_keypoints
from mocapella.recording.study_log import is_study_log

LONG = (
    "time_s,run,participant,placement,scenario,individual,keypoint,state,x_m,y_m,z_m,sd_m\n"
    "0.000000,0,7,front,walk,anna,head,measured,1.00000,2.00000,3.00000,0.01000\n"
    "0.000000,0,7,front,walk,anna,foot,unknown,,,,\n"
    "0.020000,1,7,front,walk,anna,head,inferred,1.00000,2.50000,3.00000,\n"
)
MARKERS = "head (x);head (y);head (z);foot (x);foot (y);foot (z)\n0;1500;0;0;0;0\n10;1500;0;;;\n"


def made(names: tuple[str, ...], bones: tuple[tuple[int, int], ...], kind: str, seed: int = 0) -> Trajectories:
    rng = np.random.default_rng(seed)
    positions = np.cumsum(rng.normal(scale=0.01, size=(5, 2, len(names), 3)), axis=0) + rng.normal(size=(len(names), 3))
    states = rng.integers(0, 3, positions.shape[:3]).astype(np.uint8)
    states[0] = 2
    positions[states == 0] = np.nan
    sd = np.where(states == 2, 0.01, np.nan).astype(np.float32)
    return Trajectories(
        kind, np.arange(5) / 50.0, np.array([0, 0, 0, 1, 1]), ("anna", "=ben, 2"), names, positions, states, sd, bones,
        rate_hz=50.0, labels={0: {"scenario": "walk"}, 1: {"scenario": "run"}},
    )  # fmt: skip


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["people", "hands", "points"]))
def test_our_own_table_comes_back(tmp_path_factory: pytest.TempPathFactory, seed: int, kind: str) -> None:
    kinect = topology("kinect_v2")
    names, bones = {
        "people": (kinect.joints, kinect.bones), "hands": (LANDMARKS, HAND_BONES), "points": (("a", "b"), ()),
    }[kind]  # fmt: skip
    own = made(names, bones, kind, seed)
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    write_csv(own, path)
    found = read_csv_keypoints(path)
    assert (found.kind, found.keypoints, found.individuals) == (kind, names, own.individuals)
    assert set(found.bones) == set(bones)
    present = own.present.any(axis=1)
    np.testing.assert_allclose(found.positions, own.positions[present], atol=6e-6)
    np.testing.assert_array_equal(found.states, own.states[present])
    np.testing.assert_allclose(found.sd, own.sd[present], atol=6e-6)
    np.testing.assert_allclose(found.times_s, own.times_s[present])
    np.testing.assert_array_equal(found.runs, own.runs[present])
    assert {run: labels["scenario"] for run, labels in found.labels.items()} == {
        run: own.labels[run]["scenario"] for run in set(own.runs[present].tolist())
    }


def test_the_states_have_the_names_of_the_export() -> None:
    assert STATES == keypoint_csv.STATES


def test_a_table_of_one_time_has_no_rate(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(LONG.splitlines()[:2]), encoding="utf-8")
    assert np.isnan(read_csv_keypoints(tmp_path / "a.csv").rate_hz)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("individual,keypoint", "who,keypoint", "row 1: field individual: a column is missing"),
        ("inferred", "guessed", "row 4: field state: 'guessed': is no state"),
        ("2.50000", "two", "row 4: field y_m: 'two': is no usable number"),
        ("0.020000", "", "row 4: field time_s: '': is no usable number"),
        ("0.020000", "nan", "row 4: field time_s: 'nan': is no usable number"),
        ("anna,foot,unknown", "anna,head,unknown", "row 2: the keypoint is there twice"),
        (LONG.partition("\n")[2], "", "the table has no rows"),
    ],
)
def test_a_table_that_is_damaged_is_refused_in_one_line(tmp_path: Path, old: str, new: str, why: str) -> None:
    (tmp_path / "a.csv").write_text(LONG.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        mocapella.load(tmp_path / "a.csv")
    assert why in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_markers_without_times_say_so(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"vicon{suffix}"
    path.write_bytes(gzip.compress(MARKERS.encode()) if suffix.endswith("gz") else MARKERS.encode())
    recording = mocapella.load(path)
    points = recording.points
    assert points is not None
    assert (points.individuals, points.keypoints) == (("vicon",), ("head", "foot"))
    np.testing.assert_allclose(points.positions[:, 0, 0], [[0.0, 1.5, 0.0], [0.01, 1.5, 0.0]])
    assert points.states[:, 0].tolist() == [[2, 2], [2, 0]]
    assert np.isnan(points.rate_hz)
    assert recording.problems[0].startswith(NO_TIMES)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("foot (z)", "foot (w)", "its columns are not"),
        ("10;1500", "10", "its rows have not all a cell"),
        (MARKERS.partition("\n")[2], "", "its rows have not all a cell"),
        ("10;1500", "ten;1500", "is no table of markers"),
        ("1500", "1.5", "all markers are within 0.02 m"),
    ],
)
def test_markers_that_are_damaged_are_refused(tmp_path: Path, old: str, new: str, why: str) -> None:
    (tmp_path / "a.csv").write_text(MARKERS.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=why):
        mocapella.load(tmp_path / "a.csv")


def test_markers_that_are_never_seen_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("head (x);head (y);head (z)\n;;\n", encoding="utf-8")
    assert not read_csv_keypoints(tmp_path / "a.csv").present.any()
    (tmp_path / "b.csv").write_text("head (x);head (y);head (z)\n1;2;3\n", encoding="utf-8")
    assert read_csv_keypoints(tmp_path / "b.csv").present.all()  # one marker may rest


def test_the_vicons_markers_and_the_sensors_bodies_are_read(azure_and_vicon: Path) -> None:
    vicon = mocapella.load(azure_and_vicon / "vicon.csv.gz").points
    azure = mocapella.load(azure_and_vicon / "azure_positions.csv.gz").people
    assert vicon is not None
    assert azure is not None
    assert (len(vicon), len(vicon.keypoints), len(azure), len(azure.keypoints)) == (2700, 39, 1105, 32)
    assert azure.rate_hz == pytest.approx(30.0, rel=0.01)
    assert azure.bones == topology("azure_kinect").bones
    head = azure.positions[:, 0, azure.keypoints.index("HEAD"), 1]
    pelvis = azure.positions[:, 0, azure.keypoints.index("PELVIS"), 1]
    assert np.nanmedian(head - pelvis) > 0.4  # y is up


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 1000))
def test_the_joints_of_a_written_bvh_come_back(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    """A rigid skeleton survives: it is written, read, written again and read, and the joints are the same."""
    kinect = topology("kinect_v2")
    own = made(kinect.joints, kinect.bones, "people", seed).of("anna")
    folder = tmp_path_factory.mktemp("bvh")
    write_bvh(own, folder / "a.bvh")
    first = mocapella.load(folder / "a.bvh").people
    assert first is not None
    assert (first.kind, set(first.keypoints), first.individuals) == ("people", set(kinect.joints), ("a",))
    assert first.rate_hz == pytest.approx(50.0)
    lengths = np.linalg.norm(np.diff(first.positions[:, 0][:, np.array(first.bones)], axis=2)[:, :, 0], axis=2)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), atol=1e-6)
    named = {tuple(first.keypoints[k] for k in bone) for bone in first.bones}
    assert named == {tuple(kinect.joints[k] for k in bone) for bone in kinect.bones}


def test_a_hand_in_a_bvh_is_a_hand(tmp_path: Path) -> None:
    write_bvh(made(LANDMARKS, HAND_BONES, "hands").of("anna"), tmp_path / "a.bvh")
    recording = mocapella.load(tmp_path / "a.bvh")
    assert recording.people is None
    assert recording.hands is not None
    assert len(recording.hands.bones) == 20


def test_other_peoples_bvh_are_read(mocap_files: Path) -> None:
    walk = mocapella.load(next(mocap_files.glob("PyMO/*.bvh")), unit="in").people
    other = mocapella.load(mocap_files / "bvh-python" / "test_mocapbank.bvh").people
    assert walk is not None
    assert other is not None
    for one in (walk, other):
        assert not any(name.endswith(" end") for name in one.keypoints)
        height = np.ptp(one.positions[:, 0, :, 1], axis=1)
        assert 1.2 < height.max() < 2.2
    assert walk.rate_hz == pytest.approx(120.0, rel=1e-3)


def test_a_unit_is_for_a_bvh_only(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(LONG, encoding="utf-8")
    with pytest.raises(SettingsError, match=r"unit 'mm': a\.csv is no BVH"):
        mocapella.load(tmp_path / "a.csv", unit="mm")
    with pytest.raises(SettingsError, match="unit 'ft': known: m, mm, cm"):
        mocapella.load(tmp_path / "a.csv", unit="ft")


def test_unknown_names_are_points() -> None:
    assert known_keypoints(("x", "y")) == ("points", ())
    own = made(("x", "y"), (), "points")
    assert known_keypoints(replace(own, keypoints=("head", "foot")).keypoints).kind == "points"


def test_a_file_that_cannot_be_read_is_no_study_log(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(LONG)
    (tmp_path / "b.csv").write_text("Study_Id, Tracker_Time, Person_Id\n")
    (tmp_path / "c.csv").write_bytes(b"\xff\xfe\x00")
    found = [is_study_log(tmp_path / name) for name in ("a.csv", "b.csv", "c.csv", "gone.csv")]
    assert found == [False, True, False, False]
