"""Led while a space is aligned: who moves it well is done soon; who does not hears what is missing, in full."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
import pytest
from support.moved_wand import DELAY_S, ON_BODY, T_WORLD_VR, moved, wand

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
