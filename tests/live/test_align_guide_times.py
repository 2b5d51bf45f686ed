"""When the guide of an alignment ends, and with what: observations and the time are made up."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from mocapella.calibration.space_alignment import Shortfall
from mocapella.errors import CalibrationError, InputError, NoServerError, SettingsError
from mocapella.live.align_guide import AlignGuide, AlignGuideSettings

BEGAN = 100.0
SETTINGS = AlignGuideSettings(seconds=8, least_seconds=3, every=1)
MISSING = Shortfall("too slow to know the delay", "12 ms", "move it faster")
Attempt = Callable[[float], tuple[Any, tuple[Shortfall, ...]]]


def fit(*, position: float = 0.0, lever: float = 0.0, rotation: float = 0.0, delay: float = 0.0) -> Any:
    return SimpleNamespace(position_sd_m=position, lever_sd_m=lever, rotation_sd_rad=rotation, delay_sd_s=delay)


class Led:
    """A guide whose sleep takes a quarter of a second, and what it did when [s after its beginning]."""

    def __init__(self, attempt: Attempt, settings: AlignGuideSettings = SETTINGS, scenes_at: float = 0.0) -> None:
        self.now, self.said, self.shown = BEGAN, list[str](), list[str]()
        self.attempts: list[float] = []
        self.scenes, self._scenes_at, self._attempt = 0, BEGAN + scenes_at, attempt
        self._guide = AlignGuide(
            lambda: [], self, settings, say=self.said.append, show=self.shown.append,  # type: ignore[arg-type]
            clock=lambda: self.now, sleep=self._sleep,
        )  # fmt: skip

    def update(self, _: Any) -> None:
        self.scenes = int(self.now >= self._scenes_at)

    def attempt(self, _: Any) -> Any:
        self.attempts.append(self.now - BEGAN)
        assert len(self.attempts) < 100, "no time passes"
        return self._attempt(self.now - BEGAN)

    def _sleep(self, _: float) -> None:
        self.now += 0.25

    def run(self) -> Any:
        return self._guide.run()


@pytest.mark.parametrize("patience", [0.5, 10.0])
def test_the_first_scene_is_waited_for_as_long_as_the_patience_and_no_longer(patience: float) -> None:
    settings = AlignGuideSettings(seconds=1, least_seconds=0, every=1, patience=patience)
    good = fit()
    assert Led(lambda _: (good, ()), settings, scenes_at=patience).run() is good
    late = Led(lambda _: (good, ()), settings, scenes_at=patience + 0.25)
    with pytest.raises(NoServerError, match=f"within {patience:g} s"):
        late.run()
    assert late.now == BEGAN + patience + 0.25
    assert set(late.shown) == {"waiting for scenes …"}
    assert late.attempts == []


def test_a_good_alignment_ends_it_after_the_least_time() -> None:
    good = fit()
    led = Led(lambda at_s: (good, ()) if at_s < 99 else (None, ()))
    assert led.run() is good
    assert led.attempts == [0.25 + k for k in (1, 2, 3)]  # it slept once until the first scene
    assert len(led.said) == 1
    assert led.said[0].startswith("for 8 s at most: ")


@pytest.mark.parametrize(
    ("what", "limit"), [("position", 0.002), ("lever", 0.002), ("rotation", 0.005), ("delay", 0.003)]
)
def test_an_alignment_is_good_up_to_each_limit_and_what_is_less_good_has_to_do_at_the_end(
    what: str, limit: float
) -> None:
    at_limit = Led(lambda _: (fit(**{what: limit}), ()))
    at_limit.run()
    assert at_limit.attempts[-1] == 3.25
    beyond = Led(lambda _: (fit(**{what: math.nextafter(limit, 1.0)}), ()))
    beyond.run()
    assert beyond.attempts == [0.25 + k for k in range(1, 9)]
    assert beyond.said[-1].startswith("8 s are over; the alignment could be more precise: precise to ")


def test_figures_are_in_millimetres_degrees_and_milliseconds() -> None:
    led = Led(lambda _: (fit(position=0.0041, lever=0.0062, rotation=math.radians(0.5), delay=0.0073), ()))
    led.run()
    figures = "precise to 4.1 mm (the lever arm to 6.2), 0.50° and 7.3 ms; good are 2 mm, 0.29° and 3 ms"
    assert f"2 s: {figures}" in led.shown
    assert led.said[-1].endswith(figures)


def test_the_last_attempt_is_at_the_end_also_if_it_is_no_whole_interval() -> None:
    led = Led(lambda _: (None, (MISSING,)), AlignGuideSettings(seconds=8, least_seconds=3, every=3))
    with pytest.raises(CalibrationError, match="8 s were not enough: too slow to know the delay"):
        led.run()
    assert led.attempts == [3.25, 6.25, 8.25]
    assert led.shown[-1] == "6 s: too slow to know the delay (12 ms)"


@pytest.mark.parametrize("missing", [(MISSING,), ()])
def test_a_fit_that_lacks_something_is_none_and_neither_is_no_fit(missing: tuple[Shortfall, ...]) -> None:
    led = Led(lambda _: (fit() if missing else None, missing))
    with pytest.raises(CalibrationError, match="8 s were not enough"):
        led.run()


@pytest.mark.parametrize("error", [InputError("no such body"), SettingsError("no such marker")])
def test_what_is_unknown_is_shown_and_is_an_error_at_the_end(error: Exception) -> None:
    def unknown(at_s: float) -> Any:
        raise error

    led = Led(unknown)
    with pytest.raises(type(error), match="no such"):
        led.run()
    assert led.attempts[-1] == 8.25
    assert [line for line in led.shown if "no such" in line] == [f"{k} s: {error}" for k in range(1, 8)]


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("seconds", (1, 3600), (0.999, 3600.1)),
        ("least_seconds", (0, 3600), (-0.001, 3600.1)),
        ("every", (0.05, 60), (0.0499, 60.1)),
        ("patience", (1e-9, 3600), (0.0, 3600.1)),
        ("good_m", (1e-9, 999.0), (0.0, 1e3)),
        ("good_rad", (1e-9, 999.0), (0.0, 1e3)),
        ("good_delay_s", (1e-9, 999.0), (0.0, 1e3)),
    ],
)
def test_settings_are_accepted_up_to_their_limits(name: str, good: tuple[float, ...], bad: tuple[float, ...]) -> None:
    for value in good:
        assert getattr(AlignGuideSettings(**{name: value}), name) == value
    for value in bad:
        with pytest.raises(SettingsError, match=name):
            AlignGuideSettings(**{name: value})
