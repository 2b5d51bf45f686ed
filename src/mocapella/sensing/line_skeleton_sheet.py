"""Draw the stages of `mocapella.sensing.line_skeleton`, and write them to files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.arms import ARM_BONES
from mocapella.sensing.line_skeleton import Looked
from mocapella.sensing.line_skeleton_joints import HandJoints
from mocapella.sensing.line_skeleton_outline import ArmOutline

UInt8 = NDArray[np.uint8]

_TILE_PX: Final = 256
_LINE_PX: Final = 18
_COLUMNS: Final = 5
_RED, _GREEN, _BLUE, _YELLOW = (60, 60, 255), (80, 220, 80), (255, 150, 60), (60, 220, 255)
_FINGERS: Final = ((60, 60, 255), (60, 220, 255), (80, 220, 80), (255, 180, 60), (255, 80, 220))
_BITS: Final = 4


def pictures(looked: Looked) -> Mapping[str, UInt8]:
    """Draw the result of each stage that was reached, by its name, in the order of processing.

    Returns:
        (height, width) gray or (height, width, 3) BGR uint8 images by name; some are arrays of ``looked``, not copies.
    """
    first, second, third, hand = looked.separated, looked.outline, looked.lines, looked.hand
    most = max(int(first.millimetres.max()), 1)
    out: dict[str, UInt8] = {
        "16 bits": (first.millimetres.astype(np.float64) * 255 / most).astype(np.uint8),
        "8 bits": first.gray,
        "median": first.median,
        "Gaussian": first.gaussian,
        "threshold": first.near,
        "mirror": first.mirrored,
    }
    if second is None:
        return out
    out |= {"Canny": second.edges, "contours": _contours(second), "circular region": _region(second, hand)}
    out["noise"] = _noise(second)
    if third is None:
        return out
    made = third.skeleton
    out |= {
        "thinning": made.thinned,
        "distance transform": (made.distance * np.float32(255 / max(float(made.distance.max()), 1.0))).astype(np.uint8),
        "Laplacian, normalised": made.ridges,
        "dilation": made.dilated,
        "thin on ridges": made.lines,
        "Hough": _segments(second, third.segments),
    }
    if hand is None:
        return out
    if looked.grid is not None:
        points = np.zeros_like(second.arm)
        points[looked.grid.pixels[:, 1], looked.grid.pixels[:, 0]] = 255
        out["grid"] = points
    out |= {"Harris": _dots(second, hand.corners, _GREEN), "convex hulls": _hulls(second, hand)}
    out |= {"outer fingers": _dots(second, hand.outer, _GREEN), "blobs": _dots(second, hand.blobs, _BLUE)}
    out["arm"] = _arm(second, hand, looked)
    return out


def contact_sheet(stages: Mapping[str, UInt8], columns: int = _COLUMNS) -> UInt8:
    """Draw all images into one, ``columns`` in a row, each under its number and name; return (height, width, 3) BGR.

    Args:
        stages: at least one uint8 image, (height, width) gray or (height, width, 3) BGR, by name; scaled to 256 px of
            width.
        columns: number of images in a row.
    """
    tiles: list[Any] = []
    for number, (name, picture) in enumerate(stages.items(), start=1):
        image: Any = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
        scale = _TILE_PX / image.shape[1]
        size = _TILE_PX, max(round(image.shape[0] * scale), 1)
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST)
        tile = np.full((size[1] + _LINE_PX, _TILE_PX, 3), 255, dtype=np.uint8)
        tile[_LINE_PX:] = small
        where = (4, _LINE_PX - 5)
        cv2.putText(tile, f"{number} {name}", where, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
        tiles.append(np.pad(tile, ((2, 2), (2, 2), (0, 0)), constant_values=255))
    blank = np.full_like(tiles[0], 255)
    rows = math.ceil(len(tiles) / columns)
    tiles += [blank] * (rows * columns - len(tiles))
    return np.vstack([np.hstack(tiles[r * columns : (r + 1) * columns]) for r in range(rows)])


def write_stages(stages: Mapping[str, UInt8], folder: Path, name: str = "stages") -> tuple[Path, ...]:
    """Write each image and the contact sheet as PNG into a folder.

    The files are ``NAME-01-STAGE.png`` and so on, as `write_pictures` numbers them, and ``NAME-sheet.png``. Existing
    ones are replaced.

    Args:
        stages: at least one image of `LineSkeleton.stages`, (height, width) gray or (height, width, 3) BGR, uint8, by
            name.
        folder: created if missing.
        name: beginning of the files' names, such as the image's name.

    Returns:
        The files; the contact sheet is the last.

    Raises:
        SettingsError: they cannot be written there.
    """
    files = write_pictures(stages, folder, f"{name}-")
    return (*files, write_picture(folder / f"{name}-sheet.png", contact_sheet(stages)))


def write_pictures(stages: Mapping[str, UInt8], folder: Path, prefix: str = "") -> tuple[Path, ...]:
    """Write images as numbered PNG files, of any size, without a contact sheet.

    Args:
        stages: images, (height, width) gray or (height, width, 3) BGR, uint8, by name, in order.
        folder: created if missing.
        prefix: beginning of the files' names; their numbers, from 01, and names follow. Such files are replaced.

    Returns:
        The files, in order.

    Raises:
        SettingsError: they cannot be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError(f"{folder}: {error.strerror}; name a folder that can be written to") from error
    files = []
    for number, (stage, picture) in enumerate(stages.items(), start=1):
        word = "".join(letter if letter.isalnum() else "-" for letter in stage.lower()).replace("--", "-")
        files.append(write_picture(folder / f"{prefix}{number:02d}-{word}.png", picture))
    return tuple(files)


def write_picture(path: Path, picture: UInt8) -> Path:
    """Write an image, (height, width) gray or (height, width, 3) BGR, uint8, as PNG; return the path.

    An existing file is replaced; the folder must exist.

    Raises:
        SettingsError: it cannot be written there.
    """
    try:
        path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    except OSError as error:
        raise SettingsError(f"{path}: {error.strerror}; name a folder that can be written to") from error
    return path


def _dim(of: ArmOutline) -> Any:
    return cv2.cvtColor((of.arm // 4).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def _contours(of: ArmOutline) -> UInt8:
    image: Any = np.zeros((*of.arm.shape, 3), dtype=np.uint8)
    for number, one in enumerate(of.outlines):
        cv2.polylines(image, [one[:, None]], True, _GREEN if number == 0 else _RED, 2)
    return np.asarray(image)


def _region(of: ArmOutline, hand: HandJoints | None) -> UInt8:
    image = _dim(of)
    _circle(image, of.centre, of.radius_px, _YELLOW)
    if hand is not None:
        _circle(image, hand.palm, hand.inside_px, _GREEN)
    return np.asarray(image)


def _noise(of: ArmOutline) -> UInt8:
    image = _dim(of)
    image[of.noisy] = 255
    return np.asarray(image)


def _segments(of: ArmOutline, segments: NDArray[np.float64]) -> UInt8:
    image = _dim(of)
    for x0, y0, x1, y1 in segments:
        cv2.line(image, (round(x0), round(y0)), (round(x1), round(y1)), _YELLOW, 2, cv2.LINE_AA)
        cv2.circle(image, (round(x0), round(y0)), 4, _RED, -1, cv2.LINE_AA)
    return np.asarray(image)


def _dots(of: ArmOutline, pixels: NDArray[np.float64], colour: tuple[int, int, int]) -> UInt8:
    image = _dim(of)
    for x, y in pixels:
        cv2.circle(image, (round(x), round(y)), 4, colour, -1, cv2.LINE_AA)
    return np.asarray(image)


def _hulls(of: ArmOutline, hand: HandJoints) -> UInt8:
    image = _dim(of)
    for one in hand.hulls:
        cv2.polylines(image, [one[:, None]], True, _YELLOW, 2, cv2.LINE_AA)
    return np.asarray(image)


def _arm(of: ArmOutline, hand: HandJoints, looked: Looked) -> UInt8:
    image = _dim(of)
    pixels = np.concatenate([[hand.elbow, hand.wrist, hand.palm], hand.tips])
    if looked.found is not None:
        pixels[~looked.found] = hand.palm
    for a, b in ARM_BONES:
        cv2.line(image, _fixed(pixels[a]), _fixed(pixels[b]), (255, 255, 255), 2, cv2.LINE_AA, _BITS)
    for pixel, colour in zip(pixels, ((255, 255, 255),) * 3 + _FINGERS, strict=True):
        _circle(image, pixel, 6.0, colour, cv2.FILLED)
    return np.asarray(image)


def _circle(image: Any, centre: NDArray[np.float64], radius: float, colour: Any, width: int = 2) -> None:
    cv2.circle(image, _fixed(centre), round(radius * 2**_BITS), colour, width, cv2.LINE_AA, _BITS)


def _fixed(pixel: NDArray[np.float64]) -> tuple[int, int]:
    return round(float(pixel[0]) * 2**_BITS), round(float(pixel[1]) * 2**_BITS)
