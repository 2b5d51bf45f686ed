"""The harness of the benchmarks: rows of one form, goals that can be missed, and a command that says what it knows."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from mocapella.errors import MocapellaError

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def harness(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(ROOT)
    import benchmarks.harness

    return benchmarks.harness


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "benchmarks", *arguments]
    return subprocess.run(line, cwd=ROOT, check=False, timeout=120, capture_output=True, text=True)


def test_a_row_without_a_peer_says_so_and_names_the_machine(harness: Any) -> None:
    row = harness.measured("group: thing", 4.0, "µs", goal=harness.at_most(5))
    assert asdict(row) == {
        "name": "group: thing",
        "value": 4.0,
        "unit": "µs",
        "peer": f"none ({harness.machine()})",
        "ratio": None,
        "goal": "≤ 5 µs",
        "met": True,
    }
    assert "cores" in harness.machine()


def test_a_row_with_a_peer_has_its_ratio(harness: Any) -> None:
    row = harness.compared("n", 2.0, "ms", peer="json", peer_value=8.0, goal=harness.times_the_peer(5))
    assert (row.peer, row.ratio, row.goal, row.met) == ("json 8 ms", 4.0, "≥ 5 × the peer", False)


def test_ours_and_the_peer_take_turns(harness: Any) -> None:
    calls: list[str] = []
    row = harness.against_peer(
        "n", lambda: calls.append("o"), lambda: calls.append("p"), "peer", repeat=3, number=4, peer_number=2
    )
    assert "".join(calls) == "oooooppp" * 3  # one call to warm up each time
    assert row.value > 0
    assert row.ratio == pytest.approx(float(row.peer.split()[1]) / row.value, rel=0.01)


@pytest.mark.parametrize(("value", "met"), [(4.9, True), (5.0, True), (5.1, False), (math.nan, False)])
def test_a_goal_can_be_missed(harness: Any, value: float, met: bool) -> None:
    assert harness.measured("n", value, "ms", goal=harness.at_most(5)).met is met
    assert harness.measured("n", -value, "ms", goal=harness.at_least(-5)).met is met


def test_a_goal_of_a_ratio_is_missed_without_a_peer(harness: Any) -> None:
    assert harness.measured("n", 1.0, "ms", goal=harness.times_the_peer(1)).met is False


def test_without_a_goal_nothing_is_met_or_missed(harness: Any) -> None:
    row = harness.measured("n", 1.0, "ms")
    assert (row.goal, row.met) == (None, None)


def test_times_and_loads_are_compared_with_an_earlier_revision(harness: Any) -> None:
    from benchmarks.revision import paired

    def measurement(latency: float, load: float, lost: float = 0.0) -> list[dict[str, Any]]:
        rows = (
            harness.measured("a", latency, "ms"),
            harness.measured("b", load, "%"),
            harness.measured("c", lost, "frames"),
        )
        return [asdict(row) for row in rows]

    # The machine is three times as slow in the last turn.
    ours = [measurement(2.0, 10.6), measurement(2.1, 10.6), measurement(6.0, 31.8)]
    theirs = [measurement(4.0, 10.0), measurement(9.0, 10.0), measurement(12.0, 30.0)]
    a, b, c = paired(ours, theirs, "revision x")
    assert (a.value, a.ratio, a.met, a.peer) == (2.1, 2.0, True, "revision x 4.2 ms")
    assert (b.met, c.ratio) == (False, None)
    (alone, *_) = paired(ours, [measurement(4.0, 10.0), measurement(0.0, 10.0), measurement(4.0, 10.0)], "revision x")
    assert (alone.value, alone.ratio) == (2.1, None)
    (new, *_) = paired(ours, [rows[1:] for rows in theirs], "revision x")
    assert new.ratio is None


def test_a_revision_that_is_not_there_is_said() -> None:
    done = command("codec", "--against", "no-such-revision")
    assert done.returncode == 1
    assert "no revision 'no-such-revision'" in done.stderr


def test_an_unknown_group_is_refused_with_those_there_are() -> None:
    done = command("codek")
    assert done.returncode == 2
    assert "no group 'codek'" in done.stderr
    assert "did you mean codec?" in done.stderr


def test_the_codec_group_runs_and_writes_rows(tmp_path: Path) -> None:
    target = tmp_path / "rows.json"
    done = command("codec", "--quick", "--json", str(target))
    assert done.returncode == 0, done.stderr
    rows = json.loads(target.read_text(encoding="utf-8"))
    assert all(set(row) == {"name", "value", "unit", "peer", "ratio", "goal", "met"} for row in rows)
    crashes = [row for row in rows if "crashes" in row["name"]]
    assert [row["value"] for row in crashes] == [0]
    assert list(tmp_path.iterdir()) == [target]


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(ROOT)
    import benchmarks.install

    return benchmarks.install


def test_an_installation_is_measured_away_from_all_that_is_installed(
    install: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("UV_PROJECT", str(ROOT))
    monkeypatch.setenv("VIRTUAL_ENV", sys.prefix)
    monkeypatch.setenv("UV_CACHE_DIR", "/the/users")
    fresh, quick = (install._environment(tmp_path, keep_cache=keep) for keep in (False, True))
    assert not {"UV_PROJECT", "VIRTUAL_ENV"} & (set(fresh) | set(quick))
    for environment in (fresh, quick):
        assert Path(environment["UV_PROJECT_ENVIRONMENT"]).parent == tmp_path
    assert Path(fresh["UV_CACHE_DIR"]).parent == tmp_path
    assert quick["UV_CACHE_DIR"] == "/the/users"
    copy = install._checkout(tmp_path)
    assert (copy / "src" / "mocapella" / "cli" / "__init__.py").is_file()
    assert list(copy.rglob("__pycache__")) == []


def test_an_installation_that_fails_is_no_figure(install: Any, tmp_path: Path) -> None:
    assert install._timed([sys.executable, "-c", "print(3)"], tmp_path, {}) > 0
    with pytest.raises(MocapellaError, match="ended with 3:\nno room"):
        install._timed(
            [sys.executable, "-c", "import sys; print('no room', file=sys.stderr); sys.exit(3)"], tmp_path, {}
        )


@pytest.mark.slow
def test_the_markers_peer_finds_every_colour_and_keeps_the_wall_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A peer whose thresholds are wrong would be slow and blind, and the comparison with it void."""
    cv2 = pytest.importorskip("cv2")
    monkeypatch.syspath_prepend(ROOT)
    import numpy as np

    from benchmarks.markers import SEEDS, Peer, film

    made = film("desk", SEEDS[0])
    shot = next(made.shots(1))
    for reduced in (False, True):
        peer = Peer(cv2, made.sample, made.profile.names, reduced=reduced)
        for around in (None, shot.centres_px):
            off = np.linalg.norm(peer.centres(shot.image, around) - shot.centres_px, axis=-1)
            assert (off < 2.0).all()


@pytest.fixture
def silhouettes(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(ROOT)
    import benchmarks.silhouettes
    from mocapella.sources.simulate.silhouette_scene import silhouette_scene

    def small(name: str, *, seed: int) -> Any:
        return silhouette_scene(name, seed=seed, cameras=3, size_px=(160, 120))

    monkeypatch.setattr(benchmarks.silhouettes, "silhouette_scene", small)
    return benchmarks.silhouettes


def test_a_part_of_a_group_runs_alone_and_an_unknown_one_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT)
    import benchmarks.__main__ as program
    import benchmarks.silhouettes

    asked: list[Any] = []
    monkeypatch.setattr(benchmarks.silhouettes, "run", lambda quick, parts: asked.append((quick, parts)) or [])
    assert program.main(["silhouettes", "codec", "--part", "live", "--part", "step", "--quick"]) == 0
    assert asked == [(True, ["live", "step"])]  # and of the group without parts nothing
    with pytest.raises(SystemExit):
        program.main(["silhouettes", "--part", "life"])
    with pytest.raises(SystemExit):
        program.main(["codec", "--part", "live"])


@pytest.mark.slow
def test_the_silhouettes_have_their_goals_and_what_did_not_move_misses_them(silhouettes: Any) -> None:
    rows = {row.name.removeprefix("silhouettes: "): row for row in silhouettes.run(quick=True, parts=["noise"])}
    own = rows["runner, 15 % noise, own body, joint angle error"]
    assert (own.goal, own.unit) == ("≤ 3 °", "°")
    assert 0 < own.value < 30
    assert rows["runner, 15 % noise, measured body, joint angle error"].goal is None
    assert rows["runner, noise, jitter lowered by the penalty"].goal == "≥ 60 %"
    assert rows["knee-bend, clean, error added by the penalty"].goal == "≤ 0.3 °"
    # In its first tenth of a second a knee bend does not bend a knee.
    for what in ("peak kept", "lag"):
        assert rows[f"knee-bend, noise, {what}, worst seed"].met is False


@pytest.mark.slow
def test_runs_that_fail_are_counted(silhouettes: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    fails = {0.0: "lost", 1.0: ""}
    weights = iter([0.0, 1.0])
    monkeypatch.setattr(silhouettes, "outcome", lambda *_: silhouettes.Outcome(0, 0, 0, 0, fails[next(weights)]))
    without, with_it = silhouettes.run(quick=True, parts=["corruption"])
    assert (without.value, without.met, with_it.value, with_it.met) == (1, True, 1, True)
    weights, fails[1.0] = iter([0.0, 1.0]), "lost"
    _, with_it = silhouettes.run(quick=True, parts=["corruption"])
    assert (with_it.value, with_it.met) == (0, False)


@pytest.mark.slow
def test_a_frame_is_timed_on_one_core_which_is_given_back(silhouettes: Any) -> None:
    import os

    if hasattr(os, "sched_setaffinity"):
        before = os.sched_getaffinity(0)
        with silhouettes.one_core():
            assert len(os.sched_getaffinity(0)) == 1
        assert os.sched_getaffinity(0) == before
    median, slow = silhouettes.run(quick=True, parts=["live"])
    assert 0 < median.value <= slow.value
    assert "3 cameras 160 × 120, 26 dofs" in median.name


def test_outlines_by_hand_are_drawn_with_their_holes(silhouettes: Any) -> None:
    pytest.importorskip("cv2")
    square = [[10, 10], [19, 10], [19, 29], [10, 29]]
    hole = [[12, 12], [13, 12], [13, 13], [12, 13]]
    mask = silhouettes.drawn([square], [hole])
    assert mask.shape == (1920, 1088)
    assert mask.sum() == 10 * 20 - 4
    assert mask[29, 10] == 1
    assert mask[12, 12] == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "group",
    [
        *(
            "arm_fusion",
            "arm_misdetections",
            "arm_variety",
            "articulated",
            "calibration",
            "calibration_floor",
            "calibration_in_place",
            "codec",
            "conditions",
        ),
        *("datagrams", "depth_render", "exports", "facing", "line_skeleton", "people", "recording"),
        *("segmentation", "stalls"),
        *("tracker", "triangulation", "twists"),
    ],
)
def test_a_benchmark_that_takes_seconds_still_runs(group: str) -> None:
    """What a benchmark calls may change without it; the others take minutes, or start whole sessions."""
    done = command(group, "--quick", "--json", "-")
    assert done.returncode == 0, done.stderr[-2000:]
    assert json.loads(done.stdout)
