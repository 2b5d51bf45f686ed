"""What is taken for each colour, as a picture."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.markers import marker_frame
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sensing.colour_table import cell_of
from mocapella.sensing.marker_mask import encode_image, labels_of, mask_image, paint_of
from mocapella.sensing.markers import MarkerDetector
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import load_hand_scene

UInt8 = NDArray[np.uint8]
SCENE = load_hand_scene("demo", seed=3)


@cache
def profile() -> ColourProfile:
    """Like the shot, not while tests are collected: all workers would compile for it at once."""
    return pointed_at(SCENE, "left")


@cache
def shot() -> UInt8:
    return SCENE.at("left", 0.2).image


def test_labels_are_those_of_the_table() -> None:
    rng = np.random.default_rng(0)
    table = rng.integers(0, 7, 32768).astype(np.uint8)
    image = rng.integers(0, 256, (40, 50, 3)).astype(np.uint8)
    np.testing.assert_array_equal(labels_of(image, table), table[cell_of(image)])


def test_every_colour_is_painted_where_it_is_and_only_there() -> None:
    detector = MarkerDetector(profile())
    labels, mask = labels_of(shot(), detector.table), mask_image(shot(), profile(), detector.table)
    paint = paint_of(profile())
    assert len({tuple(row) for row in paint.tolist()}) == len(profile().colours) + 1
    for label in range(1, len(paint)):
        assert (labels == label).any()
        np.testing.assert_array_equal(mask[labels == label], np.broadcast_to(paint[label], mask[labels == label].shape))
    rest = mask[labels == 0]
    assert (rest[:, 0] == rest[:, 1]).all()
    assert (rest[:, 1] == rest[:, 2]).all()
    assert rest.max() < 128


def test_crosses_stand_where_markers_were_found() -> None:
    detector = MarkerDetector(profile())
    frame = detector.update(shot(), 0.0)
    plain, crossed = (mask_image(shot(), profile(), detector.table, f) for f in (None, frame))
    changed = (plain != crossed).any(axis=-1)
    for x, y in frame.positions_px:
        assert changed[round(float(y)), round(float(x))]
    assert changed.mean() < 0.1


def test_a_cross_reaches_as_far_to_every_side() -> None:
    image, table = np.zeros((60, 80, 3), np.uint8), np.zeros(32768, np.uint8)
    frame = marker_frame("left", ["red"], time_ns=0, size_px=(80, 60), positions_px=[[40, 30]])
    bright = mask_image(image, profile(), table, frame)[..., 0] > 128
    across, down = np.flatnonzero(bright[30]) - 40, np.flatnonzero(bright[:, 40]) - 30
    np.testing.assert_array_equal(across, down)
    np.testing.assert_array_equal(across, -across[::-1])
    assert len(across) > 10


def test_pictures_are_encoded_as_asked_for() -> None:
    again = cv2.imdecode(np.frombuffer(encode_image(shot(), "png"), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(again, shot())
    half = cv2.imdecode(np.frombuffer(encode_image(shot(), "jpeg", 0.5), np.uint8), cv2.IMREAD_COLOR)
    assert half.shape == (120, 160, 3)
    assert np.abs(half.astype(float) - cv2.resize(shot(), (160, 120), interpolation=cv2.INTER_AREA)).mean() < 8
    with pytest.raises(SettingsError, match="nothing of 4 × 4 px would be left"):
        encode_image(np.zeros((4, 4, 3), np.uint8), "png", 0.05)
