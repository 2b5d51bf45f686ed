"""``mocapella align``: from a take to a file that the tracker uses; and what is said of a take that will not do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from mocapella.cli.align import align
from mocapella.cli.app import app
from mocapella.errors import CalibrationError, InputError, MocapellaError, SettingsError
from mocapella.geometry.rigid import inverse, rigid
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.model.poses import pose_frame, quaternion_of
from mocapella.model.scene import Phase, Scene, TrackedObject, TrackedPoints, TrackerState
from mocapella.model.session import Setup
from mocapella.model.space import load_space
from mocapella.model.topology import topology
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene

T_WORLD_VR = rigid(exp_twist([0, 0, 0, 0.1, 1.0, -0.2])[:3, :3], [0.5, -1.0, 2.0])
ON_BODY = rigid(exp_twist([0, 0, 0, 0.4, 0, 0])[:3, :3], [0.01, 0.05, -0.02])
DELAY_S = 0.03
assert align  # registers the verb


def wand(t: float, turned: bool = True) -> np.ndarray:
    phi = 0.7 * np.sin(np.array([2.0, 3.1, 1.6]) * t + [0, 1, 2]) * turned
    return rigid(exp_twist([0, 0, 0, *phi])[:3, :3], 0.15 * np.sin(np.array([1.5, 2.2, 2.9]) * t))


def recorded(path: Path, *, seconds: float = 6.0, turned: bool = True, spaces: tuple[str, ...] = ("vr",)) -> Path:
    """Of the wand's place, of a marker on it, and of poses that nobody could use then."""
    setup = Setup("hands", sensors_expected=2, participant=1, placement="", scenario="")
    writer = TakeWriter.create(path, info=TakeInfo(setup=setup, started_unix_ns=0, started_ns=0), reserve_bytes=0)
    state, sd, two = TrackerState(Phase.TRACKING), np.array([0.001], np.float32), np.array([2], np.uint8)
    step = 0
    for k in range(round(seconds * 50)):
        at_ns = round(1e9 * (1 + k / 50))
        seen = wand(k / 50, turned) @ ON_BODY
        thing = TrackedObject("wand", seen, np.zeros((2, 3)), 2)
        points = TrackedPoints(("cyan",), seen[None, :3, 3], sd, two)
        for space in spaces:
            T = inverse(T_WORLD_VR) @ wand(k / 50 - DELAY_S, turned)
            frame = pose_frame(
                space, space, ["LHR-1"], time_ns=at_ns, positions=[T[:3, 3]], orientations=[quaternion_of(T[:3, :3])],
                node_id=7, sequence=k,
            )  # fmt: skip
            scene = Scene(step, at_ns, space, 7, k, topology("hand"), state, (), (), (), points, (thing,))
            writer.write_frame(encode_frame(frame), sensor=space, node_id=7, sequence=k, log_ns=at_ns)
            writer.write_scene(encode_scene(scene), at_ns)
            step += 1
    writer.close()
    return path


def run(*words: object) -> Any:
    return CliRunner().invoke(app, ["align", *map(str, words)])


@pytest.mark.parametrize("what", [("--thing", "wand"), ("--marker", "cyan")])
def test_a_take_becomes_a_file(tmp_path: Path, what: tuple[str, str]) -> None:
    take, out, report = recorded(tmp_path / "move.mcap"), tmp_path / "vr.toml", tmp_path / "vr.json"
    result = run(take, "--body", "LHR-1", *what, "--out", out, "--json", report)
    assert result.exit_code == 0, result.output
    found = load_space(out)
    assert found.space == "vr"
    off = found.T_world_space @ inverse(T_WORLD_VR)
    assert np.linalg.norm(log_motion(off)[3:]) < 2e-3
    assert found.clock_s == pytest.approx(DELAY_S, abs=1e-3)
    said = json.loads(report.read_text())
    np.testing.assert_allclose(said["lever_m"], ON_BODY[:3, 3], atol=2e-3)


@pytest.mark.parametrize(
    ("words", "kind", "said"),
    [
        (("--body", "LHR-1"), SettingsError, "either --marker or --thing"),
        (("--body", "LHR-1", "--thing", "a", "--marker", "b"), SettingsError, "either --marker or --thing"),
        (("--body", "LHR-1", "--thing", "wnd"), SettingsError, "the take has wand"),
        (("--body", "LHR-1", "--marker", "red"), SettingsError, "the take has cyan"),
        (("--body", "LHR-2", "--thing", "wand"), InputError, "LHR-1"),
        (("--body", "LHR-1", "--thing", "wand", "--space", "stage"), InputError, "no such space"),
    ],
)
def test_what_the_take_does_not_have_is_named(
    tmp_path: Path, words: tuple[str, ...], kind: type[MocapellaError], said: str
) -> None:
    result = run(recorded(tmp_path / "move.mcap", seconds=0.2), *words, "--out", tmp_path / "vr.toml")
    assert isinstance(result.exception, kind)
    assert said in str(result.exception)
    assert not (tmp_path / "vr.toml").exists()


def test_a_take_that_will_not_do_says_why(tmp_path: Path) -> None:
    def refused(take: Path) -> BaseException:
        result = run(take, "--body", "LHR-1", "--thing", "wand", "--out", tmp_path / "vr.toml")
        assert result.exception is not None
        return result.exception

    still = refused(recorded(tmp_path / "still.mcap", turned=False))
    assert isinstance(still, CalibrationError)
    assert "too little rotation" in str(still)
    assert "several spaces" in str(refused(recorded(tmp_path / "two.mcap", seconds=0.2, spaces=("vr", "stage"))))
    assert "no poses of another tracker" in str(refused(recorded(tmp_path / "none.mcap", seconds=0.2, spaces=())))
