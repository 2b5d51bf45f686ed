"""Kernels that are compiled in other processes while a session serves its sensors."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.distributions import distribution
from support.forked import Forked
from support.programs import Program, free_port, wait_until

from mocapella.cli.common import PAGE_DRAWN
from mocapella.cli.live_session import LiveSession, _pass_on, compiling
from mocapella.errors import NotNowError
from mocapella.live import compilation
from mocapella.live.compilation import Compilation
from mocapella.live.launch import Children
from mocapella.live.session import Session
from mocapella.model.names import plural
from mocapella.model.scene import Phase
from mocapella.model.session import Setup
from mocapella.tracker import METHODS, is_compiled

METHOD = """
import time
from dataclasses import dataclass

from mocapella.compiled import njit
from mocapella.tracker.methods.stand_still import METHOD as STAND_STILL
from mocapella.tracker.method import Method

@dataclass(frozen=True)
class Nothing:
    pass

@njit(cache=True)
def slow(x):
    return x + 1

@njit(cache=True)
def other(x):
    return x + 2

def warm_up_run():
    time.sleep(1.0)
    slow(1)
    return STAND_STILL.make({}, 1, {}), ()

def part():
    other(1)
    raise SystemExit("a part that fails is no harm")

TINY = Method(
    interface=1, name="tiny", summary="two kernels", settings=Nothing, frame_types=STAND_STILL.frame_types,
    parts=("people",), make=lambda settings, expected, sensors: STAND_STILL.make({}, expected, sensors),
    warm_up_run=warm_up_run, warm_up_parts=("tiny_kernels:part",),
)
"""


COUNT = """
import gc
import sys
from types import ModuleType

from mocapella.kernel_dispatcher import KernelDispatcher
from mocapella.tracker import warm_up

warm_up(sys.argv[1])
found, open_ = set(), [one for one in gc.get_objects() if issubclass(type(one), KernelDispatcher) and one.overloads]
while open_:
    kernel = open_.pop()
    if kernel not in found:
        found.add(kernel)
        names = kernel.py_func.__code__.co_names
        named = [kernel.py_func.__globals__.get(name) for name in names]
        named += [getattr(one, name, None) for one in named if isinstance(one, ModuleType) for name in names]
        open_ += [one for one in named if isinstance(one, KernelDispatcher)]
print(len(found))
"""
"""Prints how many kernels a method's warm-up run calls, by Python or by each other."""


@pytest.fixture
def tiny(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that processes find a package in, with a method whose kernels are not compiled yet."""
    methods = {"mocapella.methods": {"tiny": "tiny_kernels:TINY"}}
    distribution(tmp_path, "tiny", methods, {"tiny_kernels.py": METHOD})
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "compiled"))
    return tmp_path


@pytest.mark.slow
def test_a_server_listens_while_its_method_is_compiled_and_tracks_afterwards(tiny: Path) -> None:
    words = ("serve", "--method", "tiny", "--no-view", "--port", str(free_port()))
    with Program(tiny, "first", *words) as serve:
        wait_until("the server", serve.said("waiting for sensors at"))
        wait_until("tracking", serve.said("started"))
        assert serve.end() == 0
    assert serve.output.index("compiling the method tiny") < serve.output.index("waiting for sensors at")
    names = [entry.name for entry in (tiny / "compiled").rglob("*.nbi")]
    assert any("slow" in name for name in names)
    assert any("other" in name for name in names)
    with Program(tiny, "second", *words) as serve:
        wait_until("the server", serve.said("waiting for sensors at"))
        assert serve.end() == 0
    assert "compiling" not in serve.output
    assert "started" not in serve.output


@pytest.mark.slow
def test_a_session_that_was_to_wait_is_not_started_by_the_end_of_a_compilation(tiny: Path) -> None:
    words = (
        "serve",
        "--method",
        "tiny",
        "--no-view",
        "--set",
        "wait=true",
        "--set",
        "seconds=0.5",
        "--port",
        str(free_port()),
    )
    with Program(tiny, "wait", *words) as serve:
        assert serve.process.wait(90) == 0
    assert "compiling the method tiny" in serve.output
    assert "started" not in serve.output


def test_until_tracking_begins_the_state_gives_the_reason() -> None:
    session = Session(Setup(method="stand-still"), running=False, waiting_for="compiling")
    assert (session.state.phase, session.state.reason) == (Phase.STOPPED, "compiling")
    session.ready()
    assert (session.state.phase, session.state.reason) == (Phase.STOPPED, "")
    session.carry_out("start", {})
    assert (session.state.phase, session.state.reason) == (Phase.WAITING_FOR_SENSORS, "")


@pytest.mark.parametrize("verb", ["start", "stop", "recalibrate"])
def test_until_tracking_can_begin_commands_of_it_are_refused_with_the_reason(verb: str) -> None:
    session = Session(Setup(method="stand-still"), running=False, waiting_for="compiling")
    with pytest.raises(NotNowError, match=r"^getting ready: compiling$"):
        session.carry_out(verb, {})
    assert not session.running
    session.carry_out("setup", {"method": "stand-still", "participant": 7})
    assert (session.setup.participant, session.state.reason) == (7, "compiling")


def test_another_reason_of_the_wait_is_shown_until_its_end() -> None:
    session = Session(Setup(method="stand-still"), running=False, waiting_for="compiling")
    session.wait_for("compiling (1 of 2)")
    assert session.state.reason == "compiling (1 of 2)"
    with pytest.raises(NotNowError, match=r"^getting ready: compiling \(1 of 2\)$"):
        session.carry_out("start", {})
    session.wait_for("")
    assert session.state.reason == "compiling (1 of 2)"  # else it would no longer be seen to get ready
    session.ready()
    state = session.state
    session.wait_for("compiling (2 of 2)")
    assert session.state == state


def test_the_end_of_a_wait_changes_nothing_in_a_session_that_tracks() -> None:
    session = Session(Setup(method="stand-still"))
    state = session.state
    session.ready()
    assert session.state == state


def test_a_method_without_kernels_is_compiled() -> None:
    assert is_compiled("stand-still")


class Waits:
    """A compilation that has not ended."""

    done, started, progress = False, False, ""

    def start(self) -> None:
        self.started = True


def test_it_begins_once_a_browser_draws_the_view_or_the_view_has_ended() -> None:
    """Before that, it would take the time of the browser."""
    with Children() as view, Children() as nodes:
        view.start(["view", "--help"])
        waits = Waits()
        session = LiveSession(cast(Any, None), view, nodes, threading.Event(), cast(Any, waits))
        session.begin_if_compiled()
        assert waits.started == view.any_ended()
        session.shown.set()
        session.begin_if_compiled()
        assert waits.started
        waits = session.compilation = cast(Any, Waits())
        session.shown.clear()
        wait_until("the view has ended", view.any_ended)
        session.begin_if_compiled()
        assert waits.started


@pytest.mark.parametrize(
    ("line", "called"), [("view: http://127.0.0.1:1/", "url"), (PAGE_DRAWN, "page"), ("a warning", ""), ("", "")]
)
def test_what_the_view_says_of_itself_is_not_shown_as_it_is(
    line: str, called: str, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[str] = []
    _pass_on(line, lambda url: calls.append("url"), lambda: calls.append("page"))
    assert calls == [called] * bool(called)
    assert capsys.readouterr().err.strip() == ("" if called else line)


@given(st.lists(st.sampled_from(["compiled a kernel", "a warning"]), max_size=5), st.integers(0, 4))
def test_progress_counts_the_compiled_kernels_and_never_exceeds_the_expected_number(said: list[str], most: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(cast(Any, METHODS), "default", replace(METHODS["default"], kernels=most))
        compilation = Compilation("default")
        assert compilation.progress == ""
        for line in said:
            compilation._hear(line)
        count = said.count("compiled a kernel")
        expected = f"{min(count, most)} of about {most} kernels" if most else plural(count, "kernel", "kernels")
        assert compilation.progress == (expected if count else "")


def test_who_waits_hears_of_each_new_number_of_kernels_once() -> None:
    texts = iter(["", "1 of about 2 kernels", "1 of about 2 kernels", "2 of about 2 kernels"])

    class Counts(Compilation):
        now = ""

        @property
        def done(self) -> bool:
            self.now = next(texts, "end")
            return self.now == "end"

        @property
        def progress(self) -> str:
            return self.now

        def start(self) -> None:
            pass

    compilation, told = Counts("stand-still"), list[str]()
    compilation.wait(lambda: told.append(compilation.progress))
    assert told == ["1 of about 2 kernels", "2 of about 2 kernels"]


@pytest.mark.parametrize(("begins", "then"), [(True, "tracking begins by itself"), (False, "then press Start")])
def test_the_state_tells_how_many_kernels_are_compiled_whenever_their_number_changes(begins: bool, then: str) -> None:
    told: list[str] = []
    server = SimpleNamespace(wait_for=told.append)
    with Children() as view, Children() as nodes:
        waits = Waits()
        session = LiveSession(cast(Any, server), view, nodes, threading.Event(), cast(Any, waits), begins)
        for waits.progress in ("", "1 of about 2 kernels", "1 of about 2 kernels", "2 of about 2 kernels"):
            session.begin_if_compiled()
    assert told == [f"compiling the tracking method ({k} of about 2 kernels); {then}" for k in (1, 2)]
    assert compiling("", begins=begins) == f"compiling the tracking method; {then}"


@pytest.mark.slow
@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if method.kernels])
def test_a_method_has_about_as_many_kernels_as_it_states(method: str, tmp_path: Path) -> None:
    """Those that Python calls, and all that they call."""
    count = int(Forked(tmp_path, COUNT, method).output(timeout=900.0))  # it may compile them
    assert METHODS[method].kernels == pytest.approx(count, rel=0.1)


@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="Linux with autogroups has them")
def test_a_compilation_gives_way_to_other_sessions_too_and_not_for_ever() -> None:
    code = """if True:
        from mocapella.live.compilation import _give_way, _set_group_niceness
        _give_way(3600.0)
        print(open("/proc/self/autogroup").read())
        _set_group_niceness(0)
        print(open("/proc/self/autogroup").read())
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    (group, _, gives_way), (same, _, normal) = (line.split() for line in done.stdout.split("\n") if line)
    assert (group, gives_way, normal) == (same, "10", "0")
    # Nothing stands there for what was started without a session of its own.
    assert [group] != Path("/proc/self/autogroup").read_text(encoding="ascii").split()[:1]


class Group:
    """A group's niceness that can be changed at every third attempt."""

    def __init__(self) -> None:
        self.attempts, self.niceness = 0, list[str]()

    def write_text(self, text: str, encoding: str) -> None:
        self.attempts += 1
        if self.attempts % 3:
            raise BlockingIOError
        self.niceness.append(text)


def test_a_change_of_priority_that_is_refused_for_now_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    group = Group()
    monkeypatch.setattr(compilation, "_AUTOGROUP", group)
    monkeypatch.setattr(compilation, "_AGAIN_S", 0.0)
    monkeypatch.setattr(os, "setsid", lambda: None)
    compilation._give_way(0.01)
    wait_until("it no longer gives way", lambda: group.niceness == ["10", "0"])


def test_where_priority_could_not_be_taken_back_it_stays(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(compilation, "_AUTOGROUP", tmp_path / "no folder" / "autogroup")
    monkeypatch.setattr(os, "setsid", lambda: None)
    monkeypatch.setattr(os, "nice", None)  # it may not be used
    compilation._give_way(0.01)


def test_where_kernels_cannot_be_kept_no_process_compiles_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocapella.live.compilation.keeps_kernels", lambda: False)
    with Compilation("default") as compilation:
        assert not compilation.done
        compilation.start()
        assert compilation.done
