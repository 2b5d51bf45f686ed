"""What a camera's node counts and says: late, twice, too few, other light, other colours; and times of its stages."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.live.camera_node import WARN_AFTER_S, CameraNodeSettings
from mocapella.live.marker_work import MarkerWork
from mocapella.live.stage_times import STAGES, StageTimes
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sensing.markers import MarkerReport
from mocapella.sensing.tags import TagDetector, TagSettings
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture, SourceState
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.testing import FakeCamera

SCENE = load_hand_scene("demo", seed=3)


@cache
def profile() -> ColourProfile:
    """Not while tests are collected, like the picture: all workers would compile for it at once."""
    return pointed_at(SCENE, "left")


@cache
def shot() -> np.ndarray:
    return SCENE.at("left", 0.2).image


STATE = SourceState((320, 240), 20.0, problems=("a screw is loose",))


def work(colours: bool = True) -> MarkerWork:
    return MarkerWork("left", Acquisition(FakeCamera(STATE, name="nothing")), profile() if colours else None)


def picture(image: np.ndarray, number: int) -> Picture:
    return Picture(image, 1 + 50_000_000 * number, number, 0.05 * number, 0.0)


def said(made: MarkerWork, image: np.ndarray, begin: int, count: int = 8) -> list[str]:
    """What it warns of after so many pictures."""
    for k in range(begin, begin + count):
        made.look(picture(image, 20 * k))  # a second apart, so that the light is looked at
    return list(made.warnings(begin + count + WARN_AFTER_S))


def test_markers_of_a_hand_are_found_and_nothing_is_warned_of() -> None:
    made = work()
    assert list(made.warnings(0.0)) == []
    assert said(made, shot(), 0) == []
    report = made.report()
    assert report["looked_at"] == 8
    assert {row["found"] for row in report["markers"].values()} == {8}
    assert report["problems"] == ["a screw is loose"]
    assert "red 100.0 %" in made.words()


def test_two_markers_of_one_colour_are_said_once_and_said_to_be_gone() -> None:
    made, twice = work(), shot().copy()
    x, y = (round(v) for v in made.look(picture(shot(), 0)).positions_px[0])
    patch = shot()[y - 12 : y + 13, x - 12 : x + 13]
    at = (20, 20) if x > 120 or y > 120 else (200, 280)
    twice[at[0] - 12 : at[0] + 13, at[1] - 12 : at[1] + 13] = patch
    list(made.warnings(0.0))
    first = said(made, twice, 10)
    assert len(first) == 1
    assert first[0].startswith("red is seen twice in ")
    assert said(made, twice, 20) == []
    assert made.report()["markers"]["red"]["ambiguous"] > 8
    assert "ambiguous: red" in made.words()
    assert said(made, shot(), 40, 20) == ["red: well again"]


class Counted:
    """A detector that has counted so many images of red, blue and green markers, and red so often twice."""

    def __init__(self, images: int, ambiguous: int) -> None:
        counts, none = np.array([ambiguous, 0, 0]), np.zeros(3, np.int64)
        self.report = MarkerReport(
            ("red", "blue", "green"), images, 0, 0, none, counts, none, none, none, none, none, 1.0, 0.0, ""
        )


@pytest.mark.parametrize(("images", "ambiguous", "warned"), [(8, 4, False), (8, 5, True), (0, 0, False)])
def test_a_colour_is_warned_of_that_is_twice_in_more_than_half_of_the_images(
    images: int, ambiguous: int, warned: bool
) -> None:
    """Of all images at first, and then of those since the last look."""
    made = work(colours=False)
    for before in ((0, 0), (100, 0), (100, 100)):
        seen = Counted(before[0] + images, before[1] + ambiguous).report
        problems = dict(made._problems(seen, Counted(*before).report if before[0] else None))
        assert list(problems) == (["red"] if warned else [])
        assert not warned or problems["red"].startswith(f"red is seen twice in {100 * ambiguous / images:.0f} %")


def test_other_light_than_the_colours_were_learnt_in_is_said() -> None:
    made = work()
    list(made.warnings(0.0))
    (warning,) = said(made, shot() // 3, 0)
    assert "times as bright as when the colours were learnt" in warning


def test_without_colours_frames_are_empty_until_there_are_some() -> None:
    made = work(colours=False)
    list(made.warnings(0.0))
    assert made.look(picture(shot(), 0)).names == ()
    assert ["no colours are learnt yet" in text for text in made.warnings(10.0)] == [True]
    made.use(profile())
    assert made.look(picture(shot(), 1)).names == profile().names
    assert "colours: well again" in list(made.warnings(20.0))


def test_colours_may_change_between_two_pictures() -> None:
    made = work()
    made.look(picture(shot(), 0))
    made.use(replace(profile(), colours=profile().colours[:2]))
    frame = made.look(picture(shot(), 1))
    assert frame.names == profile().names[:2]
    assert frame.found.all()
    assert made.newest is not None
    assert made.newest.frame is frame


def test_a_picture_of_another_size_is_refused() -> None:
    with pytest.raises(SettingsError, match="set it to 320 × 240"):
        work().look(picture(np.zeros((480, 640, 3), np.uint8), 0))


@given(st.lists(st.tuples(st.floats(0, 0.2), st.floats(0, 0.2)), max_size=20))
@example([(1 / 20, 0.1)])
def test_late_is_longer_than_an_interval_and_too_late_is_not_sent(looks: list[tuple[float, float]]) -> None:
    made = work(colours=False)
    sent = [made.in_time(took, age, 0.1) for took, age in looks]
    assert sent == [age <= 0.1 for _, age in looks]
    assert made.late == sum(took > 1 / 20 for took, _ in looks)
    assert made.too_late == sent.count(False)


@given(st.integers(2, 30), st.integers(0, 5), st.integers(0, 2**32 - 1))
def test_times_are_those_of_numpy_and_end_when_full(frames: int, more: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    times, seconds = StageTimes(frames, 2), rng.uniform(0, 0.02, (frames + more, 2))
    px = rng.normal(100.0, 0.5, (frames + more, 2, 2))
    px[0, 1] = np.nan
    for row, places in zip(seconds, px, strict=True):
        times.add({"detection": row[0], "all": row[1]}, places)
    assert times.full
    table, ms = times.table(), 1e3 * seconds[:frames]
    assert set(table) == {"detection", "all"} < set(STAGES)
    for k, stage in enumerate(("detection", "all")):
        found = [table[stage][key] for key in ("mean_ms", "median_ms", "sd_ms", "p99_ms", "max_ms", "frames")]
        column = ms[:, k]
        wanted = [column.mean(), np.median(column), column.std(), np.percentile(column, 99), column.max(), frames]
        np.testing.assert_allclose(found, wanted)
    jitter = times.jitter(("red", "blue"))
    np.testing.assert_allclose([jitter["red"]["x_px"], jitter["red"]["y_px"]], px[:frames, 0].std(axis=0))
    assert (jitter["red"]["seen"], jitter["blue"]["seen"]) == (frames, frames - 1)
    times.add({}, np.zeros((3, 2)))  # markers of other colours are not mixed in
    assert times.count == frames


@pytest.mark.parametrize("wrong", [{"drop_after_s": 0.0}, {"report_s": -1.0}])
def test_settings_have_ranges(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        CameraNodeSettings(**wrong)


def test_tags_are_found_beside_the_colours() -> None:
    image = shot().copy()
    tag = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 7, 48)
    image[6:66, 6:66] = 255
    image[12:60, 12:60] = tag[..., None]
    made = MarkerWork(
        "left",
        Acquisition(FakeCamera(STATE, name="nothing")),
        profile(),
        tags=TagDetector("left", TagSettings("4X4_50", (7,))),
    )
    frame = made.look(picture(image, 0))
    assert frame.names == (*profile().names, "tag7.0", "tag7.1", "tag7.2", "tag7.3")
    corners = frame.positions_px[len(profile().names) :]
    np.testing.assert_allclose(corners, [[11.5, 11.5], [59.5, 11.5], [59.5, 59.5], [11.5, 59.5]], atol=0.5)
    assert made.report()["tags"]["found"] == 1
    assert set(made.report()["markers"]) == set(profile().names)
