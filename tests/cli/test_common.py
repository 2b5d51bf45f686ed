"""What the verbs share: addresses, warnings, and how a take's end becomes an exit status."""

from __future__ import annotations

import ctypes
import inspect
import io
import os
import signal
import sys
from pathlib import Path

import numba
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from support.programs import run_here
from typer.testing import CliRunner

from mocapella.cli.app import app
from mocapella.cli.common import (
    DEFAULT_ADDRESS,
    Terminal,
    check_out,
    exit_by,
    get_ready,
    recording_row,
    say,
    take_file,
    telling_of_compiling,
    warn_if_open,
    working,
)
from mocapella.cli.demo import demo
from mocapella.cli.serve import serve
from mocapella.errors import RecordingError, SettingsError
from mocapella.model.session import RecordingHealth, Setup
from mocapella.recording.disk import take_path
from mocapella.settings import settings_of_pairs
from mocapella.tracker import METHODS, make_tracker
from mocapella.tracker.default_settings import DefaultSettings
from mocapella.tracker.people import PeopleSettings
from mocapella.viewer.setup_form import SetupFields
from mocapella.wire import session


def test_the_command_line_and_the_bus_have_one_default_address() -> None:
    assert DEFAULT_ADDRESS == session.DEFAULT_ADDRESS


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_nothing_is_said_of_an_address_that_only_this_machine_reaches(
    host: str, capsys: pytest.CaptureFixture[str]
) -> None:
    warn_if_open("the view is", host, 7448)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("host", ["0.0.0.0", "[::]", "192.168.1.7", "kinect-pc", "127.evil.example"])
def test_an_open_interface_is_warned_of(host: str, capsys: pytest.CaptureFixture[str]) -> None:
    warn_if_open("the view is", host, 7448)
    assert f"WARNING: the view is open to everyone who can reach {host}:7448" in capsys.readouterr().err


def test_a_take_with_a_problem_is_an_exit_status_and_any_other_is_none() -> None:
    assert recording_row(RecordingHealth()) is None
    exit_by(None)
    exit_by(recording_row(RecordingHealth(path="walk.mcap", frames=3)))
    with pytest.raises(typer.Exit) as ended:
        exit_by(recording_row(RecordingHealth(path="walk.mcap", problem="the disk is full")))
    assert ended.value.exit_code == 1


def test_an_out_that_cannot_be_written_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "hand.json"
    assert check_out(out) == out
    for path, why in ((tmp_path, "it is a folder"), (tmp_path / "none" / "hand.json", "there is no folder")):
        with pytest.raises(SettingsError, match=why):
            check_out(path)
    monkeypatch.setattr(os, "access", lambda *_: False)  # the superuser may write anywhere
    with pytest.raises(SettingsError, match=r"--out .*hand.json: .* cannot be written to; name a file in a folder"):
        check_out(out)


@pytest.mark.parametrize("text", ["Infinity", "-Infinity", "NaN", "1e999", "9" * 40, "9" * 5000])
def test_a_number_that_a_take_could_not_keep_is_refused(text: str) -> None:
    """JSON has none of them: a take made with one could not be replayed."""
    with pytest.raises(SettingsError, match="leave the setting out"):
        settings_of_pairs([f"max_distance_m={text}"])


@pytest.mark.slow
@given(st.from_regex(r"[A-Za-z0-9_-]{1,20}", fullmatch=True), st.sampled_from([".", "takes", "/data/study 7"]))
def test_a_take_is_named_alike_wherever_it_is_begun(name: str, folder: str) -> None:
    """With and without the suffix, by ``--record`` and by ``mocapella record``."""
    path = take_file(Path(folder) / name)
    assert path == take_file(path) == take_path(folder, name)
    assert path.suffix == ".mcap"


def test_a_name_that_a_take_may_not_have_is_refused() -> None:
    with pytest.raises(RecordingError, match="use letters"):
        take_file(Path("takes") / "a:b")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_work_that_is_interrupted_is_an_exit_status_and_a_line(
    number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    before = signal.getsignal(number)
    with pytest.raises(typer.Exit) as ended, working("writing …", status=130):
        signal.raise_signal(number)
    assert ended.value.exit_code == 130
    assert "stopped before the end" in capsys.readouterr().err
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("fails_then", [True, False])
def test_an_interruption_that_c_has_lost_is_one_all_the_same(
    fails_then: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """A compiler that is called back when the signal comes goes on as if nothing were, or fails in its own way."""
    called_back = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))
    went_on = []
    hook = sys.unraisablehook

    def compile_it() -> None:
        called_back()
        went_on.append(1)
        if fails_then:
            raise RuntimeError("no compiled object yet")

    with pytest.raises(typer.Exit) as ended, working("compiling …", status=130):
        compile_it()
    assert (ended.value.exit_code, went_on) == (130, [1])
    assert capsys.readouterr().err.strip() == "stopped before the end"
    assert sys.unraisablehook is hook


@pytest.mark.parametrize("compiles", [True, False])
def test_who_waits_for_a_method_to_be_compiled_is_told(
    compiles: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[str] = []

    class FakeCompilation:
        def __init__(self, method: str) -> None:
            made.append(method)

        def __enter__(self) -> FakeCompilation:
            return self

        def __exit__(self, *_: object) -> None: ...

        def wait(self, *_: object) -> None: ...

    monkeypatch.setattr("mocapella.tracker.is_compiled", lambda method: not compiles)
    monkeypatch.setattr("mocapella.live.compilation.Compilation", FakeCompilation)
    monkeypatch.setattr("mocapella.tracker.warm_up", made.append)
    get_ready("default")
    assert made == ["default", "default"] * compiles
    assert ("compiling the method default for this machine" in capsys.readouterr().err) == compiles


def test_who_waits_for_kernels_is_told_what_is_compiled(capsys: pytest.CaptureFixture[str]) -> None:
    @numba.njit
    def new(x: float) -> float:
        return x + 1

    for told in (True, False):
        with telling_of_compiling("the arm"):
            new(1.0)
        assert ("compiling the arm for this machine" in capsys.readouterr().err) == told


def test_the_method_where_none_is_named_is_the_same_everywhere() -> None:
    of_verbs = {inspect.signature(verb).parameters["method"].default for verb in (demo, serve)}
    assert of_verbs | {SetupFields().method, Setup().method} == {"default"}
    assert "default" in METHODS


def test_a_dot_leads_into_a_group_of_settings() -> None:
    given = settings_of_pairs(["people.smoothing=kalman", "people.fusion.age_speed=0.5", "keep_root_s=2"])
    assert given == {"people": {"smoothing": "kalman", "fusion": {"age_speed": 0.5}}, "keep_root_s": 2}
    settings = make_tracker("default", settings=settings_of_pairs(["people.smoothing=kalman"])).settings
    assert settings == DefaultSettings(people=PeopleSettings(smoothing="kalman"))


@given(st.permutations(["people.smoothing=kalman", "people=3", "people.fusion.age_speed=0.5"]))
def test_a_value_and_a_group_of_one_name_are_refused_in_any_order(pairs: list[str]) -> None:
    with pytest.raises(SettingsError, match="has a value already; leave one of them out"):
        settings_of_pairs(pairs)


def test_the_methods_are_listed_with_what_they_take_make_and_export() -> None:
    said = CliRunner().invoke(app, ["serve", "--method", "help"])
    assert said.exit_code == 0
    told = dict(line.split(":", 1) for line in said.output.splitlines() if not line.startswith(" "))
    assert {name: METHODS.find(name).summary for name in told} == {name: text.strip() for name, text in told.items()}
    assert set(told) >= {"default", "stand-still", "hands", "arms", "silhouettes"}
    (exports,) = {line.partition("exports: ")[2] for line in said.output.splitlines() if "results: people;" in line}
    assert {"study-log", "csv", "bvh", "json"} <= set(exports.split(", "))
    assert "arms" not in exports.split(", ")


def test_what_a_terminal_would_carry_out_is_shown(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    say("sensor \x1b[2Jfront\u202e [bold]\nsecond line")
    assert capsys.readouterr().err == "sensor \\x1b[2Jfront\\u202e [bold]\nsecond line\n"
    done = run_here(tmp_path, "replay", "a\x1b]0;title\x07\nb")
    assert done.returncode == 1
    assert "\x1b]" not in done.stderr
    assert "a\\x1b]0;title\\x07\\nb" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("error", [BrokenPipeError(32, "Broken pipe"), OSError(5, "Input/output error")])
def test_a_terminal_that_is_closed_ends_no_session(error: OSError, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rich would raise SystemExit, which also ends a thread without a word."""

    class Closed(io.StringIO):
        def write(self, text: str) -> int:
            raise error

    monkeypatch.setattr("mocapella.cli.common.console", Terminal(file=Closed()))
    say("one line")
    say("and another")
