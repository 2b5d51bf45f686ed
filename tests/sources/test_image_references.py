"""References to the images of a take that lead nowhere."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mocapella.errors import InputError
from mocapella.model.images import ImageFrame, image_frame
from mocapella.sources.referenced_images import ReferencedImages, checksum, referred


def reference(path: Path) -> ImageFrame:
    pixels = np.zeros((2, 2, 3), np.uint8)
    return referred(image_frame("c1", pixels, time_ns=0), path, "0" * 64, 0)


@pytest.mark.parametrize("name", ["gone.mp4", "x" * 5000 + ".mp4", "a/" * 3000 + "b.mp4"])
def test_a_video_that_cannot_be_there_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="is not there any more"):
        ReferencedImages().resolve(reference(tmp_path / name))


@pytest.mark.parametrize("number", [-1, 1])
def test_a_frame_that_an_image_does_not_have_is_refused_and_its_only_one_is_read(tmp_path: Path, number: int) -> None:
    path = tmp_path / "one.png"
    assert cv2.imwrite(str(path), np.full((2, 3, 3), 7, np.uint8))
    frame = reference(path)
    images = ReferencedImages()
    with pytest.raises(InputError, match="frame"):
        images.resolve(referred(frame, path, checksum(path), number))
    assert (images.resolve(referred(frame, path, checksum(path), 0)).data == 7).all()


def test_a_folder_that_cannot_be_listed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", fails)
    with pytest.raises(InputError, match=r"cannot be read \(Permission denied\)"):
        checksum(tmp_path)
