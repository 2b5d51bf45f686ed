from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from support.marker_images import discs, profile, scene, shot

from mocapella.errors import SettingsError
from mocapella.sensing import marker_piece_kernels as kernels
from mocapella.sensing.colour_learning import ColourSample, learn_colours
from mocapella.sensing.markers import MarkerDetector, MarkerSettings, piece_buffers

RED, BLUE = (20, 15, 190), (180, 60, 20)
TABLE = np.zeros(32768, np.uint8)  # the label is red // 8
for _k in range(32):
    TABLE[_k << 10 : (_k + 1) << 10] = _k


def pieces(
    labels: np.ndarray, box: tuple[int, int, int, int] | None = None, runs: int = 5000
) -> tuple[int, np.ndarray]:
    image = np.zeros((*labels.shape, 3), np.uint8)
    image[..., 2] = 8 * labels
    buffers = piece_buffers(labels.shape[1], runs)
    x0, y0, x1, y1 = box or (0, 0, labels.shape[1], labels.shape[0])
    return kernels.pieces(image, TABLE, x0, y0, x1, y1, 0, buffers), buffers.found


def two_discs(x: float = 60.0, y: float = 50.0, radius: float = 8.0) -> np.ndarray:
    return discs((x, y, radius, RED), (110.0, 80.0, 9.0, BLUE))


@pytest.fixture(scope="module")
def detector() -> MarkerDetector:
    learnt = learn_colours("left", [ColourSample(two_discs(), {"red": (60, 50), "blue": (110, 80)})])
    return MarkerDetector(learnt)


@pytest.mark.slow
@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 40), st.integers(1, 30), st.floats(0.1, 0.9))
def test_pieces_are_those_of_scipy(seed: int, kinds: int, width: int, height: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    labels = rng.integers(1, kinds + 1, (height, width)) * (rng.random((height, width)) < share)
    count, found = pieces(labels)
    expected = []
    for kind in range(1, kinds + 1):
        numbered, n = ndimage.label(labels == kind, np.ones((3, 3)))
        for i in range(1, n + 1):
            y, x = np.nonzero(numbered == i)
            sums = (x.sum(), y.sum(), (x * x).sum(), (x * y).sum(), (y * y).sum())
            expected.append((kind, len(x), *sums, x.min(), y.min(), x.max(), y.max()))
    assert sorted(map(tuple, found[:count])) == sorted(expected)


@pytest.mark.slow
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 20), st.integers(1, 20), st.floats(0.02, 0.98), st.booleans())
def test_a_piece_is_filled_between_its_pixels_of_each_row_and_column(
    seed: int, width: int, height: int, share: float, tight: bool
) -> None:
    there = np.random.default_rng(seed).random((height, width)) < share
    there[0, 0] |= not there.any()
    image = np.zeros((height, width, 3), np.uint8)
    image[there, 2] = 8
    y, x = np.nonzero(there)
    box = (x.min(), y.min(), x.max(), y.max()) if tight else (0, 0, width - 1, height - 1)
    piece = np.array([1.0, *np.zeros(6), *box])
    kernels.fill(image, TABLE, 1, piece, 2, 3)
    for row in range(height):
        inside = np.flatnonzero(there[row])
        if len(inside):
            there[row, inside[0] : inside[-1] + 1] |= True
    rows = np.zeros_like(there)
    for column in range(width):
        inside = np.flatnonzero(image[:, column, 2])
        if len(inside):
            rows[inside[0] : inside[-1] + 1, column] = True
    y, x = np.nonzero(there | rows)
    x, y = x - 2, y - 3
    assert piece[1:7].tolist() == [len(x), x.sum(), y.sum(), (x * x).sum(), (x * y).sum(), (y * y).sum()]


@pytest.mark.slow
@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(0, 20), st.integers(0, 20), st.integers(1, 20), st.integers(1, 20))
def test_pieces_of_a_part_are_those_of_the_part_alone(seed: int, x: int, y: int, w: int, h: int) -> None:
    labels = np.random.default_rng(seed).integers(0, 3, (40, 40))
    count, found = pieces(labels, (x, y, x + w, y + h))
    found = found[:count].copy()
    alone, expected = pieces(labels[y : y + h, x : x + w].copy())
    found[:, kernels.X0 :] -= [x, y, x, y]
    assert sorted(map(tuple, found)) == sorted(map(tuple, expected[:alone]))


def test_more_runs_than_room_is_told() -> None:
    labels = np.indices((20, 20)).sum(axis=0) % 2
    assert pieces(labels)[0] == 1
    assert pieces(labels, runs=50)[0] < 0


@settings(max_examples=25)
@given(st.floats(40, 70), st.floats(40, 60), st.integers(-20, 20), st.integers(-15, 15))
def test_a_moved_marker_moves_its_centre(detector: MarkerDetector, x: float, y: float, dx: int, dy: int) -> None:
    centres = []
    for at in ((x, y), (x + dx, y + dy)):
        detector.reset()
        centres.append(detector.update(two_discs(*at), 0.0).positions_px[0])
    np.testing.assert_allclose(centres[1] - centres[0], (dx, dy), atol=1e-3)


@settings(max_examples=25)
@given(st.floats(40, 70), st.floats(40, 60), st.floats(5, 12))
def test_a_centre_is_that_of_the_disc(detector: MarkerDetector, x: float, y: float, radius: float) -> None:
    detector.reset()
    np.testing.assert_allclose(detector.update(two_discs(x, y, radius), 0.0).positions_px[0], (x, y), atol=0.1)


def test_in_a_window_it_is_as_in_the_whole_image() -> None:
    windows, whole = MarkerDetector(profile()), MarkerDetector(profile(), MarkerSettings(whole_image_s=0.0))
    for k in range(8):
        image = shot(k / 30).image
        a, b = windows.update(image, k / 30), whole.update(image, k / 30)
        for name in ("positions_px", "sd_px", "areas_px", "elongations", "confidences"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert windows.report.whole_images == 1
    assert whole.report.whole_images == 8


@pytest.mark.parametrize("at", [(0, 0), (159, 0), (0, 119), (159, 119), (80, 0), (0, 60)])
def test_at_the_border_it_is_followed_and_less_sure(detector: MarkerDetector, at: tuple[int, int]) -> None:
    detector.reset()
    inside = np.clip(at, 20, (139, 99))
    sure = detector.update(two_discs(*inside), 0.0)
    for k in range(1, 6):
        x, y = inside + k / 5 * (np.array(at) - inside)
        cut = detector.update(two_discs(x, y), k / 30)
    assert cut.found.all()
    assert cut.sd_px[0] > 3 * sure.sd_px[0]
    assert cut.confidences[0] < 0.6 * sure.confidences[0]


def test_lost_it_is_found_again_anywhere_in_the_same_image(detector: MarkerDetector) -> None:
    detector.reset()
    detector.update(two_discs(30, 30), 0.0)
    gone = detector.update(discs((110.0, 80.0, 9.0, BLUE)), 1 / 30)
    np.testing.assert_array_equal(gone.found, [False, True])
    assert np.isnan(gone.positions_px[0]).all()
    assert gone.confidences[0] == gone.areas_px[0] == gone.candidates[0] == 0
    back = detector.update(two_discs(60, 100), 2 / 30)
    np.testing.assert_allclose(back.positions_px[0], (60, 100), atol=0.1)
    np.testing.assert_array_equal(detector.report.found, [2, 3])


def test_of_two_of_one_colour_the_one_near_the_prediction_is_taken_and_counted(detector: MarkerDetector) -> None:
    detector.reset()
    for k in range(4):
        detector.update(two_discs(40 + k, 50), k / 30)
    both = discs((44.0, 50.0, 8.0, RED), (64.0, 50.0, 8.0, RED), (110.0, 80.0, 9.0, BLUE))
    frame = detector.update(both, 4 / 30)
    np.testing.assert_allclose(frame.positions_px[0], (44, 50), atol=0.1)
    np.testing.assert_array_equal(frame.candidates, [2, 1])
    np.testing.assert_array_equal(detector.report.ambiguous, [1, 0])


@pytest.mark.parametrize(
    ("planted", "reason"),
    [((30.0, 30.0, 1.5, RED), "too_small"), ((40.0, 60.0, 35.0, RED), "too_big")],
)
def test_what_is_no_marker_by_its_size_is_rejected_and_counted(
    detector: MarkerDetector, planted: tuple[float, float, float, tuple[int, int, int]], reason: str
) -> None:
    detector.reset()
    assert not detector.update(discs(planted), 0.0).found[0]
    assert getattr(detector.report, reason)[0] > 0


def test_a_line_of_a_markers_colour_is_none(detector: MarkerDetector) -> None:
    detector.reset()
    image = discs()
    image[60:63, 20:120] = RED
    assert not detector.update(image, 0.0).found[0]
    assert detector.report.wrong_shape[0] > 0


def test_a_reflection_does_not_move_the_centre(detector: MarkerDetector) -> None:
    detector.reset()
    image = discs((60.0, 50.0, 9.0, RED), (64.0, 47.0, 3.0, (250, 250, 250)), (110.0, 80.0, 9.0, BLUE))
    np.testing.assert_allclose(detector.update(image, 0.0).positions_px[0], (60, 50), atol=0.2)


@pytest.mark.parametrize(("factor", "what"), [(0.4, "as bright"), (1.0, "")])
def test_other_light_than_learnt_is_said(factor: float, what: str) -> None:
    detector = MarkerDetector(profile())
    detector.update((shot(0.0).image * factor).astype(np.uint8), 0.0)
    assert what in detector.report.light
    assert bool(detector.report.light) == bool(what)


def test_light_of_another_colour_is_said() -> None:
    detector = MarkerDetector(profile())
    detector.update((shot(0.0).image * np.array([0.7, 1.0, 1.0])).astype(np.uint8), 0.0)
    assert "another colour" in detector.report.light


def test_images_of_another_size_or_type_are_refused() -> None:
    detector = MarkerDetector(profile())
    with pytest.raises(SettingsError, match=r"320 × 240.*160 × 120"):
        detector.update(np.zeros((120, 160, 3), np.uint8), 0.0)
    for image in (np.zeros((240, 320), np.uint8), np.zeros((240, 320, 3), np.float32)):
        with pytest.raises(SettingsError, match="must be uint8"):
            detector.update(image, 0.0)


def test_a_view_and_an_image_of_a_message_are_read_alike() -> None:
    image = shot(0.0).image
    expected = MarkerDetector(profile()).update(image, 0.0).positions_px
    fixed = np.frombuffer(image.tobytes(), np.uint8).reshape(image.shape)
    for other in (fixed, np.repeat(image, 2, axis=1)[:, ::2]):
        np.testing.assert_array_equal(MarkerDetector(profile()).update(other, 0.0).positions_px, expected)


def test_the_same_images_give_the_same_frames_after_a_reset() -> None:
    detector = MarkerDetector(profile())
    first = [detector.update(shot(k / 30).image, k / 30).positions_px for k in range(3)]
    detector.reset()
    again = [detector.update(shot(k / 30).image, k / 30).positions_px for k in range(3)]
    np.testing.assert_array_equal(first, again)
    assert detector.report.images == 3


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(MarkerSettings) if field.name != "table"])
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        MarkerSettings(**{name: -1.0})


@pytest.mark.parametrize("name", ["desk", "window", "lamp"])
def test_rendered_hands(name: str) -> None:
    """Found in every image where it is seen, near the truth, and nowhere else."""
    detector, names = MarkerDetector(profile(name)), scene(name).names
    errors = []
    for k in range(15):
        seen = shot(k / 15, name)
        frame = detector.update(seen.image, k / 15)
        assert frame.names == names
        off = np.linalg.norm(frame.positions_px - seen.centres_px, axis=-1)
        assert frame.found[seen.visible > 0.9].all()
        assert not frame.found[seen.visible < 0.05].any()
        errors.append(off[seen.visible > 0.9])
    off = np.concatenate(errors)
    assert np.median(off) < 0.35
    assert off.max() < 2.0
