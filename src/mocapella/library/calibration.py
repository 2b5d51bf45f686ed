"""Calibrate cameras by images of a board: files, folders or arrays; `mocapella calibrate cameras` uses it too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.cameras import CameraCalibration, Origin, calibrate_cameras
from mocapella.calibration.frame_sync import synchronise_frames
from mocapella.errors import CalibrationError, SettingsError, one_of
from mocapella.exports.needs import needed
from mocapella.model.board import Board, BoardView, load_board
from mocapella.model.camera import Camera, CameraRig
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.observations import check_sensor_name

UInt8 = NDArray[np.uint8]
Images = Path | str | Sequence[UInt8] | UInt8
"""Images of one camera: a video, an image or a folder, or arrays (height, width[, 3]) uint8, gray or BGR."""
Instants = dict[tuple[str, int], int]

ALONE_FROM: Final = 1_000_000
"""First frame number of views for one lens alone, so that they are never paired with another camera's frame."""


def calibrate(
    cameras: Mapping[str, Images] | Sequence[Path | str],
    board: Board | Path | str,
    *,
    times: Mapping[str, Sequence[float]] | Path | str | None = None,
    tolerance_s: float | None = None,
    rig: CameraRig | Path | str | None = None,
    alone: Mapping[str, Images] | None = None,
    frames: str | None = None,
    origin: int | None = None,
    upright: bool = False,
) -> CameraCalibration:
    """Calibrate intrinsics and extrinsics of cameras by their images of a board.

    found = mocapella.calibrate({"left": "left.mp4", "right": "right.mp4"}, "board.toml")
    save_camera_rig(Path("rig.toml"), found.rig)

    Args:
        cameras: images of each camera by its name; a sequence of files is named by the files.
        board: the board, or its TOML file.
        times: capture times of each camera's frames on one clock [s], or their CSV; without them, frames of equal
            numbers are simultaneous.
        tolerance_s: largest difference of simultaneous frames; a third of the frame interval if None [s].
        rig: a rig whose intrinsics are kept, or its file.
        alone: more images of the board by camera, for that camera's lens only.
        frames: the frames to use: ``odd``, ``even`` or ``FROM:TO:STEP``; all if None.
        origin: number of the frame whose board, lying on the floor, is the world.
        upright: whether the board of ``origin`` hangs on a wall.

    Returns:
        The rig, the quality of each camera, and hints.

    Raises:
        CalibrationError: the images do not determine the cameras; says what to film.
        InputError: a file cannot be used.
        SettingsError: an argument is invalid, or OpenCV is not installed; names the extra.
    """
    needed("cv2", extra="cameras")
    from mocapella.sources.video import parse_frames

    inputs = cameras if isinstance(cameras, Mapping) else named_inputs([str(path) for path in cameras])
    for name in inputs:
        check_sensor_name(name)
    chosen = board if isinstance(board, Board) else load_board(board)
    label = "the board" if isinstance(board, Board) else str(board)
    known = {} if rig is None else known_lenses(rig, inputs)
    wanted = parse_frames(frames)
    views, counts = board_views(inputs, chosen, wanted, label)
    instants = simultaneous(views, times, tolerance_s, counts)
    extra = views_alone(alone or {}, inputs, chosen, wanted, label)
    return calibrate_views(views, instants, extra, chosen, known=known, origin=origin, upright=upright)


def calibrate_views(
    views: Sequence[BoardView], instants: Mapping[tuple[str, int], int], extra: Sequence[BoardView], board: Board, *,
    known: Mapping[str, Camera], origin: int | None = None, upright: bool = False,
) -> CameraCalibration:  # fmt: skip
    """Calibrate cameras by views of a board.

    Args:
        views: the views; those in no group are left out.
        instants: number of the group of simultaneous frames by camera and frame.
        extra: views for one camera's lens each, with frame numbers of their own.
        board: the board.
        known: lenses to keep, by camera.
        origin, upright: as in `calibrate`.

    Raises:
        CalibrationError: the views do not determine it.
        SettingsError: no camera has the frame ``origin``.
    """
    groups = {**instants, **{(view.camera, view.frame): view.frame for view in extra}}
    paired = [view for view in views if (view.camera, view.frame) in groups]
    place = None if origin is None else Origin(_instant_of(origin, groups), upright)
    return calibrate_cameras([*paired, *extra], board, groups, known=known, origin=place)


def board_views(
    inputs: Mapping[str, Images], board: Board, wanted: Any, label: str, say: Callable[[str], None] = lambda text: None
) -> tuple[list[BoardView], dict[str, int]]:
    """Detect the board in the images of all cameras.

    Args:
        inputs: images by the camera's name.
        board: the board to detect.
        wanted: the frames to use (`mocapella.sources.video.Frames`).
        label: what the board is called in errors, such as its file.
        say: receives a line about each camera.

    Returns:
        The board's views; and by camera, the number of the last frame that was searched plus one.

    Raises:
        CalibrationError: a camera never sees the board; the message describes what its images show.
    """
    from mocapella.sensing import boards

    views, counts = [], {}
    for name, images in inputs.items():
        detector = boards.BoardDetector(board)
        without: list[UInt8] = []
        for frame, image in _numbered(images, wanted):
            counts[name] = frame + 1
            view = detector.update(image, name, frame)
            if view is not None:
                views.append(view)
            elif len(without) < 3 and not detector.report.found:
                without.append(image)
        report = detector.report
        if not report.found:
            raise CalibrationError(f"camera {name}: {boards.why_not_found(without, board)} ({label})")
        say(f"{name}: the board in {report.found} of {report.pictures} pictures, {report.corners} corners")
    return views, counts


def _numbered(images: Images, wanted: Any) -> Iterator[tuple[int, UInt8]]:
    """Yield number and image of the wanted frames."""
    from mocapella.sources.video import pictures

    if isinstance(images, Path | str):
        yield from pictures(images, wanted)
        return
    for number, image in enumerate(images):
        if np.ndim(image) not in (2, 3) or np.asarray(image).dtype != np.uint8:
            raise SettingsError(
                f"image {number} is {np.shape(image)} of {np.asarray(image).dtype}; give (height, width[, 3]) uint8"
            )
        if wanted.wants(number):
            yield number, np.asarray(image)


def views_alone(
    more: Mapping[str, Images], inputs: Iterable[str], board: Board, wanted: Any, label: str, *,
    say: Callable[[str], None] = lambda text: None,
) -> list[BoardView]:  # fmt: skip
    """Return the board's views for one camera's lens each, under frame numbers of their own; arguments as above.

    Raises:
        SettingsError: a name is not one of the cameras ``inputs``.
    """
    extra: list[BoardView] = []
    for name, images in more.items():
        if name not in inputs:
            raise SettingsError(f"alone {name}: no such camera; there are {one_of(name, list(inputs))}")
        seen, _ = board_views({name: images}, board, wanted, label, say)
        extra += [msgspec.structs.replace(view, frame=ALONE_FROM + len(extra) + k) for k, view in enumerate(seen)]
    return extra


def simultaneous(
    views: Sequence[BoardView], times: Mapping[str, Sequence[float]] | Path | str | None, tolerance_s: float | None,
    counts: Mapping[str, int], say: Callable[[str], None] = lambda text: None,
) -> Instants:  # fmt: skip
    """Return the number of the group of simultaneous frames, by camera and frame number.

    Args:
        views: the views.
        times, tolerance_s: as in `calibrate`.
        counts: number of frames by camera.
        say: receives a line about each camera that has more frames than times.

    Raises:
        SettingsError: a tolerance is given without times.
        InputError, CalibrationError: the times cannot be used.
    """
    if times is None:
        if tolerance_s is not None:
            raise SettingsError("a tolerance has no meaning without timestamps; give both or none")
        return {(view.camera, view.frame): view.frame for view in views}
    if isinstance(times, Path | str):
        from mocapella.sources.video import read_timestamps

        source, known = str(times), read_timestamps(times, list(counts))
    else:
        missing = [name for name in counts if name not in times]
        if missing:
            raise SettingsError(f"times of {missing[0]} are missing; there are {one_of(missing[0], list(times))}")
        source, known = "times", {name: list(times[name]) for name in counts}
    for name, count in counts.items():
        if len(known[name]) < count:
            say(f"{source}: {len(known[name])} times for {count} frames of {name}; the rest is left out")
    return synchronise_frames(known, tolerance_s)


def known_lenses(rig: CameraRig | Path | str, inputs: Iterable[str]) -> dict[str, Camera]:
    """Return the lenses of a rig, or its file, for the cameras ``inputs``.

    Raises:
        SettingsError: the rig has no such camera; lists its cameras.
        InputError: the file cannot be used.
    """
    cameras = rig.cameras if isinstance(rig, CameraRig) else load_camera_rig(Path(rig)).cameras
    missing = [name for name in inputs if name not in cameras]
    if missing:
        where = "the rig" if isinstance(rig, CameraRig) else f"rig {rig}"
        raise SettingsError(
            f"{where} has no camera {missing[0]!r}; it has {one_of(missing[0], list(cameras))}: name the cameras so"
        )
    return {name: cameras[name].camera for name in inputs}


def named_inputs(texts: Sequence[str], prefix: str = "") -> dict[str, str]:
    """Parse ``[NAME=]PATH`` texts; return the paths by camera name, in the order of the texts.

    Without NAME, a camera is called like the file without its suffix (``camera_0`` for ``camera:0``); one whose path
    begins with ``prefix``, such as that of a node, keeps its name.

    Raises:
        SettingsError: an invalid or repeated name.
    """
    found: dict[str, str] = {}
    for text in texts:
        name, path = named_input(text, prefix)
        if name in found:
            raise SettingsError(f"two cameras are called {name!r}; write NAME=VIDEO to tell them apart")
        found[name] = path
    return found


def named_input(text: str, prefix: str = "") -> tuple[str, str]:
    """Parse one text as in `named_inputs`; return the name and the path."""
    name, equals, path = text.partition("=")
    if not equals:
        name, path = Path(text).stem.replace(":", "_"), text
    if prefix and path.startswith(prefix):
        called = path.removeprefix(prefix)
        if equals and name != called:
            raise SettingsError(f"{text}: a node's camera keeps its name; write {path}")
        name = called
    return check_sensor_name(name), path


def _instant_of(frame: int, instants: Mapping[tuple[str, int], int]) -> int:
    found = [instant for (_, number), instant in instants.items() if number == frame]
    if not found:
        raise SettingsError(f"origin {frame}: no camera has that frame; take a frame that shows the board")
    return found[0]
