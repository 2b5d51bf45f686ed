"""TRC and C3D of other programs, and damaged ones: a file is read, or refused with its name."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mocapella
from mocapella.errors import InputError, MocapellaError
from mocapella.exports.c3d_file import write_c3d
from mocapella.model.trajectories import Trajectories
from mocapella.recording.c3d_file import read_c3d
from mocapella.recording.trc_file import read_trc

TRC = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n50\t50\t2\t2\tmm\n"
    "Frame#\tTime\thead\t\t\tfoot\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n1\t0.0\t1\t2\t3\t\t\t\n2\t0.02\t4\t5\t6\t7\t8\t9\n"
)


def points(frames: int = 3) -> Trajectories:
    positions = np.arange(frames * 2 * 3.0).reshape(frames, 1, 2, 3)
    shape = positions.shape[:3]
    return Trajectories(
        "points", np.arange(frames) / 50.0, np.zeros(frames, np.int64), ("anna",), ("head", "foot"), positions,
        np.full(shape, 2, np.uint8), np.full(shape, 0.004, np.float32), rate_hz=50.0,
    )  # fmt: skip


def c3d_bytes(tmp_path: Path) -> bytes:
    write_c3d(points(), tmp_path / "a.c3d")
    return (tmp_path / "a.c3d").read_bytes()


def test_a_trc_in_millimetres_becomes_metres(tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text(TRC, encoding="utf-8")
    found = read_trc(tmp_path / "a.trc")
    assert found.keypoints == ("head", "foot")
    np.testing.assert_allclose(found.positions[:, 0, 0], [[0.001, 0.002, 0.003], [0.004, 0.005, 0.006]])
    assert found.states[:, 0].tolist() == [[2, 0], [2, 2]]
    assert (found.rate_hz, found.individuals) == (50.0, ("a",))


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("\tmm\n", "\tfurlong\n", "Units is 'furlong': is an unknown unit"),
        ("\t4\t5\t6", "\tfour\t5\t6", "is no TRC"),
        ("2\t0.02", "2\t-1", "no frames at rising times"),
        ("DataRate", "Rate", "is no TRC"),
        ("\n50\t", "\n-30\t", "is no rate"),
        (TRC, "", "is no TRC"),
    ],
)
def test_a_trc_that_is_none_is_refused_by_name(tmp_path: Path, old: str, new: str, why: str) -> None:
    path = tmp_path / "a.trc"
    path.write_text(TRC.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_trc(path)
    assert "a.trc" in str(refused.value)
    assert why.rsplit(":", maxsplit=1)[-1].strip() in str(refused.value)


def test_pose2sims_trc_is_read(single_person: Path) -> None:
    (path,) = (one for one in (single_person / "pose-3d").glob("*.trc") if "filt" not in one.name)
    found = read_trc(path)
    assert (len(found), len(found.keypoints), found.rate_hz) == (100, 21, 60.0)
    assert 1.4 < np.nanmedian(found.positions[:, 0, found.keypoints.index("Head"), 1]) < 2.0


def test_a_file_that_is_cut_off_says_so(tmp_path: Path) -> None:
    data = c3d_bytes(tmp_path)
    (tmp_path / "b.c3d").write_bytes(data[: (struct.unpack_from("<H", data, 16)[0] - 1) * 512 + 64])
    assert mocapella.load(tmp_path / "b.c3d").problems == ("its header says 3 frames, and it has 2",)
    (tmp_path / "b.trc").write_text(TRC.replace("50\t2\t2", "50\t9\t2").replace("\t8\t9", ""), encoding="utf-8")
    assert mocapella.load(tmp_path / "b.trc").problems == (
        "its header says 9 frames, and it has 2", "1 rows have too few cells; the missing ones are unknown",
    )  # fmt: skip


def test_a_trc_of_many_names_and_few_cells_is_refused(tmp_path: Path) -> None:
    """Its table would need thousands of times the memory of its text."""
    head = TRC.splitlines()[:3]
    names = "Frame#\tTime\t" + "\t\t\t".join(f"m{k}" for k in range(30_000))
    rows = [f"{k}\t{k / 50}" for k in range(30_000)]
    (tmp_path / "bomb.trc").write_text("\n".join([*head, names, "", *rows]), encoding="utf-8")
    with pytest.raises(InputError, match="most of its cells are missing"):
        read_trc(tmp_path / "bomb.trc")


def test_markers_of_one_name_get_numbers(tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text(TRC.replace("foot", "head"), encoding="utf-8")
    assert read_trc(tmp_path / "a.trc").keypoints == ("head", "head (2)")


def test_files_of_other_programs_are_read(mocap_files: Path) -> None:
    """Values of single points are what ezc3d reads; markers.trc went through a spreadsheet."""
    walking = read_c3d(mocap_files / "kineticstoolkit" / "walkingOptiTrack.c3d")
    assert (len(walking), walking.rate_hz, len(walking.keypoints)) == (3361, 160.0, 12)
    np.testing.assert_allclose(1000 * walking.positions[100, 0, 0], [18.69213769, 107.0813159, 28.40045726], rtol=1e-6)
    assert set(np.unique(walking.states)) == {0, 2}
    markers = read_c3d(mocap_files / "pyomeca" / "markers_analogs.c3d")
    np.testing.assert_allclose(
        1000 * markers.positions[100, 0, 0], [44.25523758, -276.85455322, 675.69104004], rtol=1e-6
    )
    static = read_c3d(mocap_files / "kineticstoolkit" / "sample_static.c3d")
    assert np.isnan(static.positions[..., 0]).mean() == pytest.approx(0.204983, abs=1e-5)
    trc = read_trc(mocap_files / "pyomeca" / "markers.trc")
    assert (len(trc), trc.keypoints[0], trc.rate_hz) == (93, "ASISl", 100.0)  # its header claims 652
    np.testing.assert_allclose(trc.positions[0, 0, 0], [0.7337041, 0.0809832, 0.1918668])


def processor(data: bytes, kind: int) -> bytes:
    """The file as a MIPS (big-endian) or a DEC machine writes it: only for files made by `write_c3d`."""
    out = bytearray(data)
    words = np.frombuffer(data, "<f4", offset=(struct.unpack_from("<H", data, 16)[0] - 1) * 512)
    start = len(data) - 4 * len(words)

    def number(value: float) -> bytes:
        if kind == 86:
            return struct.pack(">f", value)
        low, high = struct.unpack("<HH", struct.pack("<f", value * 4))
        return struct.pack("<HH", high, low)

    out[start:] = b"".join(map(number, words.tolist()))
    at, end = 512 + 4, ">" if kind == 86 else "<"
    out[512 + 3] = kind
    for place, form in ((2, "H"), (4, "H"), (6, "H"), (8, "H"), (10, "H"), (16, "H"), (18, "H")):
        out[place : place + 2] = struct.pack(end + form, struct.unpack_from("<" + form, data, place)[0])
    for place in (12, 20):
        out[place : place + 4] = number(struct.unpack_from("<f", data, place)[0])
    while data[at]:
        length, group = struct.unpack_from("bb", data, at)
        at += 2 + length
        (step,) = struct.unpack_from("<h", data, at)
        out[at : at + 2] = struct.pack(end + "h", step)
        if group > 0:
            kind_of, sizes = struct.unpack_from("b", data, at + 2)[0], data[at + 3]
            count, begin = int(np.prod(list(data[at + 4 : at + 4 + sizes]) or [1])), at + 4 + sizes
            for k in range(count if kind_of in (2, 4) else 0):
                place = begin + kind_of * k
                if kind_of == 4:
                    out[place : place + 4] = number(struct.unpack_from("<f", data, place)[0])
                else:
                    out[place : place + 2] = struct.pack(end + "h", struct.unpack_from("<h", data, place)[0])
        at += step
    return bytes(out)


@pytest.mark.parametrize("kind", [84, 85, 86])
def test_a_c3d_of_each_kind_of_processor_is_read(tmp_path: Path, kind: int) -> None:
    data = c3d_bytes(tmp_path)
    (tmp_path / "b.c3d").write_bytes(data if kind == 84 else processor(data, kind))
    found = read_c3d(tmp_path / "b.c3d")
    np.testing.assert_allclose(found.positions, points().positions, atol=1e-6)
    np.testing.assert_allclose(found.sd, 0.004, atol=1e-6)
    assert (found.keypoints, found.individuals, found.rate_hz) == (("head", "foot"), ("anna",), 50.0)


def test_a_c3d_of_integers_is_read(tmp_path: Path) -> None:
    """Scaled 16-bit words, as older systems write them."""
    data = bytearray(c3d_bytes(tmp_path))
    start = (struct.unpack_from("<H", data, 16)[0] - 1) * 512
    words = np.frombuffer(bytes(data), "<f4", 24, start).reshape(-1, 4)
    whole = np.column_stack([np.rint(words[:, :3] / 2.0), words[:, 3]]).astype("<i2")
    place = data.index(b"SCALE") + 5 + 4
    for at in (12, place):
        data[at : at + 4] = struct.pack("<f", 2.0)
    (tmp_path / "b.c3d").write_bytes(bytes(data[:start]) + whole.tobytes())
    found = read_c3d(tmp_path / "b.c3d")
    np.testing.assert_allclose(found.positions, points().positions, atol=1.1e-3)


def with_number(data: bytes, name: bytes, *values: int) -> bytes:
    """The file with other whole numbers as a parameter's values."""
    at = data.index(name) + len(name) + 3
    at += 1 + data[at]
    return data[:at] + struct.pack(f"<{len(values)}h", *values) + data[at + 2 * len(values) :]


def test_without_the_frame_numbers_of_long_files_the_header_counts(tmp_path: Path) -> None:
    data = c3d_bytes(tmp_path)
    (tmp_path / "b.c3d").write_bytes(with_number(data, b"ACTUAL_START_FIELD", 9, 0))
    assert len(read_c3d(tmp_path / "b.c3d")) == 3


@pytest.mark.parametrize("step", [30_000, 0])
def test_the_last_parameter_may_say_so_or_that_another_one_follows_behind_the_end(tmp_path: Path, step: int) -> None:
    data = bytearray(c3d_bytes(tmp_path))
    at = 512 + 4
    while data[at]:
        last, length = at, struct.unpack_from("b", data, at)[0]
        at += 2 + abs(length)
        at += struct.unpack_from("<h", data, at)[0]
    struct.pack_into("<h", data, last + 2 + data[last], step)
    (tmp_path / "b.c3d").write_bytes(bytes(data))
    assert len(read_c3d(tmp_path / "b.c3d")) == 3


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (lambda data: b"", "is no C3D"),
        (lambda data: data[:600], "is no C3D"),
        (lambda data: data[:1] + b"\0" + data[2:], "it does not begin like a C3D"),
        (lambda data: data[:515] + b"\x07" + data[516:], "processor type 7 is unknown"),
        (lambda data: data.replace(b"mm\0", b"ft\0"), "is an unknown unit"),
        (lambda data: data[: (struct.unpack_from("<H", data, 16)[0] - 1) * 512], "no frames"),
        (lambda data: with_number(data, b"USED", 0), "no points"),
        (lambda data: data[:16] + b"\0\0" + data[18:], "no data"),
        (lambda data: data.replace(b"\x04\x02", b"\xff\xff"), "ends within its parameters"),
    ],
)
def test_a_c3d_that_is_none_is_refused_by_name(tmp_path: Path, damage: object, why: str) -> None:
    path = tmp_path / "b.c3d"
    path.write_bytes(damage(c3d_bytes(tmp_path)))  # type: ignore[operator]
    with pytest.raises(InputError, match=r"b\.c3d") as refused:
        read_c3d(path)
    assert why in str(refused.value)


@settings(deadline=None, max_examples=150)
@given(changes=st.lists(st.tuples(st.integers(0, 3000), st.integers(0, 255)), max_size=20), length=st.integers(0, 4000))
def test_a_damaged_c3d_is_read_or_refused(
    changes: list[tuple[int, int]], length: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    data = bytearray(c3d_bytes(folder))
    for at, value in changes:
        data[at % len(data)] = value
    path = folder / "b.c3d"
    path.write_bytes(bytes(data[:length] if length < 1500 else data))
    try:
        found = read_c3d(path)
    except MocapellaError as error:
        assert "b.c3d" in str(error)  # noqa: PT017 - either is right
    else:
        assert found.positions.shape == (len(found), 1, len(found.keypoints), 3)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    for read in (read_c3d, read_trc):
        with pytest.raises(InputError, match="no_such"):
            read(tmp_path / "no_such")
