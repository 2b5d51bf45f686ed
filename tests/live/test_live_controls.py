"""Questions about a camera's controls: described, set, refused, saved beside the colours, and set again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from mocapella.live.camera_service import CameraService
from mocapella.live.marker_work import MarkerWork
from mocapella.sensing.colour_profile import CameraControls, ColourProfile, load_profile, save_profile
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.sources.simulate.rendered_camera import RenderedCamera
from mocapella.testing import FakeCamera
from mocapella.wire.questions import (
    AskControls,
    AskLearn,
    AskPicture,
    AskReport,
    AskSave,
    AskSaveControls,
    AskSet,
    Clicks,
    NodeAnswer,
    read_answer,
    write_answer,
    write_question,
)

SCENE = load_hand_scene("demo", seed=3)


@cache
def learnt() -> ColourProfile:
    return pointed_at(SCENE, "left")


class Harness:
    """A node's service on a source, a rendered camera at first."""

    def __init__(self, file: Path | None, source: Any = None, profile: ColourProfile | None = None) -> None:
        wanted = None if profile is None else profile.controls
        self.source = source or RenderedCamera(SCENE, "left", "rendered:demo/left", wanted)
        self.acquisition = Acquisition(self.source)
        self.work = MarkerWork("left", self.acquisition, profile)
        self.service = CameraService(self.work, file)

    def ask(self, question: Any) -> NodeAnswer:
        answer = self.service.answer(write_question(question))
        return read_answer(write_answer(answer))  # as it comes over the bus

    def look(self, time_ns: int) -> None:
        self.work.look(Picture(SCENE.at("left", 0.2).image, time_ns, 0, 0.0, 0.0))

    def report(self) -> dict[str, Any]:
        report = self.ask(AskReport()).report
        assert report is not None
        return report

    def value(self, name: str) -> float:
        found = {control.name: control.value for control in self.ask(AskControls()).descriptions or ()}
        return found[name]


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Harness]:
    harness = Harness(tmp_path / "left.json", profile=learnt())
    yield harness
    harness.service.close()


def test_what_is_set_is_told_and_is_unsaved_until_it_is_saved(made: Harness, tmp_path: Path) -> None:
    before = made.ask(AskControls())
    assert before.controls is not None
    assert before.descriptions is not None
    assert [control.name for control in before.descriptions][:2] == ["exposure", "gain"]
    assert not made.report()["unsaved_controls"]
    answer = made.ask(AskSet({"exposure": 90.4}, {}))
    assert answer.ok, answer.message
    assert answer.controls is not None
    assert (answer.controls["exposure"], answer.controls["saved"]["exposure"]) == (90.0, 60.0)
    assert made.acquisition.state.controls.exposure == 90.0
    assert made.report()["unsaved_controls"]
    assert made.ask(AskSaveControls()).ok
    saved = load_profile(tmp_path / "left.json")
    assert (saved.controls.exposure, saved.colours) == (90.0, learnt().colours)
    assert not made.report()["unsaved_controls"]
    again = Harness(tmp_path / "left.json", profile=saved)
    assert again.value("exposure") == 90.0
    assert not again.report()["unsaved_controls"]
    again.service.close()


@pytest.mark.parametrize(
    ("question", "says"),
    [
        (AskSet({"exposure": 501.0, "gain": 3.0}), "exposure is 501.0; it must be from 1 to 500 (100 µs)"),
        (AskSet({"gian": 3.0}), "did you mean gain"),
        (AskSet({}, {"focus": True}), "no automatic 'focus'; it has exposure, white_balance"),
        (AskSet({"exposure": 90.0}, {"exposure": True}), "switch that off first"),
    ],
)
def test_what_cannot_be_set_is_refused_with_the_reason_and_changes_nothing(
    made: Harness, question: Any, says: str
) -> None:
    answer = made.ask(question)
    assert not answer.ok
    assert says in answer.message
    assert made.value("gain") == 0.0
    assert not made.report()["unsaved_controls"]


def test_an_automatic_mode_is_saved_and_is_on_again(made: Harness, tmp_path: Path) -> None:
    assert made.ask(AskSet({}, {"exposure": True})).ok
    assert made.report()["unsaved_controls"]
    assert made.ask(AskSaveControls()).ok
    saved = load_profile(tmp_path / "left.json")
    assert saved.controls.automatic == ("exposure",)
    for _ in range(3):
        made.source.render(0.2)
    assert made.value("exposure") != saved.controls.exposure
    assert not made.report()["unsaved_controls"]  # the camera moved it, not the user
    again = Harness(tmp_path / "left.json", profile=saved)
    assert "automatic exposure is on, as saved" in " ".join(again.report()["problems"])
    assert again.ask(AskSet({"exposure": 60.0}, {"exposure": False})).ok
    assert "automatic exposure" not in " ".join(again.report()["problems"])  # no longer so
    again.service.close()


def test_colours_that_are_learnt_are_saved_with_the_controls_of_now(made: Harness, tmp_path: Path) -> None:
    assert made.ask(AskSet({"gain": 3.0})).ok
    made.look(1)
    assert made.ask(AskPicture()).ok
    centres = SCENE.at("left", 0.2).centres_px
    points = {name: (float(x), float(y)) for name, (x, y) in zip(SCENE.names, centres, strict=True)}
    assert made.ask(AskLearn([Clicks(1, {"red": points["red"]})])).ok
    assert made.work.detector is not None
    assert made.work.detector.profile.controls.gain == 3.0
    assert made.ask(AskSet({"gain": 6.0})).ok
    assert made.ask(AskSaveControls()).ok  # beside the colours before, for the new ones are not saved
    kept = load_profile(tmp_path / "left.json")
    assert (kept.names, kept.controls.gain) == (SCENE.names, 6.0)
    assert made.report()["unsaved"]
    assert made.ask(AskSave()).ok
    kept = load_profile(tmp_path / "left.json")
    assert (kept.names, kept.controls.gain) == (("red",), 6.0)


def test_settings_without_colours_or_without_a_file_are_not_saved_and_it_is_said_why(tmp_path: Path) -> None:
    for file, says in (
        (tmp_path / "left.json", "saved with colours, and none are saved yet"),
        (None, "--profile FILE"),
    ):
        harness = Harness(file)
        assert harness.ask(AskSet({"gain": 3.0})).ok
        answer = harness.ask(AskSaveControls())
        assert (answer.ok, says in answer.message) == (False, True)
        harness.service.close()


def test_a_source_without_controls_says_so_and_keeps_those_of_its_profile(tmp_path: Path) -> None:
    file, profile = tmp_path / "left.json", replace(learnt(), controls=CameraControls(exposure=7.0))
    save_profile(file, profile)
    harness = Harness(file, FakeCamera(), profile)
    answer = harness.ask(AskControls())
    assert (answer.ok, answer.descriptions) == (True, [])
    for question in (AskSet({"gain": 1.0}), AskSaveControls()):
        answer = harness.ask(question)
        assert (answer.ok, "has no controls that can be set" in answer.message) == (False, True)
    assert harness.ask(AskSave()).ok
    assert load_profile(file).controls.exposure == 7.0
    harness.service.close()


def test_what_the_camera_does_not_take_is_refused_with_the_values_that_it_has(made: Harness) -> None:
    class Stubborn(RenderedCamera):
        def set_controls(self, values: Any, automatic: Any) -> tuple[str, ...]:
            return tuple(f"{name} cannot be set to {value:g}: it stays 60" for name, value in values.items())

    harness = Harness(None, Stubborn(SCENE, "left", "rendered:demo/left"))
    answer = harness.ask(AskSet({"exposure": 90.0}))
    assert (answer.ok, answer.message) == (False, "exposure cannot be set to 90: it stays 60")
    assert answer.controls is not None
    assert answer.controls["exposure"] == 60.0
    assert harness.report()["problems"][-1] == "exposure cannot be set to 90: it stays 60"
    harness.service.close()
