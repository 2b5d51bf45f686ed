"""``mocapella calibrate hand``: from a take and live, to a hand that the method hands then tracks better with."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.gesturing_hand import BASE_NAMES, PHASES_S, frames, rig, scenes, somebody
from support.programs import Program, free_port, wait_until
from typer.testing import CliRunner

from mocapella.cli import hand as _hand  # noqa: F401  (it registers)
from mocapella.cli.app import app
from mocapella.errors import InputError, SettingsError
from mocapella.kinematics.hand_bones import PHASES
from mocapella.model.camera_rig_file import encode_camera_rig, save_camera_rig
from mocapella.model.hand_file import decode_hand_shape, load_hand_shape
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.model.session import Setup
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene
from mocapella.tracker import make_tracker
from mocapella.wire.server import ServerLink

PHASES_TEXT = ",".join(f"{phase}={begin:g}:{end:g}" for phase, (begin, end) in PHASES_S.items())


def write_take(path: Path, rows: tuple[tuple[Arrival, Scene], ...], **settings: Any) -> Path:
    info = TakeInfo(Setup("hands", sensors_expected=2), 1_700_000_000 * 10**9, 0, method_settings=settings)
    writer = TakeWriter.create(path, info=info, reserve_bytes=0)
    for arrival, scene in rows:
        frame, log_ns = arrival.frame, arrival.at_ns
        told = {"sensor": frame.sensor, "node_id": frame.node_id, "sequence": frame.sequence}
        assert writer.write_frame(encode_frame(frame), **told, log_ns=log_ns)
        writer.write_scene(encode_scene(scene), log_ns)
    writer.close()
    return path


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = {"rig": encode_camera_rig(rig()), "base": list(BASE_NAMES)}
    return write_take(tmp_path_factory.mktemp("takes") / "gesture.mcap", scenes(), **settings)


def measure(*words: str) -> Any:
    """What ``--json -`` prints, or the error."""
    done = CliRunner().invoke(app, ["calibrate", "hand", *words, "--json", "-"])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout[done.stdout.index("{") :])


@pytest.mark.slow
def test_a_take_of_the_gesture_gives_a_hand_that_is_tracked_better_with(take: Path, tmp_path: Path) -> None:
    out, truth = tmp_path / "ada.json", somebody()
    row = measure(str(take), "--phases", PHASES_TEXT, "--person", "Ada", "--out", str(out))
    hand = load_hand_shape(out)
    assert (hand.person, hand.handedness, row["proportioned"]) == ("Ada", "right", ["thumb"])
    assert hand.lengths_sd is not None
    off = hand.lengths - truth.lengths
    assert (np.abs(off) < 2 * hand.lengths_sd).all()
    np.testing.assert_allclose([row["lengths_mm"][name] for name in row["lengths_mm"]], 1000 * hand.lengths, atol=0.01)
    assert row["whole_sd_mm"]["thumb"] > row["whole_sd_mm"]["index"]
    assert min(row["knuckles_moved_deg"].values()) > 60
    assert min(row["hook_moved_deg"].values()) > 60
    assert set(row["base_places_mm"]) == set(BASE_NAMES)

    # What `serve --method hands --file hand=FILE` does: the same frames with the average and with the measured hand.
    settings = {"rig": encode_camera_rig(rig()), "base": list(BASE_NAMES)}
    residuals = {}
    for name, told in (("average", {}), ("measured", {"hand": out.read_text(encoding="utf-8")})):
        tracker = make_tracker("hands", sensors_expected=2, settings={**settings, **told})
        assert told == {} or decode_hand_shape(told["hand"].encode()).person == "Ada"
        off_m = []
        for arrival, _ in scenes()[:160]:
            scene = tracker.update(arrival)
            if scene.hands and scene.points is not None:
                tips = scene.hands[0].landmarks[[8, 12, 16, 20]]
                off_m.append(np.linalg.norm(tips - scene.points.positions[1:5], axis=-1).mean())
        residuals[name] = np.median(off_m)
    assert residuals["measured"] < 0.5 * residuals["average"]


@pytest.mark.slow
def test_it_prints_the_table_with_what_is_only_proportioned(take: Path, tmp_path: Path) -> None:
    out = tmp_path / "hand.json"
    done = CliRunner().invoke(
        app, ["calibrate", "hand", str(take), "--phases", PHASES_TEXT, "--out", str(out)], env={"COLUMNS": "160"}
    )
    assert done.exit_code == 0, done.output
    assert "in proportion to the fingers" in " ".join(done.stderr.split())
    assert "±" in done.stderr
    assert f"serve --method hands --file hand={out}" in done.stderr
    assert "base_places_m=[[" in done.stderr


@pytest.mark.slow
def test_frames_of_a_take_can_be_tracked_anew_for_a_left_hand(tmp_path: Path) -> None:
    """The take's own scenes know one marker of the base only."""
    rows = tuple(
        (arrival, without_points(scene)) for arrival, (_, scene) in zip(frames(somebody("left")), scenes(), strict=True)
    )
    take = write_take(tmp_path / "left.mcap", rows, base=["cyan"])
    save_camera_rig(tmp_path / "rig.toml", rig())
    words = [str(take), "--phases", PHASES_TEXT, "--left", "--out", str(tmp_path / "left.json")]
    with pytest.raises(SettingsError, match="three or more markers, so that they tell how the palm lies"):
        measure(*words)
    with pytest.raises(InputError, match="no markers that cameras see"):
        measure(*words, "--base", ",".join(BASE_NAMES))
    measure(*words, "--base", ",".join(BASE_NAMES), "--rig", str(tmp_path / "rig.toml"))
    hand = load_hand_shape(tmp_path / "left.json")
    assert hand.handedness == "left"
    assert hand.lengths_sd is not None
    assert (np.abs(hand.lengths - somebody("left").lengths) < 2 * hand.lengths_sd).all()


def without_points(scene: Scene) -> Scene:
    return scene.with_parts(points=())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "error", "why"),
    [
        (["--phases", PHASES_TEXT.replace("hook", "hok")], SettingsError, "did you mean hook"),
        (["--phases", "flat=0:2,knuckles=2:5,hook=9:12"], InputError, "before the part 'hook' begins"),
        (["--phases", "flat=0:2,knuckles=5:8,hook=2:5"], InputError, "index: moves by 1° only in the part 'hook'"),
        (["--phases", "flat=0:2,knuckles=2:5,hook=5:5.3"], InputError, "seen too rarely in the part 'hook'"),
        (["--phases", PHASES_TEXT, "--base", "cyan,white,grey"], InputError, "'grey': is not tracked; choose of"),
        (["--phases", PHASES_TEXT, "--base", "cyan,white,orange,blue,x"], SettingsError, "once|three or four"),
        (["--phases", PHASES_TEXT, "--set", "hand_length_mm=18"], SettingsError, "hand_length_m is 0.018"),
        (["--phases", PHASES_TEXT, "--out", "no/such/folder.json"], SettingsError, "there is no folder no/such"),
        ([], SettingsError, "a take wants --phases flat=0:4"),
    ],
)
def test_what_cannot_be_measured_says_why_and_writes_nothing(
    words: list[str], error: type[Exception], why: str, take: Path, tmp_path: Path
) -> None:
    out = tmp_path / "hand.json"
    with pytest.raises(error, match=why):
        measure(str(take), "--out", str(out), *words)
    assert not out.exists()


def test_live_wants_no_phases_and_no_rig(tmp_path: Path) -> None:
    out = ["--out", str(tmp_path / "hand.json"), "--base", ",".join(BASE_NAMES)]
    for words, why in (
        (["--phases", PHASES_TEXT], "--phases is of a take"),
        (["--rig", "rig.toml"], "live, the server knows its cameras"),
        (["--set", "lasting=4,6"], "lasting '4,6' cannot be used; write it as 4,6,6"),
    ):
        with pytest.raises(SettingsError, match=why):
            measure(*out, *words)


@pytest.mark.slow
def test_live_it_leads_through_the_gesture(tmp_path: Path) -> None:
    """A process that says what to do, and scenes on the bus of somebody who does it."""
    address, out, report = f"tcp/127.0.0.1:{free_port()}", tmp_path / "ada.json", tmp_path / "report.json"
    by_phase = {
        phase: [scene for arrival, scene in scenes() if begin <= (arrival.at_ns - 1) / 1e9 < end]
        for phase, (begin, end) in PHASES_S.items()
    }
    link, over = ServerLink(address, on_nonsense=lambda text: None), threading.Event()
    words = ["calibrate", "hand", "--base", ",".join(BASE_NAMES), "--person", "Ada", "--out", str(out)]
    words += ["--connect", address, "--set", "lasting=1.6,2,2", "--set", "prepare=0.1", "--json", str(report)]
    try:
        with Program(tmp_path, "measure", *words) as program:
            acting = threading.Thread(target=act, args=(program, by_phase, link.publish_scene, over))
            acting.start()
            try:
                wait_until("it is measured", lambda: program.process.poll() is not None)
            finally:
                over.set()
                acting.join()
            assert program.process.poll() == 0, program.output
            for phase in PHASES:
                assert f"{phase}: now, for" in program.output
    finally:
        link.close()
    row, hand = json.loads(report.read_text()), load_hand_shape(out)
    assert hand.person == row["person"] == "Ada"
    assert hand.lengths_sd is not None
    assert (np.abs(hand.lengths - somebody().lengths) < 2 * hand.lengths_sd).all()


def act(
    program: Program, by_phase: dict[str, list[Scene]], publish: Callable[[bytes], None], over: threading.Event
) -> None:
    """Do what was said last, in real time."""
    encoded = {phase: [encode_scene(scene) for scene in of] for phase, of in by_phase.items()}
    phase, k = "flat", 0
    while not over.wait(1 / 60):
        said = max(PHASES, key=lambda name: program.output.rfind(f"{name}: now"))
        phase, k = (said, 0) if said != phase else (phase, k + 1)
        of = encoded[phase]
        # Forth and back: a swing is even in time.
        place = k % (2 * len(of) - 2)
        publish(of[min(place, 2 * len(of) - 2 - place)])
