"""References to the images of a take that lead nowhere."""

from __future__ import annotations

from pathlib import Path

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


def test_a_folder_that_cannot_be_listed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", fails)
    with pytest.raises(InputError, match=r"cannot be read \(Permission denied\)"):
        checksum(tmp_path)
