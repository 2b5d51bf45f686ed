"""Depth images of files: what is read, in which order and at what times, and what is refused with what would work."""

from __future__ import annotations

import itertools
import struct
import threading
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.kinect_depth import UNIT_M, kinect_metres
from mocapella.model.camera import Camera
from mocapella.sources.depth_files import DamagedImageError, DepthFiles, natural, read_depth_png
from mocapella.sources.depth_options import (
    DepthOptions,
    UnitCheck,
    check_disparities,
    check_lens,
    complete,
    lens_of,
    parse_lens,
    parse_unit,
    unit_problem,
)
from mocapella.sources.open_depth import open_depth
from mocapella.sources.paced_depth import PacedDepth
from mocapella.sources.picture_source import SourceState

STOP = threading.Event()
LENS = (12.0, 12.0, 7.5, 5.5, 0.0, 0.0, 0.0, 0.0, 0.0)


def image(value: int = 700, shape: tuple[int, int] = (12, 16)) -> np.ndarray:
    return (np.arange(shape[0] * shape[1]).reshape(shape) + value).astype(np.uint16)


def png(path: Path, depth: np.ndarray) -> Path:
    path.write_bytes(cv2.imencode(".png", depth)[1].tobytes())
    return path


def sequence(folder: Path, numbers: list[int]) -> Path:
    for number in numbers:
        png(folder / f"d{number}.png", image(700 + number))
    return folder


def test_a_folder_comes_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    sequence(tmp_path, [10, 9, 100, 1])
    (tmp_path / "notes.txt").write_text("not an image")
    files = DepthFiles([tmp_path], DepthOptions(0.001, lens=LENS, fps=10.0))
    found = list(files.images())
    assert files.count == 4
    assert [Path(one.file).name for one in found] == ["d1.png", "d9.png", "d10.png", "d100.png"]
    assert [int(one.depth[0, 0]) for one in found if one.depth is not None] == [701, 709, 710, 800]
    assert [one.time_ns for one in found] == [1, 100_000_001, 200_000_001, 300_000_001]
    assert (files.state.size_px, files.state.unit_m, files.state.lens) == ((16, 12), 0.001, LENS)


@given(st.lists(st.text("aB0129²٣ _", max_size=8), min_size=1, max_size=6))
def test_any_names_have_an_order(names: list[str]) -> None:
    in_order = [natural(name) for name in sorted(names, key=natural)]
    assert in_order == sorted(natural(name) for name in reversed(names))


@given(st.lists(st.integers(0, 10**6), unique=True, max_size=8))
def test_numbers_in_names_are_compared_as_numbers(numbers: list[int]) -> None:
    assert sorted((f"a{n}b" for n in numbers), key=natural) == [f"a{n}b" for n in sorted(numbers)]


def test_a_sidecar_says_what_the_user_does_not(tmp_path: Path) -> None:
    sequence(tmp_path, [1, 2])
    (tmp_path / "depth.toml").write_text("unit_m = 0.000125\nlens = [12, 7.5, 5.5]\nfps = 60\n")
    state = DepthFiles([tmp_path]).state
    assert (state.unit_m, state.lens, state.fps) == (0.000125, LENS, 60)
    state = DepthFiles([tmp_path / "d1.png"], DepthOptions(0.001, fps=5.0)).state
    assert (state.unit_m, state.lens, state.fps) == (0.001, LENS, 5)
    assert complete(state, "d1.png").size_px == (16, 12)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("units = 1", r"unknown key 'units'; known: .*did you mean unit_m"),
        ("unit_m = 'mm'", "unit_m"),
        ("unit_m = -1", "above 0"),
        ("lens = [1, 2]", r"\[F, CX, CY\]"),
        ("raw = 'v2'", "kinect-raw"),
        ("unit_m = ", "depth.toml"),
    ],
)
def test_a_sidecar_that_cannot_be_is_refused(tmp_path: Path, text: str, named: str) -> None:
    sequence(tmp_path, [1])
    (tmp_path / "depth.toml").write_text(text)
    with pytest.raises(InputError, match=named):
        DepthFiles([tmp_path])


def test_a_kinects_disparities_become_depths(tmp_path: Path) -> None:
    raw = np.array([[0, 500, 800], [1000, 1085, 2047]], np.uint16)
    png(tmp_path / "1.png", raw)
    for options in (DepthOptions(kinect_raw=True), None):
        files = DepthFiles([tmp_path], options)
        (one,) = files.images()
        assert files.state.unit_m == UNIT_M
        assert one.depth is not None
        np.testing.assert_allclose(one.depth * UNIT_M, kinect_metres(raw), atol=UNIT_M)
        (tmp_path / "depth.toml").write_text("raw = 'kinect-raw'")


def test_depths_are_no_disparities(tmp_path: Path) -> None:
    png(tmp_path / "a.png", np.full((12, 16), 2047, np.uint16))
    png(tmp_path / "b.png", np.full((12, 16), 5600, np.uint16))
    images = DepthFiles([tmp_path], DepthOptions(kinect_raw=True)).images()
    assert next(images).depth is not None
    with pytest.raises(InputError, match=r"b.png: .*unit.*kinect-raw.*values up to 5600.*--unit 0.001 or 0.000125"):
        next(images)


@given(st.integers(0, 5000))
def test_the_unit_of_depths_is_told_by_what_was_measured(unmeasured: int) -> None:
    raw = np.zeros(5001, np.uint16)
    raw[unmeasured:] = 5600
    with pytest.raises(InputError, match=r"--unit 0\.001 or 0\.000125"):
        check_disparities(raw, "here")


def test_what_is_missing_is_said_with_how_to_give_it(tmp_path: Path) -> None:
    sequence(tmp_path, [1])
    for options, named in (
        (None, "--intrinsics F,CX,CY and --unit METRES"),
        (DepthOptions(0.001), "give --intrinsics F,CX,CY, or"),
        (DepthOptions(lens=LENS), "give --unit METRES, or write a depth.toml"),
    ):
        with pytest.raises(InputError, match=named):
            complete(DepthFiles([tmp_path], options).state, tmp_path)
    with pytest.raises(InputError, match="lens or unit is unknown"):
        complete(SourceState(None, unit_m=0.001, lens=LENS), "x")


def test_eight_bits_colours_and_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"8-bit greyscale; depth images have 16 bits"):
        DepthFiles([png(tmp_path / "a.png", np.ones((4, 4), np.uint8))])
    with pytest.raises(InputError, match="8-bit colour"):
        DepthFiles([png(tmp_path / "b.png", np.ones((4, 4, 3), np.uint8))])
    with pytest.raises(InputError, match="16-bit colour"):
        DepthFiles([png(tmp_path / "c.png", np.ones((4, 4, 3), np.uint16))])
    (tmp_path / "d.png").write_bytes(b"\xff\xd8\xff this is a photograph")
    with pytest.raises(InputError, match="is no PNG"):
        DepthFiles([tmp_path / "d.png"])
    for path, named in ((tmp_path / "not.png", "is not there"), (tmp_path, "folder among files")):
        with pytest.raises(InputError, match=named):
            DepthFiles([path, tmp_path / "a.png"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="folder without PNGs"):
        DepthFiles([tmp_path / "empty"])
    with pytest.raises(SettingsError, match="no depth images"):
        DepthFiles([])


def test_a_file_that_is_cut_off_anywhere_or_changed_is_damaged(tmp_path: Path) -> None:
    path = png(tmp_path / "a.png", image())
    whole = path.read_bytes()
    for end in (*range(len(whole)), -1):
        data = whole[:end] if end >= 0 else whole[:40] + bytes([whole[40] ^ 1]) + whole[41:]
        path.write_bytes(data)
        with pytest.raises(DamagedImageError, match=r"a.png.*(cut off|damaged)"):
            read_depth_png(path)


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def header(width: int, height: int) -> bytes:
    return chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("parts", "kind", "named"),
    [
        (chunk(b"IHDR", b"12"), DamagedImageError, "has no header that can be read"),
        (header(16, 12) + chunk(b"IDAT", b"nonsense") + chunk(b"IEND", b""), DamagedImageError, "cannot be unpacked"),
        (header(1 << 20, 1 << 20) + chunk(b"IEND", b""), InputError, "is 1048576 × 1048576 px"),
    ],
)
def test_files_whose_parts_are_whole_and_say_what_cannot_be(
    tmp_path: Path, parts: bytes, kind: type[InputError], named: str
) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + parts)
    with pytest.raises(kind, match=rf"a.png: {named}"):
        read_depth_png(tmp_path / "a.png")


def test_a_file_that_is_not_there_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a.png: cannot be read: No such file"):
        read_depth_png(tmp_path / "a.png")


def test_a_sequence_with_a_damaged_file_goes_on_and_says_so(tmp_path: Path) -> None:
    sequence(tmp_path, [1, 2, 3, 4])
    for name in ("d1.png", "d3.png"):
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-30])
    found = list(DepthFiles([tmp_path]).images())
    assert [one.depth is None for one in found] == [True, False, True, False]
    assert "cut off" in found[0].problem
    source = PacedDepth(DepthFiles([tmp_path], DepthOptions(fps=1000.0)))
    source.open()
    assert [int(p.image[0, 0]) for p in iter(lambda: source.read(STOP), None)] == [702, 704]
    assert source.damaged == 2
    for name in ("d2.png", "d4.png"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(DamagedImageError, match="d1"):
        DepthFiles([tmp_path])


def test_images_of_two_sizes_are_refused(tmp_path: Path) -> None:
    sequence(tmp_path, [1, 2])
    png(tmp_path / "d3.png", image(shape=(6, 8)))
    with pytest.raises(InputError, match=r"d3.png: is 8 × 6 px; .*d1.png is 16 × 12"):
        list(DepthFiles([tmp_path]).images())


def test_recorded_images_are_given_out_when_they_are_due_and_again_in_a_loop(tmp_path: Path) -> None:
    sequence(tmp_path, [1, 2, 3])
    ticks = itertools.count(0.0, 0.001)
    source = PacedDepth(DepthFiles([tmp_path], DepthOptions(fps=200.0)), loop=True, clock=lambda: next(ticks))
    source.open()
    source.begin(0.0)
    pictures = [source.read(STOP) for _ in range(7)]
    assert [int(p.image[0, 0]) for p in pictures if p] == [701, 702, 703, 701, 702, 703, 701]
    assert [p.time_ns for p in pictures if p] == [1 + 5_000_000 * k for k in range(7)]
    assert [p.number for p in pictures if p] == list(range(7))
    ended = threading.Event()
    ended.set()
    source.begin(1e9)
    assert source.read(ended) is None
    assert isinstance(open_depth(str(tmp_path)), PacedDepth)


@pytest.mark.parametrize(
    ("text", "lens"),
    [
        ("476,313.5,242", (476, 476, 313.5, 242, 0, 0, 0, 0, 0)),
        ("476,470,313.5,242", (476, 470, 313.5, 242, 0, 0, 0, 0, 0)),
        ("476,470,313.5,242,.1,.2,.3,.4,.5", (476, 470, 313.5, 242, 0.1, 0.2, 0.3, 0.4, 0.5)),
    ],
)
def test_a_lens_is_read(text: str, lens: tuple[float, ...]) -> None:
    assert parse_lens(text) == lens
    assert parse_lens(None) is None


@pytest.mark.parametrize("text", ["", "476", "476,1", "a,b,c", "0,1,1", "-5,1,1", "nan,1,1", "1,2,3,4,5"])
def test_what_is_no_lens_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="F,CX,CY"):
        parse_lens(text)
    assert lens_of([]) is None


def test_a_unit_is_read() -> None:
    assert parse_unit("0.000125") == (0.000125, False)
    assert parse_unit("kinect-raw") == (None, True)
    assert parse_unit(None) == (None, False)
    for text in ("mm", "-1", "0", "nan", "inf", ""):
        with pytest.raises(SettingsError, match=r"0\.001 where units are millimetres"):
            parse_unit(text)


@pytest.mark.parametrize(
    ("lens", "size", "named"),
    [
        ((575.0, 575.0, 1319.5, 239.5), (640, 480), r"outside the image of 640 × 480 px; .*575.8,319.5,239.5"),
        ((575.0, 575.0, 319.5, -1.0), (640, 480), "outside the image"),
        ((5750.0, 5750.0, 319.5, 239.5), (640, 480), r"6.37° wide"),
        ((20.0, 20.0, 319.5, 239.5), (640, 480), r"173° wide"),
        ((575.0, 20.0, 319.5, 239.5), (640, 480), r"170° high"),
        ((3.6, 3.6, 2.5, 2.5), (1000, 700), r"900,499.5,349.5 would be usual"),
    ],
)
def test_a_lens_that_cannot_be_is_refused_with_a_likely_one(
    lens: tuple[float, ...], size: tuple[int, int], named: str
) -> None:
    with pytest.raises(InputError, match=named):
        check_lens(lens, size, "x")


@pytest.mark.parametrize(
    ("lens", "size"),
    [
        ((476.0, 476.0, 313.7, 242.8), (640, 480)),
        ((365.0, 365.0, 256, 212), (512, 424)),
        ((252, 252, 256, 256), (512, 512)),
    ],
)
def test_lenses_of_real_cameras_pass(lens: tuple[float, ...], size: tuple[int, int]) -> None:
    check_lens(lens, size, "x")


@pytest.mark.parametrize(
    ("units", "unit_m", "named"),
    [
        (4900, 1.0, r"4\.9 km; .*0\.001 \(4\.9 m\) or 0\.000125 \(61 cm\)"),
        (700, 1.0, r"700 m; --unit 0\.001 \(70 cm\)"),
        (5600, 1e-6, r"5\.6 mm; --unit 0\.001 \(5\.6 m\) or 0\.000125 \(70 cm\)"),
        (65_000, 1.0, r"65 km"),
        (3, 1.0, None),
    ],
)
def test_a_unit_that_cannot_be_is_refused_with_a_likely_one(units: int, unit_m: float, named: str | None) -> None:
    check = UnitCheck(unit_m, "here")
    depth = np.full((12, 16), units, np.uint16)
    if named is None:
        check.update(depth)
    else:
        with pytest.raises(InputError, match=rf"here: .*median distance would be {named}"):
            check.update(depth)


def test_empty_images_are_counted_and_say_nothing_of_the_unit() -> None:
    check = UnitCheck(1.0, "here")
    few = np.zeros((12, 16), np.uint16)
    few[0, :5] = 700
    for depth in (np.zeros((12, 16), np.uint16), few, np.zeros((12, 16), np.uint16)):
        check.update(depth)
    assert (check.images, check.empty) == (3, 2)
    good = UnitCheck(0.001, "here")
    for depth in (np.full((12, 16), 700, np.uint16), np.zeros((12, 16), np.uint16)):
        good.update(depth)
    assert (good.images, good.empty) == (2, 1)


def test_where_no_arm_is_found_a_likely_unit_and_lens_are_named() -> None:
    check = UnitCheck(0.001, "here")
    camera = Camera("depth", (640, 480), np.array([952.0, 952, 320, 240, 0, 0, 0, 0, 0]))
    assert check.doubt(camera) == ""
    check.update(np.full((480, 640), 5600, np.uint16))
    assert check.doubt(camera) == (
        "if there is an arm, unit or lens are wrong: with 0.001 m a unit the median distance is 5.6 m, likely would be "
        "--unit 0.000125 (70 cm) or 0.0001 (56 cm); a lens of f 952 px sees 37° across, usual for 640 × 480 is "
        "--intrinsics 575.8,319.5,239.5"
    )


def test_disparities_without_their_name_are_recognised() -> None:
    raw = np.full(200, 800, np.uint16)
    raw[:50] = 2047
    found = unit_problem(raw, 0.1)
    assert found is not None
    assert "kinect-raw" in found[1]
