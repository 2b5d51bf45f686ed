"""Led through the gesture: somebody who does as told is measured; who does not is told what is missing, and again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from support.gesturing_hand import BASE_NAMES, MODEL, PALM_SIDE_M, PHASES_S, TIP_NAMES, scenes

from mocapella.errors import InputError, NoServerError, SettingsError
from mocapella.kinematics.hand_bones import PHASES, Bones
from mocapella.kinematics.hand_gesture import INSTRUCTIONS, GesturePoints
from mocapella.kinematics.hand_tracker import base_layout
from mocapella.live.hand_guide import GuideSettings, HandGuide
from mocapella.model.scene import Scene

QUICK = GuideSettings(flat=2.0, knuckles=3.0, hook=3.0, prepare=0.5)
START = MODEL.shape("right")


class Actor:
    """Time passes when the guide sleeps; the scenes are those of the part that was last asked for."""

    def __init__(self, does: Callable[[str, int], str | None] = lambda phase, _time: phase) -> None:
        self.now, self.said, self.shown = 0.0, list[str](), list[str]()
        self._does, self._asked, self._since = does, dict.fromkeys(PHASES, 0), 0.0
        self._phase: str | None = None
        self._all = {p: [s for a, s in scenes() if b <= (a.at_ns - 1) / 1e9 < e] for p, (b, e) in PHASES_S.items()}

    def say(self, text: str) -> None:
        self.said.append(text)
        for phase in PHASES:
            if text.startswith(f"{phase}: now"):
                self._asked[phase] += 1
                self._phase, self._since = self._does(phase, self._asked[phase]), self.now

    def newest(self) -> Scene | None:
        of = self._all[self._phase or "flat"]
        place = round((self.now - self._since) * 60)
        if self._phase is None and self.said:
            return None
        return of[place] if place < len(of) else None

    def sleep(self, seconds: float) -> None:
        self.now += max(seconds, 0.02)

    def guide(self, settings: GuideSettings = QUICK, gesture: GesturePoints | None = None) -> HandGuide:
        return HandGuide(
            self.newest,
            gesture or GesturePoints(TIP_NAMES, BASE_NAMES),
            settings,
            say=self.say,
            show=self.shown.append,
            clock=lambda: self.now,
            sleep=self.sleep,
        )


def measured(gesture: GesturePoints) -> Bones:
    return gesture.measure(MODEL, START, base_layout(START, 3, PALM_SIDE_M))


@pytest.mark.slow
def test_who_does_as_told_is_measured_and_hears_every_part_once() -> None:
    actor = Actor()
    bones = actor.guide().run(measured)
    assert (bones.frames > 120).all()
    assert actor.said == [
        line
        for phase in PHASES
        for line in (f"{phase}: {INSTRUCTIONS[phase]}", f"{phase}: now, for {getattr(QUICK, phase):g} s")
    ]
    assert {"flat: 2 s", "flat: 1 s", "hook: 3 s"} <= set(actor.shown)


@pytest.mark.slow
def test_a_part_in_which_nothing_is_seen_is_shown_again() -> None:
    actor = Actor(lambda phase, time: None if phase == "knuckles" and time == 1 else phase)
    actor.guide().run(measured)
    assert sum(line.startswith("knuckles: now") for line in actor.said) == 2
    assert sum(line.startswith("hook: now") for line in actor.said) == 1
    assert any("knuckles: no markers were tracked meanwhile" in line for line in actor.said)


@pytest.mark.slow
def test_a_gesture_that_does_not_tell_begins_anew_and_says_why() -> None:
    actor = Actor(lambda phase, time: "flat" if phase == "knuckles" and time == 1 else phase)
    actor.guide().run(measured)
    assert sum(line.startswith("flat: now") for line in actor.said) == 2
    (why,) = [line for line in actor.said if "the bones are not determined yet" in line]
    assert "index: moves by" in why
    assert "bend the straight finger at the knuckle by 40° or more" in why


@pytest.mark.parametrize(
    ("does", "why"),
    [
        (lambda phase, _time: None if phase == "hook" else phase, "field hook: no markers were tracked meanwhile"),
        (lambda phase, _time: "flat", "moves by .* only in the part 'knuckles'"),
    ],
)
def test_who_never_does_it_is_told_at_the_end(does: Callable[[str, int], str | None], why: str) -> None:
    actor = Actor(does)
    with pytest.raises(InputError, match=why):
        actor.guide().run(measured)


def test_without_scenes_it_does_not_wait_for_ever() -> None:
    actor = Actor()
    actor.newest = lambda: None  # type: ignore[method-assign]
    with pytest.raises(NoServerError, match="no scene arrived within 10 s; start the cameras' nodes"):
        actor.guide().run(measured)
    assert actor.now < 11
    assert actor.said == []


def test_without_a_pause_none_is_counted_down() -> None:
    actor = Actor(lambda _phase, _time: None)
    with pytest.raises(InputError, match="no markers were tracked"):
        actor.guide(replace(QUICK, prepare=0.0, tries=1)).run(measured)
    assert set(actor.shown) == {"flat: 2 s", "flat: 1 s"}


@pytest.mark.parametrize(
    "changed",
    [
        {"flat": 0.0},
        {"knuckles": float("nan")},
        {"hook": 1e9},
        {"prepare": -1.0},
        {"tries": 0},
        {"patience": 0.0},
        {"least_frames": 0},
    ],
)
def test_settings_out_of_range_are_refused(changed: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(changed))):
        GuideSettings(**changed)  # type: ignore[arg-type]
