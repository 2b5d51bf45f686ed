"""Pictures with outlines."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mocapella.errors import InputError
from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.outline_picture import MODEL, SEGMENTED, OverlayWriter, outlined, side_by_side


def square(x, y, side, step=1):
    return Silhouette((x - 2 * step, y - 2 * step), step, np.pad(np.ones((side, side), np.float32), 2) - 0.5)


def near(picture, colour):
    return np.abs(picture.astype(int) - colour).max(axis=-1) < 60


@pytest.mark.parametrize("step", [1, 2])
def test_outlines_lie_on_the_border_of_what_they_are_of(step):
    image = np.full((60, 80, 3), 128, np.uint8)
    picture = outlined(image, square(10, 12, 10, step), square(40, 20, 12, step))
    assert (image == 128).all()
    for colour, x, y, side in ((SEGMENTED, 10, 12, 10), (MODEL, 40, 20, 12)):
        rows, columns = np.nonzero(near(picture, colour))
        assert abs(columns.min() - x) <= step
        assert abs(rows.min() - y) <= step
        assert abs(columns.max() - (x + step * (side - 1))) <= step
        assert not near(picture, colour)[y + step * side // 2, x + step * side // 2]


def test_a_smaller_picture_has_its_outlines_where_they_belong():
    picture = outlined(np.full((60, 80, 3), 128, np.uint8), None, square(40, 20, 12), 40)
    assert picture.shape == (30, 40, 3)
    rows, columns = np.nonzero(near(picture, MODEL))
    assert abs(columns.mean() - 22.5) < 2
    assert abs(rows.mean() - 12.5) < 2


def test_pictures_of_any_size_stand_in_a_row():
    joined = side_by_side([np.zeros((60, 80, 3), np.uint8), np.zeros((100, 51, 3), np.uint8)], 50)
    assert joined.shape[0] == 50
    assert joined.shape[1] % 2 == 0


def test_where_nothing_can_be_written_is_said(tmp_path):
    for path in (tmp_path / "no" / "folder", tmp_path / "no" / "film.mp4", tmp_path / "film.avi"):
        with pytest.raises(InputError, match="--overlay"):
            OverlayWriter(path, 30.0)
    writer = OverlayWriter(tmp_path / "seen", 30.0)
    writer.write(7, {"c1": np.zeros((20, 20, 3), np.uint8)})
    writer.close()
    assert cv2.imread(str(tmp_path / "seen" / "c1_000007.jpg")).shape == (20, 20, 3)
