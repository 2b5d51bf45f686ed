"""Laws of boundaries, and of text that comes from other programs."""

from __future__ import annotations

import logging
import threading
import unicodedata
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.supervision import AGAIN_S, MOST_REASONS, OTHER, Boundary, printable


def fail(error: Exception) -> None:
    raise error


@given(st.text(alphabet=st.characters(), max_size=40), st.integers(1, 50))
def test_a_printable_text_has_no_control_of_any_kind(text: str, most: int) -> None:
    shown = printable(text, most)
    shown.encode("utf-8")
    assert not {"Cc", "Cs", "Zl", "Zp"} & {unicodedata.category(character) for character in shown}
    assert not {unicodedata.bidirectional(character) for character in shown} & {
        "LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"
    }  # fmt: skip
    assert len(printable(shown, 1000)) == len(shown)  # what is escaped stays as it is


@given(st.text(alphabet=st.characters(categories=["L", "N", "P", "S"]), max_size=40))
def test_a_harmless_text_is_not_changed(text: str) -> None:
    assert printable(text) == text


def test_escapes_are_readable_and_long_texts_are_cut() -> None:
    assert printable("\x1b[31m\n\x9b\u202e\ud800") == r"\x1b[31m\n\x9b\u202e\ud800"
    assert printable("x" * 600) == "x" * 499 + "…"


def test_an_error_is_counted_by_its_place_said_and_logged_with_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    said: list[str] = []
    errors = Boundary(said.append)
    assert errors.run("frame", lambda: None) == ""
    problem = errors.run("frame", partial(fail, ValueError("a\x1bb")))
    assert problem == r"unexpected error (frame): ValueError: a\x1bb"
    assert said == [problem]
    assert errors.counts == {"frame: ValueError in an unknown place": 1}
    (record,) = caplog.records
    assert (record.levelno, record.exc_info is not None) == (logging.ERROR, True)


def test_the_place_is_the_last_one_in_this_package() -> None:
    errors = Boundary()
    errors.run("setting", partial(__import__("mocapella.settings").settings.check, False, "a", 1, "2"))
    (reason,) = errors.counts
    assert reason.startswith("setting: SettingsError in settings.py:")


def test_a_recurring_error_is_said_again_only_later_and_always_counted() -> None:
    said: list[str] = []
    now_s = [0.0]
    errors = Boundary(said.append, clock=lambda: now_s[0])
    for _ in range(100):
        errors.run("frame", partial(fail, ValueError("x")))
    assert len(said) == 1
    now_s[0] = AGAIN_S
    errors.run("frame", partial(fail, ValueError("x")))
    assert said[1].endswith("(101 times so far)")
    assert sum(errors.counts.values()) == 101


def test_the_number_of_reasons_is_bounded() -> None:
    errors = Boundary()
    for k in range(3 * MOST_REASONS):
        errors.run(f"part {k}", partial(fail, ValueError("x")))
    assert len(errors.counts) == MOST_REASONS + 1
    assert errors.counts[OTHER] == 2 * MOST_REASONS


@pytest.mark.parametrize(
    "error", [RecursionError(), OverflowError(), KeyError("x"), UnicodeDecodeError("a", b"", 0, 1, "")]
)
def test_whatever_a_message_can_cause_is_caught(error: Exception) -> None:
    assert Boundary().run("frame", partial(fail, error))


@pytest.mark.parametrize("error", [MemoryError(), KeyboardInterrupt(), SystemExit()])
def test_what_no_loop_can_go_on_after_is_not_caught(error: Exception) -> None:
    with pytest.raises(type(error)):
        Boundary().run("frame", partial(fail, error))


def test_a_wrapped_function_keeps_its_arguments_and_never_raises() -> None:
    got: list[tuple[int, int]] = []
    errors = Boundary()
    errors.wrap("sum", lambda a, b: got.append((a, b)))(1, 2)
    errors.wrap("sum", lambda a: a / 0)(1)
    assert got == [(1, 2)]
    assert len(errors.counts) == 1


def test_a_callback_of_a_library_that_has_no_memory_ends_the_process_as_a_thread_would(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The library would swallow the error."""
    deaths: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr("threading.excepthook", deaths.append)
    error = MemoryError("no room")
    Boundary().wrap("message of the bus", fail)(error)
    ((kind, value, _, thread),) = deaths
    assert (kind, value) == (MemoryError, error)
    assert thread is not None
    assert thread.name == "message of the bus"
