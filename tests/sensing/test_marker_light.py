"""When the whole image is searched and the light is measured, and what the detector then says of the light."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from support.marker_images import discs

from mocapella.sensing.colour_learning import ColourSample, learn_colours
from mocapella.sensing.colour_profile import BINS, BackgroundColours, ColourProfile
from mocapella.sensing.markers import LIGHT_STEP, MarkerDetector, MarkerSettings, linear_light, piece_buffers

RED = (20, 15, 190)
SCENE = discs((60.0, 50.0, 8.0, RED))


@pytest.fixture(scope="module")
def profile() -> ColourProfile:
    """Learnt on grey; its background has a luma of 99 and a colour, so that signs count."""
    learnt = learn_colours("left", [ColourSample(SCENE, {"red": (60, 50)})])
    return dataclasses.replace(learnt, background=BackgroundColours(((0,) * BINS,) * BINS, 99.0, (0.3, -0.4)))


def test_linear_light_is_that_of_the_standard() -> None:
    """IEC 61966-2-1: a straight part up to 10, which the power meets there."""
    light = linear_light()
    for value, wanted in ((0, 0.0), (10, 10 / 255 / 12.92), (11, 0.003347), (128, 0.215861), (188, 0.502886), (255, 1)):
        assert light[value] == pytest.approx(wanted, abs=1e-6)
    assert (np.diff(light) > 0).all()
    assert (np.diff(light, 2) > -1e-6).all()


@pytest.mark.parametrize(("times", "whole"), [((0.0, 0.5, 0.99), 1), ((0.0, 0.5, 1.0), 2), ((5.0, 6.0, 6.5, 7.0), 3)])
def test_the_whole_image_is_searched_again_after_its_interval(
    profile: ColourProfile, times: tuple[float, ...], whole: int
) -> None:
    detector = MarkerDetector(profile)
    for at_s in times:
        detector.update(SCENE, at_s)
    assert detector.report.whole_images == whole
    assert detector.report.images == len(times)


def test_a_frame_has_its_number_and_time(profile: ColourProfile) -> None:
    detector = MarkerDetector(profile, node_id=7)
    frames = [detector.update(SCENE, at_s) for at_s in (2.0, 2.25)]
    assert [(one.sequence, one.time_ns, one.node_id) for one in frames] == [(0, 2 * 10**9, 7), (1, 225 * 10**7, 7)]


def grey(value: float) -> Any:
    return np.full((120, 160, 3), round(value), np.uint8)


@pytest.mark.parametrize(("value", "brightness"), [(99, 1.0), (199, 2.0), (49, 0.5), (149, 1.5), (0, 0.01)])
def test_the_brightness_is_the_factor_to_the_profiles(profile: ColourProfile, value: int, brightness: float) -> None:
    detector = MarkerDetector(profile)
    detector.update(grey(value), 0.0)
    assert detector.report.brightness == pytest.approx(brightness)


@pytest.mark.parametrize("value", [150, 148, 66, 67, 200, 30])
def test_light_by_more_than_a_factor_is_said_in_both_directions(profile: ColourProfile, value: int) -> None:
    factor = (value + 1) / 100
    detector = MarkerDetector(profile, MarkerSettings(chroma_drift=9.0))
    detector.update(grey(value), 0.0)
    said = factor > 1.5 or factor < 1 / 1.5
    assert detector.report.light.startswith(f"images are {factor:.1f} times as bright") == said
    assert bool(detector.report.light) == said


@pytest.mark.parametrize(("u", "v"), [(0.3, -0.4), (0.6, -0.4), (0.0, -0.4), (0.3, 0.2), (0.3, -0.5), (-0.2, -0.1)])
def test_the_shift_of_colour_is_the_larger_of_both_differences(profile: ColourProfile, u: float, v: float) -> None:
    bgr = 100 * np.exp([v, 0.0, u]) - 8
    image = np.broadcast_to(np.round(bgr).astype(np.uint8), (120, 160, 3)).copy()
    detector = MarkerDetector(profile, MarkerSettings(brighter=9.0))
    detector.update(image, 0.0)
    shift = max(abs(u - 0.3), abs(v + 0.4))
    assert detector.report.chroma_shift == pytest.approx(shift, abs=0.01)
    assert bool(detector.report.light) == (shift > 0.2)


def test_the_light_is_measured_again_after_its_interval_at_every_sixteenth_pixel(profile: ColourProfile) -> None:
    detector = MarkerDetector(profile)
    detector.update(grey(99), 0.0)
    other = grey(0)
    other[LIGHT_STEP // 2 :: LIGHT_STEP, LIGHT_STEP // 2 :: LIGHT_STEP] = 199
    for at_s, brightness in ((0.5, 1.0), (0.99, 1.0), (1.0, 2.0), (1.5, 2.0)):
        detector.update(other, at_s)
        assert detector.report.brightness == pytest.approx(brightness)
    detector.reset()
    assert detector.report.brightness == 1.0


@pytest.mark.parametrize(("share", "found"), [(0.012, True), (0.009, False)])
def test_a_marker_is_no_larger_than_its_share_of_the_image(profile: ColourProfile, share: float, found: bool) -> None:
    """A disc of 201 px in 19200."""
    detector = MarkerDetector(profile, MarkerSettings(largest_share=share))
    assert detector.update(SCENE, 0.0).found[0] == found
    assert (detector.report.too_big[0] == 0) == found


@pytest.mark.parametrize(("flags", "whole", "overflows"), [(0, 0, 0), (1, 2, 0), (3, 2, 2)])
def test_images_searched_as_a_whole_and_those_of_too_many_runs_are_counted(
    profile: ColourProfile, flags: int, whole: int, overflows: int
) -> None:
    detector = MarkerDetector(profile)

    def follow(image: Any, colours: Any, rows: Any, *_: Any) -> int:
        rows[3][:] = 0
        return flags

    detector._follow = follow
    for at_s in (0.0, 5.0):
        detector.update(SCENE, at_s)
    report = detector.report
    assert (report.images, report.whole_images, report.overflows) == (2, whole, overflows)


@pytest.mark.parametrize("width", [1, 7, 8, 9, 160, 163])
def test_buffers_have_room_for_each_pixel_of_a_row_and_each_run(width: int) -> None:
    """Labels are written eight at a time."""
    buffers = piece_buffers(width, 50)
    assert buffers.cells.shape == (width,)
    assert len(buffers.labels) % 8 == 0
    assert len(buffers.labels) >= width + 8
    assert [rows.shape for rows in (buffers.runs, buffers.parent, buffers.found)] == [(50, 4), (50,), (50, 11)]
