"""Led while a space is aligned: who moves it well is done soon; who does not hears what is missing, in full."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.moved_wand import DELAY_S, ON_BODY, T_WORLD_VR, moved, wand

from mocapella.calibration.space_alignment import Shortfall
from mocapella.calibration.space_observations import SpaceObservations
from mocapella.errors import CalibrationError, InputError, MocapellaError, NoServerError, SettingsError
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import log_motion
from mocapella.live.align_guide import INSTRUCTION, AlignGuide, AlignGuideSettings
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame

QUICK = AlignGuideSettings(seconds=12, least_seconds=5.0)
Motion = Callable[[float], np.ndarray]


class Bus:
    """Time passes when the guide sleeps; what was said on the bus till then comes when it is asked for."""

    def __init__(self, motion: Motion = wand, *, frames: bool = True, scenes: bool = True, **how: Any) -> None:
        self.now, self.said, self.shown = 0.0, list[str](), list[str]()
        of = [(s.at_ns / 1e9 - 1, m) for s, f in moved(13, motion, **how) for m in (f, s) if m is not None]
        self._coming = [(t, m) for t, m in of if (scenes if isinstance(m, Scene) else frames)]

    def take(self) -> Iterable[Scene | SensorFrame]:
        count = next((k for k, (t, _) in enumerate(self._coming) if t > self.now), len(self._coming))
        come, self._coming = self._coming[:count], self._coming[count:]
        return [message for _, message in come]

    def sleep(self, seconds: float) -> None:
        self.now += max(seconds, 0.05)

    def lead(self, settings: AlignGuideSettings = QUICK, **what: str) -> Any:
        observations = SpaceObservations("LHR-1", **({"thing": "wand"} | what))
        guide = AlignGuide(
            self.take, observations, settings, say=self.said.append, show=self.shown.append,
            clock=lambda: self.now, sleep=self.sleep,
        )  # fmt: skip
        return guide.run()


@pytest.mark.slow
@pytest.mark.parametrize("what", [{"thing": "wand"}, {"thing": "", "marker": "cyan"}])
def test_who_moves_it_well_is_done_before_the_time_is_over(what: dict[str, str]) -> None:
    bus = Bus(noise_m=0.0005)
    fit = bus.lead(**what)
    off = fit.T_world_space @ inverse(T_WORLD_VR)
    assert np.linalg.norm(log_motion(off)[3:]) < 4 * math.sqrt(3) * fit.rotation_sd_rad + 2e-3
    assert fit.delay_s == pytest.approx(DELAY_S, abs=1e-3)
    np.testing.assert_allclose(fit.lever_m[0], ON_BODY[:3, 3], atol=2e-3)
    assert QUICK.least_seconds <= bus.now < QUICK.seconds
    assert bus.said == [f"for 12 s at most: {INSTRUCTION}"]
    assert "too few shared instants" in bus.shown[1]


@pytest.mark.slow
def test_it_goes_on_while_it_is_not_known_well_and_takes_what_will_do_at_the_end() -> None:
    bus = Bus(noise_m=0.0005)
    fit = bus.lead(AlignGuideSettings(seconds=7, least_seconds=0, good_m=1e-7))
    assert bus.now >= 7
    assert fit.position_sd_m > 1e-7
    assert "could be more precise" in bus.said[-1]
    assert any("precise to" in line and "good are" in line for line in bus.shown)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "noise_m", "said"),
    [
        (partial(wand, far=0.0, turned=0.2), 0.0005, ["too small a space"]),
        (partial(wand, turned=0.0), 0.0005, ["too little rotation"]),
        (partial(wand, axes=1), 0.0005, ["too little rotation", r"mostly about the body's axis \[1.0, 0.0, 0.0\]"]),
        (lambda t: wand(0.0), 0.0005, ["too small a space", "too little rotation"]),
        (lambda t: wand(0.13 * t), 0.018, ["too slow to know the delay"]),
    ],
)
def test_what_is_missing_is_told_meanwhile_and_at_the_end(motion: Motion, noise_m: float, said: list[str]) -> None:
    bus = Bus(motion, noise_m=noise_m)
    with pytest.raises(CalibrationError, match=".*".join(["12 s were not enough", *said])):
        bus.lead()
    seconds = {line.partition(" s: ")[0] for line in bus.shown}
    assert {str(second) for second in range(1, 12)} <= seconds


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "what", "kind", "said"),
    [
        ({}, {"thing": "wnd"}, SettingsError, "--object 'wnd': there are wand"),
        ({}, {"thing": "", "marker": "red"}, SettingsError, "--marker 'red': there are cyan"),
        ({}, {"space": "stage"}, InputError, "--space is one of vr"),
        ({"frames": False}, {}, InputError, "no poses of another tracker came; start"),
        ({"spaces": ("a", "b")}, {}, InputError, "several spaces; --space is one of a, b"),
        ({"scenes": False}, {}, NoServerError, "no scene arrived within 10 s; start"),
    ],
)
def test_what_does_not_come_is_named(
    how: dict[str, Any], what: dict[str, str], kind: type[MocapellaError], said: str
) -> None:
    bus = Bus(**how)
    with pytest.raises(kind, match=said):
        bus.lead(AlignGuideSettings(seconds=2), **what)
    assert any("waiting" in line or said[:12] in line for line in bus.shown)


def test_settings_that_cannot_be_are_refused() -> None:
    for changed in ({"seconds": 0.0}, {"least_seconds": -1.0}, {"every": 0.0}, {"patience": 0.0}, {"good_m": 0.0}):
        with pytest.raises(SettingsError, match=next(iter(changed))):
            AlignGuideSettings(**changed)


def test_frames_and_their_scenes_may_come_in_any_order() -> None:
    both = [m for scene, frame in moved(5, spaces=("vr",)) for m in (frame, scene) if m is not None]
    given, turned = (SpaceObservations("LHR-1", thing="wand") for _ in range(2))
    given.update(both)
    turned.update(sorted(both, key=lambda message: isinstance(message, Scene)))
    for one, other in zip((*given.poses(), *given.points()), (*turned.poses(), *turned.points()), strict=True):
        assert len(one) == 250
        np.testing.assert_array_equal(one, other)


def test_a_frame_without_its_scene_has_no_time_and_is_not_used() -> None:
    observations = SpaceObservations("LHR-1", thing="wand")
    kept = [(scene, frame) for scene, frame in moved(5) if frame is None or frame.sequence % 2]
    observations.update(frame for _, frame in moved(5) if frame is not None)
    observations.update(scene for scene, _ in kept)
    assert len(observations.poses()[0]) == 125


# When it ends, and with what: observations and the time are made up.

BEGAN = 100.0
EVERY_SECOND = AlignGuideSettings(seconds=8, least_seconds=3, every=1)
MISSING = Shortfall("too slow to know the delay", "12 ms", "move it faster")
Attempt = Callable[[float], tuple[Any, tuple[Shortfall, ...]]]


def precise_to(*, position: float = 0.0, lever: float = 0.0, rotation: float = 0.0, delay: float = 0.0) -> Any:
    return SimpleNamespace(position_sd_m=position, lever_sd_m=lever, rotation_sd_rad=rotation, delay_sd_s=delay)


class Led:
    """A guide whose sleep takes a quarter of a second, and what it did when [s after its beginning]."""

    def __init__(self, attempt: Attempt, settings: AlignGuideSettings = EVERY_SECOND, scenes_at: float = 0.0) -> None:
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
    good = precise_to()
    assert Led(lambda _: (good, ()), settings, scenes_at=patience).run() is good
    late = Led(lambda _: (good, ()), settings, scenes_at=patience + 0.25)
    with pytest.raises(NoServerError, match=f"within {patience:g} s"):
        late.run()
    assert late.now == BEGAN + patience + 0.25
    assert set(late.shown) == {"waiting for scenes …"}
    assert late.attempts == []


def test_a_good_alignment_ends_it_after_the_least_time() -> None:
    good = precise_to()
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
    at_limit = Led(lambda _: (precise_to(**{what: limit}), ()))
    at_limit.run()
    assert at_limit.attempts[-1] == 3.25
    beyond = Led(lambda _: (precise_to(**{what: math.nextafter(limit, 1.0)}), ()))
    beyond.run()
    assert beyond.attempts == [0.25 + k for k in range(1, 9)]
    assert beyond.said[-1].startswith("8 s are over; the alignment could be more precise: precise to ")


def test_figures_are_in_millimetres_degrees_and_milliseconds() -> None:
    led = Led(lambda _: (precise_to(position=0.0041, lever=0.0062, rotation=math.radians(0.5), delay=0.0073), ()))
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
def test_neither_a_fit_that_lacks_something_nor_none_is_an_alignment(missing: tuple[Shortfall, ...]) -> None:
    led = Led(lambda _: (precise_to() if missing else None, missing))
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
