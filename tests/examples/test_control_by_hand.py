"""The pointer and the knobs: laws of their mathematics, and both as a user runs them, over real sockets."""

from __future__ import annotations

import importlib.util
import math
import socket
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.programs import Program, free_port, wait_until

from mocapella.errors import CalibrationError
from mocapella.geometry.rigid import rotation_about_x, rotation_about_z
from mocapella.model.arms import ARM_POINTS
from mocapella.model.scene import TrackedArm
from mocapella.sources.osc import messages

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
POINTER, KNOBS = EXAMPLES / "03_pointer.py", EXAMPLES / "04_knobs.py"
ANGLE = st.floats(-3, 3)


def module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


pointer, knobs = module(POINTER), module(KNOBS)


@given(ANGLE, ANGLE, st.floats(-1.4, 1.4))
def test_a_roll_is_the_turn_about_the_palms_axis_whatever_the_hand_did_before_and_beside(
    before: float, turn: float, nod: float
) -> None:
    R = rotation_about_x(before) @ rotation_about_z(before)
    assert knobs.roll(R, R @ rotation_about_z(turn)) == pytest.approx(turn)
    assert knobs.roll(R, R @ rotation_about_x(nod)) == pytest.approx(0.0)


@given(st.lists(st.floats(-3, 3), min_size=1, max_size=6))
def test_a_knobs_turn_is_the_hands_roll_also_past_half_a_turn(steps: list[float]) -> None:
    bank, angle = knobs.Knobs(4, -0.4, 0.4, 100.0), 0.0
    assert bank.update(0.1, np.eye(3), True) == 2
    for step in steps:
        angle += step
        bank.update(0.9, rotation_about_z(angle), True)  # it keeps its knob, wherever it goes
    np.testing.assert_allclose(bank.values, [0.5, 0.5, 0.5 + angle / 100.0, 0.5], atol=1e-9)
    assert bank.update(0.1, rotation_about_z(angle + 1.0), False) is None
    np.testing.assert_allclose(bank.values[2], 0.5 + angle / 100.0, atol=1e-9)


def test_a_knob_ends_at_0_and_1_and_a_grab_beside_the_bank_takes_none() -> None:
    bank = knobs.Knobs(2, -0.4, 0.4, math.pi)
    bank.update(-0.1, np.eye(3), True)
    for angle in (1.0, 2.0):
        bank.update(-0.1, rotation_about_z(angle), True)
    assert bank.values.tolist() == [1.0, 0.5]
    bank.update(0.0, np.eye(3), False)
    assert bank.update(0.5, np.eye(3), True) is None
    assert bank.update(0.1, rotation_about_z(1.0), True) is None  # it came from beside
    assert bank.values.tolist() == [1.0, 0.5]


def arm_at(
    x: float, *, states: int = 2, grabbing: bool = False, cameras: tuple[str, ...] = ("depth",), number: int = 3
) -> TrackedArm:
    """An arm whose index finger points out of (x, 0.8, 1) at the default plane, along -z."""
    points = np.tile([x, 0.8, 1.1], (len(ARM_POINTS), 1))
    points[8, 2] = 1.0
    T, count = np.eye(4), len(points)
    T[:3, :3] = rotation_about_z(x)
    return TrackedArm(
        number, False, points, np.full(count, states, np.uint8), np.full(count, 0.005, np.float32), np.zeros(21), T,
        "", 0.0, grabbing, cameras=cameras,
    )  # fmt: skip


def sent(
    monkeypatch: pytest.MonkeyPatch, example: ModuleType, *arms: TrackedArm | None, hz: float = 1.0, learn: bool = False
) -> list[tuple[str, list[float]]]:
    """The OSC messages of an example that is given a scene for each arm, None for a scene without one."""
    times_ns = [round(k * 1e9 / hz) for k in range(len(arms))]
    scenes = iter(
        [SimpleNamespace(arms=(arm,) if arm else (), at_ns=at) for at, arm in zip(times_ns, arms, strict=True)]
    )
    out: list[tuple[str, list[float]]] = []
    osc = SimpleNamespace(send=lambda address, *values: out.append((address, [round(float(v), 6) for v in values])))
    monkeypatch.setattr(example, "open_reader", lambda _: None)
    monkeypatch.setattr(example, "Newest", lambda _: SimpleNamespace(scene=lambda: next(scenes)))
    monkeypatch.setattr(example.time, "sleep", lambda _: None)
    corners = [-0.5, 1.4, 0.4, 0.5, 1.4, 0.4, -0.5, 0.2, 0.4]
    args = SimpleNamespace(
        connect="", osc="", by="index", corners=corners, learn=learn, knobs=4, bank=[-0.4, 0.4], turn=180.0
    )
    with pytest.raises(
        (StopIteration, RuntimeError), match=r"^$|StopIteration"
    ):  # a generator turns one into the other
        example.main(args, osc)
    return out


def test_the_pointer_goes_by_sure_hands_only_and_a_lost_one_ends_its_click(monkeypatch: pytest.MonkeyPatch) -> None:
    unsure = [arm_at(0.3, states=1), arm_at(0.3, cameras=()), arm_at(0.3, states=1, grabbing=True)]
    assert sent(monkeypatch, pointer, *unsure, None) == []
    click = [arm_at(0.25), arm_at(0.0, grabbing=True), arm_at(0.0, states=1), None]
    assert sent(monkeypatch, pointer, *click) == [
        ("/pointer", [0.75, 0.5]), ("/pointer/click", [1.0]), ("/pointer/click", [0.0])
    ]  # fmt: skip


def test_another_arm_does_not_begin_where_the_last_one_pointed(monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = [arm_at(-0.25)] * 3, arm_at(0.25, number=4)
    assert sent(monkeypatch, pointer, *one, other, hz=30.0)[-1] == ("/pointer", [0.75, 0.5])
    assert sent(monkeypatch, pointer, *one, arm_at(0.25), hz=30.0)[-1][1][0] < 0.7  # the same arm is smoothed


def pointing(x: float, corner: tuple[float, ...]) -> TrackedArm:
    """An arm at (x, 0.8, 1) whose index finger points at a corner."""
    arm = arm_at(x)
    away = arm.points[8] - corner
    arm.points[5] = arm.points[8] + 0.08 * away / np.linalg.norm(away)
    return arm


def test_corners_are_learnt_by_pointing_and_printed_as_the_command_that_repeats_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    corners = [(-0.4, 1.2, 0.1), (0.4, 1.2, 0.0), (-0.4, 0.6, 0.1)]
    still = [pointing(x, corner) for x in (-0.5, 0.5) for corner in corners for _ in range(60)]
    middle = pointing(0.5, (0.0, 0.9, 0.05))
    assert sent(monkeypatch, pointer, *still, None, middle, hz=30.0, learn=True)[-1] == ("/pointer", [0.5, 0.5])
    said = capsys.readouterr().out
    assert said.count("hold still") == 6
    assert said.count("to the side") == 1
    words = "--by index --corners -0.400 1.200 0.100 0.400 1.200 0.000 -0.400 0.600 0.100"
    assert words in said
    place = [float(word) for word in words.split()[3:]]
    assert pointer.plane_corners(place).tolist() == [list(corner) for corner in corners]


def test_corners_taught_from_one_place_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = [(-0.4, 1.2, 0.1), (0.4, 1.2, 0.0), (-0.4, 0.6, 0.1)]
    still = [pointing(x, corner) for x in (0.0, 0.05) for corner in corners for _ in range(60)]
    with pytest.raises(CalibrationError, match=r"top left corner.*farther apart"):
        sent(monkeypatch, pointer, *still, hz=30.0, learn=True)


def test_knobs_turn_by_sure_hands_only_and_a_lost_one_lets_go(monkeypatch: pytest.MonkeyPatch) -> None:
    take, turned = arm_at(0.05, grabbing=True), arm_at(0.15, grabbing=True)
    unsure = [arm_at(0.3, states=1, grabbing=True), arm_at(0.3, cameras=(), grabbing=True)]
    assert sent(monkeypatch, knobs, *unsure, None) == []
    value = round(0.5 + 0.1 / math.pi, 6)
    assert sent(monkeypatch, knobs, take, *unsure, turned) == [("/knob/3", [0.5]), ("/knob/3", [value])]
    assert sent(monkeypatch, knobs, take, None, arm_at(0.35, grabbing=True)) == [("/knob/3", [0.5]), ("/knob/4", [0.5])]


@pytest.mark.parametrize(
    ("example", "words", "expected"),
    [
        (POINTER, ["--osc", "nowhere"], "OSC address 'nowhere': expected HOST:PORT"),
        (POINTER, ["--osc", "127.0.0.1:00000650009"], "expected HOST:PORT"),
        (KNOBS, ["--osc", "nowhere"], "OSC address 'nowhere': expected HOST:PORT"),
        (POINTER, ["--corners", *"000100200"], "--corners"),
        (KNOBS, ["--turn", "0"], "--turn"),
        (KNOBS, ["--bank", "1", "1"], "--bank"),
        (POINTER, [], "start a server there (mocapella serve)"),
        (KNOBS, [], "start a server there (mocapella serve)"),
    ],
)
@pytest.mark.slow
def test_what_is_wrong_is_said_in_one_line(example: Path, words: list[str], expected: str) -> None:
    command = [sys.executable, str(example), "--connect", f"tls/127.0.0.1:{free_port()}", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert expected in done.stderr


@pytest.mark.slow
def test_both_send_the_hand_of_a_live_session(tmp_path: Path) -> None:
    assert all(len(path.read_text().splitlines()) < 80 for path in (POINTER, KNOBS))
    port, heard = free_port(), dict[str, list[tuple[Any, ...]]]()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(0.05)
        osc = f"127.0.0.1:{receiver.getsockname()[1]}"

        def all_came() -> bool:
            try:
                while True:
                    for message in messages(receiver.recv(999)):
                        heard.setdefault(message.address, []).append(message.arguments)
            except TimeoutError:
                clicks = {value for (value,) in heard.get("/pointer/click", [])}
                moved = np.ptp([y for _, y in heard.get("/pointer", [(0.0, 0.0)])]) > 0.1
                return clicks == {0.0, 1.0} and bool(moved) and any(name[:5] == "/knob" for name in heard)

        with Program(tmp_path, "demo", "demo", "arm", "--no-view", "--port", str(port)) as demo:
            wait_until("an arm is tracked", demo.said("tracking"), timeout=240.0)
            command = ["--connect", f"tls/127.0.0.1:{port}", "--osc", osc]
            programs = [subprocess.Popen([sys.executable, str(path), *command]) for path in (POINTER, KNOBS)]
            try:
                wait_until("a pointer that moves, a click and a knob", all_came, timeout=120.0)
            finally:
                for program in programs:
                    program.kill()
                    program.wait()
            assert demo.end() == 0
    values = np.array([value for values in heard.values() for value in values for value in value])
    assert ((values >= 0) & (values <= 1)).all()
