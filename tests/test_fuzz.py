"""A small, always equal part of `python -m benchmarks fuzz`: no reader lets an error escape that is not ours."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mocapella.errors import InputError

pytest.importorskip("cv2")
pytest.importorskip("pygltflib")
ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def fuzz() -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        import benchmarks.fuzz

        yield benchmarks.fuzz


@pytest.fixture(scope="module")
def doors(fuzz: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    from benchmarks._doors import doors

    return {door.name: door for door in doors(tmp_path_factory.mktemp("fuzz"))}


def test_nothing_escapes_from_any_reader(fuzz: Any, doors: dict[str, Any]) -> None:
    reports = [fuzz.feed(door, round(20 + 60 * door.share)) for door in doors.values()]
    assert {one.name: one.escaped for one in reports if one.escaped} == {}
    assert sum(one.refused for one in reports) > 0.5 * sum(one.inputs for one in reports)
    rows = {row.name.partition(" of ")[0].partition(" (")[0]: row for row in fuzz.rows_of(reports)}
    assert [rows[f"fuzz: {what}"].met for what in ("escaped", "most memory")] == [True, True]


def test_every_reader_is_a_part_that_can_be_named(fuzz: Any, doors: dict[str, Any]) -> None:
    assert tuple(doors) == fuzz.PARTS


def test_the_same_seed_gives_the_same_inputs(doors: dict[str, Any]) -> None:
    for name in ("frames", "hands", "depth images"):
        first, again = (doors[name].inputs(random.Random(5)) for _ in range(2))
        assert [next(first)[1] for _ in range(30)] == [next(again)[1] for _ in range(30)]


@pytest.mark.parametrize(
    ("error", "refused", "escaped"),
    [
        (InputError("is no hand"), 3, 0),
        (InputError("is no\nhand"), 3, 3),
        (ValueError("too many digits"), 0, 3),
        (RecursionError("too deep"), 0, 3),
        (SyntaxError("no dtype"), 0, 3),
    ],
)
def test_what_escapes_is_counted(fuzz: Any, error: Exception, refused: int, escaped: int) -> None:
    from benchmarks._doors import Door

    def fails() -> None:
        raise error

    def inputs(_: random.Random) -> Iterator[tuple[Callable[[], Any], bytes]]:
        while True:
            yield fails, b"bad"

    report = fuzz.feed(Door("made", 1.0, inputs), 3)
    assert (report.inputs, report.refused, report.escapes) == (3, refused, escaped)
    assert fuzz.rows_of([report])[0].met is (escaped == 0)


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
