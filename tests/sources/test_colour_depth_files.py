"""Folders of depth images with colour images, as a source of pairs."""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from mocapella.errors import InputError
from mocapella.sources.colour_depth_files import ColourDepthFiles
from mocapella.sources.depth_options import DepthOptions
from mocapella.sources.open_depth import open_depth

SIDECAR = "unit_m = 0.001\nlens = [20.0, 7.5, 5.5]\nfps = 10.0\n"
TURNED = "colour_lens = [30.0, 15.5, 11.5]\ncolour_from_depth = [1, 0, 0, 0.05, 0, 1, 0, 0, 0, 0, 1, 0]\n"


def make(folder: Path, names: list[str], colours: list[str], *, size: tuple[int, int] = (16, 12),
         sidecar: str = SIDECAR, into: str = "colour") -> Path:  # fmt: skip
    for part in ("depth", into):
        (folder / part).mkdir(parents=True)
    for k, name in enumerate(names):
        cv2.imwrite(str(folder / "depth" / f"{name}.png"), np.full((12, 16), 1000 + k, np.uint16))
    for k, name in enumerate(colours):
        cv2.imwrite(str(folder / into / f"{name}.png"), np.full((size[1], size[0], 3), 10 * k, np.uint8))
    (folder / "depth" / "depth.toml").write_text(sidecar, encoding="utf-8")
    return folder


@pytest.mark.parametrize("into", ["colour", "color", "rgb"])
def test_images_belong_together_by_their_order(tmp_path: Path, into: str) -> None:
    source = open_depth(str(make(tmp_path, ["a9", "a10"], ["x1", "x2"], into=into)), DepthOptions(colour=True))
    state = source.open()
    assert state.colour is not None
    assert (state.colour.size_px, state.colour.T_colour_depth) == ((16, 12), None)
    source.begin(0.0)
    pictures = [source.read(threading.Event()) for _ in range(2)]
    assert [(int(p.image[0, 0]), int(p.colour[0, 0, 0])) for p in pictures if p and p.colour is not None] == [
        (1000, 0), (1001, 10),
    ]  # fmt: skip


def test_images_named_by_times_belong_together_by_the_nearest_time(tmp_path: Path) -> None:
    folder = make(tmp_path, ["1305031102.160407", "1305031102.194330", "1305031102.500000"],
                  ["1305031102.175304", "1305031102.211214"])  # fmt: skip
    files = ColourDepthFiles(folder)
    found = list(files.images())
    assert [int(image.colour[0, 0, 0]) for image in found if image.colour is not None] == [0, 10]
    assert found[1].time_ns - found[0].time_ns == pytest.approx(33_923_000, abs=1000)
    assert files.count == 2


def test_a_colour_camera_beside_the_depth_camera_is_in_the_sidecar(tmp_path: Path) -> None:
    files = ColourDepthFiles(make(tmp_path, ["1"], ["1"], size=(32, 24), sidecar=SIDECAR + TURNED))
    colour = files.state.colour
    assert colour is not None
    assert colour.size_px == (32, 24)
    assert colour.lens[:4] == (30.0, 30.0, 15.5, 11.5)
    assert colour.T_colour_depth is not None
    assert colour.T_colour_depth[0] == (1.0, 0.0, 0.0, 0.05)


@pytest.mark.parametrize(
    ("colours", "size", "sidecar", "said"),
    [
        (["1"], (16, 12), SIDECAR, "1 images for 2 depth images"),
        (["1", "2"], (32, 24), SIDECAR, "colour_lens"),
        (["1", "2"], (16, 12), SIDECAR + "colour_lens = [1.0, 2.0]\n", "colour_lens"),
        (["1", "2"], (16, 12), SIDECAR + TURNED.replace("[1, 0", "[2, 0"), "colour_from_depth"),
        (["1", "2"], (16, 12), SIDECAR + TURNED.partition("\n")[2], "colour_from_depth"),
        (["7.5", "8.5"], (16, 12), SIDECAR, "2 depth images|differ"),
    ],
)
def test_what_does_not_belong_together_is_refused(
    tmp_path: Path, colours: list[str], size: tuple[int, int], sidecar: str, said: str
) -> None:
    names = ["1.5", "2.5"] if "." in colours[0] else ["1", "2"]
    folder = make(tmp_path, names, colours, size=size, sidecar=sidecar)
    with pytest.raises(InputError, match=said):
        ColourDepthFiles(folder)


def test_a_folder_without_colour_and_images_of_another_size_are_refused(tmp_path: Path) -> None:
    folder = make(tmp_path / "one", ["1", "2"], ["1", "2"])
    cv2.imwrite(str(folder / "colour" / "2.png"), np.zeros((6, 8, 3), np.uint8))
    with pytest.raises(InputError, match="8 × 6"):
        list(ColourDepthFiles(folder).images())
    with pytest.raises(InputError, match="no folder of colour images"):
        ColourDepthFiles(folder / "depth")
