"""A small, always equal part of `python -m benchmarks fuzz`: no reader lets an error escape that is not ours."""

from __future__ import annotations

import random
import resource
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.readers import Called, all_readers, codes_of, functions_called, readers

from mocapella.errors import InputError, SettingsError
from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.part_types import PART_TYPES

pytest.importorskip("cv2")
pytest.importorskip("pygltflib")
pytest.importorskip("h5py")
ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def fuzz() -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        import benchmarks.fuzz

        yield benchmarks.fuzz


@pytest.fixture(scope="module")
def called() -> Called:
    """The functions that were called as the doors read their valid inputs; filled by `doors`."""
    return Called()


@pytest.fixture(scope="module")
def doors(fuzz: Any, called: Called, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    from benchmarks._doors import doors

    with functions_called() as found:
        made = {door.name: door for door in doors(tmp_path_factory.mktemp("fuzz"))}
    called.codes |= found.codes
    return made


NO_DOOR = {
    "decoding/__init__.py:own_toml": "reads files of this program",
    "evaluation/silhouette_video.py:score_video": "reads outlines that are in this repository",
    "kinematics/body_model.py:body_model_from_toml": "reads files of this program",
    "live/poses.py:run_osc": "hands datagrams to the reader behind the door OSC",
    "model/hand.py:hand_model_from_toml": "reads files of this program",
    "model/topology.py:topology_from_toml": "reads files of this program",
    "recording/bodies_writer.py:BodiesWriter.rows": "reads its own temporary file",
    "recording/merge.py:remove_leftovers": "a list of names, decoded as in every take",
    "sources/bridge.py:Bridge._read": "hands what it receives to the reader behind the door bridge stream",
    "sources/datagram_sockets.py:receive": "reads times of the kernel",
    "sources/depth_cameras/device.py:bgr": "of a camera's driver, in this process",
    "sources/depth_cameras/openni.py:OpenNiCamera._next": "of a camera's driver, in this process",
    "sources/depth_cameras/orbbec.py:OrbbecCamera._next": "of a camera's driver, in this process",
    "sources/simulate/depth_scene.py:_data": "reads a file of this program",
    "viewer/marker_lane.py:marker_colour": "a number of its own",
    "viewer/study_page.py:StudyPages._take": "a `decode_json` that tests/viewer/test_study_pages.py damages",
    "viewer/study_page.py:StudyPages.serve": "hands what it receives to `_take`",
    "viewer/page.py:_Connection.recv": "hands messages to the reader behind the door page messages",
    "viewer/scenery.py:_meshes": "bytes of its own",
    "wire/doorbell.py:Doorbell._run": "hands what it receives to `_answer`, behind the door rings",
    "wire/doorbell.py:_ring": "receives at most 512 bytes, and decodes three fields",
}
"""Functions that decode and have no door, each with the reason."""


def test_every_reader_of_the_sources_has_a_door(doors: dict[str, Any], called: Called) -> None:
    known = all_readers()
    assert known - called.names - NO_DOOR.keys() == set(), "add a door to benchmarks/_doors.py"
    assert NO_DOOR.keys() - known == set(), "is gone"


def test_every_registered_codec_has_a_door(doors: dict[str, Any], called: Called) -> None:
    kinds = [*FRAME_TYPES.values(), *PART_TYPES.values()]
    assert len(kinds) >= 12
    assert [kind.name for kind in kinds if not codes_of(kind.decode) <= called.codes] == []
    assert codes_of(lambda message: message) - called.codes != set()


PLANTED = {
    "call": "def read(data):\n    return decode_json(data)\n",
    "call after a function within": "def read(data):\n    def one(x): ...\n    return d.decode_toml(data)\n",
    "method": "class New:\n    def read(self, data):\n        self.x, self.y = _HEAD.unpack_from(data)\n",
    "call in a block": "def read(path):\n    with open(path) as f:\n        return np.frombuffer(f.read())\n",
    "call in a list": "async def read(data):\n    return [pb.Scene.FromString(one) for one in data]\n",
    "reference": "def read(listener):\n    return partial(listener.recv, 5)\n",
}


@pytest.mark.parametrize("planted", PLANTED)
def test_a_new_reader_without_a_door_is_found(doors: dict[str, Any], called: Called, planted: str) -> None:
    found = readers(PLANTED[planted], "schema/new.py")
    assert found - called.names in ({"schema/new.py:read"}, {"schema/new.py:New.read"})


def test_a_function_that_decodes_nothing_is_no_reader() -> None:
    assert (
        readers("def read(data):\n    def decode_json(x):\n        return x\n    return data\n", "schema/new.py")
        == set()
    )


def test_nothing_escapes_from_any_reader(fuzz: Any, doors: dict[str, Any]) -> None:
    reports = [fuzz.feed(door, round(20 + 60 * door.share)) for door in doors.values()]
    assert {one.name: one.escaped for one in reports if one.escaped} == {}
    assert sum(one.refused for one in reports) > 0.5 * sum(one.inputs for one in reports)
    assert [row.met for row in fuzz.rows_of(reports) if "escaped" in row.name or "MiB" in row.name] == [True, True]


def test_every_reader_is_a_part_that_can_be_named(fuzz: Any, doors: dict[str, Any]) -> None:
    assert tuple(doors) == fuzz.PARTS


def test_pieces_are_all_inputs_of_each_door(fuzz: Any) -> None:
    pieces = list(fuzz.pieces_of({"fast": 2.0, "slow": 0.01}, 100_000))
    assert [sum(one.inputs for one in pieces if one.door == door) for door in ("fast", "slow")] == [99_502, 498]
    assert [one.number for one in pieces if one.door == "slow"] == [0, 1, 2]
    assert [one.inputs for one in pieces if one.door == "slow"] == [200, 200, 98]


def test_slices_are_all_pieces_and_each_piece_is_in_one(fuzz: Any) -> None:
    shares = {"fast": 2.0, "slow": 0.01, "other": 0.3}
    slices = [list(fuzz.pieces_of(shares, 1_000_000, (k, 7))) for k in range(1, 8)]
    whole = list(fuzz.pieces_of(shares, 1_000_000))
    assert sorted(piece for one in slices for piece in one) == sorted(whole)
    assert max(map(len, slices)) - min(map(len, slices)) <= 1


def test_the_same_seed_gives_the_same_inputs(doors: dict[str, Any]) -> None:
    for name in ("frames", "hands", "depth images"):
        first, again = (doors[name].inputs(random.Random(5)) for _ in range(2))
        assert [next(first)[1] for _ in range(30)] == [next(again)[1] for _ in range(30)]


def planted_door(read: Callable[[], object]) -> Any:
    """Return a door whose inputs are all read by this function."""
    from benchmarks._door import Door

    def inputs(_: random.Random) -> Iterator[tuple[Callable[[], Any], bytes]]:
        while True:
            yield read, b"bad"

    return Door("made", 1.0, inputs)


class Panic(BaseException):
    """As a library in Rust raises it."""


@pytest.mark.parametrize(
    ("error", "refused", "escaped"),
    [
        (InputError("is no hand"), 3, 0),
        (SettingsError("is no\nhand"), 3, 3),
        (ValueError("too many digits"), 0, 3),
        (RecursionError("too deep"), 0, 3),
        (SyntaxError("no dtype"), 0, 3),
        (Panic("unwrap of None"), 0, 3),
    ],
)
def test_what_escapes_is_counted(fuzz: Any, error: Exception, refused: int, escaped: int) -> None:
    def fails() -> None:
        raise error

    report = fuzz.feed(planted_door(fails), 3)
    assert (report.inputs, report.refused, report.escapes) == (3, refused, escaped)
    assert fuzz.rows_of([report])[0].met is (escaped == 0)


def refuse_without_memory() -> None:
    try:
        bytearray(300 << 20)
    except MemoryError:
        raise InputError("is no table") from None


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the limit is one of Linux")
@pytest.mark.parametrize(
    ("read", "starved", "escaped"),
    [
        (lambda: bytearray(100 << 20), 0, 0),
        (lambda: bytearray(300 << 20), 2, 2),
        (lambda: [bytearray(100 << 20) for _ in range(3)], 2, 2),
        (refuse_without_memory, 2, 0),
    ],
)
def test_an_input_that_wants_too_much_memory_is_counted(
    fuzz: Any, read: Callable[[], object], starved: int, escaped: int
) -> None:
    before = resource.getrlimit(resource.RLIMIT_DATA)
    report = fuzz.feed(planted_door(read), 2)
    assert (report.starved, report.escapes) == (starved, escaped)
    row = next(row for row in fuzz.rows_of([report]) if "MiB" in row.name)
    assert (row.value, row.met) == (starved, starved == 0)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_DATA"), reason="the timer is one of POSIX")
def test_an_input_without_an_end_is_ended(fuzz: Any) -> None:
    from benchmarks._feeding import Watch

    def hangs() -> None:
        while True:
            pass

    with Watch(tick_s=0.02, most_s=0.1) as watch:
        report = fuzz.feed(planted_door(hangs), 2, watch=watch)
    assert [place.partition(" ")[0] for place in report.escaped] == ["TooSlowError"]
    assert (report.inputs, report.escapes) == (2, 2)


def test_a_process_that_dies_is_told_with_its_input(fuzz: Any) -> None:
    from concurrent.futures import Future
    from concurrent.futures.process import BrokenProcessPool

    done, died, waiting = Future[Any](), Future[Any](), Future[Any]()
    done.set_result(fuzz.feed(planted_door(lambda: None), 3))
    for one in (died, waiting):
        one.set_exception(BrokenProcessPool("gone"))
    pieces = [fuzz.Piece(door, 4, 9) for door in ("made", "made", "slow")]
    fed = fuzz._collected(list(zip(pieces, (done, died, waiting), strict=True)), [3, 7, 0])
    assert (fed.crashes, [report.inputs for report in fed.reports]) == (["made, piece 4, input 7"], [3])


def test_damaged_contents_of_takes_have_right_checksums(fuzz: Any, tmp_path: Path) -> None:
    from benchmarks._take_mutations import TakeMutations, write_example
    from mocapella.recording.mcap_scan import Damage, End, scan

    mutations, path = TakeMutations(write_example(tmp_path / "seed.mcap")), tmp_path / "damaged.mcap"
    for seed in range(5):
        mutations.write(path, random.Random(seed))
        with path.open("rb") as file:
            events = list(scan(file, path.stat().st_size, "damaged"))
        assert [one for one in events if isinstance(one, Damage)] == []
        assert events[-1] == End(True, 0)
